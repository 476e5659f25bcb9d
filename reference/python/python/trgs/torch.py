"""Projections, volumes and losses of trgs in PyTorch, with exact gradients.

Tensors are on the CPU, contiguous, and all of float32 or all of float64, which is the arithmetic. Second derivatives are not
there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from . import _core

Projection = Literal["exact", "affine"]

__all__ = ["image_loss", "l1", "nu_loss", "project", "ssim", "tv", "voxelize", "wavelet_loss"]

_NAMES = ("mean", "scale", "quaternion", "density", "nu")
_TYPES = (torch.float32, torch.float64)


def _array(what: str, tensor: Tensor) -> np.ndarray[Any, Any]:
    """The numbers of a tensor, without a copy."""
    if not isinstance(tensor, Tensor):
        raise TypeError(f"{what}: got {type(tensor).__name__}, expected a torch.Tensor; give torch.as_tensor({what})")
    if tensor.device.type != "cpu":
        raise TypeError(f"{what}: got a tensor on {tensor.device}, expected one on cpu; give {what}.cpu()")
    if tensor.dtype not in _TYPES:
        raise TypeError(f"{what}: got {tensor.dtype}, expected torch.float32 or torch.float64; give {what}.double()")
    if not tensor.is_contiguous():
        raise TypeError(f"{what}: got a tensor that is not contiguous, expected a contiguous one; give {what}.contiguous()")
    return tensor.detach().numpy()


def _one_type(named: Sequence[tuple[str, Tensor]]) -> torch.dtype:
    (first, tensor), *others = named
    for name, other in others:
        if other.dtype != tensor.dtype:
            raise TypeError(f"{name}: got {other.dtype}, expected {tensor.dtype}, the type of {first}; give {name}.to({first}.dtype)")
    return tensor.dtype


def _model(parameters: Sequence[Tensor]) -> _core.Model:
    arrays = [_array(name, tensor) for name, tensor in zip(_NAMES, parameters)]
    _one_type(list(zip(_NAMES, parameters)))
    return _core.Model(*arrays)


def _given(gradients: Sequence[np.ndarray[Any, Any]], ctx: Any, dtype: torch.dtype) -> list[Tensor | None]:
    wanted = zip(gradients, ctx.needs_input_grad)
    return [torch.from_numpy(gradient).to(dtype) if needs else None for gradient, needs in wanted]


class _Field(Function):
    """A function from the five arrays of a model to one array, and its VJP."""

    @staticmethod
    def forward(
        ctx: Any,
        mean: Tensor,
        scale: Tensor,
        quaternion: Tensor,
        density: Tensor,
        nu: Tensor,
        angles: Tensor | None,
        value: Callable[[_core.Model, Any], Any],
        vjp: Callable[[_core.Model, Any], Any],
        motion: Callable[[_core.Model, Any], Any] | None,
    ) -> Tensor:
        ctx.model, ctx.vjp, ctx.motion = _model((mean, scale, quaternion, density, nu)), vjp, motion
        ctx.angles = angles
        return torch.from_numpy(value(ctx.model, np.float32 if mean.dtype == torch.float32 else np.float64))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        array = _array("cotangent", cotangent.contiguous())
        to_model: list[Tensor | None] = [None] * 5
        if any(ctx.needs_input_grad[:5]):
            to_model = _given(ctx.vjp(ctx.model, array), ctx, cotangent.dtype)
        to_angles = None
        if ctx.needs_input_grad[5]:
            to_angles = torch.from_numpy(ctx.motion(ctx.model, array)[:, 5].copy()).to(ctx.angles.dtype)
        return (*to_model, to_angles, None, None, None)


class _Loss(Function):
    """A function from one array to a number, with its gradient."""

    @staticmethod
    def forward(ctx: Any, argument: Tensor, evaluate: Callable[[Any], tuple[float, Any]]) -> Tensor:
        value, gradient = evaluate(_array("argument", argument))
        ctx.gradient = torch.from_numpy(gradient)
        return argument.new_tensor(value)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, None]:  # type: ignore[override]
        return cotangent * ctx.gradient, None


def project(
    mean: Tensor,
    scale: Tensor,
    quaternion: Tensor,
    density: Tensor,
    nu: Tensor,
    scanner: _core.Scanner,
    angles: Sequence[float] | Tensor,
    *,
    projection: Projection = "exact",
    cutoff: float = 0.0,
) -> Tensor:
    """Projections [view, v, u] of primitives, differentiable to their five parameters and to the angles.

    Parameters
    ----------
    mean, scale, quaternion, density, nu : Tensor [M, 3], [M, 3], [M, 4], [M], [M]
        As of `trgs.Model`.
    angles : sequence of float, or Tensor [view]
        Radians. A tensor that requires a gradient gets the exact one. Vectors [view, 12] of poses are constants: their
        gradients to motions are those of `trgs.motion_vjp`.
    scanner, projection, cutoff
        As of `trgs.project`.

    Returns
    -------
    Tensor [view, v, u]
        Of the type of the parameters.

    Raises
    ------
    TypeError
        For tensors of another type or device, or that are not contiguous.
    ValueError
        As `trgs.Model` and `trgs.project`.
    """

    tensor = angles if isinstance(angles, Tensor) and angles.requires_grad else None
    if tensor is not None and tensor.ndim != 1:
        shape = list(tensor.shape)
        raise TypeError(f"angles: got shape {shape} with a gradient, expected [view]; give angles.detach(), see trgs.motion_vjp")
    views = angles.detach().cpu().numpy() if isinstance(angles, Tensor) else angles

    def value(model: _core.Model, dtype: Any) -> Any:
        return _core.project(model, scanner, views, projection=projection, cutoff=cutoff, dtype=dtype)

    def vjp(model: _core.Model, cotangent: Any) -> Any:
        return _core.project_vjp(model, scanner, views, cotangent, projection=projection, cutoff=cutoff)

    def motion(model: _core.Model, cotangent: Any) -> Any:
        return _core.motion_vjp(model, scanner, views, cotangent, projection=projection, cutoff=cutoff)

    return _Field.apply(mean, scale, quaternion, density, nu, tensor, value, vjp, motion)


def voxelize(
    mean: Tensor,
    scale: Tensor,
    quaternion: Tensor,
    density: Tensor,
    nu: Tensor,
    grid: _core.Grid | _core.Scanner,
    *,
    cutoff: float = 0.0,
) -> Tensor:
    """Densities [x, y, z] of primitives at voxel centres, differentiable to their five parameters.

    Parameters
    ----------
    mean, scale, quaternion, density, nu : Tensor [M, 3], [M, 3], [M, 4], [M], [M]
        As of `trgs.Model`.
    grid, cutoff
        As of `trgs.voxelize`.

    Returns
    -------
    Tensor [x, y, z]
        Of the type of the parameters.

    Raises
    ------
    TypeError
        For tensors of another type or device, or that are not contiguous.
    ValueError
        As `trgs.Model` and `trgs.voxelize`.
    """

    def value(model: _core.Model, dtype: Any) -> Any:
        return _core.voxelize(model, grid, cutoff=cutoff, dtype=dtype)

    def vjp(model: _core.Model, cotangent: Any) -> Any:
        return _core.voxelize_vjp(model, grid, cotangent, cutoff=cutoff)

    return _Field.apply(mean, scale, quaternion, density, nu, None, value, vjp, None)


def _constant(what: str, constant: Tensor, argument: Tensor) -> np.ndarray[Any, Any]:
    if constant.requires_grad:
        raise TypeError(f"{what}: got a tensor that requires a gradient, expected a constant; give {what}.detach()")
    _one_type([("the first argument", argument), (what, constant)])
    return _array(what, constant)


def l1(prediction: Tensor, target: Tensor) -> Tensor:
    """Mean absolute difference of two images [v, u]; the target is a constant. See `trgs.losses.l1`."""
    target_array = _constant("target", target, prediction)
    return _Loss.apply(prediction, lambda array: _core.l1(array, target_array))


def ssim(prediction: Tensor, target: Tensor) -> Tensor:
    """Structural similarity of two images [v, u]; the target is a constant. See `trgs.losses.ssim`."""
    target_array = _constant("target", target, prediction)
    return _Loss.apply(prediction, lambda array: _core.ssim(array, target_array))


def image_loss(prediction: Tensor, target: Tensor, weight: float = 0.25) -> Tensor:
    """L1 + weight·(1 - SSIM) of two images [v, u]; the target is a constant. See `trgs.losses.image_loss`."""
    target_array = _constant("target", target, prediction)
    return _Loss.apply(prediction, lambda array: _core.image_loss(array, target_array, weight))


def tv(block: Tensor) -> Tensor:
    """Mean absolute difference of neighbouring voxels [x, y, z]. See `trgs.losses.tv`."""
    return _Loss.apply(block, _core.total_variation)


def wavelet_loss(block: Tensor, high: np.ndarray[Any, np.dtype[np.uint16]], **settings: Any) -> Tensor:
    """The wavelet loss of a block [x, y, z]; settings are those of `trgs.wavelet_loss`."""
    return _Loss.apply(block, lambda array: _core.wavelet_loss(array, high, **settings)[:2])


def nu_loss(nu: Tensor, target: Tensor, confidence: Tensor, weight: float) -> Tensor:
    """The loss that pulls degrees of freedom [M] to a target, float64. See `trgs.losses.nu_loss`."""
    constants = _constant("target", target, nu), _constant("confidence", confidence, nu)
    return _Loss.apply(nu, lambda array: _core.nu_loss(array, *constants, weight))
