"""Tuples with names that functions return, and the printer of reports."""

import sys
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Parameters(NamedTuple):
    """Twelve numbers per primitive: physical or raw parameters, or a gradient to them."""

    mean: NDArray[np.float64]
    """[M, 3]"""
    scale: NDArray[np.float64]
    """[M, 3]"""
    quaternion: NDArray[np.float64]
    """[M, 4] = w, x, y, z"""
    density: NDArray[np.float64]
    """[M]"""
    nu: NDArray[np.float64]
    """[M]"""


class Population(NamedTuple):
    """The next population of density control."""

    model: Any
    """The `trgs.Model`."""
    parent: NDArray[np.int64]
    """[M']: row of the old model from which a primitive stems."""
    fresh: NDArray[np.bool_]
    """[M']: whether a primitive is new."""


class WaveletLoss(NamedTuple):
    """The wavelet loss of a block: suppress·S - enhance·E."""

    value: float
    gradient: NDArray[Any]
    """To the block [x, y, z]."""
    enhancement: float
    """E, the mean of η·|N_high|/K·g over the voxels."""
    suppression: float
    """S, the mean of |N_low|/K·g over the voxels."""


class Batch(NamedTuple):
    """What a step of a network sees."""

    points: NDArray[np.float64]
    """[ray, sample, 3], from 0 to 1 along each side of the volume."""
    lengths: NDArray[np.float64]
    """[ray, sample]: the length that a point stands for, scene units."""
    values: NDArray[np.float64]
    """[ray]: the measured line integral, divided by the unit of density."""


class NetworkSteps(NamedTuple):
    """The first steps of the training of a network.

    A step moves the parameters by Adam (decay 0.9 and 0.999, epsilon 1e-15) against the gradient of the mean squared error of
    its rays; the prediction of a ray is the sum of density times length. The density is the network's output through
    ceiling times a sigmoid (`neural.bounded`), else a leaky rectifier.
    """

    begin: dict[str, NDArray[np.float64]]
    """Parameters before the first step: `level_K` [entries, 2] of the hash grid, `layer_K.weight` [outputs, inputs] and
    `layer_K.bias`; the parts of a Lineformer block have the names of the conformance vectors."""
    batches: list[Batch]
    losses: NDArray[np.float64]
    """Mean squared error of each step, before the step."""
    end: dict[str, NDArray[np.float64]]
    """Parameters after the last step."""
    unit: float
    """Attenuation per scene unit that counts as 1."""
    settings: str
    """All keys in TOML, with what follows from the scan."""


class Metric(NamedTuple):
    """A mean, the id of its definition, and the values that it is the mean of."""

    value: float
    definition: str
    detail: list[float]
    """Of each axis or view; NaN of one that is left out."""


class Progress(NamedTuple):
    """A report of a run."""

    stage: str
    """"primitives", "pilot" (the pilot run), "voxels" or "choosing"."""
    iteration: int
    """Iterations done; 0 of a choice."""
    iterations: int
    """Iterations in all; 0 of a choice."""
    values: dict[str, Any]
    """Losses of an iteration, the residual of a pass, or the key, value and error of a trial."""


def scanner(dso: Any, dsd: Any, detector: Any, pitch: Any, grid: Any, offset: Any) -> Any:
    """A pickled `trgs.Scanner`."""
    from ._core import Scanner

    if dso is None:
        return Scanner.parallel(detector=detector, pitch=pitch, grid=grid, offset=offset)
    return Scanner.cone(dso, dsd, detector=detector, pitch=pitch, grid=grid, offset=offset)


class Printer:
    """Prints reports to stderr: at most one in a time, and the last of each stage."""

    _APART = 0.5

    def __init__(self) -> None:
        self._last = float("-inf")

    def __call__(self, progress: Progress) -> None:
        now = time.monotonic()
        if progress.iteration < progress.iterations and now - self._last < self._APART:
            return
        self._last = now
        if progress.stage == "choosing":
            text = "choosing {key}: {value:.4g}, error {error:.5f}".format(**progress.values)
        else:
            name = "loss" if "loss" in progress.values else "residual"
            text = f"{progress.stage}: {progress.iteration}/{progress.iterations}, {name} {progress.values[name]:.5g}"
        print(text, file=sys.stderr, flush=True)
