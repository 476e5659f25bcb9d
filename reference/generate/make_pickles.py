"""Writes scans in NAF's format for tests of the pickle reader: tests/data/naf_{2,3,4,5}.pickle, one per protocol.

naf_odd.pickle has angles in degrees, a COR for each view, and entries that no reader of scans needs.
"""

import datetime
import pickle
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parents[2] / "tests/data"


def counted(shape, step, dtype):
    return (np.arange(np.prod(shape)) * step).reshape(shape).astype(dtype)


def main():
    scan = {
        "DSD": 700.0, "DSO": 500, "nDetector": [3, 7], "dDetector": [50.0, 40.0], "nVoxel": [4, 5, 6],
        "dVoxel": [20.0, 20.0, 20.0], "offOrigin": [1, 0, 0], "offDetector": [2.0, 0], "accuracy": 0.5, "mode": "cone",
        "filter": None, "totalAngle": 180.0, "startAngle": 0.0, "randomAngle": False, "convert": True,
        "rescale_slope": 1.0, "rescale_intercept": -1024, "normalize": True, "noise": 2, "numTrain": 2, "numVal": 1,
        # In Fortran order, as NumPy stores a transposed array.
        "image": np.asfortranarray(counted((4, 5, 6), 1 / 120, np.float32)),
        "train": {"angles": np.array([0.0, 1.5]), "projections": counted((2, 3, 7), 0.01, np.float32)},
        "val": {"angles": np.array([0.25]), "projections": counted((1, 3, 7), 0.01, np.float64)},
    }
    for protocol in range(2, 6):
        (DATA / f"naf_{protocol}.pickle").write_bytes(pickle.dumps(scan, protocol=protocol))
    odd = scan | {
        "COR": np.array([1.0, 2.0, 3.0]), "date": datetime.datetime(2024, 5, 17, 12, 30), "tags": {"bone", "dry"},
        "names": np.array(["a", "bc"]), "objects": np.array([None, {"a": 1}], dtype=object), "big": 1 << 80,
        "path": Path("data/scan"), "complex": complex(1, 2),
        "train": {"angles": np.array([0.0, 90.0]), "projections": scan["train"]["projections"], "seconds": [1, 2]},
    }
    (DATA / "naf_odd.pickle").write_bytes(pickle.dumps(odd, protocol=4))


if __name__ == "__main__":
    main()
