"""A posed view in 50 digits: tests/data/posed_view.json.

The view is turned about all axes, shifted and out of the plane of the orbit. Pixels are line integrals from the source
to the pixel's point in the plane of the detector; the gradient is that of their sum with given factors, by central
differences. Needs mpmath.
"""

import json
from pathlib import Path

from mpmath import mp, mpf

from gradients import PARAMETERS, difference
from projection import closed_form, gamma_ratio, line_integral
from scene import combine, primitive, whitening

OUT = Path(__file__).resolve().parents[2] / "tests/data/posed_view.json"

# Float64 numbers, taken exactly; u and v are orthonormal to rounding.
SOURCE = [3.1, -3.9, 0.75]
CENTRE = [-1.2, 1.7, -0.35]
PITCH = [0.21, 0.19]            # along u, v
SHAPE = [9, 11]                 # rows, columns
MODEL = [
    primitive((0.2, -0.3, 0.15), (0.11, 0.3, 0.06), (0.7, -0.3, 0.5, 0.2), 0.8, 4.5),
    primitive((-0.35, 0.25, -0.2), (0.2, 0.09, 0.14), (0.2, 0.9, -0.4, 0.1), 0.45, 17.0),
    primitive((0.4, 0.3, 0.35), (0.15, 0.1, 0.25), (0.9, 0.1, 0.3, -0.6), 0.6, float("inf")),
]


def axes():
    """u and v in float64: perpendicular to a direction 0.1 off the one to the centre, and rolled."""
    unit = lambda x: [c / mp.sqrt(sum(e * e for e in x)) for c in x]
    cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    w = unit([c - s + o for c, s, o in zip(map(mpf, CENTRE), map(mpf, SOURCE), (0.3, -0.2, 0.4))])
    level = unit(cross(w, [mpf(0), mpf(0), mpf(1)]))
    level = [-x for x in level]
    down = cross(w, level)
    roll = mpf("0.17")
    u = combine((mp.cos(roll), level), (mp.sin(roll), down))
    v = combine((mp.cos(roll), down), (-mp.sin(roll), level))
    return [float(x) for x in u], [float(x) for x in v]


def main():
    u, v = axes()
    rows, columns = SHAPE
    source = [mpf(x) for x in SOURCE]

    def direction(row, column):
        pu = (column + mpf(1) / 2 - mpf(columns) / 2) * mpf(PITCH[0])
        pv = (row + mpf(1) / 2 - mpf(rows) / 2) * mpf(PITCH[1])
        pixel = combine((1, [mpf(x) for x in CENTRE]), (pu, [mpf(x) for x in u]), (pv, [mpf(x) for x in v]))
        d = combine((1, pixel), (-1, source))
        return [x / mp.sqrt(sum(e * e for e in d)) for x in d]

    pixels = [(row, column) for row in range(rows) for column in range(columns)]
    factor = lambda row, column: mpf((7 * row + 5 * column) % 11 - 5) / 4

    def total(p):
        ratio, whiten = gamma_ratio(p.nu), whitening(p)
        return sum(factor(*at) * closed_form(p, whiten, source, direction(*at), ratio) for at in pixels)

    image = []
    for at in pixels:
        values = [closed_form(p, whitening(p), source, direction(*at), gamma_ratio(p.nu)) for p in MODEL]
        if at in [(0, 0), (4, 5), (8, 3)]:
            for p, value in zip(MODEL, values):
                assert abs(line_integral(p, whitening(p), source, direction(*at)) / value - 1) < mpf(10)**-30
        image.append(float(sum(values)))
    gradient = {}
    for name, width in PARAMETERS.items():
        parts = [None] if width is None else range(width)
        gradient[name] = [[float(difference(total, p, name, k)) for k in parts] for p in MODEL]
    number = lambda x: None if mp.isinf(x) else float(x)
    model = {name: [[number(x) for x in (getattr(p, name) if width else [getattr(p, name)])] for p in MODEL]
             for name, width in PARAMETERS.items()}
    scene = {"source": SOURCE, "centre": CENTRE, "u": u, "v": v, "pitch": PITCH, "shape": SHAPE, "model": model,
             "image": image, "gradient": gradient}
    OUT.write_text(json.dumps(scene, indent=1) + "\n")


if __name__ == "__main__":
    main()
