"""Cases of the sampler and of density control."""

from functools import cache
from math import inf

import numpy as np
from mpmath import mpf

import population
from case import Case, Given, Table, lowered
from files import pseudo_random
from gradients import shapes
from scene import primitive
from scene_cases import cotangent, model, scanner
from scenes import BY_ID
from truth import model_arrays, truth


# ---------------------------------------------------------------------------- the sampler

CHAINS, STEPS = 5, 40
# From closed (1 and 0.3 are above the reference) to open.
DENSITIES = [1.0, 0.3, 0.02, 0.004, 0.0]


def covariances():
    """Symmetric, positive definite, of multiples of 1/1024."""
    roots = np.round(16 * pseudo_random("sghmc/roots", (CHAINS, 3, 3)))
    return np.array([(root @ root.T + np.eye(3)) / 1024 for root in roots])


def gates():
    for name, reference in [("one", 1.0), ("small", 0.04)]:
        densities = np.array([0.0, 1e-6, 1e-4, 0.001, 0.005, 0.01, 0.02, 0.1, 0.3, 1.0, 7.0])
        table = Table("gate.npy", densities.shape,
                      lambda i, d=densities, r=reference: population.gate(float(d[i]), r))
        yield Case("sghmc-gate", name, f"How far a density opens a primitive to noise, reference {reference}", [],
                   {"density": Given(f"inputs/sghmc-gate-{name}/density.npy", densities)}, {"gate": table}, "optional",
                   ["zero-density"], {"reference": reference})


def samplers():
    for name, title, burn_in, flags in [
            ("both-phases", "half of the steps without memory, half with", 20, ["zero-density"]),
            ("burn-in", "without memory throughout", STEPS, ["zero-density"]),
            ("sampling", "with memory from the first step on", 0, ["zero-density"])]:
        rates = [0.014]
        while len(rates) < STEPS:
            rates.append(rates[-1] * 0.97)
        opened = np.array([float(population.gate(d, 0.04)) for d in DENSITIES])
        given = {"start": pseudo_random(f"sghmc/{name}/start", (CHAINS, 3)),
                 "directions": pseudo_random(f"sghmc/{name}/directions", (STEPS, CHAINS, 3)),
                 "noise": 2 * pseudo_random(f"sghmc/{name}/noise", (STEPS, CHAINS, 3)),
                 "gates": opened, "covariance": covariances(), "rates": np.array(rates)}
        settings = {"burn_in": burn_in, "burn_in_friction": 40.0, "friction": 25.0}
        whole = cache(lambda given=given, settings=settings: population.sghmc(*given.values(), **settings))
        table = Table("trajectory.npy", (STEPS, CHAINS, 3), lambda i, whole=whole: whole()[i[0]][i[1]][i[2]])
        yield Case("sghmc", name, f"Forty steps of the sampler: {title}", [],
                   {key: Given(f"inputs/sghmc-{name}/{key}.npy", array) for key, array in given.items()},
                   {"trajectory": table}, "optional", flags, settings)


# ---------------------------------------------------------------------------- density control

def crowd(nus, densities):
    """One primitive per density, with different shapes and positions."""
    numbers = pseudo_random(f"crowd/{len(densities)}", (len(densities), 10))
    return [primitive(row[:3] * 0.9, 0.02 + 0.2 * np.abs(row[3:6]), row[6:10], density, nu)
            for row, density, nu in zip(numbers, densities, nus)]


FEW = [0.31, 0.004, 0.12, 0.0, 0.85, 0.0049, 0.27, 0.6, 0.001, 0.05, 0.44, 0.19]
NUS = [2.0, 3.5, 5.0, 8.0, 2.5, 13.0, 40.0, 4.0, 99.0, 6.0, 2.2, 17.0]


