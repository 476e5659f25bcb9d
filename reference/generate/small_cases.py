"""Cases that need no scene: kernels, losses, optimisers."""

from functools import cache
from math import inf

import numpy as np
from mpmath import mpf

import losses
import optimisers
import projection
import scene
from case import Case, Given, Table
from files import pseudo_random

# ---------------------------------------------------------------------------- kernels

TRAINED = [2.0, 2.5, 3.0, 5.2, 10.0, 30.0, 100.0]
UNTRAINED = [0.5, 1.0, 1e3, 1e4, 1e6]
DELTAS = [0.0, 1e-16, 1e-8, 1e-3, 0.25, 1.0, 3.7, 12.0, 81.0]

KERNELS = [
    ("trained", "The t-kernel for nu from 2 to 100, from its peak to nine scales away", TRAINED, DELTAS, "core", []),
    ("gaussian", "The Gaussian kernel", [inf], DELTAS, "core", ["gaussian-limit"]),
    ("untrained", "The t-kernel for nu below 2 and above 100", UNTRAINED[1:], DELTAS, "optional",
     ["nu-below-training-range", "nu-above-training-range", "gaussian-limit"]),
    ("far", "Huge distances: powers as small as 1e-300, and some that are 0 in float64", [1.0, *TRAINED, 1e4, 1e6, inf],
     [1e3, 1e6, 1e12, 1e30], "stress", ["far-skirt"]),
]


def kernels():
    for name, title, nus, deltas, level, flags in KERNELS:
        grid = [(delta, nu) for nu in nus for delta in deltas]
        inputs = {key: Given(f"inputs/kernel-{name}/{key}.npy", np.array(column))
                  for key, column in zip(("delta", "nu"), zip(*grid))}
        table = Table("kernel.npy", (len(grid),), lambda i, grid=grid: scene.kernel(*map(mpf, grid[i[0]])))
        equations = ["Eq. 2"] if name == "trained" else ["Eq. 2", "X3"]
        yield Case("kernel", name, title, equations, inputs, {"kernel": table}, level, flags)


def integral_factors():
    for name, title, nus, level, flags in [
            ("trained", "nu from 2 to 100", [2.0, 2.5, *map(float, range(3, 31)), 57.5, 100.0], "core", []),
            ("untrained", "nu below 2 and above 100", UNTRAINED, "optional",
             ["nu-below-training-range", "nu-above-training-range"])]:
        tables = {"factor": Table("factor.npy", (len(nus),), lambda i, nus=nus: projection.integral_factor(mpf(nus[i[0]]))),
                  "slope": Table("slope.npy", (len(nus),), lambda i, nus=nus: projection.integral_factor_slope(mpf(nus[i[0]])))}
        yield Case("integral-factor", name, f"The integral of the t-kernel along a line, and its slope: {title}",
                   ["Eq. 5", "A"], {"nu": Given(f"inputs/integral-factor-{name}/nu.npy", np.array(nus))}, tables, level, flags)


# ---------------------------------------------------------------------------- losses

def uniform(key, shape):
    return pseudo_random(key, shape) / 2 + 0.5


def images(name):
    """(prediction, target)"""
    a, b = (lambda shape: uniform(f"{name}/prediction", shape)), (lambda shape: uniform(f"{name}/target", shape))
    zero = np.zeros((6, 7))
    if name == "close":
        target = b((9, 7))
        return target + 0.02 * pseudo_random(f"{name}/prediction", (9, 7)), target
    if name == "some-equal":
        prediction, target = a((8, 9)), b((8, 9))
        prediction[2:5, 3:7] = target[2:5, 3:7]
        return prediction, target
    return {
        "random": lambda: (a((13, 12)), b((13, 12))),
        "range-eight": lambda: (8 * a((7, 8)), 8 * b((7, 8))),
        "prediction-zero": lambda: (zero, b((6, 7))),
        "both-zero": lambda: (zero, zero),
        "equal": lambda: (b((6, 7)), b((6, 7))),
        "constant": lambda: (zero + 0.375, zero + 0.75),
        "one-pixel": lambda: (a((1, 1)), b((1, 1))),
        "one-row": lambda: (a((1, 7)), b((1, 7))),
    }[name]()


PAIRS = [
    ("random", "two unrelated images larger than the window", "core", []),
    ("close", "an image and the same with noise", "core", []),
    ("range-eight", "images with values up to 8", "core", ["range-above-one"]),
    ("some-equal", "some pixels equal to the bit", "core", ["equal-pixels"]),
    ("prediction-zero", "a prediction of zeros", "core", ["zero-image"]),
    ("both-zero", "two images of zeros", "core", ["zero-image", "equal-pixels"]),
    ("equal", "an image and itself", "core", ["equal-pixels"]),
    ("constant", "two constant images", "core", ["constant-images"]),
    ("one-pixel", "images of one pixel", "optional", ["one-pixel"]),
    ("one-row", "images of one row", "optional", ["one-row"]),
]
LOSSES = {
    "loss-l1": ("Mean absolute difference", ["random", "some-equal", "prediction-zero", "both-zero", "one-pixel"]),
    "loss-ssim": ("SSIM", [name for name, *_ in PAIRS]),
    "loss-image": ("L1 + 0.25 (1 - SSIM)", ["close", "range-eight", "some-equal", "prediction-zero", "both-zero"]),
}


def loss_tables(function, values):
    return {"value": Table("value.npy", (1,), lambda _: function()(values)),
            "gradient": Table("gradient.npy", tuple(np.add(max(values), 1)), lambda i: losses.slope(function(), values, i))}


