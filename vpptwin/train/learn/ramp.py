"""Values that change in the course of training."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Ramp:
    """A value that is constant, then changes linearly, then is constant again, over the course of training."""

    start: float  # first value
    end: float  # last value
    begin: float = 0.1  # share of training at which the change starts
    finish: float = 0.7  # share of training at which it is over

    def at(self, progress: float) -> float:
        """Value at a share of training between 0 and 1."""
        span = max(self.finish - self.begin, 1e-9)
        part = min(max((progress - self.begin) / span, 0.0), 1.0)
        return self.start + part * (self.end - self.start)
