"""trgs against PyTorch in one run on one machine: seconds of a training step of NAF, SAX-NeRF and IntraTomo on the CPU.

    pip install torch numpy ./reference/python
    python benches/peers/torch_networks.py --threads 2

Both train in f32 on a simulated scan of 64³ voxels and 18 views of 128², with the same rays, points and parameters. PyTorch's
step has the points ready; that of trgs draws them. A time is the difference between runs of many and of few steps, the least
of three, by turns.
"""

import argparse
import time
import tomllib

import numpy as np
import torch

import trgs
import trgs.networks

JOINED = {"naf": 2, "sax-nerf": 2, "intratomo": 4}


def corner_entries(points, resolution, count):
    """Entries of the corners of the points' cells and their weights, [point, corner], by operations on whole arrays."""
    scaled = points * (resolution - 1) + 0.5
    cells = scaled.floor()
    part = scaled - cells
    cells = cells.long()
    offsets = torch.tensor(list(np.ndindex(2, 2, 2)))
    at = cells[:, None] + offsets
    weights = torch.where(offsets.bool(), part[:, None], 1 - part[:, None]).prod(2)
    side = resolution + 1
    if side**3 <= count:
        index = at[..., 0] + side * (at[..., 1] + side * at[..., 2])
    else:
        index = (at[..., 0] ^ at[..., 1] * 19349663 ^ at[..., 2] * 83492791) & 0xFFFFFFFF
    return index % count, weights


class Field(torch.nn.Module):
    """The density of a method, with the parameters of trgs."""

    def __init__(self, begin, settings, half_sides, joined):
        super().__init__()
        self.tensors = {name: torch.tensor(value, dtype=torch.float32, requires_grad=True) for name, value in begin.items()}
        self.tables = [value for name, value in self.tensors.items() if name.startswith("level_")]
        self.ceiling, self.joined = settings["ceiling"], joined
        self.half_sides = torch.tensor(half_sides, dtype=torch.float32)
        names = [name.split(".")[0] for name in begin if name.startswith("layer_")]
        self.layers = [
            {name.split(".")[1]: value for name, value in self.tensors.items() if name.startswith(f"layer_{k}.")}
            for k in range(1 + max(int(name.split("_")[1]) for name in names))
        ]

    def code(self, points):
        if not self.tables:
            places = (2 * points - 1) * self.half_sides
            return torch.cat([places, *(wave(2.0**k * places) for k in range(6) for wave in (torch.sin, torch.cos))], 1)
        features = []
        for number, table in enumerate(self.tables):
            with torch.no_grad():
                entries, weights = corner_entries(points, 16 << number, len(table))
            features.append(torch.nn.functional.embedding_bag(entries, table, per_sample_weights=weights, mode="sum"))
        return torch.cat(features, 1)

    def block(self, own, x):
        normal = torch.nn.functional.layer_norm
        x = x.reshape(-1, 2, 32)
        n = normal(x, (32,), own["gain_1"], own["shift_1"])
        kv = n @ own["key_value"].T
        q, k, v = (part.reshape(-1, 2, 8, 4).transpose(1, 2) for part in (n @ own["query"].T, kv[..., :32], kv[..., 32:]))
        mixed = ((q @ k.transpose(2, 3) / 2 + own["position"]).softmax(-1) @ v).transpose(1, 2).reshape(-1, 2, 32)
        y = x + torch.nn.functional.linear(mixed, own["out"], own["out_bias"])
        n = normal(y, (32,), own["gain_2"], own["shift_2"])
        gelu = torch.nn.functional.gelu
        return (y + gelu(gelu(n @ own["first"].T) @ own["second"].T) @ own["third"].T).reshape(-1, 32)

    def forward(self, points):
        code = x = self.code(points)
        for k, own in enumerate(self.layers):
            if "query" in own:
                x = self.block(own, x)
            else:
                x = torch.nn.functional.linear(torch.cat([code, x], 1) if k == self.joined else x, own["weight"], own["bias"])
            if k + 1 < len(self.layers):
                x = torch.nn.functional.leaky_relu(x, 0.01)
        return self.ceiling * torch.sigmoid(x[:, 0])


def torch_seconds(field, batches, settings, few_steps, many_steps):
    """Seconds of a step of PyTorch."""
    ready = [[torch.tensor(array, dtype=torch.float32) for array in batch] for batch in batches]
    tables = [tensor for tensor in field.tensors.values() if any(tensor is table for table in field.tables)]
    others = [tensor for name, tensor in field.tensors.items() if not name.startswith("level_")]
    groups = [{"params": others, "lr": settings["network_rate"]}]
    if tables:
        groups.append({"params": tables, "lr": settings["table_rate"]})
    adam = torch.optim.Adam(groups, eps=1e-15)

    def run(steps):
        began = time.perf_counter()
        for step in range(steps):
            points, lengths, values = ready[step % len(ready)]
            density = field(points.reshape(-1, 3)).reshape(lengths.shape)
            loss = (((density * lengths).sum(1) - values) ** 2).mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
        return time.perf_counter() - began, loss.item()

    few, (many, loss) = run(few_steps)[0], run(many_steps)
    return (many - few) / (many_steps - few_steps), loss


def trgs_seconds(scan, method, few_steps, many_steps):
    """Seconds of a step of trgs."""

    def run(steps):
        began = time.perf_counter()
        trgs.reconstruct(scan, method, iterations=steps)
        return time.perf_counter() - began

    few, many = run(few_steps), run(many_steps)
    return (many - few) / (many_steps - few_steps)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, nargs=2, default=[10, 40], metavar=("FEW", "MANY"))
    parser.add_argument("--methods", nargs="+", default=list(JOINED), choices=list(JOINED))
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    trgs.set_threads(arguments.threads)
    scan = trgs.simulate("torso", trgs.Scanner.synthetic(64, 128), views=18, test_views=2, noise="low", seed=3)
    grid = scan.scanner.grid
    half_sides = (np.array(grid.high) - np.array(grid.low)) / 2
    print(f"trgs {trgs.__version__} ({trgs._core.cpu_level()}), PyTorch {torch.__version__}, {arguments.threads} threads")
    print("\n| method | rays | samples | trgs, ms | PyTorch, ms | PyTorch / trgs |\n|---|---|---|---|---|---|")
    for method in arguments.methods:
        steps = trgs.networks.steps(scan, method, steps=2)
        settings = tomllib.loads(steps.settings)["neural"]
        ours, theirs = [], []
        for _ in range(3):
            field = Field(steps.begin, settings, half_sides, JOINED[method])
            ours.append(trgs_seconds(scan, method, *arguments.steps))
            seconds, loss = torch_seconds(field, steps.batches, settings, *arguments.steps)
            assert np.isfinite(loss), "a loss that is not a number"
            theirs.append(seconds)
        rays, samples = steps.batches[0].lengths.shape
        a, b = min(ours), min(theirs)
        print(f"| `{method}` | {rays} | {samples} | {a * 1e3:.1f} | {b * 1e3:.1f} | {b / a:.1f} |", flush=True)


if __name__ == "__main__":
    main()
