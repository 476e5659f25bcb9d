"""From the unconstrained raw parameters to the physical ones [choice]; gradients are differences of the whole chain."""

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
    """s and nu between their limits, density positive; mean and quaternion unchanged."""
    nu = mpf("inf") if kernel == "gaussian" else between(nu_range, raw.nu)
    return replace(raw, scale=tuple(between(scale_range, x) for x in raw.scale), density=softplus(raw.density), nu=nu)
