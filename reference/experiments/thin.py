"""Which setting causes holes in the volume: thin plates and thin bones, 18 views, 5,000 iterations.

    python thin.py --out /tmp/thin --jobs 2

Every combination of three factors is trained, and its volume is sampled at voxel centres and as the interpolant:

    floor   smallest scale 0.408 voxel (the default), or 0.032 voxel (R²-Gaussian's 0.0005 of the side at 64³)
    rates   raised by (30,000/n)^3/4 (the default), or as they are (horizon = n)
    cap     8,192 primitives (the default at 64³), or 20,000

Finished cells are in reference/results/thin.jsonl and are not computed again. Needs NumPy; `cargo build --release` first.
"""

import argparse
import itertools
import json
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock

import numpy as np

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parent / "results/thin.jsonl"
SIDE, FINE, ITERATIONS = 64, 3, 5000
FACTORS = {
    "floor": {"0.408": [], "0.032": ["model.smallest_scale=0.032"]},
    "rates": {"raised": [], "own": [f"optimiser.horizon={ITERATIONS}"]},
    "cap": {"8192": [], "20000": ["density_control.cap=20000"]},
}
SAMPLINGS = ["point", "interpolant"]


def volume(name):
    """Means over 3³ points a voxel. Walls are one voxel thick and lie across the grid at all angles."""
    axis = (np.arange(SIDE * FINE) + 0.5) / FINE - SIDE / 2
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    body = (x / 24) ** 2 + (y / 20) ** 2 + (z / 26) ** 2 < 1
    values = np.where(body, 0.2, 0.0).astype(np.float32)
    rng = np.random.default_rng(7)
    for _ in range(12):
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        centre = rng.uniform(-10, 10, 3)
        dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
        along = dx * normal[0] + dy * normal[1] + dz * normal[2]
        across = np.sqrt(np.maximum(dx * dx + dy * dy + dz * dz - along * along, 0))
        wall = (abs(along) < 0.5) & (across < 9) if name == "plates" else (abs(across - 2.5) < 0.5) & (abs(along) < 12)
        values[wall & body] = 0.9
    return values.reshape(SIDE, FINE, SIDE, FINE, SIDE, FINE).mean(axis=(1, 3, 5)).astype(np.float32)


def trgs(program, *arguments):
    done = subprocess.run([program, *map(str, arguments), "--quiet", "--json"], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def train(program, out, scan, levels):
    """PSNR_3D of both samplings of one model."""
    run = out / "-".join([scan.name, *levels.values()])
    settings = [key for factor, level in levels.items() for key in FACTORS[factor][level]]
    found = {}
    for sampling in SAMPLINGS:
        keys = [*settings, "finish=none", f"sampling={sampling}"]
        sets = [argument for key in keys for argument in ("--set", key)]
        more = ["--resume"] if run.exists() else []
        metrics = trgs(program, "reconstruct", scan, "--out", run, "--iterations", ITERATIONS, "--threads", 1, *sets, *more)
        found[sampling] = metrics["psnr_3d"]["value"]
        found["psnr_2d"] = metrics["psnr_2d"]["value"]
    shutil.rmtree(run)
    return found


def table(cells):
    names = list(FACTORS)
    lines = ["| scan | " + " | ".join(names) + " | points | interpolant | PSNR_2D |", "|---" * (len(names) + 4) + "|"]
    for cell, found in sorted(cells, key=lambda item: list(item[0].values())):
        values = [cell["scan"], *(cell[name] for name in names)]
        lines.append("| " + " | ".join([*values, *(f"{found[key]:.2f}" for key in [*SAMPLINGS, "psnr_2d"])]) + " |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--program", default=str(HERE.parent.parent / "target/release/trgs"))
    arguments = parser.parse_args()
    out, program, lock = arguments.out, arguments.program, Lock()
    out.mkdir(parents=True, exist_ok=True)
    cells = [json.loads(line) for line in RESULTS.read_text().splitlines()] if RESULTS.exists() else []
    scans = {}
    for name in ["plates", "bones"]:
        scans[name] = out / name
        if not (scans[name] / "meta_data.json").exists():
            np.save(out / f"{name}.npy", volume(name))
            trgs(program, "simulate", "--volume", out / f"{name}.npy", "--out", scans[name], "--views", 18, "--noise", "low")
    wanted = [{"scan": scan, **dict(zip(FACTORS, levels))}
              for scan in scans for levels in itertools.product(*(list(levels) for levels in FACTORS.values()))]

    def work(cell):
        levels = {name: cell[name] for name in FACTORS}
        found = train(program, out, scans[cell["scan"]], levels)
        with lock:
            cells.append([cell, found])
            with RESULTS.open("a") as file:
                file.write(json.dumps([cell, found]) + "\n")

    with ThreadPoolExecutor(arguments.jobs) as workers:
        list(workers.map(work, [cell for cell in wanted if cell not in [done for done, _ in cells]]))
    print(table(cells))


if __name__ == "__main__":
    main()
