"""Does adding and recycling cost R²-Gaussian quality with other settings? Rows of Table 6 with its keys varied.

    python recycling.py --out DIR

Every setting runs the rows with adding and recycling of `trgs table optimiser --size 64 --matched ray --set ...`: Adam, both
methods, fifteen phantoms. Their difference to the rows with adaptive density control, which do not depend on these keys, is
printed as a Markdown table with its standard error and R²-Gaussian's mean populations at the end. Finished cells are not run
again. Needs Python 3.11 and nothing else; `cargo build --release` first.
"""

import argparse
import json
import statistics
import subprocess
from pathlib import Path

HERE = Path(__file__).resolve().parent
# Rows of the table with Adam, in the order of its cells: method, density control.
ROWS = {0: ("r2-gaussian", "adc"), 1: ("r2-gaussian", "ar"), 5: ("tr-gs", "ar"), 6: ("tr-gs", "adc")}
ROWS_OF_A_CASE = 8
SETTINGS = [
    [],
    ["relocation=sss"],
    ["relocation=sss-program"],
    ["relocation=sss", "spread=0"],
    ["relocation=sss", "spread=0.3"],
    ["relocation=sss", "spread=2"],
    ["relocation=sss", "dead=0.005"],
    ["relocation=sss", "dead=0.02"],
    ["relocation=sss", "dead=0.05"],
    ["relocation=sss", "spread=0", "dead=0.005", "recycled=1"],
    ["relocation=sss-program", "spread=0", "dead=0.005", "recycled=1"],
    ["relocation=sss", "growth=0.003"],
    ["relocation=sss", "growth=0.01"],
    ["relocation=sss", "growth=0.2"],
    ["relocation=sss", "cap=4000"],
    ["relocation=sss", "cap=16000"],
    ["relocation=sss", "stop=0.5"],
    ["relocation=sss", "stop=1", "start=0"],
]


def table(arguments, setting, *more):
    keys = [word for key in setting for word in ("--set", f"density_control.{key}")]
    command = [arguments.program, "table", "optimiser", "--size", "64", "--matched", "ray", *keys, *more]
    command += ["--quiet", "--json", "--threads", "1"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def differences(arguments, setting, folder):
    """For each method and case, PSNR_3D of adding and recycling less that of adaptive density control; mean populations."""
    listed = json.loads(table(arguments, setting, "--list-cells"))
    base = json.loads(table(arguments, [], "--list-cells"))
    psnr, population = {}, {}
    for row, (method, control) in ROWS.items():
        for case, start in enumerate(range(0, len(listed), ROWS_OF_A_CASE)):
            # Adaptive density control runs once, with its own settings.
            setting_of, cells, out = (setting, listed, folder) if control == "ar" else ([], base, arguments.out / "adc")
            cell = cells[start + row]["id"]
            path = out / "cells" / f"{cell}.json"
            if not path.exists():
                table(arguments, setting_of, "--out", out, "--cell", cell)
            result = json.loads(path.read_text())
            psnr[method, control, case] = result["metrics"]["psnr_3d"]
            population.setdefault((method, control), []).append(result["primitives"])
    cases = len(listed) // ROWS_OF_A_CASE
    gain = {method: [psnr[method, "ar", case] - psnr[method, "adc", case] for case in range(cases)]
            for method in ("r2-gaussian", "tr-gs")}
    return gain, {row: statistics.fmean(counts) for row, counts in population.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--program", default=str(HERE.parent.parent / "target/release/trgs"))
    arguments = parser.parse_args()
    print("| `density_control.` | R²-Gaussian | TR-GS | primitives, AR and ADC |\n|---|---|---|---|", flush=True)
    for setting in SETTINGS:
        name = "-".join(setting) or "default"
        gain, population = differences(arguments, setting, arguments.out / name)
        columns = [f"{statistics.fmean(values):+.2f} ± {statistics.stdev(values) / len(values) ** 0.5:.2f}" for values in gain.values()]
        columns.append(f"{population['r2-gaussian', 'ar']:.0f}, {population['r2-gaussian', 'adc']:.0f}")
        print(f"| {', '.join(setting) or 'default (exact)'} | " + " | ".join(columns) + " |", flush=True)


if __name__ == "__main__":
    main()
