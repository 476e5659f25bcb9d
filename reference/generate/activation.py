"""From the free raw parameters to the physical ones [choice]; gradients go through it by differencing the whole."""

from dataclasses import replace

from mpmath import mp, mpf


def sigmoid(x):
    return 1 / (1 + mp.exp(-x))


def softplus(x):
    return mp.log1p(mp.exp(x)) if x < 0 else x + mp.log1p(mp.exp(-x))


def between(limits, raw):
    low, high = map(mpf, limits)
    return low + (high - low) * sigmoid(raw)


def physical(raw, kernel, scale_range, nu_range):
    """s and nu between their limits, density positive; mean and quaternion as they are."""
    nu = mpf("inf") if kernel == "gaussian" else between(nu_range, raw.nu)
    return replace(raw, scale=tuple(between(scale_range, x) for x in raw.scale), density=softplus(raw.density), nu=nu)
