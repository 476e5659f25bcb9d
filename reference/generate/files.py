"""Arrays and descriptions as bytes: the same numbers always give the same file."""

import hashlib
import io
import json
import math
import random
import zipfile

import numpy as np
from mpmath import mp, mpf

SMALLEST_NORMAL = mpf(2)**-1022


def to_float(x):
    """The nearest float64, subnormal numbers included (mpmath would round those twice)."""
    if mp.isfinite(x) and 0 < abs(x) < SMALLEST_NORMAL:
        return math.ldexp(float(int(mp.nint(mp.ldexp(x, 1074)))), -1074)
    return float(x)


def pseudo_random(key, shape):
    """Uniform numbers in [-1, 1): Python's Mersenne Twister, whose stream is fixed for all versions."""
    stream = random.Random(key)
    return np.array([2 * stream.random() - 1 for _ in range(int(np.prod(shape)))]).reshape(shape)


def npy_bytes(array):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(array, dtype="<f8"), version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def npz_bytes(arrays):
    """An uncompressed zip without timestamps or an operating system."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, npy_bytes(array))
    return stream.getvalue()


def json_bytes(content):
    return (json.dumps(content, indent=1) + "\n").encode()


def file_bytes(path, content):
    """The bytes of a file; the format follows from the name."""
    kinds = {"npz": npz_bytes, "npy": npy_bytes, "json": json_bytes}
    return kinds[path.rsplit(".", 1)[1]](content)


def sha256(data):
    return hashlib.sha256(data).hexdigest()
