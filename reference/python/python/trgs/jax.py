"""Projections and volumes of trgs in JAX, with exact gradients, also under `jax.jit` and `jax.vmap`.

Arrays are all of float32 or all of float64 (with `jax_enable_x64`), which is the arithmetic. The calls run on the CPU. Values are
checked when a compiled function runs; an error there is one of the run time of XLA, which has the message.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import numpy as np

from . import _core

Projection = Literal["exact", "affine"]

__all__ = ["project", "voxelize"]

_WIDTHS = {"mean": 3, "scale": 3, "quaternion": 4, "density": None, "nu": None}


def _check(arrays: Sequence[Any]) -> np.dtype[Any]:
    """Shapes and types, which are known before the run."""
    m, dtype = arrays[3].shape[:1], arrays[0].dtype
    if dtype not in (np.float32, np.float64):
        raise TypeError(f"mean: got {dtype}, expected float32 or float64; give mean.astype(jax.numpy.float32)")
    for (name, width), array in zip(_WIDTHS.items(), arrays):
        expected = m if width is None else (*m, width)
        if array.shape != expected:
            raise ValueError(f"{name}: got shape {array.shape}, expected {expected}; give one row per primitive")
        if array.dtype != dtype:
            raise TypeError(f"{name}: got {array.dtype}, expected {dtype}, the type of mean; give {name}.astype(mean.dtype)")
    return dtype


def _model(arrays: Sequence[Any]) -> _core.Model:
    return _core.Model(*(np.ascontiguousarray(array) for array in arrays))


def _field(
    arrays: Sequence[Any],
    shape: tuple[int, ...],
    value: Callable[[_core.Model, Any], Any],
    vjp: Callable[[_core.Model, Any], Any],
) -> Any:
    """A function from the five arrays of a model to one array, with its VJP."""
    arrays = [jax.numpy.asarray(array) for array in arrays]
    dtype = _check(arrays)

    def gradients(cotangent: Any, *arrays: Any) -> Any:
        found = vjp(_model(arrays), np.ascontiguousarray(cotangent))
        return tuple(np.asarray(gradient, dtype=dtype) for gradient in found)

    @jax.custom_vjp
    def field(*arrays: Any) -> Any:
        result = jax.ShapeDtypeStruct(shape, dtype)
        return jax.pure_callback(lambda *arrays: value(_model(arrays), dtype), result, *arrays, vmap_method="sequential")

    def forward(*arrays: Any) -> Any:
        return field(*arrays), arrays

    def backward(arrays: Any, cotangent: Any) -> Any:
        result = tuple(jax.ShapeDtypeStruct(array.shape, dtype) for array in arrays)
        return jax.pure_callback(gradients, result, cotangent, *arrays, vmap_method="sequential")

    field.defvjp(forward, backward)
    return field(*arrays)


def project(
    mean: Any,
    scale: Any,
    quaternion: Any,
    density: Any,
    nu: Any,
    scanner: _core.Scanner,
    angles: Sequence[float],
    *,
    projection: Projection = "exact",
    cutoff: float = 0.0,
) -> Any:
    """Projections [view, v, u] of primitives, differentiable to their five parameters.

    Parameters
    ----------
    mean, scale, quaternion, density, nu : Array [M, 3], [M, 3], [M, 4], [M], [M]
        As of `trgs.Model`.
    scanner, angles, projection, cutoff
        As of `trgs.project`; constants. `trgs.motion_vjp` has the gradient to them.

    Returns
    -------
    Array [view, v, u]
        Of the type of the parameters.

    Raises
    ------
    TypeError, ValueError
        For arrays of another type or shape.
    """
    views = np.asarray(angles, dtype=np.float64)

    def value(model: _core.Model, dtype: Any) -> Any:
        return _core.project(model, scanner, views, projection=projection, cutoff=cutoff, dtype=dtype)

    def vjp(model: _core.Model, cotangent: Any) -> Any:
        return _core.project_vjp(model, scanner, views, cotangent, projection=projection, cutoff=cutoff)

    return _field((mean, scale, quaternion, density, nu), (len(views), *scanner.detector), value, vjp)


def voxelize(
    mean: Any,
    scale: Any,
    quaternion: Any,
    density: Any,
    nu: Any,
    grid: _core.Grid,
    *,
    cutoff: float = 0.0,
) -> Any:
    """Densities [x, y, z] of primitives at voxel centres, differentiable to their five parameters.

    Parameters
    ----------
    mean, scale, quaternion, density, nu : Array [M, 3], [M, 3], [M, 4], [M], [M]
        As of `trgs.Model`.
    grid : trgs.Grid
        A constant.
    cutoff
        As of `trgs.voxelize`.

    Returns
    -------
    Array [x, y, z]
        Of the type of the parameters.

    Raises
    ------
    TypeError, ValueError
        For arrays of another type or shape.
    """

    def value(model: _core.Model, dtype: Any) -> Any:
        return _core.voxelize(model, grid, cutoff=cutoff, dtype=dtype)

    def vjp(model: _core.Model, cotangent: Any) -> Any:
        return _core.voxelize_vjp(model, grid, cotangent, cutoff=cutoff)

    return _field((mean, scale, quaternion, density, nu), grid.shape, value, vjp)
