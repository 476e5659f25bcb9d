"""Judges the claims of reference/results/claims.toml by the rules of reference/results/PROTOCOL-OF-VERDICT.md.

    python judge.py            write reference/results/verdict/judged.json
    python judge.py --check    exit 1 if it is not that of the tables

Reads reference/results/verdict/SERIES/TABLE-cases.csv. Needs Python 3.11 and scipy.
"""

import csv
import functools
import hashlib
import json
import math
import statistics
import sys
import tomllib
from pathlib import Path

from scipy import stats

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parent / "results"
PAPER = HERE.parent / "paper"
LEVEL, POINT = 0.05, 1.0
# Names of the row of TR-GS in the tables.
FULL = ("full", "TR-GS", "TR-GS, AR, SGHMC", "t, AR, SGHMC", "T = 0.25", "τ = 0.35", "η = 1.50", "default")
FIGURES = RESULTS / "verdict" / "judged.json"


@functools.cache
def cases(series, table):
    """(views, noise, row, metric) -> {case: value}; None if the table was not run."""
    path = RESULTS / "verdict" / series / f"{table}-cases.csv"
    if not path.exists():
        return None
    found = {}
    with path.open(newline="") as file:
        for line in csv.DictReader(file):
            key = int(line["views"]), line["noise"], line["row"], line["metric"]
            found.setdefault(key, {})[line["case"]] = float(line["ours"])
    return found


def printed(views, noise):
    """The paper's PSNR_3D of the full model at a number of views and a level of noise."""
    table, column, full = ("ablation", "variant", "full") if noise == "low" else ("noise", "method", "tr-gs")
    with (PAPER / f"{table}.csv").open(newline="") as file:
        rows = (line for line in csv.DictReader(file) if line[column] == full and line.get("noise", noise) == noise)
        return next(float(line["psnr_3d"]) for line in rows if int(line["views"]) == views)


def difference(found, claim, rows, views):
    """The paired differences by case of two rows at a number of views; None where a row is missing."""
    noise, metric = claim.get("noise", "low"), claim.get("metric", "psnr_3d")
    first, second = (found.get((views, noise, row, metric)) for row in rows)
    if not first or not second:
        return None
    return {case: first[case] - second[case] for case in first.keys() & second.keys()}


def paired(series, claim, views):
    """The differences of a claim by case; less those of `minus`, the same comparison under other conditions."""
    table, *rows = claim["series"][series]
    found = cases(series, table)
    values = difference(found, claim, rows, views) if found else None
    if not values or "minus" not in claim:
        return values
    table, *rows = claim["minus"]
    less = difference(cases(series, table), claim, rows, views)
    return {case: values[case] - less[case] for case in values.keys() & less.keys()}


def measured(series, claim):
    """What a series has for a claim: differences by views, means, the test, the operating point."""
    table, *rows = claim["series"][series]
    by_views = {views: values for views in claim["views"] if (values := paired(series, claim, views))}
    if not by_views:
        return None
    found = cases(series, table)
    noise = claim.get("noise", "low")
    level = {
        views: statistics.fmean(next(found[key].values() for name in FULL if (key := (views, noise, name, "psnr_3d")) in found))
        for views in by_views
    }
    off = {views: level[views] - printed(views, noise) for views in by_views}
    meeting = [views for views in by_views if not claim.get("point", True) or abs(off[views]) <= POINT]
    tested = {views: by_views[views] for views in meeting or by_views}
    everywhere = sorted(set.intersection(*(set(values) for values in tested.values())))
    means = [statistics.fmean(values[case] for values in tested.values()) for case in everywhere]
    error = statistics.stdev(means) / math.sqrt(len(means))
    reach = stats.t.ppf(1 - LEVEL / 2, len(means) - 1) * error
    centre = statistics.fmean(means)

    def means_of(metric):
        values = {name: [value for views in by_views for value in found.get((views, noise, name, metric), {}).values()] for name in rows}
        return {name: statistics.fmean(of_row) for name, of_row in values.items() if of_row}

    return {
        "series": series,
        "cases": len(means),
        "by_views": {views: [statistics.fmean(values.values()), statistics.stdev(values.values()) / math.sqrt(len(values))]
                     for views, values in by_views.items()},
        "mean": centre,
        "error": error,
        "interval": [centre - reach, centre + reach],
        "p": float(stats.ttest_1samp(means, 0.0).pvalue),
        "level": level,
        "off": off,
        "meets": meeting,
        "primitives": means_of("primitives"),
        "spearman": means_of("spearman"),
        "paper": statistics.fmean(effect for views, effect in zip(claim["views"], claim["paper"]) if views in tested),
    }


