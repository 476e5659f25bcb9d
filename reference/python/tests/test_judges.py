"""Independent programs that must agree: PyWavelets, SciPy, scikit-image, PyTorch, and Siddon's algorithm in NumPy.

A test without its judge is skipped and says which package is missing.
"""

import numpy as np
import pytest

import trgs
import trgs.losses
import trgs.metrics
import trgs.optim


def test_haar_is_that_of_pywavelets():
    pywt = pytest.importorskip("pywt")
    block = np.random.default_rng(0).normal(size=(8, 6, 4))
    (bands,) = trgs.haar(block)
    judged = pywt.dwtn(block, "haar")
    # Band 4·hx + 2·hy + hz is high along the axes with h = 1.
    for band in range(8):
        key = "".join("d" if band >> (2 - axis) & 1 else "a" for axis in range(3))
        assert abs(bands[band] - judged[key]).max() < 1e-15 * abs(block).max() * 4, key
    assert abs(trgs.haar_inverse([bands]) - block).max() < 4e-15


def test_ssim_is_that_of_scikit_image_within_the_image():
    metrics = pytest.importorskip("skimage.metrics")
    draw = np.random.default_rng(1)
    prediction, target = draw.uniform(size=(2, 30, 25))
    value, _ = trgs.losses.ssim(prediction, target)
    # Zeros beyond the image: an image in a frame of zeros as wide as the window, without that frame.
    framed = [np.pad(image, 16) for image in (prediction, target)]
    settings = {"gaussian_weights": True, "sigma": 1.5, "truncate": 3.5, "use_sample_covariance": False, "data_range": 1.0}
    _, whole = metrics.structural_similarity(*framed, full=True, **settings)
    assert abs(whole[16:-16, 16:-16].mean() - value) < 1e-14


def test_neighbours_are_those_of_a_kd_tree_of_scipy():
    spatial = pytest.importorskip("scipy.spatial")
    draw = np.random.default_rng(2)
    grid = trgs.Grid((8, 6, 10), (-1.0, -0.8, -1.0), (1.0, 0.8, 1.0))
    means, confidence = draw.uniform(-1, 1, (200, 3)), draw.uniform(size=200)
    high = trgs.wavelet_routing(grid, means, confidence, neighbours=8, threshold=0.35)
    axes = [np.array(low) + (np.arange(n) + 0.5) * step for low, n, step in zip(grid.low, grid.shape, grid.spacing)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    _, nearest = spatial.cKDTree(means).query(centres.reshape(-1, 3), k=8)
    judged = (confidence[nearest] >= 0.35).sum(axis=1).reshape(grid.shape)
    assert (high == judged).all() and 0 < judged.min() < judged.max()


def test_the_density_of_a_kernel_is_the_t_distribution_of_scipy(model):
    stats = pytest.importorskip("scipy.stats")
    covariances = model.covariance()
    grid = trgs.Grid((5, 4, 3))
    axes = [low + (np.arange(n) + 0.5) * step for low, n, step in zip(grid.low, grid.shape, grid.spacing)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    judged = np.zeros(grid.shape)
    for mean, shape, density, nu in zip(model.mean, covariances, model.density, model.nu):
        law = stats.multivariate_t(mean, shape, df=nu)
        judged += density * law.pdf(centres) / law.pdf(mean)
    volume = trgs.voxelize(model, grid)
    assert abs(volume - judged).max() < 1e-12 * judged.max()


def test_adam_is_that_of_pytorch():
    torch = pytest.importorskip("torch")
    draw = np.random.default_rng(3)
    start, gradients = draw.normal(size=50), draw.normal(size=(20, 50))
    ours, adam = start.copy(), trgs.optim.Adam(50, beta=(0.9, 0.999), epsilon=1e-8)
    theirs = torch.tensor(start, requires_grad=True)
    judge = torch.optim.Adam([theirs], lr=0.01, betas=(0.9, 0.999), eps=1e-8)
    for gradient in gradients:
        adam.step(ours, gradient, 0.01)
        theirs.grad = torch.tensor(gradient)
        judge.step()
        assert abs(ours - theirs.detach().numpy()).max() < 1e-14
    assert abs(ours - start).max() > 0.01


def siddon(volume, scanner, angle, row, column):
    """The line integral of one ray of a cone beam through voxels of constant density."""
    across, up = np.array([-np.sin(angle), np.cos(angle), 0.0]), np.array([0.0, 0.0, 1.0])
    inwards = -np.array([np.cos(angle), np.sin(angle), 0.0])
    (rows, columns), (pitch_v, pitch_u), (offset_v, offset_u) = scanner.detector, scanner.pitch, scanner.offset
    u, v = (column - (columns - 1) / 2) * pitch_u + offset_u, (row - (rows - 1) / 2) * pitch_v + offset_v
    source = -scanner.dso * inwards
    ray = scanner.dsd * inwards + u * across - v * up
    grid = scanner.grid
    crossings = [np.array([0.0, 1.0])]
    for axis in np.flatnonzero(ray):
        planes = grid.low[axis] + np.arange(grid.shape[axis] + 1) * grid.spacing[axis]
        crossings.append((planes - source[axis]) / ray[axis])
    steps = np.unique(np.clip(np.concatenate(crossings), 0.0, 1.0))
    middles = source + (steps[1:] + steps[:-1])[:, None] / 2 * ray
    voxels = np.floor((middles - grid.low) / grid.spacing).astype(int)
    inside = ((voxels >= 0) & (voxels < grid.shape)).all(axis=1)
    lengths = (steps[1:] - steps[:-1]) * np.linalg.norm(ray)
    return (volume[tuple(voxels[inside].T)] * lengths[inside]).sum()


def test_rays_through_voxels_are_those_of_siddon_in_numpy(scanner):
    volume = np.random.default_rng(4).uniform(size=scanner.grid.shape)
    angles = [0.3, 2.0]
    images = trgs.forward_project(volume, scanner, angles, rays="siddon")
    rows, columns = scanner.detector
    judged = [[[siddon(volume, scanner, a, v, u) for u in range(columns)] for v in range(rows)] for a in angles]
    assert abs(images - judged).max() < 1e-12 * images.max() and images.max() > 0.5


def test_psnr_is_that_of_scikit_image():
    metrics = pytest.importorskip("skimage.metrics")
    truth, result = np.random.default_rng(5).uniform(size=(2, 6, 7, 8)).astype(np.float32)
    judged = metrics.peak_signal_noise_ratio(truth.astype(float), result.astype(float), data_range=1.0)
    assert abs(trgs.metrics.psnr_3d(truth, result).value - judged) < 1e-12 * judged
