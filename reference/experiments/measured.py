"""The measured half of Tables 1 and 2 on three measured discs of the Helsinki tomography challenge 2022.

    python measured.py FOLDER --out DIR [--size 64]

FOLDER has ta.npy, tc.npy and solid_disc.npy, line integrals [720, 560], and angles_degrees.txt. As in R²-Gaussian's protocol
the truth is FDK of all views, 75 views are for training, and the unit of length makes densities lie between 0 and about 1
(here: the 99.5th percentile of the truth is 1). `trgs table` takes 12, 18 and 25 of the 75 views. Needs NumPy;
`cargo build --release` first.
"""

import argparse
import subprocess
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
DISCS = ["ta", "tc", "solid_disc"]
TRAINING_VIEWS = 75


def trgs(program, *arguments):
    subprocess.run([program, *map(str, arguments), "--quiet"], check=True, stdout=subprocess.DEVNULL)


def scan(arguments, frames, out):
    """A scan by R²-Gaussian's protocol from line integrals."""
    full = out.with_name(out.name + "-full")
    trgs(arguments.program, "convert", frames, full, "--scanner", HERE / "disc.json", "--line-integrals", "--degrees",
         "--angles", arguments.folder / "angles_degrees.txt")
    trgs(arguments.program, "convert", full, out, "--pseudo-truth", "--views", TRAINING_VIEWS)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--program", default=str(HERE.parent.parent / "target/release/trgs"))
    arguments = parser.parse_args()
    scans, work = arguments.out / "scans", arguments.out / "work"
    scans.mkdir(parents=True, exist_ok=True)
    work.mkdir(exist_ok=True)
    for disc in DISCS:
        if (scans / disc).exists():
            continue
        frames = work / f"{disc}.npy"
        scan(arguments, arguments.folder / f"{disc}.npy", work / disc)
        peak = np.percentile(np.load(work / disc / "vol_gt.npy"), 99.5)
        np.save(frames, (np.load(arguments.folder / f"{disc}.npy") / peak).astype(np.float32))
        scan(arguments, frames, work / f"{disc}-unit")
        (work / f"{disc}-unit").rename(scans / disc)
    for table in ["volume", "projection"]:
        trgs(arguments.program, "table", table, "--size", arguments.size, "--measured", "--data", scans,
             "--out", arguments.out / "tables")
        print((arguments.out / "tables" / f"{table}.md").read_text())


if __name__ == "__main__":
    main()
