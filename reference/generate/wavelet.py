"""The wavelet regularisation from its definitions [Eq. 11-15].

Blocks are dictionaries from (x, y, z) to an mpmath number, coefficients from (band, i, j, k); sides are even.
"""

import itertools

from mpmath import mp, mpf

STEP = mpf(10)**-17
AGREEMENT = mpf(10)**-20
FLAT = mpf(10)**-12
MIDDLE = range(1, 7)


def sides(block):
    return tuple(max(index[axis] for index in block) + 1 for axis in range(3))


def highs(band):
    """(hx, hy, hz) of band 4 hx + 2 hy + hz."""
    return band // 4, band // 2 % 2, band % 2


# ---------------------------------------------------------------------------- transform

def halved(values, axis):
    """One axis: of each pair (a, b) low = (a + b)/sqrt 2 and high = (a - b)/sqrt 2, as two dictionaries."""
    low, high = {}, {}
    for index, a in values.items():
        if index[axis] % 2 == 0:
            b = values[tuple(x + (k == axis) for k, x in enumerate(index))]
            cell = tuple(x // 2 if k == axis else x for k, x in enumerate(index))
            low[cell], high[cell] = (a + b) / mp.sqrt(2), (a - b) / mp.sqrt(2)
    return low, high


def doubled(low, high, axis):
    """The inverse of `halved`."""
    values = {}
    for cell in low:
        for side, sign in ((0, 1), (1, -1)):
            index = tuple(2 * x + side if k == axis else x for k, x in enumerate(cell))
            values[index] = (low[cell] + sign * high[cell]) / mp.sqrt(2)
    return values


def transform(block):
    """[Eq. 11] band -> its coefficients, one level."""
    parts = {(): block}
    for axis in range(3):
        parts = {key + (h,): part for key, values in parts.items() for h, part in enumerate(halved(values, axis))}
    return {band: parts[highs(band)] for band in range(8)}


def inverse(bands):
    parts = {highs(band): values for band, values in bands.items()}
    for axis in (2, 1, 0):
        parts = {key: doubled(parts[key + (0,)], parts[key + (1,)], axis) for key in {key[:-1] for key in parts}}
    return parts[()]


def alone(block, band, level=1):
    """The contribution of one band of a level (1: the finest) to the block: the inverse transform with all others zero."""
    bands = transform(block)
    kept = 0 if level > 1 else band
    bands = {b: values if b == kept else dict.fromkeys(values, mpf(0)) for b, values in bands.items()}
    if level > 1:
        bands[0] = alone(bands[0], band, level - 1)
    return inverse(bands)


# ---------------------------------------------------------------------------- routing

def squared_distance(a, b):
    return sum((x - y)**2 for x, y in zip(a, b))


def order(centre, means):
    """Primitives from near to far: by distance, then by index."""
    return sorted(range(len(means)), key=lambda i: (squared_distance(centre, means[i]), i))


def gap(centre, means, neighbours):
    """Distance between the last neighbour and the first primitive that is none."""
    near = order(centre, means)
    if len(means) <= neighbours:
        return mp.inf
    first, last = (mp.sqrt(squared_distance(centre, means[near[k]])) for k in (neighbours, neighbours - 1))
    return first - last


def confident(centre, means, confidence, neighbours, threshold):
    """[Eq. 12] Number of nearest primitives with a confidence of at least the threshold; [Eq. 13] are the others."""
    return sum(confidence[i] >= threshold for i in order(centre, means)[:neighbours])


# ---------------------------------------------------------------------------- loss

def slope_along(f, index, axis, n):
    """Central difference, one-sided at the faces; spacing 1."""
    at = lambda i: f[tuple(i if k == axis else x for k, x in enumerate(index))]
    i = index[axis]
    if i == 0:
        return at(1) - at(0)
    if i == n - 1:
        return at(n - 1) - at(n - 2)
    return (at(i + 1) - at(i - 1)) / 2


def strength(block, levels):
    """g: mean over the bands of sqrt(|grad|^2 + 1e-12)."""
    n, bands = sides(block), [alone(block, band, level) for level in range(1, levels + 1) for band in MIDDLE]
    root = lambda f, i: mp.sqrt(sum(slope_along(f, i, axis, n[axis])**2 for axis in range(3)) + FLAT)
    return {i: mp.fsum(root(f, i) for f in bands) / len(bands) for i in block}


def loss(block, high, s):
    """(L, E, S) [Eq. 14, 15]; `high` the number of confident neighbours, s the settings."""
    g, k = strength(block, s["levels"]), s["neighbours"]
    e = mp.fsum(mpf(s["enhancement"]) * high[i] / k * g[i] for i in g) / len(g)
    low = mp.fsum(mpf(k - high[i]) / k * g[i] for i in g) / len(g)
    return mpf(s["suppress"]) * low - mpf(s["enhance"]) * e, e, low


def slope(block, high, s, index):
    """dL/d block[index], by central differences; asserts agreement with a step eight times as long."""
    def central(h):
        moved = lambda step: loss({**block, index: block[index] + step}, high, s)[0]
        return (moved(h) - moved(-h)) / (2 * h)

    short, long = central(STEP), central(8 * STEP)
    scale = max(abs(mpf(s["suppress"])), abs(mpf(s["enhance"]))) / len(block)
    assert abs(short - long) < AGREEMENT * scale, f"slope at {index}: {mp.nstr(short, 25)} or {mp.nstr(long, 25)}"
    return short if abs(short) > AGREEMENT * scale else mpf(0)


# ---------------------------------------------------------------------------- self-check

def check():
    """Asserts that the inverse inverts, energy is preserved, and a cell of eight voxels follows its formula."""
    block = {i: mpf((7 * i[0] + 5 * i[1] * i[1] + 3 * i[2]) % 11) / 8 for i in itertools.product(range(4), range(2), range(6))}
    bands = transform(block)
    assert all(abs(value - block[i]) < mpf(10)**-48 for i, value in inverse(bands).items())
    energy = mp.fsum(c * c for values in bands.values() for c in values.values())
    assert abs(energy - mp.fsum(v * v for v in block.values())) < mpf(10)**-46
    for band in range(8):
        sign = lambda o: (-1)**sum(h * x for h, x in zip(highs(band), o))
        direct = mp.fsum(sign(o) * block[tuple(2 * c + x for c, x in zip((1, 0, 2), o))] for o in itertools.product((0, 1), repeat=3))
        assert abs(bands[band][(1, 0, 2)] - direct / mp.sqrt(8)) < mpf(10)**-48, band


check()
