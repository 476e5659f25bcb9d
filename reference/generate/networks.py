"""Hash grid, Lineformer block and quadrature along rays, in 50-digit arithmetic; the methods of NAF and SAX-NeRF."""

import numpy as np
from mpmath import mp, mpf

import scene

PRIMES = [1, 19_349_663, 83_492_791]
WORD = 2**32
HIDDEN, HEADS, DEPTH = 32, 8, 4
LAST = mpf(1e-10)
PARTS = {"gain_1": (32,), "shift_1": (32,), "query": (32, 32), "key_value": (64, 32), "position": (8, 2, 2), "out": (32, 32),
         "out_bias": (32,), "gain_2": (32,), "shift_2": (32,), "first": (128, 32), "second": (128, 128), "third": (32, 128)}


def exact(array):
    """An array of mpmath numbers."""
    array = np.asarray(array, dtype=float)
    return np.array([mpf(x) for x in array.ravel()], dtype=object).reshape(array.shape)


# ---------------------------------------------------------------------------- encodings

def entry(point, resolution, entries):
    """The entry of a grid point: joined coordinates while their step, in 32 bits, is at most the size of the table."""
    index, step = 0, 1
    for coordinate in point:
        if step > entries:
            break
        index, step = (index + coordinate * step) % WORD, step * (resolution + 1) % WORD
    if step > entries:
        index = 0
        for coordinate, prime in zip(point, PRIMES):
            index ^= coordinate * prime % WORD
    return index % entries


def corners(point, resolution, entries):
    """(entry, weight) of the eight corners of a point's cell, x fastest."""
    scaled = [mpf(x) * (resolution - 1) + mpf(1) / 2 for x in point]
    cell = [int(mp.floor(x)) for x in scaled]
    found = []
    for corner in range(8):
        at = [cell[axis] + (corner >> axis & 1) for axis in range(3)]
        weight = mpf(1)
        for axis in range(3):
            weight *= 1 - abs(scaled[axis] - at[axis])
        found.append((entry(at, resolution, entries), weight))
    return found


def hash_code(points, table, resolution):
    return [[sum(weight * mpf(table[at, k]) for at, weight in corners(point, resolution, len(table))) for k in range(2)]
            for point in points]


def hash_code_gradient(points, cotangent, resolution, entries):
    gradient = [[mpf(0), mpf(0)] for _ in range(entries)]
    for point, slopes in zip(points, cotangent):
        for at, weight in corners(point, resolution, entries):
            for k in range(2):
                gradient[at][k] += weight * mpf(slopes[k])
    return gradient


def frequency_code(point, half_sides, frequencies):
    place = [(2 * mpf(x) - 1) * mpf(side) for x, side in zip(point, half_sides)]
    waves = [wave(2**k * x) for k in range(frequencies) for wave in (mp.sin, mp.cos) for x in place]
    return place + waves


# ---------------------------------------------------------------------------- Lineformer

def normalised(x):
    """(x with mean 0 and variance 1, 1 over the standard deviation)"""
    centred = x - x.sum() / HIDDEN
    inverse = 1 / mp.sqrt((centred * centred).sum() / HIDDEN + mpf(1e-5))
    return centred * inverse, inverse


def gelu(x):
    """Value and slope of x·Φ(x)."""
    phi = mp.erfc(-x / mp.sqrt(2)) / 2
    return x * phi, phi + x * mp.exp(-x * x / 2) / mp.sqrt(2 * mp.pi)


def each(function, x):
    pairs = [function(value) for value in x]
    return np.array([a for a, _ in pairs], dtype=object), np.array([b for _, b in pairs], dtype=object)


