"""A trainer in PyTorch that answers the stages `iteration`, `recycling` and `run`:  python3 trainer.py VECTORS ANSWERS [float32] [BUG]

VECTORS is what `trgs oracle trace` writes. Gradients are PyTorch's own (autograd) from the losses alone. BUG puts a mistake of
trainers into it: noise, friction, order, decay, moments, burn-in, or originals, share, copies, parents, momentum of recycling.
"""
import math, sys
from pathlib import Path

import numpy as np
import torch

BUGS = "noise friction order decay moments burn-in originals share copies parents momentum".split()
BUG = sys.argv.pop() if sys.argv[-1] in BUGS else None
import backend
from backend import KEYS, REAL


def physical(raw, settings):  # section 3
    between = lambda x, ends: ends[0] + (ends[1] - ends[0]) * torch.sigmoid(x)
    nu = torch.full_like(raw["nu"], math.inf) if settings["kernel"] == "gaussian" else between(raw["nu"], settings["nu_range"])
    density = torch.nn.functional.softplus(raw["density"], threshold=1000)
    return raw | {"scale": between(raw["scale"], settings["scale_range"]), "density": density, "nu": nu}


def block_of(scanner, numbers):  # the scanner of a block of voxels
    first, shape = np.array(numbers[:3]), np.array(numbers[3:])
    n, size = np.array(scanner["nVoxel"]), np.array(scanner["sVoxel"])
    least = np.array(scanner["offOrigin"]) - size / 2 + first * size / n
    part = shape * size / n
    return scanner | {"nVoxel": shape.tolist(), "sVoxel": part.tolist(), "offOrigin": (least + part / 2).tolist()}


def haar(block):  # section 9: band 4·hx + 2·hy + hz
    bands = [block]
    for axis in range(3):
        halves = [band.unflatten(axis, (-1, 2)).unbind(axis + 1) for band in bands]
        bands = [half / 2**0.5 for even, odd in halves for half in (even + odd, even - odd)]
    return bands


def alone(band, number, times):  # a band at full size
    for _ in range(times):
        for axis, high in enumerate((number >> 2 & 1, number >> 1 & 1, number & 1)):
            band = torch.stack([band, -band if high else band], axis + 1).flatten(axis, axis + 1) / 2**0.5
        number = 0
    return band


def wavelet_loss(block, high, settings):
    rest, share = block, high / settings["neighbours"]
    size = 0
    for level in range(settings["levels"]):
        bands = haar(rest)
        for number in range(1, 7):
            slopes = torch.gradient(alone(bands[number], number, level + 1))
            size = size + torch.sqrt(sum(slope * slope for slope in slopes) + 1e-12)
        rest = bands[0]
    size = size / (6 * settings["levels"])
    enhancement = (settings["enhancement"] * share * size).mean()
    return settings["suppress"] * ((1 - share) * size).mean() - settings["enhance"] * enhancement


def routed(scanner, model, confidence, settings):  # confident ones among the nearest, in float64
    n, size, offset = (np.array(scanner[key]) for key in ("nVoxel", "sVoxel", "offOrigin"))
    axes = [offset[k] - size[k] / 2 + (np.arange(n[k]) + 0.5) * size[k] / n[k] for k in range(3)]
    voxels = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 1, 3)
    distance = ((voxels - model["mean"].detach().cpu().numpy().astype(float)) ** 2).sum(-1)
    nearest = np.argsort(distance, axis=1, kind="stable")[:, : settings["neighbours"]]
    confident = confidence.cpu().numpy() >= settings["threshold"]
    return torch.tensor(confident[nearest].sum(1).reshape(*n), dtype=REAL)


def losses(model, given, image):
    """The six losses, and the part of their sum on blocks alone."""
    scanner = given["scanner"]
    l1, d_ssim = backend.l1(image, given["target"]), 1 - backend.ssim(image, given["target"])
    zero = torch.zeros(())
    tv, wavelet, nu = zero, zero, zero
    if given.get("tv_block"):
        tv = backend.total_variation(backend.density(model, block_of(scanner, given["tv_block"]), None).sum(0))
    if given.get("wavelet_block"):
        part = block_of(scanner, given["wavelet_block"])
        high = routed(part, model, given["confidence"], given)
        wavelet = wavelet_loss(backend.density(model, part, None).sum(0), high, given)
    if given["nu_weight"] > 0:
        square = (torch.log(model["nu"]) - torch.log(given["nu_target"])) ** 2
        nu = (given["nu_weight"] * (1 - given["confidence"]) * square).mean()
    blocks = given["tv_weight"] * tv + wavelet
    total = l1 + given["d_ssim"] * d_ssim + blocks + nu
    return [l1, d_ssim, tv, wavelet, nu, total], blocks


