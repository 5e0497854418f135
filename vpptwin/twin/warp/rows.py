"""A table of numbers for Warp: arrays of many simulations, a row of the table for each number of one simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vpptwin.engine.trace.terms import REAL, Cells, Term


@dataclass(frozen=True)
class TableLayout:
    """Which rows of a table each array of numbers takes.

    Attributes:
        shapes: of the arrays of one simulation, by name.
    """

    shapes: Mapping[str, tuple[int, ...]]

    @cached_property
    def starts(self) -> dict[str, int]:
        """The first row of each."""
        firsts, total = {}, 0
        for name, shape in self.shapes.items():
            firsts[name] = total
            total += math.prod(shape)
        return firsts

    @property
    def count(self) -> int:
        """TableLayout of the table."""
        return sum(map(math.prod, self.shapes.values()))

    def __getitem__(self, name: str) -> slice:
        """The rows of an array."""
        first = self.starts[name]
        return slice(first, first + math.prod(self.shapes[name]))

    def pack(self, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
        """The table, (rows, N), of arrays (N, ...)."""
        parts = [np.asarray(arrays[name], float).reshape(len(arrays[name]), -1).T for name in self.shapes]
        return np.ascontiguousarray(np.concatenate(parts))

    def unpack(self, table: np.ndarray) -> dict[str, np.ndarray]:
        """The arrays, (N, ...), of a table."""
        count = table.shape[1]
        return {name: table[self[name]].T.reshape(count, *shape).copy() for name, shape in self.shapes.items()}

    def terms(self, name: str, table: str) -> Cells:
        """The numbers of an array as they lie in a column."""
        first, shape = self.starts[name], self.shapes[name]
        cells = np.empty(math.prod(shape), dtype=object)
        cells[:] = [Term(f"{table}[{first + k}, i]", REAL, lasting=True) for k in range(cells.size)]
        return Cells.of(cells.reshape(shape))
