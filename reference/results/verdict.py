"""Writes VERDICT.md and VERDICT.html: what holds of the paper, a row for each claim.

    python verdict.py            write both
    python verdict.py --check    exit 1 if they are not those of the files that it reads

Reads claims.toml, verdict/judged.json, which reference/verdict/judge.py makes of the tables by the rules, and verdict.toml: the
summary, the runs, and claims that are no differences of two rows. Needs Python 3.11 and nothing else.
"""

import hashlib
import html
import json
import sys
import textwrap
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
VERDICTS = ["holds", "holds only if", "does not hold", "cannot be tested here"]
SERIES = {"B": "128³", "A": "64³", "C": "stand-ins"}
# Colours of Okabe and Ito, which colour-blind readers can tell apart.
COLOURS = {"paper": "#0072B2", "here": "#D55E00"}
BADGES = {"holds": "#007A58", "holds only if": "#8A6D00", "does not hold": "#B34700", "cannot be tested here": "#666666"}


def joined(texts):
    texts = list(texts)
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def figure(value, metric):
    return f"{value:+.3f}" if metric in ("ssim_3d", "ssim_2d", "spearman") else f"{value:+.2f}"


def spread(mean, error, metric):
    return f"{figure(mean, metric)} ± {figure(error, metric)[1:]}"


def series_text(result, metric, decides):
    """What a series has for a claim, in one paragraph."""
    meets = [str(views) for views in result["meets"]]
    views = [f"{spread(mean, error, metric)} with {views}" for views, (mean, error) in result["by_views"].items()]
    low, high = (figure(end, metric) for end in result["interval"])
    p = f"p {result['p']:.2g}" + (f", adjusted {result['adjusted']:.2g}" if decides else "")
    of = f" of {joined(meets)} views" if meets and len(meets) < len(views) else ""
    parts = [f"{joined(views)} views; mean{of} {spread(result['mean'], result['error'], metric)}, 95 % from {low} to {high}, {p}"]
    levels = [f"{level:.2f} ({off:+.1f})" for level, off in zip(result["level"].values(), result["off"].values())]
    parts.append(f"PSNR_3D of TR-GS {joined(levels)}")
    for key, what, form in (("primitives", "primitives", ",.0f"), ("spearman", "ρ", ".2f")):
        if result.get(key):
            parts.append(f"{what} {joined(f'{format(value, form)} ({row})' for row, value in result[key].items())}")
    return "; ".join(parts)


def missed(claim, found):
    """The condition that keeps a claim from being decided."""
    if "lacks" in claim:
        return claim["lacks"]
    if not found["series"]:
        return "the runs"
    if not any(result["meets"] for result in found["series"]):
        return "the operating point: the figures in brackets are PSNR_3D against the paper's, which may differ by 1 dB"
    deciding = next(result for result in found["series"] if result["meets"])
    low, high = deciding["interval"]
    if low > 0 or high < 0:
        return f"precision: after the correction for all claims p is {deciding['adjusted']:.2g}"
    return "precision: the interval has zero and half of the paper's effect in it"


def judged(figures):
    """The claims that are differences: name, source, means, rows of text, verdict, plot."""
    claims = tomllib.loads((HERE / "claims.toml").read_text())["claim"]
    for claim, found in zip(claims, figures["claims"], strict=True):
        assert claim["claim"] == found["claim"], "judged.json is of other claims; run judge.py"
        metric = claim.get("metric", "psnr_3d")
        effects = [figure(value, metric) for value in claim["paper"]]
        printed = "none printed" if claim["paper"] == [0.0] else f"{joined(effects)} with {joined(map(str, claim['views']))} views"
        rows = [("Paper", printed)]
        for result in found["series"]:
            name = f"{SERIES[result['series']]}, {result['cases']} scans"
            rows.append((name, series_text(result, metric, found["decided_by"] == result["series"])))
        if found["outcome"] == "cannot be tested here":
            rows.append(("Missed", missed(claim, found)))
        first = found["series"][0] if found["series"] else None
        plot = None
        if first:
            nan = float("nan")
            here = [first["by_views"].get(str(views), [nan])[0] for views in claim["views"]]
            unit = {"psnr_3d": "PSNR_3D, dB", "psnr_2d": "PSNR_2D, dB", "ssim_3d": "SSIM_3D", "spearman": "ρ"}[metric]
            labels = [f"{views} views" for views in claim["views"]]
            plot = {"title": f"{unit}; here {SERIES[first['series']]}", "labels": labels, "paper": claim["paper"], "here": here}
        means = {result["series"]: spread(result["mean"], result["error"], metric) for result in found["series"]}
        paper = "" if claim["paper"] == [0.0] else figure(sum(claim["paper"]) / len(claim["paper"]), metric)
        brief = [paper, *(means.get(series, "") for series in SERIES)]
        yield {"claim": claim["claim"], "source": claim["source"], "brief": brief, "rows": rows, "verdict": found["outcome"], "plot": plot}


