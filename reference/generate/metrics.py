"""PSNR and SSIM of volumes and projections with R2-Gaussian's definitions. Arrays are numpy, numbers mpmath."""

import numpy as np
from mpmath import mp, mpf

from losses import Ssim, numbers


def psnr(truth, result):
    """10 log10(1/MSE) of two dictionaries; infinite when they are equal."""
    error = mp.fsum((truth[i] - result[i])**2 for i in truth) / len(truth)
    return mpf("inf") if error == 0 else -10 * mp.log10(error)


def psnr_3d(truth, result):
    """Peak 1, without clipping or scaling."""
    return psnr(numbers(truth), numbers(result))


def ssim_3d(truth, result):
    """Mean over the three axes of the mean SSIM of the slices, without slices whose truth has no value above 0."""
    axes = []
    for axis in range(3):
        pairs = zip(np.moveaxis(truth, axis, 0), np.moveaxis(result, axis, 0))
        slices = [(numbers(t), numbers(r)) for t, r in pairs if t.max() > 0]
        axes.append(mp.fsum(Ssim(t)(r) for t, r in slices) / len(slices))
    return mp.fsum(axes) / 3


def scaled(image):
    """Divided by its own maximum; unchanged if no value is above 0."""
    values = numbers(image)
    top = max(values.values())
    return {i: x / top for i, x in values.items()} if top > 0 else values


def mean_of_views(measure, truth, result):
    pairs = [(scaled(t), scaled(r)) for t, r in zip(truth, result) if t.max() > 0]
    return mp.fsum(measure(t, r) for t, r in pairs) / len(pairs)


def psnr_2d(truth, result):
    return mean_of_views(psnr, truth, result)


def ssim_2d(truth, result):
    return mean_of_views(lambda t, r: Ssim(t)(r), truth, result)
