"""Cases of the networks: encodings, the Lineformer block, quadrature along rays."""

from functools import cache

import numpy as np

import networks
from case import Case, Given, Table
from files import pseudo_random
from scan_cases import CONE, PARALLEL, short, uniform
from scene import view_at
from truth import meta_data

# name, title, resolution, entries: what the rule for entries does with such a level.
LEVELS = [
    ("dense", "a table with an entry for each grid point", 16, 17**3),
    ("hashed", "fewer entries than grid points", 64, 2**14),
    ("plane-fits", "a table that holds a plane of grid points but not all", 128, 2**17),
    ("overflow", "the product of the sides overflows 32 bits and seems to fit", 65_536, 2**19),
    ("not-a-power", "a number of entries that is no power of two", 40, 1009),
]


def places(name, count=24):
    """Points whose place in a cell float32 holds exactly, at all levels; the corners of the box among them."""
    points = np.floor(uniform(f"network/{name}", (count, 3)) * 256) / 256
    points[0], points[1], points[2] = 0.0, 1.0, (0.0, 1.0, 0.5)
    return points


def hash_corners():
    for name, title, resolution, entries in LEVELS:
        points = places(name)
        found = cache(lambda points=points, r=resolution, e=entries: [networks.corners(p, r, e) for p in points])
        tables = {role: Table(f"{role}.npy", (len(points), 8), lambda i, found=found, k=k: found()[i[0]][i[1]][k])
                  for k, role in enumerate(("entry", "weight"))}
        yield Case("hash-corners", name, f"Entries and weights of the corners of cells: {title}", [],
                   {"points": Given(f"inputs/hash-{name}/points.npy", points)}, tables, "optional", [],
                   {"resolution": resolution, "entries": entries})


TABLES = [("dense", "an entry for each grid point", 4, 125), ("hashed", "grid points share entries", 16, 64)]


def hash_codes(stage):
    for name, title, resolution, entries in TABLES:
        points, settings = places(f"table-{name}"), {"resolution": resolution, "entries": entries}
        inputs = {"points": Given(f"inputs/table-{name}/points.npy", points)}
        if stage == "hash-code":
            table = short(pseudo_random(f"network/table/{name}", (entries, 2)))
            inputs["table"] = Given(f"inputs/table-{name}/table.npy", table)
            found = cache(lambda points=points, table=table, r=resolution: networks.hash_code(points, table, r))
            tables = {"code": Table("code.npy", (len(points), 2), lambda i, found=found: found()[i[0]][i[1]])}
            yield Case(stage, name, f"Features of a level of the hash grid: {title}", [], inputs, tables, "optional", [], settings)
            continue
        cotangent = short(pseudo_random(f"network/cotangent/{name}", (len(points), 2)))
        inputs["cotangent"] = Given(f"inputs/table-{name}/cotangent.npy", cotangent)
        found = cache(lambda points=points, d=cotangent, r=resolution, e=entries: networks.hash_code_gradient(points, d, r, e))
        tables = {"gradient": Table("gradient.npy", (entries, 2), lambda i, found=found: found()[i[0]][i[1]])}
        yield Case(stage, name, f"Gradient to a table of the hash grid: {title}", [], inputs, tables, "optional", [], settings)


def frequency_codes():
    points, settings = places("frequencies"), {"frequencies": 6, "half_sides": [1.0, 0.85, 0.5]}
    found = cache(lambda: [networks.frequency_code(p, settings["half_sides"], settings["frequencies"]) for p in points])
    table = Table("code.npy", (len(points), 39), lambda i: found()[i[0]][i[1]])
    yield Case("frequency-code", "box", "Coordinates, sines and cosines of points in a box", [],
               {"points": Given("inputs/frequencies/points.npy", points)}, {"code": table}, "optional", [], settings)


def block_parameters():
    """Of the size that training starts with; gains and positions about 1."""
    def values(name, shape):
        draw = short(pseudo_random(f"lineformer/{name}", shape))
        if name.startswith("gain"):
            return 1 + draw / 4
        return draw if len(shape) == 3 or len(shape) == 1 else short(draw * 2 / np.sqrt(shape[1]))
    return {name: values(name, shape) for name, shape in networks.PARTS.items()}