def outcome(claim, result):
    """The outcome of a claim by the deciding series, with its adjusted p. `lacks` is what no run here has."""
    if "lacks" in claim or result is None or not result["meets"]:
        return "cannot be tested here"
    sign = math.copysign(1.0, result["paper"])
    effects = dict(zip(claim["views"], claim["paper"]))
    same = all(result["by_views"][views][0] * math.copysign(1.0, effects[views]) > 0 for views in result["meets"])
    if same and result["adjusted"] < LEVEL:
        return "holds"
    low, high = sorted(sign * end for end in result["interval"])
    if high < abs(result["paper"]) / 2:
        return "does not hold"
    return "cannot be tested here"


def adjust(results):
    """Holm's adjustment of the p-values, in place."""
    largest = 0.0
    for place, result in enumerate(sorted(results, key=lambda result: result["p"])):
        largest = max(largest, min(1.0, (len(results) - place) * result["p"]))
        result["adjusted"] = largest


def reading(row):
    """The prediction of a reading beside what its runs have: mean and standard error of each comparison."""
    compared = []
    for comparison in row["compared"]:
        metric, views = comparison.get("metric", "psnr_3d"), comparison["views"]
        values = []
        for series, table, name in comparison["rows"]:
            found = cases(series, table)
            values.append(found and found[views, "low", name, metric])
        if not all(values):
            continue
        each = [values[0][case] - (values[1][case] if len(values) > 1 else 0.0) for case in values[0]]
        error = statistics.stdev(each) / math.sqrt(len(each))
        compared.append({"what": comparison["what"], "metric": metric, "mean": statistics.fmean(each), "error": error})
    return {"reading": row["reading"], "prediction": row["prediction"], "compared": compared}


def judged():
    table = tomllib.loads((RESULTS / "claims.toml").read_text())
    claims = []
    for claim in table["claim"]:
        series = [result for name in ("B", "A", "C") if name in claim["series"] and (result := measured(name, claim))]
        deciding = next((result for result in series if result["meets"] and "lacks" not in claim), None)
        claims.append((claim, series, deciding))
    adjust([deciding for _, _, deciding in claims if deciding])
    rules = hashlib.sha256((RESULTS / "PROTOCOL-OF-VERDICT.md").read_bytes()).hexdigest()
    return {
        "rules": rules,
        "claims": [
            {
                "claim": claim["claim"],
                "outcome": outcome(claim, deciding),
                "decided_by": deciding["series"] if deciding else None,
                "series": series,
            }
            for claim, series, deciding in claims
        ],
        "readings": [reading(row) for row in table["reading"]],
    }


def rounded(value):
    """Numbers to six digits: the last ones differ between versions of SciPy."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: rounded(inner) for key, inner in value.items()}
    return [rounded(inner) for inner in value] if isinstance(value, list) else value


def keep(path, text):
    """Writes a file, or with --check demands that it has the text."""
    if sys.argv[1:] != ["--check"]:
        path.write_text(text)
    elif not path.exists() or path.read_text() != text:
        sys.exit(f"{path.name}: not that of the tables; write it with `python {sys.argv[0]}`")


def main():
    found = rounded(judged())
    # A line for each claim and each reading.
    lists = [f'"{key}": [\n' + ",\n".join(json.dumps(row, ensure_ascii=False) for row in found[key]) + "\n]" for key in ("claims", "readings")]
    keep(FIGURES, f'{{"rules": "{found["rules"]}",\n' + ",\n".join(lists) + "}\n")


if __name__ == "__main__":
    main()
