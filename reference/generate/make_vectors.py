"""Write reference/vectors, or check a random part of it against a fresh computation.

    python make_vectors.py                            write everything
    python make_vectors.py --only image-exact/nu-3    write the cases whose id or name has this prefix (and the manifest)
    python make_vectors.py --check 0.1 --seed 3       recompute a tenth of all numbers; exit 1 on a difference
"""

import argparse
import json
import platform
import random
import shutil
import sys
import time
from pathlib import Path

import jsonschema
import mpmath
import numpy as np
from mpmath import mp

from cases import CASES, FLAGS, INPUTS
from files import file_bytes, json_bytes, sha256

VECTORS = Path(__file__).resolve().parent.parent / "vectors"
SCHEMA = VECTORS.parent / "manifest.schema.json"


def chosen(only):
    return [case for case in CASES if not only or case.id.startswith(only) or case.name.startswith(only)]


def files_of(case):
    """group -> name -> path, as the manifest lists them."""
    groups = {"inputs": {name: given.path for name, given in case.inputs.items()}}
    for group, name, table in case.tables():
        groups.setdefault(group, {})[name] = f"{case.id}/{table.file}"
    return groups


def known_paths():
    """Every file that belongs in the folder."""
    return {"manifest.json", *INPUTS} | {path for case in CASES for group in files_of(case).values() for path in group.values()}


# ---------------------------------------------------------------------------- write

def put(path, data):
    target = VECTORS / path
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(data)


def manifest():
    rows = []
    for case in CASES:
        digest = lambda path: {"file": path, "sha256": sha256((VECTORS / path).read_bytes())}
        groups = {group: {name: digest(path) for name, path in paths.items()} for group, paths in files_of(case).items()}
        rows.append({**case.describe(), **groups})
    return {"schema_version": 2,
            "generator": {"script": "reference/generate/make_vectors.py", "python": platform.python_version(),
                          "mpmath": mpmath.__version__, "mpmath_backend": mpmath.libmp.BACKEND,
                          "numpy": np.__version__, "decimal_digits": mp.dps},
            "flags": FLAGS, "cases": rows}


def write(only):
    started = time.time()
    if not only:
        shutil.rmtree(VECTORS, ignore_errors=True)
    for path, content in INPUTS.items():
        put(path, file_bytes(path, content))
    for case in chosen(only):
        clock = time.time()
        for _, _, table in case.tables():
            path = f"{case.id}/{table.file}"
            put(path, file_bytes(path, table.compute()))
        print(f"{case.id:48} {time.time() - clock:6.1f} s", flush=True)
    put("manifest.json", json_bytes(manifest()))
    print(f"done in {time.time() - started:.0f} s")


# ---------------------------------------------------------------------------- check

def check_schema(stored, wrong):
    """The manifest's form; one without the stage of its first case must be refused."""
    schema = json.loads(SCHEMA.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    wrong += [f"manifest: {error.json_path}: {error.message}" for error in validator.iter_errors(stored)]
    first, *others = stored["cases"]
    lacking = {key: value for key, value in first.items() if key != "stage"}
    if validator.is_valid({**stored, "cases": [lacking, *others]}):
        wrong.append("manifest.schema.json: accepts a case without a stage")


def check_files(case, row, wrong):
    """The case's description, inputs and digests."""
    groups = files_of(case)
    listed = {group: row.pop(group, {}) for group in ("inputs", "outputs", "allowances")}
    if row != json.loads(json_bytes(case.describe())):
        wrong.append(f"{case.id}: the manifest's description is not that of the scripts")
    for group in listed:
        paths = groups.get(group, {})
        if {name: entry["file"] for name, entry in listed[group].items()} != paths:
            wrong.append(f"{case.id}: the manifest lists other {group}: {sorted(listed[group])}")
            continue
        for name, path in paths.items():
            file = VECTORS / path
            if not file.is_file():
                wrong.append(f"{path}: missing")
                continue
            data = file.read_bytes()
            if sha256(data) != listed[group][name]["sha256"]:
                wrong.append(f"{path}: its digest is not that of the manifest")
            if group == "inputs" and data != file_bytes(path, INPUTS[path]):
                wrong.append(f"{path}: differs from the scripts")


def check_numbers(case, fraction, seed, wrong):
    compared = 0
    for _, _, table in case.tables():
        path = f"{case.id}/{table.file}"
        if not (VECTORS / path).is_file():
            continue
        stored, indices = np.load(VECTORS / path), table.indices()
        count = min(len(indices), max(1, round(fraction * len(indices))))
        for index in random.Random(f"{seed}/{path}").sample(indices, count):
            compared += 1
            found, expected = table.get(stored, index), table.value(index)
            if found != expected and not (found != found and expected != expected):
                wrong.append(f"{path} {index}: stored {found!r}, recomputed {expected!r}")
    return compared


def check(fraction, seed, only):
    started = time.time()
    stored = json.loads((VECTORS / "manifest.json").read_text())
    rows = {row["id"]: row for row in stored["cases"]}
    wrong, compared = [], 0
    if list(rows) != [case.id for case in CASES]:
        wrong.append("manifest: its cases are not those of the scripts")
    check_schema(stored, wrong)
    if stored["flags"] != FLAGS:
        wrong.append("manifest: its flags are not those of the scripts")
    present = {str(path.relative_to(VECTORS)) for path in VECTORS.rglob("*") if path.is_file()}
    wrong += [f"{path}: belongs to no case" for path in sorted(present - known_paths())]
    for case in chosen(only):
        if case.id in rows:
            check_files(case, dict(rows[case.id]), wrong)
            compared += check_numbers(case, fraction, seed, wrong)
    for line in wrong[:50]:
        print(line)
    print(f"{compared} numbers recomputed in {time.time() - started:.0f} s, {len(wrong)} differences")
    return 1 if wrong else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", type=float, metavar="FRACTION", help="recompute this fraction of all numbers and compare")
    parser.add_argument("--seed", default="0", help="seed of the numbers that --check selects")
    parser.add_argument("--only", metavar="PREFIX", help="cases whose id (stage/name) or name has this prefix")
    arguments = parser.parse_args()
    if not chosen(arguments.only):
        parser.error(f"--only {arguments.only}: no case's id or name begins so; ids: {', '.join(case.id for case in CASES)}")
    if arguments.check is None:
        write(arguments.only)
        return 0
    if not 0 < arguments.check <= 1:
        parser.error(f"--check {arguments.check}: expected a part in (0, 1]")
    return check(arguments.check, arguments.seed, arguments.only)


if __name__ == "__main__":
    sys.exit(main())
