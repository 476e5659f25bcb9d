"""The memory that a run announces, and its largest resident set: all methods, cubes of several sides.

    python memory.py --program target/release/trgs [--sides 64 128 256] [--large 512] > table.md

A scan of the torso has as many pixels a side as voxels, 256 at most, in 10 views and 2 for the test. Runs have few
iterations: memory does not depend on their number, but that of populations, which may grow. The peak is the `ru_maxrss`
of the process, which /usr/bin/time -v prints. Methods on voxels alone have a row at --large. Needs Python 3.11 and Linux.
"""

import argparse
import os
import re
import subprocess
import tempfile
from pathlib import Path

FINISH = "--set tv.weight=1e-3 --set tv.finish_iterations=2"
# Enough iterations that all arrays are in use; tv begins with sets of views.
VOXELS = {
    "fdk": "",
    "sart": "--iterations 1",
    "os-sart": "--iterations 1",
    "cgls": "--iterations 2",
    "asd-pocs": "--iterations 1",
    "tv": "--iterations 3 --set tv.weight=1e-3",
}
OTHERS = {
    "naf": "--iterations 2",
    "sax-nerf": "--iterations 2",
    "tr-gs": f"--iterations 20 {FINISH}",
    "r2-gaussian": f"--iterations 20 {FINISH}",
}
LARGE = ["fdk", "sart", "tv"]
MIB = 1 << 20


def measured(program: Path, arguments: list[str]) -> tuple[float, float]:
    """MiB that the run announces, and its peak."""
    run = subprocess.Popen([program, *arguments, "--log-format", "json"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    said = run.stderr.read().decode()
    _, status, usage = os.wait4(run.pid, 0)
    if status != 0:
        raise SystemExit(f"{arguments}: {said}")
    return int(re.search(r'"memory":(\d+)', said)[1]) / MIB, usage.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", type=Path, required=True)
    parser.add_argument("--sides", type=int, nargs="*", default=[64, 128, 256])
    parser.add_argument("--large", type=int, nargs="*", default=[])
    arguments = parser.parse_args()
    print("| method | side | announced, MiB | peak, MiB | ratio |\n|---|---|---|---|---|")
    methods = VOXELS | OTHERS
    with tempfile.TemporaryDirectory() as folder:
        for side in arguments.sides + arguments.large:
            scan = f"{folder}/{side}"
            size = ["--size", str(side), "--detector", str(min(side, 256)), "--views", "10", "--test-views", "2"]
            simulate = [arguments.program, "simulate", "--phantom", "torso", "--out", scan, "--quiet", *size]
            subprocess.run(simulate, check=True, stdout=subprocess.DEVNULL)
            for method in methods if side in arguments.sides else LARGE:
                run = ["reconstruct", scan, "--method", method, "--out", f"{folder}/run", "--overwrite", "--threads", "2"]
                said, peak = measured(arguments.program, run + methods[method].split())
                print(f"| `{method}` | {side} | {said:.0f} | {peak:.0f} | {said / peak:.2f} |", flush=True)


if __name__ == "__main__":
    main()
