"""Reads HDF5 files with h5py: the judge of src/scan/hdf5/tests.rs.

hdf5.py FOLDER FILE...   writes each array of numbers as float64 to FOLDER; prints {file: {name: {shape, numbers, array}}}

An array has one of its names. Half precision is left out: trgs does not read it.
"""

import json
import pathlib
import sys

import h5py
import numpy as np


def main(folder, files):
    found = {}
    for path in files:
        described = found.setdefault(path, {})

        def add(name, item):
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and item.dtype != "f2":
                array = folder / f"{pathlib.Path(path).name}_{len(described)}.npy"
                np.save(array, np.asarray(item[()], "f8"))
                described[f"/{name}"] = {"shape": item.shape, "numbers": item.dtype.name, "array": str(array)}

        with h5py.File(path) as file:
            file.visititems(add)
    print(json.dumps(found))


main(pathlib.Path(sys.argv[1]), sys.argv[2:])