def gradients(total, blocks, model, moves):
    """Of the losses to the parameters; blocks need not move centres."""
    known = [key for key in KEYS if model[key].requires_grad]
    still = not moves and blocks.requires_grad
    of_blocks = torch.autograd.grad(blocks, model["mean"], retain_graph=True)[0] if still else 0
    slope = dict(zip(known, backend.slopes(total, *(model[key] for key in known))))
    slope["mean"] = slope["mean"] - of_blocks
    return {key: slope.get(key, torch.zeros_like(model[key])) for key in KEYS}


def rate(ends, given):  # section 10
    done = given["done"]
    if BUG == "decay":
        return given["pace"] * (ends[0] + (ends[1] - ends[0]) * min(done / given["length"], 1))
    t = min(done / given["length"], 1)
    return given["pace"] * math.exp((1 - t) * math.log(ends[0]) + t * math.log(ends[1])) if min(ends) > 0 else 0.0


def gate(density, reference):
    value = torch.sigmoid(100 * ((1 - (density / reference).clamp(max=1)) - 0.995))
    return torch.where(value < 1e-12, torch.zeros(()), value)


def sampled(x, p, direction, step, model, given):  # SGHMC
    done, burn_in, root = given["done"], given["burn_in"] + (BUG == "burn-in"), math.sqrt(given["pace"])
    s, z = gate(model["density"], given["reference"])[:, None], given["normals"]
    old = p
    if done < burn_in:
        friction = given["burn_in_friction"] / root
        z = (backend.covariance(model)[0] @ z[..., None])[..., 0]
        kept = torch.zeros_like(p)
    else:
        friction = given["friction"] / root * (1.05 if BUG == "friction" else 1)
        kept = torch.zeros_like(p) if done == burn_in else s * (1 - step * friction) * p
    noise = math.sqrt((1 if BUG == "noise" else 2) * step * friction)
    p = kept - step * direction + s * noise * z
    return x + step * (old if BUG == "order" else p), p


def iteration(given):
    """All outputs of the stage, by name."""
    with torch.no_grad():
        start = physical(given["raw"], given)
    model = {key: value.detach().requires_grad_(bool(torch.isfinite(value).all())) for key, value in start.items()}
    angles = torch.tensor(given["angles"], dtype=REAL)
    image = backend.images(given["projection"] == "exact")(model, given["scanner"], angles).sum(0)[0]
    values, blocks = losses(model, given, image)
    seen = image.detach().requires_grad_()
    cotangent = backend.slopes(backend.image_loss(seen, given["target"], given["d_ssim"]), seen)[0]
    slope = gradients(values[-1], blocks, model, given["blocks_move"])
    raw = {key: value.detach().requires_grad_() for key, value in given["raw"].items()}
    ways = physical(raw, given)
    finite = [key for key in KEYS if model[key].requires_grad]
    weighted = sum((ways[key] * slope[key]).sum() for key in finite)
    of_raw = dict(zip(KEYS, backend.slopes(weighted, *(raw[key] for key in KEYS))))

    t, (b1, b2) = given["done"] + 1, (given["beta1"], given["beta2"])
    if BUG == "moments":
        t = 1
    first = {key: b1 * given["first"][key] + (1 - b1) * of_raw[key] for key in KEYS}
    second = {key: b2 * given["second"][key] + (1 - b2) * of_raw[key] ** 2 for key in KEYS}
    pairs = zip(given["rates"][::2], given["rates"][1::2])
    rates = {key: rate(ends, given) for key, ends in zip(KEYS, pairs)}
    after, momentum = {}, given["momentum"]
    for key in KEYS:
        direction = first[key] / (1 - b1**t) / (torch.sqrt(second[key] / (1 - b2**t)) + given["epsilon"])
        if key == "mean" and given["position"] == "sghmc":
            step = math.sqrt(rates[key])
            after[key], momentum = sampled(given["raw"][key], momentum, direction, step, start, given)
        else:
            after[key] = given["raw"][key] - rates[key] * direction
    return {
        "01-physical": start,
        "02-image": image,
        "03-cotangent": cotangent,
        "04-losses": torch.stack([value.detach() for value in values]),
        "05-gradient": slope,
        "06-raw-gradient": of_raw,
        "07-rates": torch.tensor([rates[key] for key in KEYS], dtype=REAL),
        "08-first": first,
        "09-second": second,
        "10-momentum": momentum,
        "11-raw": after,
    }


