"""Losses on images and blocks, from their definitions; gradients by central differences of the whole loss.

Images and blocks are dictionaries from an index to an mpmath number.
"""

import itertools

import numpy as np
from mpmath import mp, mpf

STEP = mpf(10)**-17
ZERO = mpf(10)**-22     # a slope below this is a zero with the rounding of the difference on it

RADIUS = 5
SIGMA = mpf(3) / 2
# The constants are the decimal numbers 0.01 and 0.03, not the float64 numbers next to them.
C1, C2 = (mpf(1) / 100)**2, (mpf(3) / 100)**2


def numbers(array):
    return {index: mpf(float(value)) for index, value in np.ndenumerate(array)}


def slope(function, values, index):
    """d function(values) / d values[index]. At a kink of |.| the two sides cancel: 0, the required sub-gradient."""
    def central(h):
        moved = lambda step: function({**values, index: values[index] + step})
        return (moved(h) - moved(-h)) / (2 * h)

    short, long = central(STEP), central(8 * STEP)
    assert abs(short - long) < mpf(10)**-20 * max(1, abs(short)), f"slope at {index}: {mp.nstr(short, 25)} or {mp.nstr(long, 25)}"
    return short if abs(short) > ZERO else mpf(0)


def l1(prediction, target):
    """mean |p - t|"""
    return mp.fsum(abs(prediction[i] - target[i]) for i in prediction) / len(prediction)


def window():
    """The Gaussian window along one axis, normalised over all of its 11 weights."""
    weights = [mp.exp(-mpf(k)**2 / (2 * SIGMA**2)) for k in range(-RADIUS, RADIUS + 1)]
    return [w / sum(weights) for w in weights]


WINDOW = window()


def blur(image):
    """The window over both axes, zeros outside the image."""
    for axis in (0, 1):
        shifted = lambda i, k, axis=axis: (i[0] + k, i[1]) if axis == 0 else (i[0], i[1] + k)
        image = {i: mp.fsum(WINDOW[k + RADIUS] * image[shifted(i, k)] for k in range(-RADIUS, RADIUS + 1) if shifted(i, k) in image)
                 for i in image}
    return image


def product(a, b):
    return {i: a[i] * b[i] for i in a}


class Ssim:
    """Mean structural similarity with a fixed target (Wang et al. 2004, Eq. 13, data of range 1)."""

    def __init__(self, target):
        self.target, self.mean, self.square = target, blur(target), blur(product(target, target))

    def __call__(self, prediction):
        mean, square, cross = blur(prediction), blur(product(prediction, prediction)), blur(product(prediction, self.target))
        total = mpf(0)
        for i in prediction:
            a, b = mean[i], self.mean[i]
            covariance = cross[i] - a * b
            variances = square[i] - a * a + self.square[i] - b * b
            total += (2 * a * b + C1) * (2 * covariance + C2) / ((a * a + b * b + C1) * (variances + C2))
        return total / len(prediction)


def image_loss(target, weight):
    """L1 + weight (1 - SSIM)"""
    similarity = Ssim(target)
    return lambda p: l1(p, target) + weight * (1 - similarity(p))


def total_variation(block):
    """(sum |dx| + sum |dy| + sum |dz|) / number of differences; 0 if there are none."""
    pairs = []
    for i, axis in itertools.product(block, range(3)):
        j = tuple(x + (axis == k) for k, x in enumerate(i))
        if j in block:
            pairs.append(abs(block[j] - block[i]))
    return mp.fsum(pairs) / len(pairs) if pairs else mpf(0)
