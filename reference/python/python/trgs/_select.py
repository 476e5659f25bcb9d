"""The choice of the extension module: a wheel can carry some for newer CPUs besides the one for every CPU.

All are compiled from the same source and give the same bits: `baseline` for every CPU, `v3` for x86-64-v3 (AVX2 and FMA),
`v4` for x86-64-v4 (AVX-512). One of these names as `TRGS_MODULE` in the environment overrides the choice.
"""

import importlib
import importlib.util
import os
import sys
import warnings

_LEVELS = ("baseline", "v3", "v4")
_CHOICES = ("auto", *_LEVELS)


def select() -> None:
    """Makes `trgs._core` the fastest module that this CPU can run."""
    wanted = os.environ.get("TRGS_MODULE", "auto")
    if wanted not in _CHOICES:
        raise ImportError(f"TRGS_MODULE: got {wanted!r}, expected one of {', '.join(_CHOICES)}; unset TRGS_MODULE")
    core = importlib.import_module("trgs._core")
    can = _LEVELS[: _LEVELS.index(core.cpu_level()) + 1]
    there = [level for level in _LEVELS if level == "baseline" or importlib.util.find_spec(f"trgs._{level}")]
    if wanted != "auto" and not (wanted in can and wanted in there):
        missing = "this CPU lacks its instructions" if wanted in there else "this build has no such module"
        raise ImportError(
            f"TRGS_MODULE: got {wanted!r} ({missing}), expected a module that can run; unset TRGS_MODULE"
        )
    level = wanted if wanted != "auto" else [level for level in there if level in can][-1]
    if level != "baseline":
        core = importlib.import_module(f"trgs._{level}._core")
        sys.modules["trgs._core"] = core
        setattr(sys.modules["trgs"], "_core", core)
    if not core.is_fast() and wanted == "auto":
        warnings.warn(_slow("v3" in can), RuntimeWarning, stacklevel=4)


def _slow(can: bool) -> str:
    if can:
        return (
            "trgs was compiled without AVX2 and FMA, which this CPU has: results are the same, but take many times as long. "
            "Build the wheel with .ci/wheel, or install from a checkout: pip install ./reference/python"
        )
    return "this CPU has no AVX2 and FMA: the results of trgs are the same, but take many times as long"
