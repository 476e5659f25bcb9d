"""CT reconstruction from few X-ray projections by a sum of Student's t-kernels: the reference implementation of TR-GS.

Everything runs on the CPU, in float32 or float64. The same input gives the same bits on every build and any number of
threads. Lengths are in scene units, in which the longest side of a volume is 2; images are [view, v, u] with row 0 at the top
(+z), volumes [x, y, z]. Arrays must be C-contiguous and of the stated type: nothing is converted or copied silently. An array
that a call reads must not be changed by another thread until the call returns.

>>> import trgs
>>> scan = trgs.simulate("torso", trgs.Scanner.synthetic(16, 24), views=6, test_views=2)
>>> result = trgs.reconstruct(scan, method="fdk")
>>> metrics = scan.evaluate(result.volume)

The submodules: `losses`, `metrics`, `optim` (single steps of optimisers), `density` (density control), `networks` (training steps of NAF, SAX-NeRF and IntraTomo), `conformance` (test
vectors for other implementations), `distributed` (volumes in slabs on workers of Dask), and for gradients in other frameworks `torch` and `jax`; the last three are imported when asked for.
"""

from . import _select

_select.select()

from ._core import (
    Grid,
    Model,
    Page,
    Reconstruction,
    Scan,
    Scanner,
    asd_pocs,
    back_project,
    build,
    cgls,
    confidence,
    fdk,
    fdk_backproject,
    fdk_filter,
    footprint_gradient,
    forward_project,
    haar,
    haar_inverse,
    integral_factor,
    kernel,
    load_scan,
    load_volume,
    motion_vjp,
    nu_target,
    os_sart,
    phantoms,
    project,
    project_vjp,
    reconstruct,
    sart,
    save_page,
    save_volume,
    set_max_memory,
    set_threads,
    show,
    simulate,
    support,
    threads,
    truncation_bound,
    tv,
    voxelize,
    voxelize_vjp,
    wavelet_loss,
    wavelet_routing,
)
from ._geometries import Geometry, from_astra, from_tigre
from ._types import Metric, Parameters, Population, Progress, WaveletLoss

__version__ = dict(build())["version"]

__all__ = [
    "Geometry",
    "Grid",
    "Metric",
    "Model",
    "Page",
    "Parameters",
    "Population",
    "Progress",
    "Reconstruction",
    "Scan",
    "Scanner",
    "WaveletLoss",
    "asd_pocs",
    "back_project",
    "build",
    "cgls",
    "confidence",
    "fdk",
    "fdk_backproject",
    "fdk_filter",
    "footprint_gradient",
    "forward_project",
    "from_astra",
    "from_tigre",
    "haar",
    "haar_inverse",
    "integral_factor",
    "kernel",
    "load_scan",
    "load_volume",
    "motion_vjp",
    "nu_target",
    "os_sart",
    "phantoms",
    "project",
    "project_vjp",
    "reconstruct",
    "sart",
    "save_page",
    "save_volume",
    "set_max_memory",
    "set_threads",
    "show",
    "simulate",
    "support",
    "threads",
    "truncation_bound",
    "tv",
    "voxelize",
    "voxelize_vjp",
    "wavelet_loss",
    "wavelet_routing",
]

_SUBMODULES = ("conformance", "density", "losses", "metrics", "networks", "optim")
_FRAMEWORKS = ("jax", "torch")


def __getattr__(name: str) -> object:
    if name in _SUBMODULES + _FRAMEWORKS:
        import importlib

        try:
            return importlib.import_module(f"{__name__}.{name}")
        except ModuleNotFoundError as error:
            # help() and inspect expect of a missing attribute no other exception.
            if error.name != name:
                raise
            raise AttributeError(f"trgs.{name}: got no module {name!r}; install it: pip install {name}") from error
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    from importlib.util import find_spec

    return [*__all__, *_SUBMODULES, *(name for name in _FRAMEWORKS if find_spec(name))]