def readings_of(figures):
    """Rows of the table of readings."""
    for row in figures["readings"]:
        compared = (f"{part['what']} {spread(part['mean'], part['error'], part['metric'])}" for part in row["compared"])
        yield row["reading"], row["prediction"], "; ".join(compared) or "not run"


def verdict_of(claim):
    (found,) = [verdict for verdict in VERDICTS if claim["verdict"] == verdict or claim["verdict"].startswith(f"{verdict} ")][-1:]
    return found


def content():
    """Summary, digests, runs, all claims and readings."""
    table = tomllib.loads((HERE / "verdict.toml").read_text())
    figures = json.loads((HERE / "verdict" / "judged.json").read_text())
    others = [
        {**claim, "rows": [("Paper", claim["paper"]), ("Here", claim["ours"]), ("Command", claim["command"])], "brief": [""] * 4, "plot": None}
        for claim in table["claim"]
    ]
    claims = [*judged(figures), *others]
    counts = [f"{verdict}: {sum(verdict_of(claim) == verdict for claim in claims)}" for verdict in VERDICTS]
    summary = [*table["summary"].strip().split("\n\n"), f"{len(claims)} claims. {'; '.join(counts)}."]
    runs = [["series", *table["runs"]["columns"]], *table["runs"]["rows"]]
    predictions = hashlib.sha256((HERE / "predictions.json").read_bytes()).hexdigest()
    digests = f"Rules: PROTOCOL-OF-VERDICT.md, SHA-256 {figures['rules']}. Predictions for the paper's own scans: predictions.json, SHA-256 {predictions}."
    return summary, digests, runs, claims, [*readings_of(figures)]


