"""Sizes that a hidden parameter may take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def round_size(value: float) -> float:
    """To five digits, so that a printed failure can be flown again."""
    return float(f"{value:.5g}")


@dataclass(frozen=True)
class Size:
    """Sizes that a hidden parameter may take."""

    unit: str  # SI unit of the parameter
    off: float  # Value at which the effect does nothing (NaN: the vehicle's nominal value)
    spans: tuple[tuple[float, float], ...]  # Intervals to draw from, negative ones included, each equally likely
    idle: float | None = None  # Value from which on it does nothing in flight, where that is not `off`

    @property
    def nothing(self) -> float:
        """The value from which strength counts."""
        return self.off if self.idle is None else self.idle

    def draw(self, rng: np.random.Generator, least: float = 0.0) -> float:
        """Draw one size.

        Args:
            rng: Source of randomness.
            least: Share of the span, from its faint end on, that is left out.
        """
        near, far = self._from_faint_end(self.spans[rng.integers(len(self.spans))])
        return round_size(near + rng.uniform(least, 1.0) * (far - near))

    def draw_faint(self, rng: np.random.Generator, least: float) -> float:
        """Draw a size of strength `least` to 1: below all that `draw` gives."""
        near, _ = self._from_faint_end(self.spans[rng.integers(len(self.spans))])
        return round_size(self.nothing + rng.uniform(least, 1.0) * (near - self.nothing))

    def draw_of_strength(self, rng: np.random.Generator, strength: float) -> float:
        """The size of that strength, on a side that is drawn."""
        near, _ = self._from_faint_end(self.spans[rng.integers(len(self.spans))])
        return round_size(self.nothing + strength * (near - self.nothing))

    def _from_faint_end(self, span: tuple[float, float]) -> tuple[float, float]:
        """The ends of a span, the one closer to nothing first."""
        near, far = sorted(span, key=lambda end: abs(end - self.nothing))
        return near, far

    def measure_strength(self, value: float) -> float:
        """Distance from nothing over that of the faint end of the value's span: 1 is the least that `draw` gives."""
        edges = [self._from_faint_end(span)[0] for span in self.spans]
        edge = next((e for e in edges if (e - self.nothing) * (value - self.nothing) > 0.0), edges[0])
        return abs(value - self.nothing) / abs(edge - self.nothing)


def either_sign(low: float, high: float) -> tuple[tuple[float, float], ...]:
    """Spans from `low` to `high`, and their mirror."""
    return ((-high, -low), (low, high))
