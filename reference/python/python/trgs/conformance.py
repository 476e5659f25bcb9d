"""Conformance vectors for other implementations: questions with inputs, and a judge of the answers.

A backend's test with pytest, in which `image` is the backend's own function::

    import trgs.conformance

    @trgs.conformance.cases(stage="image-exact", level="core")
    def test_image(case):
        case.check(image=image(case.inputs["model"], case.inputs["scanner"], case.settings["angles"]), precision="f32")

`export` writes the page that defines every stage beside the vectors. `cases(stage=…, fresh=200, seed=1)` asks generated questions
instead of those of the vectors, `cases(stage=…, waivers="waivers.toml")` accepts failures until a day, and `hunt` shrinks the
questions that a function fails.
"""

from __future__ import annotations

import atexit
import json
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ._core import (
    Scanner,
    conformance_cases,
    conformance_check,
    conformance_export,
    conformance_hunt,
    conformance_input,
    conformance_make,
    conformance_open,
    conformance_truth,
    conformance_waivers,
)

Level = Literal["core", "optional", "stress", "large"]
Precision = Literal["f64", "f32", "f16", "bf16", "tf32", "f16+f32"]
Ask = Literal["values", "relations", "refusals"]
Answer = ArrayLike | Mapping[str, ArrayLike] | Sequence[ArrayLike]

# A wheel with several extension modules carries the vectors as files. Otherwise they are part of the module.
_FOLDER = Path(__file__).with_name("vectors")
if _FOLDER.is_dir():
    conformance_open(_FOLDER)

_GROUPS = ("mean", "scale", "quaternion", "density", "nu")

__all__ = ["Case", "Failure", "cases", "export", "find", "hunt"]


class Failure(AssertionError):
    """An answer is beyond a tolerance, missing, not finite, or of another shape. `result` has the numbers."""

    def __init__(self, message: str, result: dict[str, Any]) -> None:
        super().__init__(message)
        self.result = result


@dataclass(frozen=True)
class Case:
    """A question with its inputs."""

    id: str
    """`stage/name`."""
    stage: str
    """The part of the method in question."""
    title: str
    """A description in one sentence."""
    level: Level
    settings: dict[str, Any]
    """Numbers and words that are not arrays; angles are in radians."""
    input_names: tuple[str, ...] = field(repr=False)
    output_names: tuple[str, ...] = field(repr=False)
    folder: str | None = field(default=None, repr=False)
    """The folder of a generated question."""
    remark: str | None = field(default=None, repr=False)
    """What a failure says in addition: a waiver that ran out."""

    @cached_property
    def inputs(self) -> dict[str, Any]:
        """Role → float64 array, dict of arrays (models), or the scanner: the dict of section 2 of the protocol."""
        return {role: self._input(role) for role in self.input_names}

    def _input(self, role: str) -> Any:
        if self.folder is not None:
            return _load(_file(self.folder, self.id, role))
        value = conformance_input(self.id, role)
        return json.loads(value)["scanner"] if isinstance(value, str) else value

    @property
    def scanner(self) -> Scanner:
        """The scanner as trgs has it."""
        if self.folder is not None:
            return Scanner.parse(_file(self.folder, self.id, "scanner").read_text(encoding="utf-8"))
        return Scanner.parse(conformance_input(self.id, "scanner"))

    @property
    def truth(self) -> dict[str, Any]:
        """Role → what is expected, computed with 50 digits: a float64 array or a dict of arrays. Not of generated questions."""
        if self.folder is not None:
            raise ValueError("truth: got a generated question, expected one of the vectors; call check, which computes it")
        return {role: conformance_truth(self.id, role) for role in self.output_names}

    def check(self, *, precision: Precision = "f32", **answers: Answer) -> dict[str, Any]:
        """Judges answers by the tolerances of the stage.

        Parameters
        ----------
        precision : {"f64", "f32", "f16", "bf16", "tf32", "f16+f32"}
            The arithmetic of the backend: it selects limits.
        **answers
            Role → array of any number type; of a model or gradient a mapping of its arrays, or the five of them in order.

        Returns
        -------
        dict
            Norms of the errors and limits by array.

        Raises
        ------
        Failure
            For an answer beyond a limit, missing, not finite, or of another shape.
        TypeError
            For an unknown role.
        """
        __tracebackhide__ = True  # pytest shows the line of the test
        unknown = sorted(set(answers) - set(self.output_names))
        if unknown:
            raise TypeError(
                f"answer: got {', '.join(unknown)}, expected {', '.join(self.output_names)}; "
                f"give case.check({self.output_names[0]}=…)"
            )
        arrays = {role: self._arrays(answer) for role, answer in answers.items()}
        result: dict[str, Any] = json.loads(conformance_check(self.id, arrays, precision, self.folder))
        if result["status"] not in ("passed", "skipped"):
            raise Failure("\n  ".join(filter(None, [_message(result, precision), self.remark])), result)
        return result

    @staticmethod
    def _arrays(answer: Answer) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
        if isinstance(answer, (tuple, list)) and len(answer) == len(_GROUPS):
            answer = dict(zip(_GROUPS, answer))
        named: Mapping[str, Any] = answer if isinstance(answer, Mapping) else {"": answer}
        return {name: np.ascontiguousarray(array, dtype=np.float64) for name, array in named.items()}


