"""Write reference/vectors, or check a random part of it against a fresh computation.

    python make_vectors.py                          write everything
    python make_vectors.py --only cone-centred      write one case (and the manifest)
    python make_vectors.py --check 0.1 --seed 3     recompute a tenth of all numbers; exit 1 on a difference
"""

import argparse
import hashlib
import io
import itertools
import json
import platform
import random
import sys
import time
import zipfile
from pathlib import Path

import mpmath
import numpy as np
from mpmath import mp, mpf

import density
import gradients
import projection
import scene
from cases import CASES

VECTORS = Path(__file__).resolve().parent.parent / "vectors"
CLOSED_FORM_AGREEMENT = mpf(10)**-30


# ---------------------------------------------------------------------------- the truth of one case

class Truth:
    """Every number of a case on demand: images, volume and gradients, as mpmath numbers."""

    def __init__(self, case):
        self.case = case
        s = case.scanner
        self.views = [scene.view_at(s, angle) for angle in case.angles]
        self.pixels = list(itertools.product(range(len(self.views)), *map(range, s.n_detector)))
        self.voxels = list(itertools.product(*map(range, s.n_voxel)))
        self.centres = {index: s.voxel_centre(index) for index in self.voxels}
        self.rays = {(n, r, c): scene.ray(s, self.views[n], r, c) for n, r, c in self.pixels}
        self.d_image = pseudo_random(f"{case.id}/image", (len(self.views), *s.n_detector))
        self.d_volume = pseudo_random(f"{case.id}/volume", s.n_voxel)
        self.parts = [(p, scene.whitening(p), projection.gamma_ratio(p.nu)) for p in case.primitives]
        self.frames = [[projection.CameraFrame(p, s, view) for view in self.views] for p in case.primitives]
        for frame in itertools.chain(*self.frames):
            assert frame.parallel or frame.m[2] > 0.5, f"{case.id}: a centre at depth {mp.nstr(frame.m[2], 4)}"

    def image_exact(self, pixel):
        """Quadrature; on the way both closed forms are held against it."""
        total = mpf(0)
        for (p, whiten, ratio), frames in zip(self.parts, self.frames):
            value = projection.line_integral(p, whiten, *self.rays[pixel])
            for other in (projection.closed_form(p, whiten, *self.rays[pixel], ratio), frames[pixel[0]].exact(*pixel[1:])):
                assert abs(other / value - 1) < CLOSED_FORM_AGREEMENT, f"{self.case.id} {pixel}: {mp.nstr(other / value - 1, 3)}"
            total += value
        return total

    def image_affine(self, pixel):
        return sum(frames[pixel[0]].affine(*pixel[1:]) for frames in self.frames)

    def volume(self, voxel):
        return sum(density.sample(p, whiten, self.centres[voxel]) for p, whiten, _ in self.parts)

    # <cotangent, what one primitive adds>, as functions of that primitive

    def along_exact(self, p):
        whiten, ratio = scene.whitening(p), projection.gamma_ratio(p.nu)
        return mp.fsum(mpf(self.d_image[i]) * projection.closed_form(p, whiten, *self.rays[i], ratio) for i in self.pixels)

    def along_affine(self, p):
        frames = [projection.CameraFrame(p, self.case.scanner, view) for view in self.views]
        return mp.fsum(mpf(self.d_image[i]) * frames[i[0]].affine(*i[1:]) for i in self.pixels)

    def along_volume(self, p):
        whiten = scene.whitening(p)
        return mp.fsum(mpf(self.d_volume[i]) * density.sample(p, whiten, self.centres[i]) for i in self.voxels)

    def gradient(self, along, index):
        number, name, component = index
        return gradients.difference(along, self.case.primitives[number], name, component)

    # file -> (function of an index, all its indices)

    def tables(self):
        entries = [(number, name, component) for number in range(len(self.case.primitives))
                   for name in gradients.PARAMETERS for component in gradients.components(name)]
        return {
            "image_exact.npy": (self.image_exact, self.pixels),
            "image_affine.npy": (self.image_affine, self.pixels),
            "volume.npy": (self.volume, self.voxels),
            "grad_exact.npz": (lambda i: self.gradient(self.along_exact, i), entries),
            "grad_affine.npz": (lambda i: self.gradient(self.along_affine, i), entries),
            "grad_volume.npz": (lambda i: self.gradient(self.along_volume, i), entries),
        }

    def empty(self, name):
        if name.endswith(".npz"):
            return parameter_arrays(len(self.case.primitives))
        return np.zeros(self.case.scanner.n_voxel if name == "volume.npy" else self.d_image.shape)

    def inputs(self):
        """The files that are given, not computed."""
        return {"model.npz": model_arrays(self.case), "meta_data.json": meta_data(self.case),
                "cotangent_image.npy": self.d_image, "cotangent_volume.npy": self.d_volume}


