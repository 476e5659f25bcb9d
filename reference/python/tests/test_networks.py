"""Training steps of the networks, repeated by a program in PyTorch that was written from the methods' descriptions alone."""

import tomllib

import numpy as np
import pytest

import trgs
from trgs import networks

SMALL = {"levels": 5, "table": 10, "samples": 24, "rays": 96}


def begun(scan, method, **settings):
    settings = {"neural": SMALL, "precision": "f64", "seed": 5, **settings}
    return networks.steps(scan, method, **settings)


# ---------------------------------------------------------------------------- the program in PyTorch


def entries(points, resolution, count):
    """Entries and weights of the corners of cells, [point, corner]."""
    scaled = points * (resolution - 1) + 0.5
    cells = np.floor(scaled).astype(np.int64)
    found, weights = [], []
    for corner in np.ndindex(2, 2, 2):
        at = cells + np.array(corner)
        index, step, is_whole = np.zeros(len(points), np.int64), 1, True
        for axis in range(3):
            if step > count:
                is_whole = False
                break
            index, step = (index + at[:, axis] * step) % 2**32, step * (resolution + 1) % 2**32
        if step > count or not is_whole:
            index = np.zeros(len(points), np.int64)
            for axis, prime in enumerate((1, 19349663, 83492791)):
                index ^= at[:, axis] * prime % 2**32
        found.append(index % count)
        weights.append(np.prod(1 - np.abs(scaled - at), axis=1))
    return np.stack(found, 1), np.stack(weights, 1)


def code_of(torch, parameters, points, half_sides):
    tables = [name for name in parameters if name.startswith("level_")]
    if not tables:
        places = (2 * points - 1) * np.array(half_sides)
        waves = [wave(2.0**k * places) for k in range(6) for wave in (np.sin, np.cos)]
        return torch.tensor(np.concatenate([places, *waves], axis=1))
    features = []
    for number, name in enumerate(tables):
        table = parameters[name]
        entry, weight = entries(points, 16 << number, len(table))
        features.append((table[torch.tensor(entry)] * torch.tensor(weight)[:, :, None]).sum(1))
    return torch.cat(features, 1)


def block(torch, p, x):
    """The Lineformer block of pairs [pair, 2, 32]."""
    functional = torch.nn.functional
    n = functional.layer_norm(x, (32,), p["gain_1"], p["shift_1"])
    q, kv = n @ p["query"].T, n @ p["key_value"].T
    heads = [part.reshape(-1, 2, 8, 4).transpose(1, 2) for part in (q, kv[..., :32], kv[..., 32:])]
    scores = heads[0] @ heads[1].transpose(2, 3) / 2 + p["position"]
    mixed = (scores.softmax(-1) @ heads[2]).transpose(1, 2).reshape(-1, 2, 32)
    y = x + mixed @ p["out"].T + p["out_bias"]
    n = functional.layer_norm(y, (32,), p["gain_2"], p["shift_2"])
    return y + functional.gelu(functional.gelu(n @ p["first"].T) @ p["second"].T) @ p["third"].T


def densities(torch, parameters, points, half_sides, joined, ceiling):
    code = code_of(torch, parameters, points, half_sides)
    layers = 1 + max(int(name.split("_")[1].split(".")[0]) for name in parameters if name.startswith("layer_"))
    x = code
    for k in range(layers):
        own = {name.split(".")[1]: value for name, value in parameters.items() if name.startswith(f"layer_{k}.")}
        if "query" in own:
            x = block(torch, own, x.reshape(-1, 2, 32)).reshape(-1, 32)
        else:
            x = torch.cat([code, x], 1) if k == joined else x
            x = x @ own["weight"].T + own["bias"]
        if k + 1 < layers:
            x = torch.nn.functional.leaky_relu(x, 0.01)
    return ceiling * torch.sigmoid(x[:, 0])


