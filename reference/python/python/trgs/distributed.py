"""Volumes in slabs on several workers, by Dask: `fdk`, `sart`, `os_sart`, `tv` and `voxelize`.

A volume is cut into slabs along x, which the memory of no single worker has to hold together. Rays carry their sums from slab to
slab, and all sums over voxels are over slices first: for any number of slabs and workers the bits are those of the function of
the same name in `trgs` and of the program. A worker that dies is replaced, and what it had is computed again.

>>> import trgs, trgs.distributed
>>> scan = trgs.simulate("torso", trgs.Scanner.synthetic(16, 24), views=6, test_views=2)
>>> volume = trgs.distributed.fdk(scan.projections, scan.scanner, scan.angles, slabs=2)      # doctest: +SKIP

`client` is a `dask.distributed.Client`, of a cluster of any kind; without one, a `LocalCluster` with a worker for each core is
started and ended. Every worker computes on as many threads as its process may use, so give each process one thread of Dask, as
`LocalCluster(threads_per_worker=1)` does. Needs the package `distributed`.
"""

import os
import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _core
from ._types import Progress

__all__ = ["fdk", "os_sart", "sart", "tv", "voxelize"]

_Views = Sequence[float] | NDArray[np.float64]
_Slices = tuple[int, int]
_Volume = NDArray[np.float32]

ANCHOR_EVERY = 20
"""Corrections of a volume after which its slabs are written to files: what a worker that dies had is computed again from there."""


