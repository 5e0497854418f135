"""What is known only when the text of a kernel runs, and arrays of it: the values of `specialize`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import FunctionType
from typing import Any

import numpy as np

REAL, WHOLE, TRUTH = "Real", "wp.int32", "wp.bool"
ZERO = {REAL: "Real(0.0)", WHOLE: "wp.int32(0)", TRUTH: "bool(False)"}
Value = Any
"""A Python value, or a `Term`, or a tuple with such in it."""


@dataclass(frozen=True, eq=False)
class Term:
    """A number that is known only when the text runs."""

    text: str  # its name, or where it is in memory
    kind: str = REAL  # `REAL`, `WHOLE` or `TRUTH`
    lasting: bool = False  # it is in memory that nothing writes to, and read where it is wanted


@dataclass(frozen=True, eq=False)
class Cells:
    """An array of numbers that come apart into variables; a part of it shares them, as numpy's views do."""

    store: list[Value]
    index: np.ndarray

    @classmethod
    def of(cls, values: Any) -> Cells:  # noqa: ANN401
        """An array of its own with these values, an array of objects or of numbers."""
        array = np.asarray(values, dtype=object)
        return cls(array.ravel().tolist(), np.arange(array.size).reshape(array.shape))

    @property
    def shape(self) -> tuple[int, ...]:
        """Its shape."""
        return self.index.shape

    def reshape(self, *shape: int) -> Cells:
        """The same numbers in another shape."""
        return Cells(self.store, self.index.reshape(*shape))


@dataclass(frozen=True, eq=False)
class Ring:
    """An array in memory that is read and written at places known only when the text runs."""

    place: Callable[[str, int], str]  # text of an element, of its indices
    shape: tuple[int, ...]  # its shape; the number of rows counts only where something asks for it
    fixed: tuple[int | None, ...] = (None, None)  # indices that are known, None for the others


class Record:
    """Numbers and arrays by name, written in place."""

    def __init__(self, **fields: Any) -> None:  # noqa: ANN401
        self.fields = fields


class Unwritable(Exception):  # noqa: N818
    """What cannot be written for Warp: why, and where in which function."""

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.stack: list[tuple[FunctionType | None, int]] = []


class Scope(dict[str, Value]):
    """Names of a function that runs."""

    def __init__(self, function: FunctionType | None, names: dict[str, Value], serial: int) -> None:
        super().__init__(names)
        self.function, self.serial = function, serial


@dataclass(frozen=True)
class Repeat:
    """Numbers from 0 that a loop of the text counts through, up to a number or a name, instead of one that unrolls."""

    times: int | str


def common_kind(one: Value, two: Value) -> str:
    """The kind of number that both fit into."""
    kinds = set()
    for value in (one, two):
        if isinstance(value, Term):
            kinds.add(value.kind)
        elif isinstance(value, (bool, np.bool_)):
            kinds.add(TRUTH)
        elif isinstance(value, (int, np.integer)):
            kinds.add(WHOLE)
        elif isinstance(value, (float, np.floating)):
            kinds.add(REAL)
        else:
            raise Unwritable("is a number in one case, and something else in the other")
    return REAL if REAL in kinds else WHOLE if WHOLE in kinds else TRUTH


def same(one: Value, two: Value) -> bool:
    """Whether two values are one."""
    if isinstance(one, Term) or isinstance(two, Term):
        return one is two
    numbers = (int, float, bool, np.number)
    if isinstance(one, numbers) and isinstance(two, numbers):
        return bool(one == two) and type(one) is type(two)
    return one is two
