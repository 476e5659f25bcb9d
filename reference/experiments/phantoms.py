"""Draw the fifteen stand-ins: for each a frontal projection and a slice, one row per group of the paper's cases.

    python phantoms.py reference/phantoms.png

Needs NumPy, and `cargo build --release` first.
"""

import argparse
import struct
import subprocess
import tempfile
import zlib
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
SIDE = 128
# Per phantom: the axis across which the slice cuts, and its position.
GROUPS = [
    {"chest": (2, 0.45), "foot": (0, 0.53), "head": (2, 0.66), "jaw": (2, 0.46), "pancreas": (2, 0.53)},
    {"beetle": (0, 0.5), "bonsai": (1, 0.5), "broccoli": (1, 0.5), "kingsnake": (2, 0.45), "pepper": (1, 0.5)},
    {"backpack": (0, 0.56), "engine": (0, 0.5), "mount": (0, 0.5), "present": (1, 0.35), "teapot": (1, 0.5)},
]


def grey(values, top):
    """Eight bits, with dark tones raised."""
    return (255 * np.clip(values / top, 0, 1) ** 0.7).astype(np.uint8)


def tiles(program, name, axis, place, folder):
    scan = Path(folder) / name
    # The fourth of four views looks from -y, with x to the right.
    options = ["--size", SIDE, "--detector", SIDE, "--detector-size", 3.2, "--views", 4, "--test-views", 0]
    subprocess.run([program, "simulate", "--phantom", name, "--out", scan, "--quiet", *map(str, options)],
                   check=True, stdout=subprocess.DEVNULL)
    projection = np.load(scan / "proj_train/proj_train_0003.npy")
    volume = np.load(scan / "vol_gt.npy")
    cut = np.take(volume, int(place * SIDE), axis=axis).T
    # z upwards, but the back of a body downwards.
    cut = cut if axis == 2 else cut[::-1]
    return np.hstack([grey(projection, np.percentile(projection, 99.7)), grey(cut, 1.0)])


def png(picture):
    """The bytes of a grey PNG."""
    height, width = picture.shape
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    # Each row is stored as differences to the row above.
    rows = np.diff(picture, axis=0, prepend=np.zeros((1, width), np.uint8))
    lines = np.hstack([np.full((height, 1), 2, np.uint8), rows]).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(lines, 9)) + chunk(b"IEND", b"")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--trgs", type=Path, default=HERE.parents[1] / "target/release/trgs")
    settings = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [np.hstack([tiles(settings.trgs, name, *cut, folder) for name, cut in group.items()]) for group in GROUPS]
    settings.out.write_bytes(png(np.vstack(rows)))


if __name__ == "__main__":
    main()
