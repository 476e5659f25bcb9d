"""Gradients by central differences at 50 digits.

With a step of 1e-17 the truncation error is of the order 1e-34 (1e-26 for the thinnest primitives,
1e-3 of the step's length scale squared) and the rounding error 1e-33 relative to the function, both
far below a float64. `difference` repeats itself with a step eight times as long and asserts
agreement.
"""

from mpmath import mp, mpf

STEP = mpf(10)**-17
AGREEMENT = mpf(10)**-20

# name -> number of components; None means one number per primitive
PARAMETERS = {"mean": 3, "scale": 3, "quaternion": 4, "density": None, "nu": None}


def shapes(count):
    """Shapes of the arrays of a model of `count` primitives, and of a gradient."""
    return {name: (count,) if width is None else (count, width) for name, width in PARAMETERS.items()}


def difference(function, p, name, component):
    """d function(p) / d one number of p; quaternion entries are the unnormalised ones."""
    if name == "nu" and p.gaussian:
        return mpf(0)

    unit = STEP
    if name == "quaternion":        # a step of its own length for the tiny ones
        unit *= min(1, mp.sqrt(sum(x * x for x in p.quaternion)))

    def slope(h):
        return (function(p.moved(name, component, h)) - function(p.moved(name, component, -h))) / (2 * h)

    short, long = slope(unit), slope(8 * unit)
    size = max(abs(short), abs(function(p)) * mpf(10)**-6)
    assert abs(short - long) <= AGREEMENT * size, f"d/d{name}[{component}]: {mp.nstr(short, 25)} or {mp.nstr(long, 25)}"
    return short