class Lineformer:
    """The block for one pair of points: its value, and its gradient by the chain rule, step by step backwards."""

    def __init__(self, p, x):
        self.p, self.x = p, x
        self.hat, self.inverse = zip(*(normalised(row) for row in x))
        self.n = [p["gain_1"] * hat + p["shift_1"] for hat in self.hat]
        self.q = [p["query"] @ n for n in self.n]
        self.k, self.v = zip(*((p["key_value"][:32] @ n, p["key_value"][32:] @ n) for n in self.n))
        self.weights = [[self.softmax(own, head) for head in range(HEADS)] for own in range(2)]
        self.mixed = [np.concatenate([sum(self.weights[own][head][other] * self.part(self.v[other], head) for other in range(2))
                                      for head in range(HEADS)]) for own in range(2)]
        self.y = [p["out"] @ mixed + p["out_bias"] + x for mixed, x in zip(self.mixed, x)]
        self.hat_2, self.inverse_2 = zip(*(normalised(row) for row in self.y))
        self.n_2 = [p["gain_2"] * hat + p["shift_2"] for hat in self.hat_2]
        self.a, self.a_slope = zip(*(each(gelu, p["first"] @ n) for n in self.n_2))
        self.b, self.b_slope = zip(*(each(gelu, p["second"] @ a) for a in self.a))
        self.value = [p["third"] @ b + y for b, y in zip(self.b, self.y)]

    @staticmethod
    def part(row, head):
        return row[head * DEPTH:(head + 1) * DEPTH]

    def softmax(self, own, head):
        query = self.part(self.q[own], head)
        scores = [mp.exp((query * self.part(self.k[other], head)).sum() / 2 + self.p["position"][head, own, other])
                  for other in range(2)]
        return [score / sum(scores) for score in scores]

    def gradient(self, d):
        """name -> gradient, with that to the pair as x."""
        p, found = self.p, {name: np.full(shape, mpf(0), dtype=object) for name, shape in PARTS.items()}
        d_y = []
        for own in range(2):
            found["third"] += np.outer(d[own], self.b[own])
            d_b = p["third"].T @ d[own] * self.b_slope[own]
            found["second"] += np.outer(d_b, self.a[own])
            d_a = p["second"].T @ d_b * self.a_slope[own]
            found["first"] += np.outer(d_a, self.n_2[own])
            d_n = p["first"].T @ d_a
            found["gain_2"] += d_n * self.hat_2[own]
            found["shift_2"] += d_n
            d_y.append(d[own] + self.unnormalised(d_n * p["gain_2"], self.hat_2[own], self.inverse_2[own]))
        d_q, d_k, d_v = ([np.full(HIDDEN, mpf(0), dtype=object) for _ in range(2)] for _ in range(3))
        for own in range(2):
            found["out"] += np.outer(d_y[own], self.mixed[own])
            found["out_bias"] += d_y[own]
            d_mixed = p["out"].T @ d_y[own]
            for head in range(HEADS):
                weights, slope = self.weights[own][head], self.part(d_mixed, head)
                along = [(slope * self.part(self.v[other], head)).sum() for other in range(2)]
                mean = sum(w * a for w, a in zip(weights, along))
                for other in range(2):
                    self.part(d_v[other], head)[:] += weights[other] * slope
                    to_score = weights[other] * (along[other] - mean)
                    found["position"][head, own, other] += to_score
                    self.part(d_q[own], head)[:] += to_score / 2 * self.part(self.k[other], head)
                    self.part(d_k[other], head)[:] += to_score / 2 * self.part(self.q[own], head)
        d_x = []
        for own in range(2):
            found["query"] += np.outer(d_q[own], self.n[own])
            d_kv = np.concatenate([d_k[own], d_v[own]])
            found["key_value"] += np.outer(d_kv, self.n[own])
            d_n = p["query"].T @ d_q[own] + p["key_value"].T @ d_kv
            found["gain_1"] += d_n * self.hat[own]
            found["shift_1"] += d_n
            d_x.append(d_y[own] + self.unnormalised(d_n * p["gain_1"], self.hat[own], self.inverse[own]))
        return {**found, "x": np.array(d_x, dtype=object)}

    @staticmethod
    def unnormalised(d, hat, inverse):
        return inverse * (d - d.sum() / HIDDEN - hat * (d * hat).sum() / HIDDEN)


# ---------------------------------------------------------------------------- rays

def crossing(scanner, origin, direction):
    """Where a line enters and leaves the box of the volume."""
    near, far = -mp.inf, mp.inf
    for axis in range(3):
        middle, half = mpf(scanner.off_origin[axis]), mpf(scanner.s_voxel[axis]) / 2
        if direction[axis] == 0:
            assert abs(origin[axis] - middle) <= half, "a ray beside the box"
            continue
        ends = [(middle + side * half - origin[axis]) / direction[axis] for side in (-1, 1)]
        near, far = max(near, min(ends)), min(far, max(ends))
    assert near < far, "a ray beside the box"
    return near, far


def quadrature(scanner, view, pixel, draws, density):
    """(points, lengths, integral) of a ray; a draw from 0 to 1 places a point in its part of the ray."""
    origin, direction = scene.ray(scanner, view, *pixel)
    near, far = crossing(scanner, origin, direction)
    last = len(draws) - 1
    at = []
    for k, draw in enumerate(draws):
        begin, end = max(k - mpf(1) / 2, mpf(0)), min(k + mpf(1) / 2, mpf(last))
        at.append(near + (far - near) / last * (begin + (end - begin) * mpf(draw)))
    lengths = [b - a for a, b in zip(at, at[1:])] + [LAST]
    points = [scene.combine((mpf(1), origin), (t, direction)) for t in at]
    return points, lengths, sum(length * mpf(rho) for length, rho in zip(lengths, density))
