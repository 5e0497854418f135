"""A number that knows what float32 may make of it: running error analysis (Higham, Accuracy and Stability, 3.3)."""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.numbers import Number

EPS, SMALLEST = float(np.finfo(np.float32).eps), float(np.finfo(np.float32).tiny)


class Tracked:
    """A value and a bound on its error; every operation hands on errors of its operands and rounds once."""

    def __init__(self, value: float, error: float = 0.0, rounds: float = 0.0) -> None:
        self.value, self.error = float(value), float(error) + rounds * EPS * abs(float(value))

    def __add__(self, other: Number) -> Tracked:
        b = track(other)
        return Tracked(self.value + b.value, self.error + b.error, 1)

    def __mul__(self, other: Number) -> Tracked:
        b = track(other)
        handed_on = abs(self.value) * b.error + abs(b.value) * self.error + self.error * b.error
        return Tracked(self.value * b.value, handed_on, 1)

    def __truediv__(self, other: Number) -> Tracked:
        b = track(other)
        quotient = self.value / b.value
        return Tracked(quotient, (self.error + abs(quotient) * b.error) / max(abs(b.value) - b.error, SMALLEST), 1)

    def __neg__(self) -> Tracked:
        return Tracked(-self.value, self.error)

    def __abs__(self) -> Tracked:
        return Tracked(abs(self.value), self.error)

    def __sub__(self, other: Number) -> Tracked:
        return self + -track(other)

    def __rsub__(self, other: Number) -> Tracked:
        return track(other) + -self

    def __rtruediv__(self, other: Number) -> Tracked:
        return track(other) / self

    def __eq__(self, other: object) -> bool:
        return self.value == track(other).value

    __hash__ = None  # type: ignore[assignment]

    def __lt__(self, other: Number) -> bool:
        return self.value < track(other).value

    def __gt__(self, other: Number) -> bool:
        return self.value > track(other).value

    def __le__(self, other: Number) -> bool:
        return self.value <= track(other).value

    def __ge__(self, other: Number) -> bool:
        return self.value >= track(other).value

    __radd__, __rmul__ = __add__, __mul__

    def sqrt(self) -> Tracked:
        """Steepest at the lower end."""
        low = np.sqrt(max(self.value - self.error, 0.0))
        return Tracked(np.sqrt(self.value), np.sqrt(self.value) - low, 1)

    def exp(self) -> Tracked:
        """Steepest at the upper end; the library's is within two units of the last place."""
        return Tracked(np.exp(self.value), np.exp(self.value) * np.expm1(min(self.error, 50.0)), 2)

    def expm1(self) -> Tracked:
        """Likewise; Kahan's way takes four operations more."""
        return Tracked(np.expm1(self.value), np.exp(self.value) * np.expm1(min(self.error, 50.0)), 6)


def track(number: Number) -> Tracked:
    """The number, rounded to float32 unless it is tracked already."""
    return number if isinstance(number, Tracked) else Tracked(float(number), 0.0, 1)


def pick_tracked(given: Number, k: int) -> Number:
    """Number k of what an effect is called with, a tuple of them or one, all of which float32 holds."""
    if isinstance(given, tuple):
        make: Number = type(given)
        return make(*(Tracked(v[k]) for v in given))
    return Tracked(given[k])