def repeated(torch, steps, half_sides, joined):
    """The losses of the same steps from the same parameters."""
    settings = tomllib.loads(steps.settings)["neural"]
    parameters = {name: torch.tensor(value, requires_grad=True) for name, value in steps.begin.items()}
    groups = [
        {"params": [value for name, value in parameters.items() if name.startswith(start)], "lr": settings[f"{group}_rate"]}
        for start, group in (("level_", "table"), ("layer_", "network"))
    ]
    optimiser = torch.optim.Adam([group for group in groups if group["params"]], eps=1e-15)
    losses = []
    for batch in steps.batches:
        rays, samples, _ = batch.points.shape
        rho = densities(torch, parameters, batch.points.reshape(-1, 3), half_sides, joined, settings["ceiling"])
        predicted = (rho.reshape(rays, samples) * torch.tensor(batch.lengths)).sum(1)
        loss = ((predicted - torch.tensor(batch.values)) ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    return np.array(losses), {name: value.detach().numpy() for name, value in parameters.items()}


# ---------------------------------------------------------------------------- the tests


@pytest.mark.parametrize(("method", "joined"), [("naf", 2), ("sax-nerf", 2), ("intratomo", 4)])
def test_two_hundred_steps_are_those_of_pytorch(scan, method, joined):
    torch = pytest.importorskip("torch")
    steps = begun(scan, method, steps=200)
    grid = scan.scanner.grid
    half_sides = (np.array(grid.high) - np.array(grid.low)) / 2
    losses, end = repeated(torch, steps, half_sides, joined)
    off = abs(losses / steps.losses - 1)
    # Measured: 4e-16 in the first five steps, 8e-14 in all.
    assert off[:5].max() < 1e-14, off[:5]
    assert off.max() < 2e-12, f"{off.max()} at step {off.argmax()}"
    assert steps.losses[-20:].mean() < 0.5 * steps.losses[:5].mean()
    assert set(end) == set(steps.end)
    single = begun(scan, method, steps=200, precision="f32")
    # In single precision, 4e-8 and 1 %.
    off = abs(single.losses / steps.losses - 1)
    assert off[:5].max() < 1e-6 and off.max() < 0.05, off


def test_batches_are_rays_of_the_scan(scan):
    steps = begun(scan, "naf", steps=3)
    assert len(steps.batches) == len(steps.losses) == 3
    for batch in steps.batches:
        rays, samples, axes = batch.points.shape
        assert (samples, axes) == (24, 3) and batch.lengths.shape == (rays, samples) and batch.values.shape == (rays,)
        assert rays <= 96 and batch.points.min() >= 0 and batch.points.max() <= 1
        # Lengths are those between neighbours.
        size = np.array(scan.scanner.grid.high) - np.array(scan.scanner.grid.low)
        between = np.linalg.norm(np.diff(batch.points, axis=1) * size, axis=2)
        assert abs(between - batch.lengths[:, :-1]).max() < 1e-9
    assert steps.unit > 0 and steps.begin["level_4"].shape == (1024, 2)
    assert (steps.begin["layer_0.bias"] != steps.end["layer_0.bias"]).any()


def test_steps_are_those_of_a_reconstruction(scan):
    # Rates of a run of four steps drop after three; those of steps() drop as in a run of the default length.
    neural = {**SMALL, "drop": 1000}
    settings = {"neural": neural, "precision": "f64", "seed": 5}
    seen = []
    trgs.reconstruct(scan, "naf", iterations=4, callback=seen.append, **settings)
    steps = begun(scan, "naf", steps=4, neural=neural)
    norms = [np.sqrt(loss * len(batch.values)) * steps.unit for loss, batch in zip(steps.losses, steps.batches, strict=True)]
    assert np.allclose([event.values["residual"] for event in seen if event.stage == "voxels"], norms, rtol=1e-12)


def test_a_method_without_a_network_is_refused(scan):
    with pytest.raises(ValueError, match="naf"):
        networks.steps(scan, "sart")