def slot(index):
    """Where an entry of a table lives in its array (or in which array of an npz)."""
    if isinstance(index[1], str):
        number, name, component = index
        return name, (number,) if component is None else (number, component)
    return None, index


def get(table, index):
    name, where = slot(index)
    return (table if name is None else table[name])[where]


def put(table, index, value):
    name, where = slot(index)
    (table if name is None else table[name])[where] = float(value)


# ---------------------------------------------------------------------------- inputs and files

def pseudo_random(key, shape):
    """Uniform numbers in [-1, 1): Python's Mersenne Twister, whose stream is fixed for all versions."""
    stream = random.Random(key)
    return np.array([2 * stream.random() - 1 for _ in range(int(np.prod(shape)))]).reshape(shape)


def parameter_arrays(count):
    return {name: np.zeros((count,) if width is None else (count, width)) for name, width in gradients.PARAMETERS.items()}


def model_arrays(case):
    arrays = parameter_arrays(len(case.primitives))
    for number, p in enumerate(case.primitives):
        for name in gradients.PARAMETERS:
            value = getattr(p, name)
            arrays[name][number] = [float(x) for x in value] if isinstance(value, tuple) else float(value)
    return arrays


def meta_data(case):
    s = case.scanner
    low = [o - size / 2 for o, size in zip(s.off_origin, s.s_voxel)]
    high = [o + size / 2 for o, size in zip(s.off_origin, s.s_voxel)]
    assert max(s.s_voxel) == 2, "the scene scale must be 1"
    return {"scanner": {"mode": s.mode, "DSO": s.dso, "DSD": s.dsd, "nDetector": s.n_detector, "sDetector": s.s_detector,
                        "nVoxel": s.n_voxel, "sVoxel": s.s_voxel, "offOrigin": s.off_origin,
                        "offDetector": s.off_detector, "totalAngle": 360.0, "startAngle": 0.0},
            "bbox": [low, high]}


def npy_bytes(array):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(array, dtype="<f8"), version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def npz_bytes(arrays):
    """An uncompressed zip without a clock or an operating system in it."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, npy_bytes(array))
    return stream.getvalue()


def file_bytes(name, content):
    if name.endswith(".npz"):
        return npz_bytes(content)
    if name.endswith(".npy"):
        return npy_bytes(content)
    return json_bytes(content)


def json_bytes(content):
    return (json.dumps(content, indent=1) + "\n").encode()


def sha256(data):
    return hashlib.sha256(data).hexdigest()


def describe(case):
    """The manifest's row for a case, without its digests."""
    return {"id": case.id, "title": case.title, "kernel": case.kernel, "angles": case.angles,
            "equations": case.equations, "level": case.level, "flags": case.flags}


# ---------------------------------------------------------------------------- write

