"""Stand-ins for what a test does not look at."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.search.suspects import Linearisation


class Starts(SimpleNamespace):
    """Windows of which only what is given counts, their starts at least."""

    def __len__(self) -> int:
        return len(self.start)


def lay_starts(start: list[float], flight: list[int] | None = None) -> Bench:
    """A bench of which only the windows' times count."""
    flights = np.zeros(len(start), dtype=int) if flight is None else np.array(flight)
    return SimpleNamespace(windows=Starts(start=np.array(start), flight=flights))  # type: ignore[return-value]


def linear(at: np.ndarray, columns: np.ndarray, residual: np.ndarray, tried: np.ndarray | None = None) -> Linearisation:
    """A linear experiment, given whitened."""
    tried = np.empty((0, len(residual))) if tried is None else tried
    return Linearisation(at, columns[:, None], residual[None], tried[:, None], columns, residual, tried)
