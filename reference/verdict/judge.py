"""Judges the claims of reference/results/claims.toml by the rules of reference/results/PROTOCOL-OF-VERDICT.md.

    python judge.py            write reference/results/verdict/judged.json
    python judge.py --check    exit 1 if it is not that of the tables

Reads reference/results/verdict/SERIES/TABLE-cases.csv. Needs Python 3.11 and scipy.
"""

import csv
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
FIGURES = RESULTS / "verdict" / "judged.json"


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


def printed(views):
    """The paper's PSNR_3D of the full model at a number of views."""
    with (PAPER / "ablation.csv").open(newline="") as file:
        return next(float(line["psnr_3d"]) for line in csv.DictReader(file) if line["variant"] == "full" and int(line["views"]) == views)


def difference(found, claim, rows, views):
    """The paired differences by case of two rows at a number of views; None where a row is missing."""
    noise, metric = claim.get("noise", "low"), claim.get("metric", "psnr_3d")
    first, second = (found.get((views, noise, row, metric)) for row in rows)
    if not first or not second:
        return None
    return {case: first[case] - second[case] for case in first.keys() & second.keys()}


def measured(series, claim):
    """What a series has for a claim: differences by views, means, the test, the operating point."""
    table, *rows = claim["series"][series]
    found = cases(series, table)
    if found is None:
        return None
    by_views = {views: difference(found, claim, rows, views) for views in claim["views"]}
    by_views = {views: values for views, values in by_views.items() if values}
    if not by_views:
        return None
    everywhere = sorted(set.intersection(*(set(values) for values in by_views.values())))
    means = [statistics.fmean(values[case] for values in by_views.values()) for case in everywhere]
    noise = claim.get("noise", "low")
    level = {views: statistics.fmean(found[views, noise, rows[0], "psnr_3d"].values()) for views in by_views}
    off = {views: level[views] - printed(views) for views in by_views}
    error = statistics.stdev(means) / math.sqrt(len(means))
    reach = stats.t.ppf(1 - LEVEL / 2, len(means) - 1) * error
    centre = statistics.fmean(means)
    populations = {
        name: statistics.fmean(values)
        for name in rows
        if (values := [value for views in by_views for value in found.get((views, noise, name, "primitives"), {}).values()])
    }
    return {
        "series": series,
        "cases": len(means),
        "by_views": {views: [statistics.fmean(values.values()), statistics.stdev(values.values()) / math.sqrt(len(values))]
                     for views, values in by_views.items()},
        "mean": centre,
        "error": error,
        "interval": [centre - reach, centre + reach],
        "p": float(stats.ttest_1samp(means, 0.0).pvalue),
        "off": off,
        "meets": not claim.get("point", True) or all(abs(value) <= POINT for value in off.values()),
        "primitives": populations,
        "paper": statistics.fmean(effect for views, effect in zip(claim["views"], claim["paper"]) if views in by_views),
    }


def outcome(claim, result):
    """The outcome of a claim by the deciding series, with its adjusted p."""
    if result is None or not result["meets"]:
        return "cannot be tested here"
    sign = math.copysign(1.0, result["paper"])
    effects = dict(zip(claim["views"], claim["paper"]))
    same = all(mean * math.copysign(1.0, effects[views]) > 0 for views, (mean, _) in result["by_views"].items())
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


def judged():
    table = tomllib.loads((RESULTS / "claims.toml").read_text())
    claims = []
    for claim in table["claim"]:
        series = [result for name in ("B", "A", "C") if name in claim["series"] and (result := measured(name, claim))]
        deciding = next((result for result in series if result["meets"]), None)
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
    }


def main():
    text = json.dumps(judged(), indent=1, ensure_ascii=False) + "\n"
    if sys.argv[1:] == ["--check"]:
        if not FIGURES.exists() or FIGURES.read_text() != text:
            sys.exit(f"{FIGURES.name}: not that of the tables; write it with `python reference/verdict/judge.py`")
        return
    FIGURES.write_text(text)


if __name__ == "__main__":
    main()
