"""Cases of our parametrisation: the raw parameters of the optimiser, and gradients with respect to them."""

from dataclasses import dataclass

import activation
import gradients
from case import Case, Given, Table
from scene import primitive
from scene_cases import cotangent, scanner
from scenes import CONE, OFFSET, PARALLEL, Scene
from truth import model_arrays, truth

LIMITS = {"scale_range": [0.001, 1.0], "nu_range": [2.0, 100.0]}


@dataclass(frozen=True)
class RawScene:
    id: str
    title: str
    scanner: object
    angles: list
    raw: list
    kernel: str = "student_t"
    level: str = "optional"
    flags: tuple = ()

    def physical(self, raw):
        return activation.physical(raw, self.kernel, **LIMITS)

    def settings(self):
        return {"kernel": self.kernel, **LIMITS}

    def scene(self):
        return Scene(self.id, self.title, self.scanner, self.angles, [self.physical(raw) for raw in self.raw])


def several(*nus):
    """Raw numbers of primitives like those of the scenes."""
    shapes = [
        ((0.21, -0.34, 0.15), (-1.0, -1.9, -1.45), (0.81, -0.33, 0.41, 0.26), -0.15),
        ((-0.45, 0.12, -0.38), (-2.0, -0.7, -1.3), (3.5, 7.2, -1.8, 5.7), -0.9),
        ((0.52, 0.48, 0.29), (-2.4, -1.7, -1.2), (-0.027, 0.044, 0.066, -0.054), 0.7),
    ]
    return [primitive(*shape, nu) for shape, nu in zip(shapes, nus)]


EXTREME = [
    primitive((0.2, -0.3, 0.1), (-1.0, -12.0, 9.0), (0.8, -0.3, 0.4, 0.2), -20.0, -15.0),
    primitive((-0.4, 0.1, -0.3), (0.5, -1.5, -40.0), (0.3, 0.7, -0.1, 0.5), 30.0, 18.0),
]
SATURATED = [
    primitive((0.0, 1e-300, -1e300), (-40.0, 40.0, 0.0), (1e-100, 0.0, 0.0, 0.0), -40.0, -40.0),
    primitive((1.0, -1.0, 0.5), (-800.0, 800.0, -745.0), (0.0, 0.0, 0.0, -1e100), 800.0, 800.0),
    primitive((0.0, 0.0, 0.0), (1e-20, -1e-20, 1.0), (1.0, 2.0, 3.0, 4.0), -740.0, -800.0),
    primitive((0.0, 0.0, 0.0), (-700.0, 30.0, 37.0), (1.0, 2.0, 3.0, 4.0), -800.0, 38.0),
]

RAW = [
    RawScene("raw-cone", "three Student-t primitives, cone beam", CONE, [0.3, 2.2], several(-5.0, -2.75, -1.9)),
    RawScene("raw-offset", "shifted non-square detector", OFFSET, [0.7, 2.9], several(-4.0, 0.0, 3.5),
             flags=("offset-detector", "non-square-pixels")),
    RawScene("raw-parallel", "parallel beam", PARALLEL, [0.5, 1.6], several(-4.0, -6.5, 1.0),
             flags=("parallel", "offset-detector", "non-square-pixels")),
    RawScene("raw-gaussian", "Gaussian kernel", CONE, [0.3, 2.2], several(0.0, 1.5, -2.0), "gaussian"),
    RawScene("raw-extreme", "raw numbers far out on the sigmoids and on the softplus", CONE, [1.3], EXTREME,
             level="stress", flags=("saturated",)),
]
ACTIVATION_ONLY = [
    RawScene("raw-saturated", "raw numbers where float64 reaches the ends of the intervals", CONE, [0.3], SATURATED,
             level="stress", flags=("saturated",)),
]


def raw_file(raw):
    return Given(f"inputs/{raw.id}/raw.npz", model_arrays(raw.raw))


def entry(p, index):
    """One number of a primitive."""
    name, (_, *component) = index
    value = getattr(p, name)
    return value[component[0]] if component else value


def name_of(raw):
    return raw.id.removeprefix("raw-")


def activations():
    for raw in RAW + ACTIVATION_ONLY:
        table = Table("physical.npz", gradients.shapes(len(raw.raw)),
                      lambda i, raw=raw: entry(raw.physical(raw.raw[i[1][0]]), i))
        yield Case("activation", name_of(raw), f"From raw to physical parameters: {raw.title}", [], {"raw": raw_file(raw)},
                   {"physical": table}, raw.level, [flag for flag in raw.flags if flag == "saturated"], raw.settings())


def raw_gradients():
    for raw in RAW:
        scene = raw.scene()

        def slope(index, raw=raw, scene=scene):
            name, (number, *component) = index
            along = lambda p: truth(scene).along_exact(number, raw.physical(p))
            return gradients.difference(along, raw.raw[number], name, component[0] if component else None)

        equations = ["Eq. 4", "X1"] if raw.kernel == "gaussian" else ["Eq. 2", "Eq. 4", "Eq. 5", "X1"]
        yield Case("gradient-raw", name_of(raw), f"Gradient through line integrals to the raw parameters: {raw.title}", equations,
                   {"raw": raw_file(raw), "scanner": scanner(scene), "cotangent": cotangent(scene, "image")},
                   {"grad": Table("grad.npz", gradients.shapes(len(raw.raw)), slope)}, raw.level, list(raw.flags),
                   {**raw.settings(), "angles": raw.angles})