def share(rule, density, nu, n):  # section 11
    if n == 1 or rule == "exact":
        return density / n, 1
    line = lambda j: j**-0.5 if math.isinf(nu) else math.exp(math.lgamma((j * (nu + 3) - 1) / 2) - math.lgamma(j * (nu + 3) / 2))
    n, opacity = min(n, 51), min(density, 1 - 1e-6)
    each = 1 - (1 - opacity) ** (1 / n)
    total = sum(math.comb(n, j) * (-1) ** (j - 1) * each**j * line(j) for j in range(1, n + 1))
    # A factor that all lines lack, sqrt(pi) of B(1/2, x), cancels.
    factor = opacity * line(1) / total
    return each, factor if rule == "sss" else factor**2


def recycling(given):
    """The population after adding and recycling, and the state of its optimisers; thresholds and draws in float64."""
    model, draws = physical(given["raw"], given), iter(given["uniform"].double().tolist())
    density, scale, nu = (model[key].double().cpu().numpy() for key in ("density", "scale", "nu"))
    m, dead = len(density), given["dead"]
    parent, fresh = list(range(m)), [False] * m
    density, scale = list(density), list(scale)

    def copies(weights, n):
        running = np.cumsum(weights)
        rows = [int(np.searchsorted(running, next(draws) * running[-1], "right")) for _ in range(n if running[-1] > 0 else 0)]
        for i in set(rows):
            density[i], factor = share(given["relocation"], density[i], nu[parent[i]], rows.count(i) + (BUG != "share"))
            scale[i] = scale[i] * factor
        return rows

    gone = sorted((i for i in range(m) if density[i] < dead), key=lambda i: (density[i], i))[: int(given["recycled"] * m)]
    alive = [rho if rho >= dead or BUG == "originals" else 0 for rho in density]
    for row, i in zip(gone, copies(alive, len(gone))):
        parent[row], fresh[row], density[row], scale[row] = parent[i], True, density[i], scale[i]
    for i in copies(density, min(int(given["growth"] * m), max(given["cap"] - m, 0))):
        for values, value in ((parent, parent[i]), (fresh, True), (density, density[i]), (scale, scale[i])):
            values.append(value)

    rows, new = torch.tensor(parent), torch.tensor(fresh)
    after = {key: model[key][rows] for key in KEYS}
    after |= {"density": torch.tensor(np.array(density), dtype=REAL), "scale": torch.tensor(np.array(scale), dtype=REAL)}
    if given["spread"]:
        z = given["normals"] * after["scale"][new]
        turned = (backend.rotations(after["quaternion"][new]) @ z[..., None])[..., 0]
        after["mean"] = after["mean"].index_put((new,), after["mean"][new] + given["spread"] * turned)
    copied = torch.isin(rows, rows[new]) & bool(given["reset_parents"] and BUG != "parents")
    lost = copied & ~new if BUG == "copies" else copied | new
    kept = lambda array, lost: torch.where(lost.reshape(-1, *[1] * (array.ndim - 1)), torch.zeros(()), array[rows])
    return {
        "1-parent": rows.to(REAL),
        "2-fresh": new.to(REAL),
        "3-physical": after,
        "4-first": {key: kept(given["first"][key], lost) for key in KEYS},
        "5-second": {key: kept(given["second"][key], lost) for key in KEYS},
        "6-momentum": given["momentum"][rows] if BUG == "momentum" else kept(given["momentum"], new),
    }


def run(given):
    """Iterations in a row."""
    steps = len(given["angles"])
    state, found, values = {key: given[key] for key in ("raw", "first", "second", "momentum")}, [], []
    for k in range(steps):
        blocks = {key: given[key][k] for key in ("tv_block", "wavelet_block") if given.get(key)}
        views = {"angles": [given["angles"][k]], "target": given["targets"][given["views"][k]]}
        step = given | state | blocks | views | {"normals": given["normals"][k], "done": given["done"] + k}
        done = iteration(step)
        names = {"raw": "11-raw", "first": "08-first", "second": "09-second", "momentum": "10-momentum"}
        state = {key: done[name] for key, name in names.items()}
        values.append(done["04-losses"])
        while len(found) < 5 and 5 * (k + 1) >= (len(found) + 1) * steps:
            found.append(state["raw"])
    return {"1-losses": torch.stack(values)} | {f"{k}-raw": raw for k, raw in enumerate(found, 2)}


def answer(stage, given):
    outputs = {"iteration": iteration, "recycling": recycling, "run": run}[stage](given)
    return [outputs[name] for name in sorted(outputs)]


if __name__ == "__main__":
    backend.answer = answer
    backend.main(*map(Path, sys.argv[1:3]))
