"""Insert each fault of mutations.toml into a copy of the sources and check that the tests fail: the program's own answers
to the conformance vectors first, then lanes, unit tests, parity and determinism.

    python run.py                 all faults, and the table of reference/mutations/README.md
    python run.py --sample 2      two at random (seeded by the day, or --seed)

Needs Python 3.11 or newer, its standard library and cargo. A fault that does not compile or that survives is an error. What
is found is kept in the target folder: a run that was stopped goes on where it was, as long as no source has changed.
"""

import argparse
import datetime
import hashlib
import json
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Run in turn if the vectors detect nothing. The first failure counts.
TESTS = [["--test", "contracts", "lanes::"], ["--lib"], ["--test", "contracts", "parity::"], ["--test", "cli", "determinism::"]]


def run(*command, folder, target):
    environment = {**os.environ, "CARGO_TARGET_DIR": str(target), "CARGO_TERM_COLOR": "never"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def built(*arguments, folder, target):
    outcome = run("cargo", *arguments, "--profile", "mutants", "--locked", folder=folder, target=target)
    if outcome.returncode:
        sys.exit(f"does not compile:\n{outcome.stderr[-3000:]}")


def wrong_answer(folder, target):
    """The first answer to the vectors that the program's own check rejects, as in tests/contracts/{analytic,gradients}.rs."""
    built("build", "--bin", "trgs", folder=folder, target=target)
    trgs = str(target / "mutants" / "trgs")
    for precision in ["f64", "f32"]:
        with tempfile.TemporaryDirectory() as answers:
            vectors = ["--vectors", str(folder / "reference/vectors")]
            every = ["--level", "optional", "--json"]
            answer = run(trgs, "oracle", "answer", answers + "/own", "--precision", precision, *vectors, folder=folder, target=target)
            if answer.returncode:
                return f"vectors in {precision}: no answer"
            check = run(trgs, "oracle", "check", answers + "/own", "--precision", precision, *every, *vectors, folder=folder, target=target)
            failed = [result["id"] for result in json.loads(check.stdout)["results"] if result["status"] == "failed"]
            if failed:
                return f"vectors in {precision}: {failed[0]} and {len(failed) - 1} more"
    return None


def failed_test(folder, target):
    """The first test binary that fails, and the first of its tests."""
    for selection in TESTS:
        built("test", *selection, "--no-run", folder=folder, target=target)
        outcome = run("cargo", "test", *selection, "--profile", "mutants", "--locked", folder=folder, target=target)
        if outcome.returncode:
            lines = [line.split() for line in outcome.stdout.splitlines() if line.endswith("FAILED")]
            return f"{selection[-1].strip('-:')}: {lines[0][1] if lines else 'no test reported'}"
    return None


def digest(folder):
    """The digest of everything that the result of a fault depends on."""
    sums = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        sums.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return sums.hexdigest()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="TEXT", help="only faults whose description or file contains this text")
    parser.add_argument("--sample", type=int, metavar="N", help="only N random faults")
    parser.add_argument("--seed", default=datetime.date.today().isoformat(), help="seed of --sample")
    parser.add_argument("--target", type=pathlib.Path, default=ROOT / "target" / "mutations", help="cargo's target folder")
    arguments = parser.parse_args()
    mutations = tomllib.loads((pathlib.Path(__file__).parent / "mutations.toml").read_text())["mutation"]
    mutations = [m for m in mutations if arguments.only in m["what"] + m["file"]]
    chosen = mutations if arguments.sample is None else random.Random(arguments.seed).sample(mutations, arguments.sample)
    survived = 0
    # In one place and with their times, so that cargo compiles again what differs alone.
    copy = arguments.target.resolve() / "sources"
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir(parents=True)
    for name in ["Cargo.toml", "Cargo.lock", ".cargo", ".clippy.toml", "README.md", "src", "tests", "benches", "reference"]:
        source = ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, copy / name)
    kept = arguments.target / f"killed-{digest(copy)[:16]}.json"
    killers = json.loads(kept.read_text()) if kept.exists() else {}
    print("| # | fault | file | killed by |\n|---|---|---|---|", flush=True)
    for number, mutation in enumerate(chosen, 1):
        path = copy / mutation["file"]
        text = path.read_text()
        if text.count(mutation["find"]) != 1:
            sys.exit(f"{mutation['file']}: {mutation['find']!r} occurs {text.count(mutation['find'])} times")
        began = time.time()
        key = json.dumps(mutation)
        if not killers.get(key):
            path.write_text(text.replace(mutation["find"], mutation["replace"]))
            killers[key] = wrong_answer(copy, arguments.target) or failed_test(copy, arguments.target)
            path.write_text(text)
            kept.write_text(json.dumps(killers))
        killer = killers[key]
        survived += killer is None
        print(f"| {number} | {mutation['what']} | `{mutation['file']}` | {killer or '**nothing: it survived**'} |", flush=True)
        print(f"{time.time() - began:.0f} s", file=sys.stderr, flush=True)
    print(f"\n{len(chosen) - survived} of {len(chosen)} killed")
    return 1 if survived else 0


if __name__ == "__main__":
    sys.exit(main())
