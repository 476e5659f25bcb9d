"""Writes HDF5 files for the tests of the reader: tests/data/*.h5, .nxs and .mat. Needs h5py."""

from pathlib import Path

import h5py
import numpy as np

DATA = Path(__file__).resolve().parents[2] / "tests/data"
# [z, y, x] of 4 x 3 x 5, every number another.
VALUES = np.arange(60, dtype="u2").reshape(4, 3, 5) * 7 + 100


def data_exchange():
    """Four views, two flat fields, one dark field, angles in degrees without a unit."""
    with h5py.File(DATA / "exchange.h5", "w") as file:
        group = file.create_group("exchange")
        group.create_dataset("data", data=VALUES, chunks=(2, 2, 5), compression="gzip", shuffle=True)
        group["data_white"] = np.full((2, 3, 5), 1000, "u2")
        group["data_dark"] = np.full((1, 3, 5), 10, "u2")
        group["theta"] = np.array([0.0, 45.0, 90.0, 135.0])
        file["measurement/instrument/distance"] = 0.3


def nx_tomo():
    """A dark field, two flat fields, four views, one frame without an image; arrays are linked twice."""
    with h5py.File(DATA / "nxtomo.nxs", "w", libver="latest") as file:
        detector = file.create_group("entry/instrument/detector")
        fields = [np.full((1, 3, 5), 10, "f4"), np.full((2, 3, 5), 1000, "f4")]
        detector["data"] = np.concatenate([*fields, VALUES.astype("f4"), np.zeros((1, 3, 5), "f4")])
        detector["image_key"] = np.array([2, 1, 1, 0, 0, 0, 0, 3])
        angles = file.create_dataset("entry/sample/rotation_angle", data=np.arange(8) * 0.25)
        angles.attrs["units"] = "rad"
        group = file.create_group("entry/data")
        group["data"] = detector["data"]
        group["image_key"] = h5py.SoftLink("/entry/instrument/detector/image_key")
        group["rotation_angle"] = angles
        file["entry/title"] = "a text"
        file["entry/again"] = file["entry"]


def matlab():
    """What MATLAB writes with -v7.3 of A(x, y, z): the axes in reverse order behind a header of 512 bytes."""
    path = DATA / "matlab.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["A"] = VALUES.astype("f8")
        file["A"].attrs["MATLAB_class"] = np.bytes_("double")
        file["pixel"] = np.array([[0.1]])
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    content = path.read_bytes()
    path.write_bytes(header + content[len(header):])


def arrays():
    """Arrays of all types of numbers, in both byte orders, and what is no array of numbers."""
    with h5py.File(DATA / "arrays.h5", "w") as file:
        for name in ["i1", "u1", ">i2", "u2", "i4", ">u4", "i8", "u8", "f4", ">f4", "f8", ">f8"]:
            file.create_dataset(f"types/{name.replace('>', 'big_')}", data=(VALUES // 7).astype(name))
        file["slice"] = VALUES[0]
        file["half"] = VALUES.astype("f2")
        file["words"] = ["a", "b"]
        file["loop"] = h5py.SoftLink("/types")
        file["nowhere"] = h5py.SoftLink("/missing")
        file.create_dataset("constant", shape=(50, 60, 70), dtype="f4", fillvalue=2.5, chunks=(10, 10, 10))


def limits():
    """An array deeper than the search for arrays goes, and one beyond 2¹⁰ paths through ten groups."""
    with h5py.File(DATA / "deep.h5", "w", libver="latest") as file:
        file["/".join(f"g{i}" for i in range(18)) + "/deep"] = VALUES
        file["top"] = VALUES[:2]
    with h5py.File(DATA / "many_paths.h5", "w", libver="latest") as file:
        group = file
        for _ in range(10):
            inner = group.create_group("a")
            group["b"] = inner
            group = inner
        group["data"] = VALUES
        file["z/data"] = VALUES[:2]


if __name__ == "__main__":
    data_exchange()
    nx_tomo()
    matlab()
    arrays()
    limits()
