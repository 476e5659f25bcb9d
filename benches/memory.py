"""The estimate of memory that a run states against its largest resident set:  python3 memory.py TRGS SIDE... > RESULT.md

A torso with 25 views, whose detector has as many pixels as the volume has voxels on a side, at most two threads. Iterations are few:
memory does not grow with them. Linux alone: the resident set is that of `wait4`.
"""
import json, os, subprocess, sys, tempfile
from pathlib import Path

SHORT = "--set density_control.every=2 --set checkpoint_every=2 --set tv.weight=1e-3 --set tv.finish_iterations=2"
# Of each method, its settings: what takes long and needs no memory is left out.
METHODS = {
    "fdk": "",
    "sart": "--iterations 2",
    "os-sart": "--iterations 2",
    "asd-pocs": "--iterations 2",
    "cgls": "--iterations 2",
    "tv": "--iterations 12 --set tv.weight=1e-3",
    "naf": "--iterations 2",
    "sax-nerf": "--iterations 2",
    "r2-gaussian": f"--iterations 4 {SHORT}",
    "tr-gs": f"--iterations 4 {SHORT}",
}


def peak(command, folder):
    """MiB of the largest resident set."""
    child = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    text = child.stderr.read().decode()
    _, status, usage = os.wait4(child.pid, 0)
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"{' '.join(command)}: {text}")
    return usage.ru_maxrss / 1024


def main(trgs, *sides):
    trgs = str(Path(trgs).resolve())
    print("| voxels | method | estimate, MiB | largest resident set, MiB | estimate / largest |", "|---|---|---|---|---|", sep="\n")
    with tempfile.TemporaryDirectory() as folder:
        for side in sides:
            scan = "--phantom torso --views 25 --test-views 2 --noise low --quiet --overwrite --out scan"
            peak([trgs, "simulate", *scan.split(), "--size", side, "--detector", side], folder)
            for method, settings in METHODS.items():
                run = f"reconstruct scan --method {method} {settings} --out run --threads 2 --quiet --overwrite"
                largest = peak([trgs, *run.split()], folder)
                estimate = json.loads((Path(folder) / "run/provenance.json").read_text())["memory"] / 2**20
                print(f"| {side}³ | `{method}` | {estimate:.0f} | {largest:.0f} | {estimate / largest:.2f} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