def _entries(folder: str) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = json.loads(Path(folder, "manifest.json").read_text(encoding="utf-8"))["cases"]
    return entries


def _file(folder: str, id: str, role: str) -> Path:
    (entry,) = (entry for entry in _entries(folder) if entry["id"] == id)
    return Path(folder, entry["inputs"][role]["file"])


def _load(path: Path) -> Any:
    if path.suffix == ".json":
        return json.loads(path.read_text(encoding="utf-8"))["scanner"]
    if path.suffix == ".npy":
        return np.load(path)
    with np.load(path) as arrays:
        return dict(arrays)


def _case(entry: dict[str, Any], folder: str | None = None) -> Case:
    names = ("id", "stage", "title", "level", "settings")
    return Case(*(entry[name] for name in names), tuple(entry["inputs"]), tuple(entry["outputs"]), folder)


def _message(result: dict[str, Any], precision: str) -> str:
    wrong = [part for part in result["parts"] if part["status"] != "passed"]
    # pytest's summary has the first line alone.
    named = "; ".join(dict.fromkeys(part["looks_like"] for part in wrong if part.get("looks_like")))
    lines = [f"{result['id']} {result['status']} in {precision}" + (f", looks like: {named}" if named else "")]
    for part in wrong:
        beyond = [f"{excess['norm']} {excess['value']}, limit {excess['limit']}" for excess in part.get("exceeded", [])]
        facts = [*beyond, part.get("message"), part.get("looks_like") and f"looks like: {part['looks_like']}"]
        lines.append(f"  {part['output']}: " + "; ".join(fact for fact in facts if fact))
    return "\n".join(lines)


def _stages(stage: str | Sequence[str] | None) -> list[str]:
    return [] if stage is None else [stage] if isinstance(stage, str) else list(stage)


def find(*, stage: str | Sequence[str] | None = None, level: Level = "core") -> list[Case]:
    """The cases of some stages up to a level.

    Parameters
    ----------
    stage : str or sequence of str, optional
        All stages if absent.
    level : {"core", "optional", "stress", "large"}

    Returns
    -------
    list of Case

    Raises
    ------
    ValueError
        For an unknown stage or level, or when no case is left.
    """
    entries = json.loads(conformance_cases(_stages(stage), level))
    return [_case(entry) for entry in entries]


