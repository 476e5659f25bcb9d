"""R²-Gaussian's volumes against the truth, as they are and times 0.95: what an integral factor that is 5 % too large would cost.

    python scaled.py VOLUMES FOLDER TRGS     VOLUMES: .npy of 64³; runs that are in FOLDER are not made again

Writes FOLDER/scaled-cases.csv, which is kept in reference/results/verdict/A. Needs numpy.
"""

import csv
import math
import subprocess
import sys
from pathlib import Path

import numpy as np

SCAN = "--rays siddon --detector 64 --views 18 --test-views 20 --noise low".split()
ROWS = {"volume": 1.0, "volume × 0.95": 0.95}


def main(volumes, folder, program):
    folder.mkdir(parents=True, exist_ok=True)
    lines = []
    for path in sorted(volumes.glob("*.npy")):
        scan, run = folder / f"s-{path.stem}", folder / f"r-{path.stem}"
        if not (run / "volume.npy").exists():
            subprocess.run([program, "simulate", "--volume", path, *SCAN, "--out", scan, "--overwrite", "--quiet"], check=True)
            method = ["--method", "r2-gaussian", "--preset", "paper", "--threads", "1"]
            subprocess.run([program, "reconstruct", scan, *method, "--out", run, "--overwrite", "--quiet"], check=True)
        truth, found = (np.load(file).astype(float) for file in (path, run / "volume.npy"))
        for row, factor in ROWS.items():
            psnr = 10 * math.log10(truth.max() ** 2 / np.mean((factor * found - truth) ** 2))
            lines.append([18, "low", row, "psnr_3d", path.stem, f"{psnr:.6f}"])
    lines.sort(key=lambda line: (line[2] != "volume", line[4]))
    with (folder / "scaled-cases.csv").open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["views", "noise", "row", "metric", "case", "ours"])
        table.writerows(lines)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