def next_generation(rows):
    """Tables of a list of (primitive, parent, new?)."""
    m = len(rows)
    arrays = model_arrays([p for p, _, _ in rows])
    return {"model": Table("model.npz", shapes(m), lambda i: arrays[i[0]][i[1]]),
            "parent": Table("parent.npy", (m,), lambda i: float(rows[i[0]][1])),
            "fresh": Table("fresh.npy", (m,), lambda i: float(rows[i[0]][2]))}


def recyclings():
    base = {"dead": 0.005, "recycled": 0.25, "growth": 0.25, "cap": 1000}
    for name, title, change, relocation, gaussian, flags in [
            ("exact", "copies share the density", {}, "exact", False, []),
            ("limited", "more dead than may be recycled", {"recycled": 0.1, "growth": 0.0}, "exact", False, []),
            ("cap", "growth ends at the cap", {"cap": 13}, "exact", False, ["cap-reached"]),
            ("crowded", "many copies of few", {"recycled": 0.5, "growth": 1.0}, "exact", False, []),
            ("sss", "copies share as opacities", {"growth": 1.0}, "sss", False, []),
            ("sss-program", "copies share as opacities, with the scales of the published program", {}, "sss-program", False, []),
            ("sss-gaussian", "Gaussians share as opacities", {"growth": 0.5}, "sss", True, ["gaussian-limit"])]:
        people = crowd([inf] * len(FEW) if gaussian else NUS, FEW)
        settings = {**base, **change}
        uniform = (pseudo_random(f"ar/{name}", (24,)) + 1) / 2
        rows = population.ar(people, uniform, **settings, relocation=relocation)
        yield Case("ar", name, f"Adding and recycling: {title}", [],
                   {"model": Given(f"inputs/ar-{'gaussian' if gaussian else 'crowd'}/model.npz", model_arrays(people)),
                    "uniform": Given(f"inputs/ar-{name}/uniform.npy", uniform)},
                   next_generation(rows), "optional", ["zero-density", *flags],
                   {**settings, "relocation": relocation})


def controls():
    base = {"gradient": 0.4, "split_scale": 0.15, "faint": 0.003, "cap": 1000,
            "low": [-0.8, -0.85, -0.9], "high": [0.85, 0.8, 0.9]}
    people = crowd(NUS, FEW)
    pull = np.abs(pseudo_random("adc/pull", (len(FEW),)))
    normals = 1.5 * pseudo_random("adc/normals", (len(FEW), 6))
    for name, title, change, flags in [
            ("mixed", "some cloned, some split, some removed", {}, []),
            ("clones", "all that pull are small", {"split_scale": 10.0}, []),
            ("splits", "all that pull are large", {"split_scale": 0.0}, []),
            ("cap", "a full population is only thinned", {"cap": 12}, ["cap-reached"])]:
        settings = {**base, **change}
        rows = population.adc(people, pull, normals, **settings)
        yield Case("adc", name, f"Adaptive density control: {title}", [],
                   {"model": Given("inputs/ar-crowd/model.npz", model_arrays(people)),
                    "pull": Given("inputs/adc/pull.npy", pull), "normals": Given("inputs/adc/normals.npy", normals)},
                   next_generation(rows), "optional", ["zero-density", *flags], settings)


def shadow_gradients():
    for name in ["cone-centred", "cone-offset", "parallel-offset", "gaussian-cone"]:
        for kind in ["affine", "exact"] if name != "parallel-offset" else ["affine"]:
            of = BY_ID[name]

            def entry(index, of=of, kind=kind):
                number, axis = index
                t = truth(of)
                views = enumerate(t.views)
                return sum((population.shadow_gradient(of.primitives[number], of.scanner, view, t.d_image[n], axis,
                                                       kind == "exact") for n, view in views), mpf(0))

            yield Case("gradient-shadow", f"{name}-{kind}",
                       f"Gradient to the places of shadows, {kind}: {lowered(of.title)}", [],
                       {"model": model(of), "scanner": scanner(of), "cotangent": cotangent(of, "image")},
                       {"shadow": Table("shadow.npy", (len(of.primitives), 2), entry)}, "optional", of.flags,
                       {"angles": of.angles, "projection": kind})