def wrapped(text, indent=""):
    return textwrap.fill(text, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def rows_of_markdown(rows):
    head, *body = [f"| {' | '.join(row)} |" for row in rows]
    return [head, "|" + "---|" * len(rows[0]), *body, ""]


def markdown(summary, rules, runs, claims, readings):
    lines = ["# What holds of the paper", ""]
    lines += [part for paragraph in summary for part in (wrapped(paragraph), "")]
    for name in ("PROTOCOL-OF-VERDICT.md", "predictions.json"):
        rules = rules.replace(name, f"[{name}]({name})")
    lines += [wrapped(f"{rules} The same page [with plots](VERDICT.html)."), ""]
    lines += rows_of_markdown(runs)
    lines += [wrapped("Means over the numbers of views; of a series that meets the operating point at some, over those."), ""]
    series = [place for place in range(len(SERIES)) if any(claim["brief"][1 + place] for claim in claims)]
    brief = [[claim["claim"], claim["brief"][0], *(claim["brief"][1 + place] for place in series), verdict_of(claim)] for claim in claims]
    lines += rows_of_markdown([["", "paper", *([*SERIES.values()][place] for place in series), ""], *brief])
    for claim in claims:
        lines += [f"## {claim['claim']}", "", wrapped(f"**{claim['verdict'][0].upper()}{claim['verdict'][1:]}.** ({claim['source']})"), ""]
        lines += [*(wrapped(f"- {name}: {text}", "  ") for name, text in claim["rows"]), ""]
    lines += ["## Readings", "", wrapped("Differences of PSNR_3D in dB, or ρ, on the seven volumes of 64³; 18 views, 12 for T, τ and η."), ""]
    for name, prediction, found in readings:
        lines += [wrapped(f"- **{name}.** Predicted: {prediction}. Found: {found}.", "  ")]
    return "\n".join(lines).rstrip() + "\n"


def bars(plot):
    """Bars of the paper's and our figures, as SVG."""
    width, row, left = 460, 13, 150
    values = [value for name in COLOURS for value in plot[name] if value == value]
    low, high = min(0.0, *values), max(0.0, *values)
    scale = (width - left - 60) / ((high - low) or 1)
    zero = left + -low * scale
    height = len(plot["labels"]) * (2 * row + 8) + 24
    parts = [f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{html.escape(plot["title"])}">',
             f'<text x="0" y="11" class="title">{html.escape(plot["title"])}</text>']
    for place, label in enumerate(plot["labels"]):
        top = 22 + place * (2 * row + 8)
        parts.append(f'<text x="0" y="{top + row + 3}">{html.escape(label)}</text>')
        for k, (name, colour) in enumerate(COLOURS.items()):
            value, y = plot[name][place], top + k * row
            if value != value:
                continue
            x, length = zero + min(value, 0) * scale, abs(value) * scale
            parts.append(f'<rect x="{x:.1f}" y="{y}" width="{max(length, 1):.1f}" height="{row - 2}" fill="{colour}"/>')
            end = x + length + 4 if value >= 0 else zero + 4
            parts.append(f'<text x="{end:.1f}" y="{y + 10}" class="value">{value:.3g}</text>')
    parts.append(f'<line x1="{zero:.1f}" x2="{zero:.1f}" y1="18" y2="{height}" stroke="#333"/></svg>')
    return "".join(parts)


def inline(text):
    """Text with `code` and **bold** as HTML."""
    parts = html.escape(text).split("`")
    joined = "".join(f"<code>{part}</code>" if k % 2 else part for k, part in enumerate(parts))
    parts = joined.split("**")
    return "".join(f"<strong>{part}</strong>" if k % 2 else part for k, part in enumerate(parts))


def page(summary, rules, runs, claims, readings):
    style = """body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}
article{border-top:1px solid #ccc;padding:.6rem 0;display:grid;grid-template-columns:minmax(0,1fr) 29rem;gap:1rem}
h2{font-size:1.05rem;margin:.2rem 0}.badge{color:#fff;padding:.1rem .5rem;border-radius:.3rem;font-size:.85rem}
code{font-size:.85em;background:#f2f2f2;overflow-wrap:anywhere}svg{width:100%}svg text{font:11px system-ui}.title{font-weight:600}
dl{margin:.3rem 0}dt{font-weight:600;float:left;margin-right:.5rem}dd{margin:0 0 .3rem}
table{border-collapse:collapse;font-size:.9rem}td,th{border-bottom:1px solid #ccc;padding:.2rem .5rem;text-align:left}
.rules{overflow-wrap:anywhere}@media(max-width:60rem){article{grid-template-columns:minmax(0,1fr)}}"""
    parts = ["<!doctype html>", '<html lang="en"><head><meta charset="utf-8">',
             '<meta name="viewport" content="width=device-width, initial-scale=1"><title>What holds of the paper</title>',
             f"<style>{style}</style></head><body><h1>What holds of the paper</h1>"]
    parts += [f"<p>{inline(paragraph)}</p>" for paragraph in summary]
    parts.append(f'<p class="rules">{html.escape(rules)}</p><table>')
    for place, row in enumerate(runs):
        cell = "td" if place else "th"
        parts.append("<tr>" + "".join(f"<{cell}>{inline(text)}</{cell}>" for text in row) + "</tr>")
    legend = " ".join(f'<span style="color:{colour}">■</span> {name}' for name, colour in COLOURS.items())
    parts.append(f"</table><p>Plots: {legend}.</p>")
    for claim in claims:
        colour = BADGES[verdict_of(claim)]
        parts.append(f'<article><div><h2>{inline(claim["claim"])}</h2>'
                     f'<span class="badge" style="background:{colour}">{html.escape(claim["verdict"])}</span> {claim["source"]}<dl>')
        parts += [f"<dt>{name}</dt><dd>{inline(text)}</dd>" for name, text in claim["rows"]]
        plot = bars(claim["plot"]) if claim["plot"] else ""
        parts.append(f"</dl></div><div>{plot}</div></article>")
    parts.append("<h2>Readings</h2><table><tr><th></th><th>predicted</th><th>found (64³, dB of PSNR_3D or ρ)</th></tr>")
    parts += ["<tr>" + "".join(f"<td>{inline(text)}</td>" for text in row) + "</tr>" for row in readings]
    return "\n".join([*parts, "</table></body></html>"]) + "\n"


def main():
    found = content()
    files = {HERE / "VERDICT.md": markdown(*found), HERE / "VERDICT.html": page(*found)}
    if sys.argv[1:] == ["--check"]:
        stale = [path.name for path, text in files.items() if not path.exists() or path.read_text() != text]
        for name in stale:
            print(f"{name}: not that of verdict.toml and judged.json; write it with `python reference/results/verdict.py`")
        return 1 if stale else 0
    for path, text in files.items():
        path.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