def write(only):
    started = time.time()
    for case in CASES:
        if only and case.id != only:
            continue
        clock = time.time()
        truth = Truth(case)
        folder = VECTORS / case.id
        folder.mkdir(parents=True, exist_ok=True)
        contents = truth.inputs()
        for name, (function, indices) in truth.tables().items():
            table = truth.empty(name)
            for index in indices:
                put(table, index, function(index))
            contents[name] = table
        for name, content in contents.items():
            (folder / name).write_bytes(file_bytes(name, content))
        image = contents["image_exact.npy"]
        print(f"{case.id:20} {time.time() - clock:6.1f} s   image {image.min():.3g} .. {image.max():.3g}   affine off by up to "
              f"{np.max(np.abs(contents['image_affine.npy'] / image - 1)):.2g}", flush=True)
    rows = []
    for case in CASES:
        paths = sorted((VECTORS / case.id).glob("*.np[yz]")) + [VECTORS / case.id / "meta_data.json"]
        files = {path.name: sha256(path.read_bytes()) for path in paths if path.is_file()}
        rows.append({**describe(case), "files": files})
    manifest = {"schema_version": 1,
                "generator": {"script": "reference/generate/make_vectors.py", "python": platform.python_version(),
                              "mpmath": mpmath.__version__, "mpmath_backend": mpmath.libmp.BACKEND,
                              "numpy": np.__version__, "decimal_digits": mp.dps},
                "cases": rows}
    (VECTORS / "manifest.json").write_bytes(json_bytes(manifest))
    print(f"done in {time.time() - started:.0f} s")


# ---------------------------------------------------------------------------- check

def check(fraction, seed, only):
    started = time.time()
    manifest = json.loads((VECTORS / "manifest.json").read_text())
    listed = {row["id"]: row for row in manifest["cases"]}
    wrong, compared = [], 0
    if list(listed) != [case.id for case in CASES]:
        wrong.append("manifest: its cases are not those of cases.py")
    for case in CASES:
        if case.id not in listed or (only and case.id != only):
            continue
        row = dict(listed[case.id])
        digests = row.pop("files")
        if row != describe(case):
            wrong.append(f"{case.id}: the manifest's description differs from cases.py")
        truth = Truth(case)
        inputs, tables = truth.inputs(), truth.tables()
        if set(digests) != set(inputs) | set(tables):
            wrong.append(f"{case.id}: the manifest lists {sorted(digests)}")
        for name in [*inputs, *tables]:
            path = VECTORS / case.id / name
            if not path.is_file():
                wrong.append(f"{case.id}/{name}: missing")
                continue
            data = path.read_bytes()
            if sha256(data) != digests.get(name):
                wrong.append(f"{case.id}/{name}: its digest is not that of the manifest")
            if name in inputs and data != file_bytes(name, inputs[name]):
                wrong.append(f"{case.id}/{name}: differs from cases.py")
        for name, (function, indices) in tables.items():
            path = VECTORS / case.id / name
            if not path.is_file():
                continue
            stored = np.load(path)
            count = min(len(indices), max(1, round(fraction * len(indices))))
            for index in random.Random(f"{seed}/{case.id}/{name}").sample(indices, count):
                compared += 1
                found, expected = float(get(stored, index)), float(function(index))
                if found != expected:
                    wrong.append(f"{case.id}/{name} {index}: stored {found!r}, recomputed {expected!r}")
    for line in wrong[:50]:
        print(line)
    print(f"{compared} numbers recomputed in {time.time() - started:.0f} s, {len(wrong)} differences")
    return 1 if wrong else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", type=float, metavar="FRACTION", help="recompute this part of all numbers and compare")
    parser.add_argument("--seed", default="0", help="which part --check takes")
    parser.add_argument("--only", metavar="ID", help="one case")
    arguments = parser.parse_args()
    if arguments.only and arguments.only not in [case.id for case in CASES]:
        parser.error(f"--only {arguments.only}: the cases are {', '.join(case.id for case in CASES)}")
    if arguments.check is None:
        write(arguments.only)
        return 0
    if not 0 < arguments.check <= 1:
        parser.error(f"--check {arguments.check}: expected a part in (0, 1]")
    return check(arguments.check, arguments.seed, arguments.only)


if __name__ == "__main__":
    sys.exit(main())
