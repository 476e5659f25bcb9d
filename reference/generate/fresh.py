"""Answers generated questions from the definitions, with 50 digits:  fresh.py VECTORS ANSWERS

VECTORS is what `trgs oracle make` writes, without truncated and wavelet stages. `trgs oracle check ANSWERS --vectors VECTORS
--precision f64` then compares these answers with the truth that the program computes itself.
"""

import json
import sys
from pathlib import Path

import numpy as np
from mpmath import mpf

import activation
import confidence
import gradients
import losses
import optimisers
import population
import projection
import scene
from case import Table
from files import file_bytes
from raw_cases import entry
from scenes import Scene
from truth import Truth


def primitives(model):
    rows = zip(*(model[name] for name in gradients.PARAMETERS))
    return [scene.primitive(*row) for row in rows]


def scanner(path):
    s = json.loads(path.read_text())["scanner"]
    u, v = s["offDetector"]
    return scene.Scanner(s["mode"], s["DSO"], s["DSD"], s["nDetector"], s["sDetector"], s["nVoxel"], s["sVoxel"], s["offOrigin"],
                         (u, 0.0 - v))


class ClosedForm(Truth):
    """Line integrals in closed form, which the cases compare with quadrature, and the question's own cotangent."""

    def __init__(self, of, cotangent):
        super().__init__(of)
        self.cotangent = cotangent

    d_image = d_volume = property(lambda self: self.cotangent)

    def exact(self, number, pixel):
        p, whiten, ratio = self.parts[number]
        frame = self.frames[number][pixel[0]]
        return mpf(0) if frame is None else projection.closed_form(p, whiten, *self.rays[pixel], ratio)


def of_scene(stage, given, settings):
    """The table of a stage that takes a scene."""
    solid = primitives(given["model"])
    at = given.get("scanner") or scene.Scanner("parallel", 1.0, 1.0, (1, 1), (1.0, 1.0), (1, 1, 1), (1.0, 1.0, 1.0))
    t = ClosedForm(Scene("fresh", "", at, settings.get("angles", []), solid), given.get("cotangent"))
    one = t.exact if stage.endswith("exact") else t.affine
    if stage == "covariance":
        return {"covariance": ((len(solid), 3, 3), lambda i: scene.covariance(solid[i[0]])[i[1]][i[2]])}
    if stage == "density":
        return {"volume": (tuple(at.n_voxel), t.volume)}
    if stage.startswith("image"):
        return {"image": (t.image_shape, lambda i: t.image(one, i))}
    if stage.startswith("projected"):
        return {"kernels": ((len(solid), *t.image_shape), lambda i: one(i[0], i[1:]))}
    along = {"y": t.along_volume, "e": t.along_affine, "t": t.along_exact}[stage[-1]]
    return {"grad": (gradients.shapes(len(solid)), lambda i: t.gradient(along, i))}


def of_raw(stage, given, s):
    """The table of a stage that takes raw parameters."""
    raw = primitives(given["raw"])
    physical = lambda p: activation.physical(p, s["kernel"].replace("-", "_"), s["scale_range"], s["nu_range"])
    solid, shapes = [physical(p) for p in raw], gradients.shapes(len(raw))
    if stage == "activation":
        return {"physical": (shapes, lambda i: entry(solid[i[1][0]], i))}
    t = ClosedForm(Scene("fresh", "", given["scanner"], s["angles"], solid), given["cotangent"])

    def slope(index):
        name, (number, *component) = index
        along = lambda p: t.along_exact(number, physical(p))
        return gradients.difference(along, raw[number], name, component[0] if component else None)

    return {"grad": (shapes, slope)}


def of_loss(stage, given, settings):
    values = losses.numbers(given["block"] if stage == "loss-tv" else given["prediction"])
    target = losses.numbers(given["target"]) if "target" in given else None
    function = {"loss-tv": lambda: losses.total_variation, "loss-l1": lambda: lambda p: losses.l1(p, target),
                "loss-ssim": lambda: losses.Ssim(target),
                "loss-image": lambda: losses.image_loss(target, mpf(settings.get("weight", 0)))}[stage]()
    shape = tuple(np.add(max(values), 1))
    return {"value": ((1,), lambda _: function(values)), "gradient": (shape, lambda i: losses.slope(function, values, i))}


def along_one(name, function, *arrays):
    """A stage whose output has one number for each of its inputs."""
    return {name: (arrays[0].shape, lambda i: function(*(mpf(float(array[i])) for array in arrays)))}


def tables(stage, given, s):
    if stage == "kernel":
        return along_one("kernel", scene.kernel, given["delta"], given["nu"])
    if stage == "integral-factor":
        return along_one("factor", projection.integral_factor, given["nu"]) | \
            along_one("slope", projection.integral_factor_slope, given["nu"])
    if "raw" in given:
        return of_raw(stage, given, s)
    if stage.startswith("loss-") and stage != "loss-nu":
        return of_loss(stage, given, s)
    if stage == "schedule":
        return along_one("rate", lambda step: optimisers.rate(step, s["first"], s["last"], s["length"]), given["steps"])
    if stage == "adam":
        path = optimisers.adam(given["start"], given["gradients"], given["rates"], s["beta1"], s["beta2"], s["epsilon"])
        return {"trajectory": (given["gradients"].shape, lambda i: path[i[0]][i[1]])}
    if stage == "sghmc-gate":
        return along_one("gate", lambda density: population.gate(density, s["reference"]), given["density"])
    if stage == "sghmc":
        path = population.sghmc(*(given[name] for name in ("start", "directions", "noise", "gates", "covariance", "rates")),
                                s["burn_in"], s["burn_in_friction"], s["friction"])
        return {"trajectory": (given["directions"].shape, lambda i: path[i[0]][i[1]][i[2]])}
    if stage == "nu-target":
        return along_one("nu_target", lambda c: confidence.nu_target(c, s["temperature"], s["nu_range"], s["sphere_points"]), given["c"])
    if stage == "loss-nu":
        nu, target, c = (losses.numbers(given[name]) for name in ("nu", "target", "confidence"))
        function = confidence.nu_loss(target, c, s["weight"])
        return {"value": ((1,), lambda _: function(nu)), "gradient": (given["nu"].shape, lambda i: losses.slope(function, nu, i))}
    return of_scene(stage, given, s)


def load(path):
    if path.suffix == ".json":
        return scanner(path)
    arrays = np.load(path)
    return arrays if path.suffix == ".npy" else dict(arrays)


if __name__ == "__main__":
    questions, answers = map(Path, sys.argv[1:3])
    for case in json.loads((questions / "manifest.json").read_text())["cases"]:
        given = {role: load(questions / file["file"]) for role, file in case["inputs"].items()}
        for name, (shape, function) in tables(case["stage"], given, case["settings"]).items():
            path = answers / case["outputs"][name]["file"]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file_bytes(path.name, Table(path.name, shape, function).compute()))