PARAMETERS = block_parameters()
EXACT = cache(lambda: {name: networks.exact(array) for name, array in PARAMETERS.items()})
# name, title, level, flags.
PAIRS = [
    ("random", "five unrelated pairs", "optional", []),
    ("alike", "both points of a pair are the same, or nearly so", "optional", ["repeated-points"]),
    ("flat", "numbers of a point that hardly differ, so that the variance is small beside what is added to it", "stress", []),
    ("large", "scores far apart, so that one point has all the weight", "stress", ["saturated"]),
]


def pairs(name):
    x = short(pseudo_random(f"lineformer/pairs/{name}", (5, 2, 32)))
    if name == "alike":
        x[:3, 1] = x[:3, 0]
        x[3:, 1] = x[3:, 0] + x[3:, 1] / 1024
    if name == "flat":
        x = 0.5 + x / 1024
    if name == "large":
        x[:, :, 1:] /= 64
        x[:, :, 0] = 8 * np.sign(x[:, :, 0])
    return x


def block_inputs(name):
    inputs = {key: array for key, array in PARAMETERS.items()}
    return {"parameters": Given("inputs/lineformer/parameters.npz", inputs),
            "x": Given(f"inputs/lineformer-{name}/x.npy", pairs(name))}


def blocks(name):
    return [networks.Lineformer(EXACT(), pair) for pair in networks.exact(pairs(name))]


def lineformers():
    for name, title, level, flags in PAIRS:
        found = cache(lambda name=name: [block.value for block in blocks(name)])
        table = Table("value.npy", (5, 2, 32), lambda i, found=found: found()[i[0]][i[1]][i[2]])
        yield Case("lineformer", name, f"The Lineformer block: {title}", [], block_inputs(name), {"value": table}, level, flags)


def lineformer_gradients():
    name, title, level, flags = PAIRS[0]
    cotangent = short(pseudo_random("lineformer/cotangent", (5, 2, 32)))

    @cache
    def found():
        each = [block.gradient(d) for block, d in zip(blocks(name), networks.exact(cotangent))]
        total = {part: sum(one[part] for one in each) for part in networks.PARTS}
        return {**total, "x": np.array([one["x"] for one in each], dtype=object)}

    shapes = {**networks.PARTS, "x": (5, 2, 32)}
    table = Table("grad.npz", shapes, lambda i: found()[i[0]][i[1]])
    inputs = {**block_inputs(name), "cotangent": Given("inputs/lineformer-random/cotangent.npy", cotangent)}
    yield Case("gradient-lineformer", name, f"Gradient to the parameters and the input of the Lineformer block: {title}", [],
               inputs, {"grad": table}, level, flags)


RAYS = [("cone", "a cone beam, shifted detector and volume", CONE, [0.0, 0.7, 2.9], [(0, 2, 3), (1, 3, 2), (1, 2, 4), (2, 3, 3)],
         ["offset-detector", "non-square-pixels", "offset-volume", "anisotropic-voxels"]),
        ("parallel", "a parallel beam", PARALLEL, [0.4, 1.1], [(0, 2, 3), (0, 1, 6), (1, 3, 2)],
         ["parallel", "offset-detector", "non-square-pixels", "offset-volume", "anisotropic-voxels"])]


def quadratures():
    for name, title, scanner, angles, pixels, flags in RAYS:
        shape = (len(pixels), 10)
        draws, density = uniform(f"quadrature/{name}/draws", shape), uniform(f"quadrature/{name}/density", shape)
        draws[0, 0], draws[-1, -1] = 0.0, 1.0
        found = cache(lambda scanner=scanner, angles=angles, pixels=pixels, draws=draws, density=density: [
            networks.quadrature(scanner, view_at(scanner, angles[view]), (row, column), draws[k], density[k])
            for k, (view, row, column) in enumerate(pixels)])
        tables = {"point": Table("point.npy", (*shape, 3), lambda i, found=found: found()[i[0]][0][i[1]][i[2]]),
                  "length": Table("length.npy", shape, lambda i, found=found: found()[i[0]][1][i[1]]),
                  "integral": Table("integral.npy", shape[:1], lambda i, found=found: found()[i[0]][2])}
        given = {"pixels": np.array(pixels, dtype=float), "draws": draws, "density": density}
        inputs = {key: Given(f"inputs/quadrature-{name}/{key}.npy", array) for key, array in given.items()}
        inputs["scanner"] = Given(f"inputs/quadrature-{name}/meta_data.json", meta_data(scanner))
        yield Case("ray-quadrature", name, f"Points along rays and line integrals: {title}", [], inputs, tables, "optional",
                   flags, {"angles": angles})
