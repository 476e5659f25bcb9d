"""A training loop in PyTorch with the gradients of trgs, beside trgs.reconstruct before and after its finish on voxels.

    python reference/python/train.py [--size 64] [--views 18] [--iterations 3000] [--ours 500]

The scene is that of `trgs demo`: a torso phantom of SIZE³ voxels from noisy projections of twice as many pixels. Needs PyTorch.
"""

import argparse

import numpy as np
import torch

import trgs
import trgs.torch


def starting_points(scan, count):
    """Raw parameters of points at the brightest voxels of a first volume, in random order."""
    volume = trgs.reconstruct(scan, "sart").volume
    grid, draw = scan.scanner.grid, np.random.default_rng(0)
    bright = np.argwhere(volume > 0.05 * volume.max())
    chosen = bright[draw.choice(len(bright), min(count, len(bright)), replace=False)]
    mean = np.array(grid.low) + (chosen + 0.5) * np.array(grid.spacing)
    size = np.linalg.norm(np.array(grid.spacing)) * (len(bright) / len(chosen)) ** (1 / 3) / 2
    ones = np.ones(len(chosen))
    density = np.log(np.expm1(np.maximum(0.3 * volume[tuple(chosen.T)], 1e-3)))
    values = mean, np.log(size) + np.zeros_like(mean), np.outer(ones, [1.0, 0, 0, 0]), density, np.log(10 * ones)
    return [torch.tensor(value, dtype=torch.float32, requires_grad=True) for value in values]


def train(scan, count, iterations):
    """The volume of primitives that were fitted to a scan."""
    raw, angles, measured = starting_points(scan, count), list(scan.angles), torch.tensor(scan.projections)
    rates = 1e-3, 2e-2, 5e-3, 4e-2, 2e-2
    adam = torch.optim.Adam([{"params": [p], "lr": rate} for p, rate in zip(raw, rates)], eps=1e-15)
    decay = torch.optim.lr_scheduler.ExponentialLR(adam, 0.1 ** (1 / iterations))
    weight = 0.05 * scan.scanner.grid.shape[0] / 256

    def physical():
        mean, scale, quaternion, density, nu = raw
        return mean, scale.exp(), quaternion, torch.nn.functional.softplus(density), 2 + nu.exp()

    for step in range(iterations):
        view = step % len(angles)
        image = trgs.torch.project(*physical(), scan.scanner, [angles[view]], cutoff=1e-3)
        loss = trgs.torch.image_loss(image[0], measured[view])
        if step % 4 == 0:
            loss = loss + 4 * weight * trgs.torch.tv(trgs.torch.voxelize(*physical(), scan.scanner, cutoff=1e-3))
        adam.zero_grad()
        loss.backward()
        adam.step()
        decay.step()
    return trgs.torch.voxelize(*physical(), scan.scanner).detach().numpy()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--views", type=int, default=18)
    parser.add_argument("--iterations", type=int, default=3000)
    parser.add_argument("--ours", type=int, default=500, help="iterations of trgs.reconstruct; the demo has 500")
    arguments = parser.parse_args()
    scanner = trgs.Scanner.synthetic(arguments.size, 2 * arguments.size)
    scan = trgs.simulate("torso", scanner, views=arguments.views, test_views=2, noise="low", seed=0)
    psnr = lambda volume: scan.evaluate(volume)["psnr_3d"].value
    ours = trgs.reconstruct(scan, iterations=arguments.ours, report_every=50)
    volume = train(scan, ours.model.mean.shape[0], arguments.iterations)
    print(f"the loop in PyTorch: {psnr(volume):.2f} dB")
    unfinished = ours.volume if ours.unfinished is None else ours.unfinished
    print(f"trgs.reconstruct: {psnr(unfinished):.2f} dB, {psnr(ours.volume):.2f} dB with the finish on voxels")


if __name__ == "__main__":
    main()
