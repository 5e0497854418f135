"""A physical parameter: what the fit bounds, the randomization draws and the diagnosis compares with its off value."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

SIGMAS_90 = 1.645
"""Standard deviations that hold 90 % to both sides."""
UNLIMITED = 1e6
"""Off value of a limit on inputs of the order of one: no actuator gets there."""


@dataclass(frozen=True)
class Prior:
    """Where a parameter is expected before any data, in the parameter's unit.

    Attributes:
        kind: `normal` (a = mean, b = standard deviation), `uniform` (a = low, b = high) or
            `halfnormal` (a = start, b = scale; values lie at or above a).
        a: first number of the distribution.
        b: second number of the distribution.
    """

    kind: Literal["normal", "uniform", "halfnormal"]
    a: float
    b: float

    @classmethod
    def within(cls, low: float, high: float) -> Prior:
        """A normal distribution with 90 % of it between `low` and `high`."""
        return cls("normal", 0.5 * (low + high), 0.5 * (high - low) / SIGMAS_90)

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Draw `count` values, (count,)."""
        if self.kind == "uniform":
            return rng.uniform(self.a, self.b, count)
        deviation = self.b * rng.standard_normal(count)
        return self.a + (np.abs(deviation) if self.kind == "halfnormal" else deviation)

    def __str__(self) -> str:
        return f"{self.kind}({self.a:g}, {self.b:g})"


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of an effect, written with keywords only.

    Attributes:
        name: the key in a twin YAML and in verdict.json.
        unit: SI unit in plain text, "" for none.
        off: value at which the effect does nothing: a rollout there is bit-equal to one without the effect.
        low: physical lower bound.
        high: physical upper bound.
        prior: expectation before any data; the randomization draws from it.
        size: step for secants and scale for optimizers: a physically typical size, not a numerical epsilon.
        tolerance: deviation from off that a well-built rig may show unremarked; below it nothing is named.
        nominal: dotted key of the vehicle file that holds the off value, "" when off is a constant.
        source: where these numbers come from: a datasheet, the paper, a file, or an assumption and why; "" untold.
    """

    name: str
    unit: str
    off: float
    low: float
    high: float
    prior: Prior
    size: float
    tolerance: float = 0.0
    nominal: str = ""
    source: str = ""

    def with_off(self, off: float) -> Parameter:
        """The same parameter with a positive off value taken from a vehicle file.

        A prior centred on it moves along, and the bounds widen so that it lies between them.
        """
        shift = off - self.off
        prior = replace(
            self.prior, a=self.prior.a + shift, b=self.prior.b + (shift if self.prior.kind == "uniform" else 0)
        )
        return replace(self, off=off, prior=prior, low=min(self.low, 0.5 * off), high=max(self.high, 2.0 * off))

    def away(self, times: float, start: float | None = None) -> float:
        """A value so many sizes above the off value or a start, or below it without room, within the bounds."""
        start = self.off if start is None else start
        up = start + times * self.size
        return up if up <= self.high else float(self.clip(np.array(start - times * self.size)))

    def clip(self, value: np.ndarray) -> np.ndarray:
        """Move values into the physical bounds."""
        return np.clip(value, self.low, self.high)

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Draw values from the prior inside the bounds, (count,)."""
        return self.clip(self.prior.draw(rng, count))
