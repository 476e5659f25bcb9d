"""Predicts what `paper` and `trgs` reach on the paper's own scans, which are not at hand: reference/results/predictions.json.

    python predict.py            write it
    python predict.py --check    exit 1 if it is not that of the tables

    trgs table volume --size 256 --data SYNTHETIC --out DIR --against reference/results/predictions.json
    trgs table volume --size 256 --data MEASURED --measured --out DIR --against reference/results/predictions.json
    trgs table reference/verdict/default.toml --size 256 --data SYNTHETIC --out DIR --against reference/results/predictions.json

judge them when the scans are at hand. Each interval is of 95 %, for a mean over the paper's cases:

- R²-Gaussian: the paper's figure, and the largest difference between ours and its own program on six scans
  (reference/results/README.md).
- The lead of TR-GS: the mean over the volumes of the largest series with that number of views, and the error of a mean over as
  many new cases. TR-GS itself: both, errors in squares.
- trgs: TR-GS, and what the default gains over it on series A.

Needs Python 3.11 and scipy.
"""

import csv
import json
import math
import statistics

from judge import PAPER, RESULTS, cases, keep
from scipy import stats

PROGRAMS = 0.4
METRIC = "psnr_3d"


def lead(first, second, new):
    """Mean of first − second over their cases, and the half of the interval of a mean over `new` other cases."""
    each = [first[case] - second[case] for case in sorted(first.keys() & second.keys())]
    n = len(each)
    reach = stats.t.ppf(0.975, n - 1) * statistics.stdev(each) * math.sqrt(1 / n + 1 / new)
    return statistics.fmean(each), reach


def predictions():
    with (PAPER / "volume.csv").open(newline="") as file:
        printed = {(line["data"], int(line["views"])): float(line[METRIC]) for line in csv.DictReader(file) if line["method"] == "r2-gaussian"}
    tables = {name: cases(*name) for name in (("A", "volume"), ("A", "measured"), ("A", "default"), ("B", "large"))}

    def row(name, views, row):
        return (tables[name] or {}).get((views, "low", row, METRIC))

    for data, new in (("synthetic", 15), ("real", 3)):
        for views in (12, 18, 25):
            base = printed[data, views]
            runs = [(("A", "measured"), "TR-GS")] if data == "real" else [(("B", "large"), "full"), (("A", "volume"), "TR-GS")]
            name, ours = next((name, ours) for name, ours in runs if row(name, views, ours))
            gain, error = lead(row(name, views, ours), row(name, views, "R²-Gaussian"), new)
            both = math.hypot(PROGRAMS, error)
            rows = [("volume", "R²-Gaussian", None, base, PROGRAMS), ("volume", "TR-GS", "R²-Gaussian", gain, error), ("volume", "TR-GS", None, base + gain, both)]
            if data == "synthetic":
                more, error = lead(row(("A", "default"), views, "trgs"), row(("A", "volume"), views, "TR-GS"), new)
                rows.append(("default", "trgs", None, base + gain + more, math.hypot(both, error)))
            for table, of, minus, middle, reach in rows:
                interval = {key: round(value, 2) for key, value in (("low", middle - reach), ("expected", middle), ("high", middle + reach))}
                difference = {"minus": minus} if minus else {}
                yield {"table": table, "measured": data == "real", "row": of, **difference, "views": views, "noise": "low", "metric": METRIC, **interval}


def main():
    rows = ",\n".join(json.dumps(row, ensure_ascii=False) for row in predictions())
    keep(RESULTS / "predictions.json", f'{{"predictions": [\n{rows}\n]}}\n')


if __name__ == "__main__":
    main()
