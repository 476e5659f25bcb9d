"""The choice of the extension module: a wheel can carry one for x86-64-v3 besides the one for every CPU.

Both are compiled from the same source and give the same bits. `TRGS_MODULE=baseline` or `TRGS_MODULE=v3` in the environment
overrides the choice.
"""

import importlib
import importlib.util
import os
import sys
import warnings

_CHOICES = ("auto", "baseline", "v3")


def select() -> None:
    """Makes `trgs._core` the fastest module that this CPU can run."""
    wanted = os.environ.get("TRGS_MODULE", "auto")
    if wanted not in _CHOICES:
        raise ImportError(f"TRGS_MODULE: got {wanted!r}, expected one of {', '.join(_CHOICES)}; unset TRGS_MODULE")
    core = importlib.import_module("trgs._core")
    can = core.has_x86_64_v3()
    there = importlib.util.find_spec("trgs._v3") is not None
    if wanted == "v3" and not (can and there):
        missing = "this CPU lacks its instructions" if there else "this build has no such module"
        raise ImportError(f"TRGS_MODULE: got 'v3' ({missing}), expected a module that can run; unset TRGS_MODULE")
    if there and can and wanted != "baseline":
        core = importlib.import_module("trgs._v3._core")
        sys.modules["trgs._core"] = core
        setattr(sys.modules["trgs"], "_core", core)
    if not core.is_fast() and wanted == "auto":
        warnings.warn(_slow(can), RuntimeWarning, stacklevel=4)


def _slow(can: bool) -> str:
    if can:
        return (
            "trgs was compiled without AVX2 and FMA, which this CPU has: results are the same, but take many times as long. "
            "Build the wheel with .ci/wheel, or install from a checkout: pip install ./reference/python"
        )
    return "this CPU has no AVX2 and FMA: the results of trgs are the same, but take many times as long"
