"""A number that knows what float32 may make of it: running error analysis (Higham, Accuracy and Stability, 3.3).

The text of a Warp kernel runs on such numbers as it is, with `Tracked` for `Real` and `wp` from here.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from vpptwin.actuators.numbers import Number

EPS, SMALLEST = float(np.finfo(np.float32).eps), float(np.finfo(np.float32).tiny)


class Undecided(Exception):  # noqa: N818
    """A branch that float32 may take otherwise."""


class Truth:
    """A condition, and whether float32 is sure of it."""

    def __init__(self, value: bool, sure: bool = True) -> None:
        self.value, self.sure = bool(value), bool(sure)

    def __bool__(self) -> bool:
        if not self.sure:
            raise Undecided
        return self.value


class Tracked:
    """A value and a bound on its error; every operation hands on errors of its operands and rounds once."""

    def __init__(self, value: Any, error: float = 0.0, rounds: float = 0.5) -> None:  # noqa: ANN401
        if isinstance(value, Tracked):
            value, error, rounds = value.value, value.error, 0.0
        self.value = float(value)
        rounded = 0.0 if float(np.float32(self.value)) == self.value and not error else rounds * EPS * abs(self.value)
        self.error = float(error) + rounded + (SMALLEST if rounded else 0.0)

    def __add__(self, other: Number) -> Tracked:
        b = track(other)
        return Tracked(self.value + b.value, self.error + b.error)

    def __mul__(self, other: Number) -> Tracked:
        b = track(other)
        handed_on = abs(self.value) * b.error + abs(b.value) * self.error + self.error * b.error
        return Tracked(self.value * b.value, handed_on)

    def __truediv__(self, other: Number) -> Tracked:
        b = track(other)
        if not b.value:
            return Tracked(np.nan, np.inf)
        quotient = self.value / b.value
        return Tracked(quotient, (self.error + abs(quotient) * b.error) / max(abs(b.value) - b.error, SMALLEST))

    def __neg__(self) -> Tracked:
        return Tracked(-self.value, self.error, 0.0)

    def __sub__(self, other: Number) -> Tracked:
        return self + -track(other)

    def __lt__(self, other: Number) -> Truth:
        b = track(other)
        return Truth(self.value < b.value, abs(self.value - b.value) >= self.error + b.error)

    def __ge__(self, other: Number) -> Truth:
        less = self < other
        return Truth(not less.value, less.sure)

    def __gt__(self, other: Number) -> Truth:
        return track(other) < self

    def __le__(self, other: Number) -> Truth:
        return track(other) >= self

    def __eq__(self, other: object) -> Truth:  # type: ignore[override]
        b = track(other)
        apart = abs(self.value - b.value)
        return Truth(self.value == b.value, apart > self.error + b.error or self.error + b.error == 0.0)

    def __ne__(self, other: object) -> Truth:  # type: ignore[override]
        equal = self == other
        return Truth(not equal.value, equal.sure)

    __hash__ = None  # type: ignore[assignment]


def track(number: Any) -> Tracked:  # noqa: ANN401
    """The number, rounded to float32 unless it is tracked already."""
    return number if isinstance(number, Tracked) else Tracked(number)


def pick(smaller: bool) -> Callable[[Tracked, Tracked], Tracked]:
    """The smaller or the larger of two; where float32 may pick the other one, as wrong as either."""

    def picked(a: Tracked, b: Tracked) -> Tracked:
        first = (a.value < b.value) == smaller
        apart = abs(a.value - b.value) > a.error + b.error
        one = a if first else b
        return Tracked(one.value, one.error if apart else max(a.error, b.error), 0.0)

    return picked


def where(test: Any, a: Tracked, b: Tracked) -> Any:  # noqa: ANN401
    """One or the other; where float32 may take the other one, as wrong as that."""
    test = test if isinstance(test, Truth) else Truth(test)
    if not isinstance(a, Tracked) or not isinstance(b, Tracked):
        return a if bool(test) else b
    one = a if test.value else b
    return one if test.sure else Tracked(one.value, max(a.error, b.error) + abs(a.value - b.value), 0.0)


def curve(function: Callable[[float], float], steepest: Callable[[float, float], float], ulps: float) -> Any:  # noqa: ANN401
    """A function of one number, of which `steepest(value, error)` bounds the slope and float32's is so exact."""

    def of(x: Tracked) -> Tracked:
        with np.errstate(all="ignore"):
            value = float(function(x.value))
        return Tracked(value, steepest(x.value, x.error) * x.error if x.error else 0.0, ulps)

    return of


def cut(x: Any) -> int:  # noqa: ANN401
    """The whole part of a number."""
    if isinstance(x, Tracked):
        if int(x.value - x.error) != int(x.value + x.error):
            raise Undecided
        return int(x.value)
    return int(x)


def sign(x: Tracked) -> Tracked:
    """-1, 0 or 1; where float32 may see the other, as wrong as that."""
    sure = abs(x.value) > x.error or not x.error
    return Tracked(float(np.sign(x.value)), 0.0 if sure else 2.0, 0.0)


grow = curve(np.expm1, lambda x, e: float(np.exp(min(x + e, 80.0))), 6.0)
"""expm1, Kahan's way: four operations more."""
warp = SimpleNamespace(
    int32=cut, where=where, min=pick(True), max=pick(False), inf=np.inf,
    abs=curve(abs, lambda x, e: 1.0, 0.0), sin=curve(np.sin, lambda x, e: 1.0, 2.0),
    cos=curve(np.cos, lambda x, e: 1.0, 2.0), tanh=curve(np.tanh, lambda x, e: 1.0, 2.0),
    exp=curve(np.exp, lambda x, e: float(np.exp(min(x + e, 80.0))), 2.0),
    sqrt=curve(np.sqrt, lambda x, e: 1.0 / np.sqrt(max(x, e / 4.0, SMALLEST)), 1.0),
)  # fmt: skip
"""Warp's functions, those that the pipeline uses; with bounds that CUDA's and the C library's keep."""
