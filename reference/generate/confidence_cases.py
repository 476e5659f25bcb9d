"""Cases of the ray confidence, the target of nu and its loss."""

from functools import cache

import numpy as np
from mpmath import mpf

import confidence
import losses
import scene
from case import Case, Given, Table
from scene_cases import model, scanner
from scenes import BY_ID, Scene
from small_cases import loss_tables

# ---------------------------------------------------------------------------- confidence

SIX = [0.15, 1.2, 2.3, 3.05, 4.4, 5.6]
EIGHT = [0.3, 0.5, 1.35, 1.9, 2.85, 3.6, 4.75, 5.5]

# In view 0 the detector extends from -0.95 to 1.55 along u and from -1 to 0.6 along v; a point in the plane of the axis is
# projected to 1.4 y, -1.4 z. Two centres are in the outer half of the first and last columns, two in that of the rows, and
# four are as far outside.
EDGES = [(1.04, 0.1), (-0.64, -0.1), (0.2, 0.68), (0.3, -0.39), (1.18, 0.05), (-0.75, -0.05), (0.25, 0.75), (0.35, -0.47)]
EDGE = Scene("detector-edge", "Centres on both sides of each of the detector's edges",
             scene.Scanner("cone", dso=5.0, dsd=7.0, n_detector=(4, 5), s_detector=(1.6, 2.5), n_voxel=(3, 4, 5), s_voxel=(2.0, 2.0, 2.0),
                           off_detector=(0.3, -0.2)),
             [0.0],
             [scene.primitive((0.0, y, z), (0.1 + 0.02 * k, 0.2, 0.15), (0.83, -0.31, 0.42, 0.19 + 0.1 * k), 0.5, 4.0)
              for k, (y, z) in enumerate(EDGES)])

# name, title, scene of the model and the scanner, angles, points, r_max, kappa, flags
SCENES = [
    ("cone-five", "six views of five primitives", "cone-five", SIX, 512, 0.5, 1.0, ["uneven-views"]),
    ("one-view", "a single view", "cone-five", [2.3], 512, 0.5, 1.0, ["one-view"]),
    ("cone-offset", "a shifted detector; other radii, and points whose number is no power of two", "cone-offset", SIX, 100, 0.62, 1.3,
     ["offset-detector", "non-square-pixels", "uneven-views"]),
    ("parallel-offset", "a parallel beam onto a shifted detector", "parallel-offset", SIX[:4], 512, 0.5, 1.0,
     ["parallel", "offset-detector", "non-square-pixels", "uneven-views"]),
    ("needle", "a needle 1:1000", "needle", SIX, 512, 0.5, 0.02, ["ill-conditioned"]),
    ("pancake", "a pancake 1:1000", "pancake", SIX, 512, 0.5, 0.2, ["ill-conditioned"]),
    ("quaternion-norm", "quaternions that are not of norm 1", "quaternion-norm", SIX, 256, 0.4, 0.9, ["unnormalised-quaternion"]),
    ("outside-view", "centres that most views see beside the detector", "outside-view", EIGHT, 512, 0.5, 1.0,
     ["centre-outside-detector", "offset-detector"]),
    ("detector-edge", "centres whose shadows lie within half a pixel of the detector's edges, inside and outside", EDGE, EDGE.angles, 128, 0.5, 1.0,
     ["centre-outside-detector", "offset-detector", "non-square-pixels", "one-view", "nothing-covered"]),
    ("unseen", "centres that no view sees: 0", "outside-view", EIGHT[:2], 64, 0.5, 1.0,
     ["centre-outside-detector", "nothing-covered"]),
    ("behind-source", "centres behind the source and in its plane", "behind-source-turned", [0.0, 1.3], 512, 0.5, 1.0,
     ["behind-source", "at-source-plane", "near-limit"]),
    ("covered", "tubes as wide as the sphere: 1", "cone-five", SIX[:2], 64, 1.0, 0.01, ["all-covered"]),
    ("one-point", "a single point", "cone-five", SIX, 1, 0.9, 0.2, []),
]


def confidences():
    for name, title, of, angles, points, r_max, kappa, flags in SCENES:
        given = of if isinstance(of, Scene) else BY_ID[of]
        settings = {"angles": angles, "sphere_points": points, "r_max": r_max, "kappa": kappa}
        views = [scene.view_at(given.scanner, angle) for angle in angles]
        value = lambda i, given=given, views=views, numbers=(points, r_max, kappa): confidence.confidence(
            given.primitives[i[0]], given.scanner, views, *numbers)
        yield Case("confidence", name, f"Ray confidence: {title}", ["Eq. 6", "Eq. 7", "Eq. 8"],
                   {"model": model(given), "scanner": scanner(given)},
                   {"confidence": Table("confidence.npy", (len(given.primitives),), value)}, "optional", flags, settings)


# ---------------------------------------------------------------------------- nu

COUNTS = [0, 1, 2, 9, 31, 32, 33, 48, 57, 63, 64]

TARGETS = [
    ("default", "the default temperature", 0.25, [2.0, 100.0], 64),
    ("sharp", "a low temperature", 0.1, [2.0, 100.0], 64),
    ("linear", "the temperature 1, where nothing is bent, and a narrow range", 1.0, [1.5, 7.0], 64),
    ("many-points", "more points: c is left closer to 0 and 1", 0.25, [2.0, 100.0], 4096),
]


def nu_targets():
    c = np.array([count / 64 for count in COUNTS])
    for name, title, temperature, nu_range, points in TARGETS:
        numbers = (temperature, nu_range, points)
        table = Table("nu_target.npy", (len(c),), lambda i, numbers=numbers: confidence.nu_target(mpf(c[i]), *numbers))
        yield Case("nu-target", name, f"Degrees of freedom for a confidence: {title}", ["Eq. 9"],
                   {"c": Given("inputs/nu-target/c.npy", c)}, {"nu_target": table}, "optional",
                   ["nothing-covered", "all-covered"],
                   {"temperature": temperature, "nu_range": nu_range, "sphere_points": points})


LOSSES = [
    ("ordinary", "nu above and below their targets", [2.3, 9.5, 41.0, 88.0, 5.25, 17.0], [3.1, 7.0, 90.0, 12.5, 60.0, 2.01],
     [0.125, 0.5, 0.8125, 0.25, 0.625, 0.03125], 1e-3, []),
    ("at-target", "one nu at its target, one that is confident, one neither", [7.5, 3.0, 30.0], [7.5, 80.0, 4.0], [0.25, 1.0, 0.0], 0.7,
     ["zero-gradient", "nothing-covered", "all-covered"]),
    ("one", "a single primitive", [12.0], [50.0], [0.375], 2.5, []),
]


def nu_losses():
    for name, title, nu, target, c, weight, flags in LOSSES:
        arrays = {"nu": np.array(nu), "target": np.array(target), "confidence": np.array(c)}
        numbers = {role: losses.numbers(array) for role, array in arrays.items()}
        function = cache(lambda n=numbers, weight=weight: confidence.nu_loss(n["target"], n["confidence"], weight))
        yield Case("loss-nu", name, f"Loss of nu: {title}", ["Eq. 10"],
                   {role: Given(f"inputs/loss-nu-{name}/{role}.npy", array) for role, array in arrays.items()},
                   loss_tables(function, numbers["nu"]), "optional", flags, {"weight": weight})
