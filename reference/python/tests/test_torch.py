"""Gradients in PyTorch, and a training loop."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import trgs  # noqa: E402
import trgs.torch as tt  # noqa: E402
from conftest import model_of  # noqa: E402

ANGLES = [0.2, 1.9]


def tensors(model, dtype=torch.float64):
    arrays = (getattr(model, name) for name in trgs.Parameters._fields)
    return [torch.tensor(array).to(dtype).requires_grad_() for array in arrays]


@pytest.mark.parametrize("projection", ["exact", "affine"])
def test_projections_pass_gradcheck(scanner, projection):
    run = lambda *parameters: tt.project(*parameters, scanner, ANGLES, projection=projection)
    assert torch.autograd.gradcheck(run, tensors(model_of(3)), eps=1e-6, atol=1e-7, rtol=1e-6)


def test_volumes_pass_gradcheck(scanner):
    assert torch.autograd.gradcheck(lambda *p: tt.voxelize(*p, scanner.grid), tensors(model_of(3)), atol=1e-7, rtol=1e-6)


def test_losses_pass_gradcheck():
    draw = torch.Generator().manual_seed(0)
    random = lambda *shape: torch.rand(*shape, generator=draw, dtype=torch.float64)
    check = lambda function, *shape: torch.autograd.gradcheck(function, random(*shape).requires_grad_(), atol=1e-7)
    target = random(8, 9)
    for loss in (tt.l1, tt.ssim, tt.image_loss):
        assert check(lambda image: loss(image, target), 8, 9)
    assert check(tt.tv, 4, 4, 6)
    high = np.full((4, 4, 6), 3, dtype=np.uint16)
    assert check(lambda block: tt.wavelet_loss(block, high, neighbours=8), 4, 4, 6)
    wanted, confidence = 1 + random(5), random(5)
    assert check(lambda nu: tt.nu_loss(1 + nu, wanted, confidence, 0.3), 5)


def test_single_precision_stays_single(scanner):
    parameters = tensors(model_of(4), torch.float32)
    image = tt.project(*parameters, scanner, ANGLES)
    image.sum().backward()
    assert image.dtype == torch.float32 and all(p.grad.dtype == torch.float32 for p in parameters)
    expected = trgs.project_vjp(trgs.Model(*(p.detach().numpy() for p in parameters)), scanner, ANGLES,
                                np.ones((2, 9, 12), dtype=np.float32))
    assert all(np.array_equal(p.grad.numpy(), e.astype(np.float32)) for p, e in zip(parameters, expected))


def test_gradients_are_only_computed_where_asked(scanner):
    mean, *others = tensors(model_of(4))
    others = [tensor.detach() for tensor in others]
    tt.voxelize(mean, *others, scanner).sum().backward()
    assert mean.grad.shape == (4, 3) and all(tensor.grad is None for tensor in others)


def test_what_cannot_be_read_is_refused(scanner):
    mean, scale, *rest = tensors(model_of(4))
    with pytest.raises(TypeError, match="scale: got torch.float32, expected torch.float64, the type of mean"):
        tt.project(mean, scale.float(), *rest, scanner, ANGLES)
    with pytest.raises(TypeError, match="mean: got a tensor that is not contiguous"):
        tt.project(mean.t().contiguous().t(), scale, *rest, scanner, ANGLES)
    with pytest.raises(TypeError, match="mean: got torch.float16"):
        tt.project(mean.half(), scale, *rest, scanner, ANGLES)
    with pytest.raises(TypeError, match="mean: got ndarray"):
        tt.project(mean.detach().numpy(), scale, *rest, scanner, ANGLES)
    with pytest.raises(TypeError, match="target: got a tensor that requires a gradient"):
        tt.l1(torch.zeros(2, 2), torch.zeros(2, 2, requires_grad=True))


def test_twenty_lines_train():
    scanner = trgs.Scanner.synthetic(16, 24)
    scan = trgs.simulate("torso", scanner, views=8)
    angles, target = scan.angles, torch.tensor(scan.projections)
    draw = np.random.default_rng(0)
    mean = torch.tensor(draw.uniform(-0.6, 0.6, (150, 3)), dtype=torch.float32, requires_grad=True)
    log_scale = torch.full((150, 3), -1.8, requires_grad=True)
    quaternion = torch.tensor(draw.normal(size=(150, 4)), dtype=torch.float32, requires_grad=True)
    raw_density = torch.full((150,), -2.0, requires_grad=True)
    nu = torch.full((150,), 10.0)
    optimiser = torch.optim.Adam([mean, log_scale, quaternion, raw_density], lr=0.03)
    losses = []
    for step in range(48):
        view = step % len(angles)
        parameters = (mean, log_scale.exp(), quaternion, torch.nn.functional.softplus(raw_density), nu)
        (image,) = tt.project(*parameters, scanner, angles[view : view + 1], cutoff=1e-3)
        loss = tt.image_loss(image, target[view]) + 0.02 * tt.tv(tt.voxelize(*parameters, scanner))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert np.mean(losses[-8:]) < 0.5 * np.mean(losses[:8])


@pytest.mark.parametrize("projection", ["exact", "affine"])
def test_angles_pass_gradcheck(scanner, projection):
    parameters = [tensor.detach() for tensor in tensors(model_of(3))]
    run = lambda angles: tt.project(*parameters, scanner, angles, projection=projection)
    angles = torch.tensor(ANGLES, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(run, [angles], eps=1e-6, atol=1e-7, rtol=1e-6)
    assert torch.equal(run(angles), run(ANGLES))
    with pytest.raises(TypeError, match=r"angles: got shape \[2, 12\] with a gradient, expected \[view\]"):
        tt.project(*parameters, scanner, torch.zeros(2, 12, requires_grad=True))