def image_losses(stage):
    what, names = LOSSES[stage]
    for name, title, level, flags in PAIRS:
        if name not in names:
            continue
        prediction, target = images(name)
        inputs = {"prediction": Given(f"inputs/images-{name}/prediction.npy", prediction),
                  "target": Given(f"inputs/images-{name}/target.npy", target)}
        p, t = losses.numbers(prediction), losses.numbers(target)
        function = {"loss-l1": lambda t: lambda p: losses.l1(p, t), "loss-ssim": losses.Ssim,
                    "loss-image": lambda t: losses.image_loss(t, mpf(1) / 4)}[stage]
        ready = cache(lambda function=function, t=t: function(t))
        yield Case(stage, name, f"{what}: {title}", [], inputs, loss_tables(ready, p), level, flags,
                   {"weight": 0.25} if stage == "loss-image" else {})


def tv_losses():
    stairs = np.array([[[0.5, 0.5, 0.25, 0.25, 1.0]] * 2 + [[0.5, 0.0, 0.25, 0.75, 1.0]]] * 2 + [[[0.0, 0.5, 0.5, 0.25, 1.0]] * 3])
    for name, title, block, level, flags in [
            ("random", "a random block with three different sides", uniform("tv/random", (4, 3, 5)), "core", []),
            ("equal-neighbours", "a block with many equal neighbours", stairs, "core", ["equal-neighbours"]),
            ("one-slice", "a block with a side of 1", uniform("tv/one-slice", (4, 1, 3)), "optional", ["side-of-one"]),
            ("one-voxel", "a block without any difference", uniform("tv/one-voxel", (1, 1, 1)), "optional", ["side-of-one"])]:
        yield Case("loss-tv", name, f"Total variation: {title}", [], {"block": Given(f"inputs/block-{name}/block.npy", block)},
                   loss_tables(lambda: losses.total_variation, losses.numbers(block)), level, flags)


# ---------------------------------------------------------------------------- optimisers

SCHEDULES = [
    ("decay", "a decay by ten, and after its end", 1e-2, 1e-3, 100, [0, 1, 17, 50, 99, 100, 101, 5000]),
    ("rise", "a rise", 1e-4, 0.3, 7, [0, 1, 3, 6, 7, 8]),
    ("constant", "the same rate at both ends", 5e-3, 5e-3, 30, [0, 13, 30, 31]),
    ("one-step", "a run of one step", 2e-4, 2e-5, 1, [0, 1, 2]),
    ("first-zero", "0 at the start is 0 throughout", 0.0, 1e-3, 100, [0, 50, 100, 200]),
    ("last-zero", "0 at the end is 0 throughout", 1e-3, 0.0, 100, [0, 50, 100, 200]),
]


def schedules():
    for name, title, first, last, length, steps in SCHEDULES:
        ends = (first, last, length)
        table = Table("rate.npy", (len(steps),), lambda i, ends=ends, steps=steps: optimisers.rate(steps[i[0]], *ends))
        yield Case("schedule", name, f"A log-linear rate: {title}", [],
                   {"steps": Given(f"inputs/schedule-{name}/steps.npy", np.array(steps, dtype=float))}, {"rate": table},
                   "optional", ["zero-rate"] if 0.0 in (first, last) else [], {"first": first, "last": last, "length": length})


STEPS, WIDTH = 100, 6


def decaying(first):
    """Computed by multiplication, so that inputs do not depend on a library's pow."""
    rates = [first]
    while len(rates) < STEPS:
        rates.append(rates[-1] * 0.977)
    return np.array(rates)


def adam_gradients(name):
    draws = pseudo_random(f"adam/{name}", (STEPS, WIDTH))
    if name == "zero-gradients":
        draws[:, 1] = 0.0
        draws[1:, 3] = 0.0
        draws[:60, 4] = 0.0
    if name == "far-apart":
        draws = draws * np.array([1e-12, 1.0, 1e8, 1e-12, 1e8, 1e-3])
        draws[50:, 3:5] *= np.array([1e20, 1e-20])
    if name == "sign-flips":
        draws[:, 0] = np.where(np.arange(STEPS) < 50, 0.5, -0.5)
        draws[:, 1] = np.where(np.arange(STEPS) % 2 == 0, 2.0, -2.0)
        draws[:, 2] = np.where(np.arange(STEPS) == 99, -1e3, 1e-3)
    if name == "below-epsilon":
        draws = draws * np.array([1e-14, 1e-15, 1e-16, 1e-18, 1e-20, 1e-30])
    return draws


def adams():
    for name, title, level, flags in [
            ("random", "random gradients, decaying rates", "core", []),
            ("zero-gradients", "a gradient that is always zero, one that becomes zero, one that starts late", "core",
             ["zero-gradient"]),
            ("far-apart", "gradients of 1e-12 and of 1e8, and two that change from one to the other", "core", ["extreme-gradient"]),
            ("sign-flips", "gradients that change sign", "core", ["sign-flip"]),
            ("below-epsilon", "gradients about and below epsilon", "optional", ["extreme-gradient"])]:
        given = {"start": pseudo_random(f"adam/{name}/start", (WIDTH,)), "gradients": adam_gradients(name),
                 "rates": decaying(0.01)}
        settings = {"beta1": 0.9, "beta2": 0.999, "epsilon": 1e-15}
        whole = cache(lambda given=given, settings=settings: optimisers.adam(*given.values(), **settings))
        table = Table("trajectory.npy", (STEPS, WIDTH), lambda i, whole=whole: whole()[i[0]][i[1]])
        yield Case("adam", name, f"A hundred steps of Adam: {title}", [],
                   {key: Given(f"inputs/adam-{name}/{key}.npy", array) for key, array in given.items()},
                   {"trajectory": table}, level, flags, settings)
