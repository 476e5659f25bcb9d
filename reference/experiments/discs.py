"""Default runs on measured discs of the Helsinki tomography challenge 2022, against many more views.

    python discs.py FOLDER --out DIR [--discs ta tc] [--views 12 18 25] [--methods sart asd-pocs tv tr-gs]

FOLDER has NAME.npy, line integrals [720, 560], and angles_degrees.txt. The views are evenly spaced. The reference is the
volume of two passes of SART over 180 views; PSNR has its 99.5th percentile as peak. Needs NumPy; `cargo build --release`
first.
"""

import argparse
import subprocess
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
SCANNER = HERE / "disc.json"
REFERENCE_VIEWS = 180


def trgs(program, *arguments):
    subprocess.run([program, *map(str, arguments), "--quiet"], check=True, stdout=subprocess.DEVNULL)


def scan(arguments, disc, views):
    folder = arguments.out / f"{disc}-{views}"
    if not folder.exists():
        projections = np.load(arguments.folder / f"{disc}.npy")
        angles = np.loadtxt(arguments.folder / "angles_degrees.txt")
        chosen = np.arange(views) * len(angles) // views
        frames, listed = arguments.out / "frames.npy", arguments.out / "angles.txt"
        np.save(frames, projections[chosen])
        np.savetxt(listed, angles[chosen])
        trgs(arguments.program, "convert", frames, folder, "--scanner", SCANNER, "--angles", listed, "--degrees",
             "--line-integrals")
    return folder


def volume(arguments, disc, views, method, *settings):
    out = arguments.out / f"{disc}-{views}-{method}"
    if not (out / "volume.npy").exists():
        data = scan(arguments, disc, views)
        trgs(arguments.program, "reconstruct", data, "--out", out, "--method", method, "--threads", 1, *settings)
    return np.load(out / "volume.npy").astype(float)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--program", default=str(HERE.parent.parent / "target/release/trgs"))
    parser.add_argument("--discs", nargs="+", default=["ta", "tc"])
    parser.add_argument("--views", nargs="+", type=int, default=[12, 18, 25])
    parser.add_argument("--methods", nargs="+", default=["sart", "asd-pocs", "tv", "tr-gs"])
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for disc in arguments.discs:
        reference = volume(arguments, disc, REFERENCE_VIEWS, "sart", "--iterations", 2)
        peak = np.percentile(reference, 99.5)
        for method in arguments.methods:
            for views in arguments.views:
                error = ((volume(arguments, disc, views, method) - reference) ** 2).mean()
                print(f"{disc} {views} {method} {10 * np.log10(peak**2 / error):.2f}", flush=True)


main()
