"""Cases of the wavelet regularisation: transform, routing, loss, and its gradient through the field."""

import random
from functools import cache

import numpy as np
from mpmath import mpf

import gradients
import losses
import wavelet
from case import Case, Given, Table
from density import sample
from files import pseudo_random
from scene import Scanner, whitening
from scenes import several
from truth import meta_data, model_arrays

# No volume is larger: the time of a routing case grows with voxels times primitives.
GAP = mpf(10)**-9
DEFAULT = {"neighbours": 8, "enhancement": 1.5, "suppress": 1e-3, "enhance": 1e-3, "levels": 1}
# Equal weights would hide an exchange of the two.
UNEQUAL = {"neighbours": 8, "enhancement": 1.5, "suppress": 0.75, "enhance": 0.3, "levels": 1}


def uniform(key, shape):
    return pseudo_random(key, shape) / 2 + 0.5


def counts(key, shape, neighbours):
    """Numbers from 0 to `neighbours`, both ends included."""
    high = np.floor(uniform(key, shape) * (neighbours + 1))
    assert {0.0, float(neighbours)} <= set(high.flat), key
    return high


def ramp(shape):
    """Varies only along y, with a constant half; dyadic, so that rounding adds no detail."""
    block = np.zeros(shape) + 0.25
    block[: shape[0] // 2] += np.arange(shape[1])[None, :, None] * 0.125
    return block


BLOCKS = {
    "one-cell": lambda: uniform("wavelet/one-cell", (2, 2, 2)),
    "three-sides": lambda: uniform("wavelet/three-sides", (4, 6, 2)),
    "cube": lambda: uniform("wavelet/cube", (4, 4, 4)),
    "partly-flat": lambda: ramp((4, 6, 4)),
    "two-levels": lambda: uniform("wavelet/two-levels", (8, 4, 4)),
}


def block(name):
    return Given(f"inputs/wavelet-{name}/block.npy", BLOCKS[name]())


# ---------------------------------------------------------------------------- transform

def transforms():
    for name, title, flags in [
            ("one-cell", "a block of one cell", []),
            ("three-sides", "a block with three different sides, one of them 2", []),
            ("cube", "a cube", []),
            ("partly-flat", "a ramp along y beside a constant part", ["flat-block"])]:
        given = block(name)
        values = losses.numbers(given.content)
        shape = given.content.shape
        bands = cache(lambda values=values: wavelet.transform(values))
        alone = cache(lambda band, values=values: wavelet.alone(values, band))
        tables = {"coefficients": Table("coefficients.npy", (8, *(n // 2 for n in shape)), lambda i, b=bands: b()[i[0]][i[1:]]),
                  "bands": Table("bands.npy", (6, *shape), lambda i, alone=alone: alone(i[0] + 1)[i[1:]])}
        yield Case("haar", name, f"Haar transform: {title}", ["Eq. 11"], {"block": given}, tables, "optional", flags)


# ---------------------------------------------------------------------------- routing

def scanner(n_voxel, s_voxel, off_origin=(0.0, 0.0, 0.0)):
    return Scanner("cone", dso=5.0, dsd=7.0, n_detector=(7, 9), s_detector=(3.5, 4.5), n_voxel=n_voxel, s_voxel=s_voxel,
                   off_origin=off_origin)


def lattice(name):
    """Multiples of 1/2 between voxel centres at odd multiples of 1/8: up to eight primitives at one distance."""
    points = [(x / 2 - 0.75, y / 2 - 0.75, z / 2 - 0.5) for x in range(4) for y in range(4) for z in range(3)]
    random.Random(name).shuffle(points)
    return np.array(points)


def repeated(name):
    """Ten points on multiples of 1/8, each four times, in shuffled order."""
    points = [tuple(p) for p in np.round(pseudo_random(name, (10, 3)) * 8) / 8] * 4
    random.Random(name).shuffle(points)
    return np.array(points)


ROUTINGS = [
    ("cloud", "a cloud in and around a block with three different sides", scanner((6, 8, 4), (1.6, 2.0, 0.9), (0.1, -0.05, 0.2)),
     lambda name: 1.1 * pseudo_random(name, (60, 3)), 8, 0.35, []),
    ("three-neighbours", "three neighbours and another threshold", scanner((4, 4, 8), (1.0, 0.8, 2.0), (-0.1, 0.15, 0.05)),
     lambda name: pseudo_random(name, (40, 3)), 3, 0.6, []),
    ("equal-distances", "a lattice, whose points are tied", scanner((8, 8, 4), (2.0, 2.0, 1.0)), lattice, 5, 0.35,
     ["equal-distances"]),
    ("repeated-points", "every point four times", scanner((4, 8, 4), (1.0, 2.0, 1.0), (0.25, 0.0, -0.125)), repeated, 6, 0.35,
     ["equal-distances", "repeated-points"]),
    ("few-primitives", "three primitives for eight neighbours", scanner((2, 4, 2), (1.0, 2.0, 1.5)),
     lambda name: pseudo_random(name, (3, 3)), 8, 0.35, ["few-primitives"]),
]


def routings():
    for name, title, s, points, neighbours, threshold, flags in ROUTINGS:
        means = points(f"wavelet-routing/{name}")
        confidence = uniform(f"wavelet-routing/{name}/confidence", (len(means),))
        confidence[1::7] = threshold        # the threshold itself is confident
        exact, c = [tuple(map(mpf, mean)) for mean in means.tolist()], confidence.tolist()
        if "equal-distances" not in flags:
            for index in np.ndindex(*s.n_voxel):
                assert wavelet.gap(s.voxel_centre(index), exact, neighbours) > GAP, f"{name}: {index} is nearly tied"
        else:
            # Doubles hold every coordinate, so a tie is one in float64 too.
            assert all(float(x) == x for index in np.ndindex(*s.n_voxel) for x in s.voxel_centre(index)), name
            assert any(wavelet.gap(s.voxel_centre(index), exact, neighbours) == 0 for index in np.ndindex(*s.n_voxel)), name

        def high(index, s=s, exact=exact, c=c, neighbours=neighbours, threshold=threshold):
            return mpf(wavelet.confident(s.voxel_centre(index), exact, c, neighbours, threshold))

        inputs = {"means": Given(f"inputs/wavelet-{name}/means.npy", means),
                  "confidence": Given(f"inputs/wavelet-{name}/confidence.npy", confidence),
                  "scanner": Given(f"inputs/wavelet-{name}/meta_data.json", meta_data(s))}
        yield Case("wavelet-routing", name, f"Confident neighbours: {title}", ["Eq. 12", "Eq. 13"], inputs,
                   {"high": Table("high.npy", s.n_voxel, high)}, "optional", flags,
                   {"neighbours": neighbours, "threshold": threshold})


# ---------------------------------------------------------------------------- loss

def wavelet_losses():
    for name, title, of, settings, flags in [
            ("one-cell", "a block of one cell", "one-cell", UNEQUAL, []),
            ("three-sides", "a block with three different sides, one of them 2", "three-sides", UNEQUAL, []),
            ("default", "a cube, with equal weights of 1e-3", "cube", DEFAULT, []),
            ("three-neighbours", "a cube and three neighbours", "cube", {**UNEQUAL, "neighbours": 3, "enhancement": 2.25}, []),
            ("partly-flat", "a ramp along y beside a constant part", "partly-flat", UNEQUAL, ["flat-block"]),
            ("two-levels", "two levels", "two-levels", {**UNEQUAL, "levels": 2}, ["two-levels"])]:
        given = block(of)
        high = counts(f"wavelet/{name}/high", given.content.shape, settings["neighbours"]) if given.content.size > 8 \
            else np.arange(8.0).reshape(2, 2, 2)
        values, h = losses.numbers(given.content), losses.numbers(high)
        numbers = cache(lambda values=values, h=h, settings=settings: wavelet.loss(values, h, settings))
        part = lambda k, numbers=numbers: Table(("value.npy", "enhancement.npy", "suppression.npy")[k], (1,), lambda _: numbers()[k])
        gradient = Table("gradient.npy", given.content.shape,
                         lambda i, values=values, h=h, settings=settings: wavelet.slope(values, h, settings, i))
        tables = {"value": part(0), "enhancement": part(1), "suppression": part(2), "gradient": gradient}
        inputs = {"block": given, "high": Given(f"inputs/wavelet-{name}/high.npy", high)}
        yield Case("wavelet-loss", name, f"Wavelet loss: {title}", ["Eq. 11", "Eq. 14", "Eq. 15"], inputs, tables, "optional",
                   flags, settings)


# ---------------------------------------------------------------------------- gradient through the field

def through_the_field(scanner, primitives, high, settings):
    """index of a number of the model -> dL/d of it."""
    centres = {i: scanner.voxel_centre(i) for i in np.ndindex(*scanner.n_voxel)}
    field = cache(lambda number: of(primitives[number]))

    def of(p):
        whiten = whitening(p)
        return {i: sample(p, whiten, x) for i, x in centres.items()}

    def gradient(index):
        name, (number, *component) = index
        others = [field(k) for k in range(len(primitives)) if k != number]

        def value(p):
            own = of(p)
            return wavelet.loss({i: own[i] + sum(other[i] for other in others) for i in centres}, high, settings)[0]

        return gradients.difference(value, primitives[number], name, component[0] if component else None)

    return gradient


def field_gradients():
    inf = float("inf")
    for name, title, s, primitives, settings in [
            ("student", "three Student-t primitives in a block with three different sides",
             scanner((4, 6, 4), (1.5, 2.0, 1.1), (0.1, -0.05, 0.07)), several(2.5, 7.25, 14.6), UNEQUAL),
            ("gaussian", "two Gaussians", scanner((4, 2, 6), (1.4, 0.8, 2.0), (-0.05, 0.1, 0.03)), several(inf, inf), DEFAULT)]:
        high = counts(f"gradient-wavelet/{name}", s.n_voxel, settings["neighbours"])
        gradient = through_the_field(s, primitives, losses.numbers(high), settings)
        inputs = {"model": Given(f"inputs/wavelet-{name}/model.npz", model_arrays(primitives)),
                  "scanner": Given(f"inputs/wavelet-{name}/meta_data.json", meta_data(s)),
                  "high": Given(f"inputs/wavelet-{name}/high.npy", high)}
        equations = ["Eq. 1", *["Eq. 2"] * (name == "student"), "Eq. 3", "Eq. 11", "Eq. 14", "Eq. 15"]
        yield Case("gradient-wavelet", name, f"Gradient of the wavelet loss through the density: {title}", equations, inputs,
                   {"grad": Table("grad.npz", gradients.shapes(len(primitives)), gradient)}, "optional",
                   ["gaussian-limit"] * (name == "gaussian"), settings)