@contextmanager
def _connected(client: Any) -> Iterator[Any]:
    """A client, or that of a cluster on this machine."""
    if client is not None:
        yield client
        return
    from distributed import Client, LocalCluster

    with LocalCluster(threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as own:
        yield own


def _parts(slices: int, slabs: int | None, client: Any) -> list[_Slices]:
    if slabs is not None and slabs < 1:
        raise ValueError(f"slabs: got {slabs}, expected at least 1; give slabs=2, or leave it out for one per worker")
    count = min(slices, slabs or max(1, len(client.nthreads())))
    return [(k * slices // count, (k + 1) * slices // count) for k in range(count)]


def _gathered(slabs: list[Any], shape: tuple[int, int, int], dtype: Any, out: str | os.PathLike[str] | None) -> Any:
    """The slabs as one array; with `out` as a file of NumPy, which is written slab by slab."""
    if out is None:
        volume = np.empty(shape, dtype)
    else:
        partial = Path(out).with_name(Path(out).name + ".partial")
        volume = np.lib.format.open_memmap(partial, "w+", dtype, shape)
    at = 0
    for slab in slabs:
        values = slab.result()
        volume[at : at + len(values)] = values
        at += len(values)
    if out is None:
        return volume
    volume.flush()
    partial.replace(out)
    return np.load(out, mmap_mode="r")


def _independent(function: Callable[..., Any], arguments: tuple[Any, ...], grid: Any, slabs: int | None, client: Any, out: Any, dtype: Any = np.float32) -> Any:
    """A volume whose slabs do not depend on each other: the last argument of the function is the slab's slices."""
    with _connected(client) as found:
        shared = [found.submit(_same, argument, pure=False) for argument in arguments]
        parts = _parts(grid.shape[0], slabs, found)
        return _gathered([found.submit(function, *shared, part, pure=False) for part in parts], grid.shape, dtype, out)


def fdk(
    projections: NDArray[np.float32],
    scanner: _core.Scanner,
    angles: _Views,
    *,
    window: str = "ram-lak",
    turn: str = "measured",
    slabs: int | None = None,
    client: Any = None,
    out: str | os.PathLike[str] | None = None,
) -> _Volume:
    """`trgs.fdk` by slabs.

    Parameters
    ----------
    projections, scanner, angles, window, turn
        As of `trgs.fdk`.
    slabs : int, optional
        Number of slabs; the default is one for each worker.
    client : dask.distributed.Client, optional
        Whose workers compute.
    out : path, optional
        A file .npy to write slab by slab, for a volume that is larger than the memory of this process.

    Returns
    -------
    ndarray [x, y, z], float32
        With `out`, memory-mapped from the file.

    Raises
    ------
    TypeError, ValueError
        As `trgs.fdk`.
    """
    return _independent(_fdk, (projections, scanner, np.asarray(angles), window, turn), scanner.grid, slabs, client, out)


def voxelize(
    model: _core.Model,
    grid: _core.Grid | _core.Scanner,
    *,
    cutoff: float = 0.0,
    dtype: Any = np.float64,
    slabs: int | None = None,
    client: Any = None,
    out: str | os.PathLike[str] | None = None,
) -> NDArray[Any]:
    """`trgs.voxelize` by slabs.

    Parameters
    ----------
    model, grid, cutoff, dtype
        As of `trgs.voxelize`.
    slabs, client, out
        As of `fdk`.

    Returns
    -------
    ndarray [x, y, z]
        Of `dtype`; with `out`, memory-mapped from the file.

    Raises
    ------
    TypeError, ValueError
        As `trgs.voxelize`.
    """
    of = grid.grid if isinstance(grid, _core.Scanner) else grid
    # As bytes: arrays of a model that came from another process would lie at any address.
    return _independent(_voxelized, (pickle.dumps(model), of, cutoff, np.dtype(dtype).name), of, slabs, client, out, dtype)


def sart(
    projections: NDArray[np.float32],
    scanner: _core.Scanner,
    angles: _Views,
    *,
    iterations: int = 20,
    relaxation: float = 1.0,
    reduction: float = 0.999,
    order: str = "input",
    non_negative: bool = True,
    tolerance: float = 0.0,
    seed: int = 0,
    callback: Callable[[Progress], object] | None = None,
    slabs: int | None = None,
    client: Any = None,
    out: str | os.PathLike[str] | None = None,
) -> _Volume:
    """`trgs.sart` by slabs, in float32 with Joseph's rays.

    The rays of a view go through the slabs one after another, so more workers bring memory; the corrections alone are faster.

    Parameters
    ----------
    projections, scanner, angles, iterations, relaxation, reduction, order, non_negative, tolerance, seed, callback
        As of `trgs.sart`.
    slabs, client, out
        As of `fdk`.

    Returns
    -------
    ndarray [x, y, z], float32
        With `out`, memory-mapped from the file.

    Raises
    ------
    TypeError, ValueError, ArithmeticError
        As `trgs.sart`.
    """
    return os_sart(
        projections, scanner, angles, subset=1, iterations=iterations, relaxation=relaxation, reduction=reduction, order=order,
        non_negative=non_negative, tolerance=tolerance, seed=seed, callback=callback, slabs=slabs, client=client, out=out,
    )


def os_sart(
    projections: NDArray[np.float32],
    scanner: _core.Scanner,
    angles: _Views,
    *,
    subset: int = 10,
    iterations: int = 20,
    relaxation: float = 1.0,
    reduction: float = 0.999,
    order: str = "input",
    non_negative: bool = True,
    tolerance: float = 0.0,
    seed: int = 0,
    callback: Callable[[Progress], object] | None = None,
    slabs: int | None = None,
    client: Any = None,
    out: str | os.PathLike[str] | None = None,
) -> _Volume:
    """`trgs.os_sart` by slabs, in float32 with Joseph's rays.

    Parameters
    ----------
    projections, scanner, angles, subset, iterations, relaxation, reduction, order, non_negative, tolerance, seed, callback
        As of `trgs.os_sart`.
    slabs, client, out
        As of `fdk`.

    Returns
    -------
    ndarray [x, y, z], float32
        With `out`, memory-mapped from the file.

    Raises
    ------
    TypeError, ValueError, ArithmeticError
        As `trgs.os_sart`.
    """
    settings = {
        "iterations": iterations, "seed": seed, "algebraic.subset": subset, "algebraic.relaxation": relaxation,
        "algebraic.reduction": reduction, "algebraic.order": order, "algebraic.non_negative": str(non_negative).lower(),
        "algebraic.tolerance": tolerance,
    }  # fmt: skip
    return _iterated("os-sart", settings, projections, scanner, angles, callback, slabs, client, out)


def tv(
    projections: NDArray[np.float32],
    scanner: _core.Scanner,
    angles: _Views,
    *,
    weight: float | None = 1e-3,
    iterations: int = 40,
    tolerance: float = 1e-4,
    steps: int = 10,
    callback: Callable[[Progress], object] | None = None,
    slabs: int | None = None,
    client: Any = None,
    out: str | os.PathLike[str] | None = None,
) -> _Volume:
    """`trgs.tv` by slabs, in float32 with Joseph's rays.

    Parameters
    ----------
    projections, scanner, angles, iterations, tolerance, steps, callback
        As of `trgs.tv`.
    weight : float or None
        As of `trgs.tv`; None: chosen by views held out, as `trgs.reconstruct(scan, "tv")` does.
    slabs, client, out
        As of `fdk`.

    Returns
    -------
    ndarray [x, y, z], float32
        With `out`, memory-mapped from the file.

    Raises
    ------
    TypeError, ValueError, ArithmeticError
        As `trgs.tv`.
    """
    chosen = "auto" if weight is None else weight
    settings = {"iterations": iterations, "tv.weight": chosen, "tv.tolerance": tolerance, "tv.steps": steps}
    return _iterated("tv", settings, projections, scanner, angles, callback, slabs, client, out)


def _iterated(
    method: str, settings: dict[str, Any], projections: Any, scanner: Any, angles: Any, callback: Any, slabs: Any, client: Any, out: Any
) -> Any:
    with _connected(client) as found, tempfile.TemporaryDirectory(prefix="trgs-slabs-") as folder:
        space = _Space(found, scanner, np.asarray(angles), _parts(scanner.grid.shape[0], slabs, found), Path(folder))
        assignments = [f"{key}={value}" for key, value in settings.items()]
        _core.iterate_in(projections, scanner, angles, space, method, assignments, callback)
        return _gathered(space.slabs["volume"], scanner.grid.shape, np.float32, out)


# Functions of workers. A part is made from its arguments once in a process.

_made: list[tuple[Any, Any, _Slices, _core.Part]] = []


def _part(scanner: Any, angles: Any, slices: _Slices) -> _core.Part:
    for of, at, where, part in _made:
        if of is scanner and at is angles and where == slices:
            return part
    _made[:] = [*_made[-7:], (scanner, angles, slices, _core.Part(scanner, _own(angles), *slices))]
    return _made[-1][-1]


def _same(value: Any) -> Any:
    return value


def _own(array: Any) -> Any:
    """What came from another process may lie at any address."""
    return np.require(array, None, ("C", "A"))


def _fdk(projections: Any, scanner: Any, angles: Any, window: str, turn: str, slices: _Slices) -> Any:
    return _core.fdk_part(_own(projections), scanner, _own(angles), window, turn, slices)


def _filled(shape: tuple[int, ...], value: float) -> Any:
    return np.full(shape, value, np.float32)


def _scaled(slab: _Volume, factor: float) -> Any:
    return slab * np.float32(factor)


def _extrapolated(x: _Volume, before: _Volume, beta: float) -> Any:
    return x + np.float32(beta) * (x - before)


def _cut(slab: NDArray[np.float32], first: int, last: int) -> Any:
    return slab[..., first:last, :, :].copy()


def _joined(pieces: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.concatenate(pieces, axis=-3))


def _projected(scanner: Any, angles: Any, slices: _Slices, views: list[int], slab: list[Any] | None, rising: bool, sums: Any) -> Any:
    joined = None if slab is None else _joined(slab)
    sums = np.zeros(len(views) * scanner.detector[0] * scanner.detector[1], np.float32) if sums is None else _own(sums)
    return _part(scanner, angles, slices).project(views, joined, rising, sums)


def _completed(scanner: Any, angles: Any, slices: _Slices, views: list[int], rising: Any, falling: Any) -> Any:
    # A ray belongs to one of both: the other sum is 0.
    return _part(scanner, angles, slices).complete(views, rising + falling)


def _adjoint(scanner: Any, angles: Any, slices: _Slices, views: list[int], images: Any, slab: Any, step: float | None) -> Any:
    return _part(scanner, angles, slices).adjoin(views, _own(images), _own(slab), step)


def _corrected(
    scanner: Any, angles: Any, slices: _Slices, views: list[int], images: Any, slab: Any, relaxation: float, non_negative: bool
) -> Any:
    return _part(scanner, angles, slices).correct(views, *map(_own, images), _own(slab), relaxation, non_negative)


def _measured(scanner: Any, angles: Any, slices: _Slices, what: str, beta: float, volumes: list[list[Any]]) -> Any:
    return _part(scanner, angles, slices).measure(what, beta, [_joined(volume) for volume in volumes])


def _solved(scanner: Any, angles: Any, slices: _Slices, y: list[Any], dual: list[Any], tau: float, steps: int) -> Any:
    x, dual = _part(scanner, angles, slices).solve(_joined(y), tuple(_joined(dual)), tau, steps)
    return x, np.stack(dual)


def _item(values: tuple[Any, ...], number: int) -> Any:
    return values[number]


def _saved(values: Any, path: str) -> str:
    np.save(path + ".partial.npy", values)
    os.replace(path + ".partial.npy", path)
    return path


def _loaded(path: str) -> Any:
    return np.load(path)


def _voxelized(model: bytes, grid: Any, cutoff: float, dtype: str, slices: _Slices) -> Any:
    return _core.voxelize_part(pickle.loads(model), grid, cutoff, np.dtype(dtype), slices)


class _Space:
    """The volumes of a method as futures of slabs: what `_core.iterate_in` calls.

    Tasks are never equal to others (`pure=False`), since arrays would be compared by their content.
    """

    def __init__(self, client: Any, scanner: Any, angles: Any, parts: list[_Slices], folder: Path) -> None:
        self.client, self.parts, self.folder = client, parts, folder
        self.scanner, self.angles = self._put(scanner), self._put(angles)
        self.slice = scanner.grid.shape[1:]
        self.slabs: dict[str, list[Any]] = {}
        for name in ("volume", "before", "next"):
            self.change("fill", name, 0.0)
        self.change("forget", "dual", 0.0)
        self.reads = [_core.Part(scanner, angles, *part).reads for part in parts]
        self.corrections, self.files = 0, 0
        # Views in groups: while one is in the second slab, the next is in the first.
        self.groups = 2 * len(parts)

    def _submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return self.client.submit(function, *arguments, pure=False)

    def _on(self, function: Callable[..., Any], part: _Slices, *arguments: Any) -> Any:
        return self._submit(function, self.scanner, self.angles, part, *arguments)

    def _put(self, value: Any) -> Any:
        """A value for tasks that can be had again when the worker that has it dies, which one of `scatter` cannot."""
        return self._submit(_same, value)

    def _slices(self, name: str, first: int, last: int) -> list[Any]:
        """Some slices of a volume, of all slabs that have any."""
        found = []
        for (start, end), slab in zip(self.parts, self.slabs[name]):
            low, high = max(first, start), min(last, end)
            if low < high:
                whole = (low, high) == (start, end)
                found.append(slab if whole else self._submit(_cut, slab, low - start, high - start))
        return found

    def project(self, views: list[int], name: str | None) -> NDArray[np.float32]:
        slabs = [None if name is None else self._slices(name, *reads(0)) for reads in self.reads]
        size = -(-len(views) // self.groups)
        images = []
        for group in (views[at : at + size] for at in range(0, len(views), size)):
            sums: list[Any] = [None, None]
            both = list(zip(self.parts, slabs))
            for rising, order in ((True, both), (False, both[::-1])):
                for part, slab in order:
                    sums[rising] = self._on(_projected, part, group, slab, rising, sums[rising])
            images.append(self._on(_completed, self.parts[0], group, sums[True], sums[False]))
        return np.concatenate(self.client.gather(images))

    def adjoin(self, views: list[int], images: NDArray[np.float32], name: str, step: float | None) -> None:
        shared, slabs = self._put(images), self.slabs[name]
        self.slabs[name] = [self._on(_adjoint, part, views, shared, slab, step) for part, slab in zip(self.parts, slabs)]

    def correct(self, views: list[int], corrections: Any, weights: Any, relaxation: float, non_negative: bool) -> None:
        shared, slabs = self._put((corrections, weights)), self.slabs["volume"]
        how = (relaxation, non_negative)
        self.slabs["volume"] = [self._on(_corrected, part, views, shared, slab, *how) for part, slab in zip(self.parts, slabs)]
        self._count()

    def change(self, what: str, name: str, value: float) -> None:
        if what == "keep":
            self.slabs[name] = list(self.slabs["volume"])
        elif what == "scale":
            self.slabs[name] = [self._submit(_scaled, slab, value) for slab in self.slabs[name]]
        elif what == "extrapolate":
            pairs = zip(self.slabs["volume"], self.slabs["before"])
            self.slabs[name] = [self._submit(_extrapolated, x, before, value) for x, before in pairs]
        else:
            arrays = (3,) if what == "forget" else ()
            shapes = [(*arrays, last - first, *self.slice) for first, last in self.parts]
            self.slabs[name] = [self._submit(_filled, shape, value) for shape in shapes]

    def measure(self, what: str, beta: float, names: list[str]) -> list[Any]:
        parts = zip(self.parts, self.reads)
        terms = [self._on(_measured, part, what, beta, [self._slices(name, *reads(0)) for name in names]) for part, reads in parts]
        return [term for slab in self.client.gather(terms) for term in slab]

    def solve(self, tau: float, steps: int) -> None:
        read = [(self._slices("next", *reads(steps)), self._slices("dual", *reads(steps))) for reads in self.reads]
        both = [self._on(_solved, part, y, dual, tau, steps) for part, (y, dual) in zip(self.parts, read)]
        self.slabs["next"] = [self._submit(_item, found, 0) for found in both]
        self.slabs["dual"] = [self._submit(_item, found, 1) for found in both]
        self._count()

    def swap(self, a: str, b: str) -> None:
        self.slabs[a], self.slabs[b] = self.slabs[b], self.slabs[a]

    def _count(self) -> None:
        """Now and then, slabs become files: tasks before them are forgotten."""
        self.corrections += 1
        if self.corrections % ANCHOR_EVERY:
            return
        paths = {}
        for name, slabs in self.slabs.items():
            for number, slab in enumerate(slabs):
                self.files += 1
                paths[name, number] = self._submit(_saved, slab, str(self.folder / f"{self.files}.npy"))
        found = self.client.gather(paths)
        old = [path for path in self.folder.glob("*.npy") if str(path) not in found.values()]
        for (name, number), path in found.items():
            self.slabs[name][number] = self._submit(_loaded, path)
        for path in old:
            path.unlink(missing_ok=True)
