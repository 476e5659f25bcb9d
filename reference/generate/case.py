"""The definition of a case: given files, and tables whose numbers can be computed one by one."""

import itertools
from dataclasses import dataclass, field

import numpy as np

from files import to_float

LEVELS = ["core", "optional", "stress"]


@dataclass(frozen=True)
class Given:
    """A file of inputs: an array, a dictionary of arrays (npz) or a description (json)."""

    path: str
    content: object


@dataclass(frozen=True)
class Table:
    """A file of results. `function(index)` gives one of its numbers, as an mpmath number or a float.

    `shape` is a tuple and an index a tuple; or, for an npz, a dictionary of shapes and (name, tuple).
    """

    file: str
    shape: object
    function: object

    def indices(self):
        if isinstance(self.shape, dict):
            return [(name, i) for name, shape in self.shape.items() for i in np.ndindex(*shape)]
        return list(itertools.product(*map(range, self.shape)))

    def value(self, index):
        return to_float(self.function(index))

    def get(self, stored, index):
        return float(stored[index[0]][index[1]] if isinstance(self.shape, dict) else stored[index])

    def compute(self):
        if isinstance(self.shape, dict):
            arrays = {name: np.zeros(shape) for name, shape in self.shape.items()}
            for name, i in self.indices():
                arrays[name][i] = self.value((name, i))
            return arrays
        array = np.zeros(self.shape)
        for index in self.indices():
            array[index] = self.value(index)
        return array


@dataclass(frozen=True)
class Case:
    stage: str
    name: str
    title: str
    equations: list
    inputs: dict                                   # name -> Given
    outputs: dict                                  # name -> Table
    level: str = "core"
    flags: list = field(default_factory=list)
    settings: dict = field(default_factory=dict)
    allowances: dict = field(default_factory=dict)     # name of an output -> Table

    @property
    def id(self):
        return f"{self.stage}/{self.name}"

    def tables(self):
        """(group of the manifest, name, table) of all computed files."""
        return [("outputs", name, table) for name, table in self.outputs.items()] + \
               [("allowances", name, table) for name, table in self.allowances.items()]

    def describe(self):
        """The manifest's row without its files."""
        return {"id": self.id, "stage": self.stage, "title": self.title, "equations": self.equations,
                "level": self.level, "flags": self.flags, "settings": self.settings}


def lowered(title):
    """A title as the second part of another one: in lower case, but for a name."""
    return title if title.startswith("Gaussian") else title[0].lower() + title[1:]


def higher(*levels):
    """The least demanding of several levels: the stage's and its scene's."""
    return max(levels, key=LEVELS.index)
