"""Writes VERDICT.md and VERDICT.html from verdict.toml: what holds of the paper, a row for each claim.

    python verdict.py            write both
    python verdict.py --check    exit 1 if they are not those of verdict.toml

Needs Python 3.11 and nothing else.
"""

import html
import sys
import textwrap
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
VERDICTS = ["holds", "holds only if", "does not hold", "cannot be tested here"]
# Colours of Okabe and Ito, which colour-blind readers can tell apart.
COLOURS = {"paper": "#0072B2", "ours": "#D55E00"}
BADGES = {"holds": "#007A58", "holds only if": "#8A6D00", "does not hold": "#B34700", "cannot be tested here": "#666666"}


def verdict_of(claim):
    (found,) = [verdict for verdict in VERDICTS if claim["verdict"] == verdict or claim["verdict"].startswith(f"{verdict} ")][-1:]
    return found


def wrapped(text, indent=""):
    return textwrap.fill(text, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def markdown(table):
    lines = ["# What holds of the paper", ""]
    lines += [part for paragraph in table["summary"].strip().split("\n\n") for part in (wrapped(paragraph), "")]
    counts = [f"{verdict}: {sum(verdict_of(claim) == verdict for claim in table['claim'])}" for verdict in VERDICTS]
    lines += [wrapped(f"{len(table['claim'])} claims. {'; '.join(counts)}. The same page [with plots](VERDICT.html)."), ""]
    lines += ["| claim | | |", "|---|---|---|"]
    lines += [f"| {claim['claim']} | {claim['source']} | {verdict_of(claim)} |" for claim in table["claim"]] + [""]
    for claim in table["claim"]:
        lines += [f"## {claim['claim']}", "", wrapped(f"**{claim['verdict'][0].upper()}{claim['verdict'][1:]}.** ({claim['source']})"), ""]
        rows = [("Paper", claim["paper"]), ("Here", claim["ours"]), ("Command", claim["command"])]
        lines += [*(wrapped(f"- {name}: {text}", "  ") for name, text in rows), ""]
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
            parts.append(f'<text x="{end:.1f}" y="{y + 10}" class="value">{value:g}</text>')
    parts.append(f'<line x1="{zero:.1f}" x2="{zero:.1f}" y1="18" y2="{height}" stroke="#333"/></svg>')
    return "".join(parts)


def inline(text):
    """Text with `code` and **bold** as HTML."""
    parts = html.escape(text).split("`")
    joined = "".join(f"<code>{part}</code>" if k % 2 else part for k, part in enumerate(parts))
    parts = joined.split("**")
    return "".join(f"<strong>{part}</strong>" if k % 2 else part for k, part in enumerate(parts))


def page(table):
    style = """body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}
article{border-top:1px solid #ccc;padding:.6rem 0;display:grid;grid-template-columns:minmax(0,1fr) 29rem;gap:1rem}
h2{font-size:1.05rem;margin:.2rem 0}.badge{color:#fff;padding:.1rem .5rem;border-radius:.3rem;font-size:.85rem}
code{font-size:.85em;background:#f2f2f2;overflow-wrap:anywhere}svg{width:100%}svg text{font:11px system-ui}.title{font-weight:600}
dl{margin:.3rem 0}dt{font-weight:600;float:left;margin-right:.5rem}dd{margin:0 0 .3rem}
@media(max-width:60rem){article{grid-template-columns:minmax(0,1fr)}}"""
    parts = ["<!doctype html>", '<html lang="en"><head><meta charset="utf-8">',
             '<meta name="viewport" content="width=device-width, initial-scale=1"><title>What holds of the paper</title>',
             f"<style>{style}</style></head><body><h1>What holds of the paper</h1>"]
    parts += [f"<p>{inline(paragraph)}</p>" for paragraph in table["summary"].strip().split("\n\n")]
    legend = " ".join(f'<span style="color:{colour}">■</span> {name}' for name, colour in COLOURS.items())
    parts.append(f"<p>Plots: {legend}.</p>")
    for claim in table["claim"]:
        colour = BADGES[verdict_of(claim)]
        parts.append(f'<article><div><h2>{inline(claim["claim"])}</h2>'
                     f'<span class="badge" style="background:{colour}">{html.escape(claim["verdict"])}</span> {claim["source"]}<dl>')
        for name, key in (("Paper", "paper"), ("Here", "ours"), ("Command", "command")):
            parts.append(f"<dt>{name}</dt><dd>{inline(claim[key])}</dd>")
        plot = bars(claim["plot"]) if "plot" in claim else ""
        parts.append(f"</dl></div><div>{plot}</div></article>")
    return "\n".join([*parts, "</body></html>"]) + "\n"


def main():
    table = tomllib.loads((HERE / "verdict.toml").read_text())
    files = {HERE / "VERDICT.md": markdown(table), HERE / "VERDICT.html": page(table)}
    if sys.argv[1:] == ["--check"]:
        stale = [path.name for path, text in files.items() if not path.exists() or path.read_text() != text]
        for name in stale:
            print(f"{name}: not that of verdict.toml; write it with `python reference/results/verdict.py`")
        return 1 if stale else 0
    for path, text in files.items():
        path.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