def _fresh(stage: str | Sequence[str] | None, level: Level, count: int, seed: int) -> list[Case]:
    folder = tempfile.mkdtemp(prefix="trgs-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    conformance_make(folder, _stages(stage), seed, count, level)
    return [_case(entry, folder) for entry in _entries(folder)]


def cases(
    *,
    stage: str | Sequence[str] | None = None,
    level: Level = "core",
    fresh: int = 0,
    seed: int = 0,
    waivers: str | PathLike[str] | None = None,
) -> Callable[..., Any]:
    """Parametrises a test with the argument `case`. Needs pytest.

    With `waivers` the cases of the file may fail until their day: they are marked `xfail(strict=True)`, so that one which passes
    fails as XPASS and its waiver is removed.

    Parameters
    ----------
    stage, level
        As of `find`.
    fresh : int
        Generated questions of each stage, instead of those of the vectors. `stage` must be given.
    seed : int
        Seed of the generated questions.
    waivers : str or os.PathLike, optional
        File of `[[waiver]]` with `case`, `reason` and `expires`, as of `trgs oracle check`.

    Returns
    -------
    callable
        A decorator, `pytest.mark.parametrize`.

    Raises
    ------
    OSError
        For a file of waivers that cannot be read.
    ValueError
        As `find`, for waivers of unknown cases, without reason or day, and for waivers of generated questions.
    """
    import pytest

    if fresh and waivers is not None:
        raise ValueError("waivers: got those of generated questions, expected cases of the vectors; leave out waivers or fresh")
    accepted = {} if waivers is None else json.loads(conformance_waivers(waivers))

    def row(case: Case) -> Any:
        reason, holds = accepted.get(case.id, (None, False))
        if reason is not None and not holds:
            case = replace(case, remark=f"its waiver ran out: {reason}")
        return pytest.param(case, id=case.id, marks=[pytest.mark.xfail(reason=reason, strict=True)] if holds else [])

    found = _fresh(stage, level, fresh, seed) if fresh else find(stage=stage, level=level)
    return pytest.mark.parametrize("case", [row(case) for case in found])


def hunt(
    function: Callable[[Case], Answer | Mapping[str, Answer]],
    *,
    stage: str | Sequence[str],
    out: str | PathLike[str],
    seed: int = 0,
    cases: int = 1000,
    seconds: float | None = None,
    precision: Precision = "f32",
    level: Level = "core",
    ask: Ask = "values",
) -> list[dict[str, Any]]:
    """Asks a function generated questions until it fails, and shrinks each failure.

    Parameters
    ----------
    function : callable
        Gets a `Case`; returns the only output, or a mapping of all outputs by role. An exception of it is a failure, but
        for questions without an answer.
    stage : str or sequence of str
    out : str or os.PathLike
        Folder for the shrunk questions, which `trgs oracle replay` asks again: new, empty, or of the same hunt.
    seed : int
    cases : int
        Questions of each stage.
    seconds : float, optional
        Stops after this time.
    precision, level
        As of `Case.check` and `find`.
    ask : str
        `values`; `relations` between answers, which need no truth; `refusals` of questions without an answer.

    Returns
    -------
    list of dict
        One for each stage that fails: `looks_like`, `error`, `primitives`, `elements`, `case` (the folder below `out`).

    Raises
    ------
    ValueError
        For an unknown stage, or a folder with other content.
    """

    def backend(questions: Any, answers: Any) -> str | None:
        for entry in _entries(questions):
            try:
                found = function(_case(entry, str(questions)))
            except Exception as error:
                return f"{type(error).__name__}: {error}"
            roles = tuple(entry["outputs"])
            if not (isinstance(found, Mapping) and set(found) == set(roles)):
                found = {roles[0]: found}
            for role, answer in found.items():
                path = Path(answers, entry["outputs"][role]["file"])
                path.parent.mkdir(parents=True, exist_ok=True)
                arrays = Case._arrays(answer)
                np.save(path, arrays[""]) if "" in arrays else np.savez(path, **arrays)
        return None

    found = conformance_hunt(backend, out, _stages(stage), seed, cases, seconds, precision, level, ask)
    findings: list[dict[str, Any]] = json.loads(found)["findings"]
    return findings


def export(
    folder: str | PathLike[str],
    *,
    stage: str | Sequence[str] | None = None,
    level: Level = "core",
    blind: bool = False,
) -> int:
    """Writes manifest.json, PROTOCOL.md and inputs to a folder, and the truth to its folder `expected`.

    Parameters
    ----------
    folder : str or os.PathLike
        It appears as a whole or not at all.
    stage, level
        As of `find`.
    blind : bool
        Whether the truth is left out.

    Returns
    -------
    int
        Number of files of inputs and truth.

    Raises
    ------
    OSError
        For a folder that cannot be written.
    ValueError
        As `find`, and for a folder that holds other files.
    """
    return conformance_export(folder, _stages(stage), level, blind)
