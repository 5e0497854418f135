"""Stand-ins for what a test does not look at."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.search.fits import Fit
from vpptwin.diagnosis.search.frame import Frame, Linearisation, Rows


class Starts(SimpleNamespace):
    """Windows of which only what is given counts, their starts at least."""

    def __len__(self) -> int:
        return len(self.start)


def lay_starts(start: list[float], flight: list[int] | None = None) -> Bench:
    """A bench of which only the windows' times count."""
    flights = np.zeros(len(start), dtype=int) if flight is None else np.array(flight)
    windows = Starts(start=np.array(start), flight=flights)
    return SimpleNamespace(windows=windows, criteria=CRITERIA)  # type: ignore[return-value]


def linear(
    at: np.ndarray, columns: np.ndarray, residual: np.ndarray, tried: np.ndarray | None = None, scale: float = 1.0
) -> Linearisation:
    """A linear experiment, given whitened, in a frame in which noise has variance `scale`."""
    tried = np.empty((0, len(residual))) if tried is None else tried
    frame = Frame(np.ones(len(residual)), scale, np.zeros(len(residual)))
    likelihood = SimpleNamespace(whiten=lambda raw: raw)
    return Linearisation(
        frame, likelihood, at, Rows(columns[:, None]), residual[None], None, tried[:, None], Rows(columns), residual,
        columns @ columns.T,
    )  # type: ignore[arg-type]  # fmt: skip


FRAME = Frame(np.ones(1), 1.0, np.zeros(1))


def guess(values: dict[Key, float], cost: float = 0.0, frame: Frame = FRAME) -> Fit:
    """A fit of which values, cost and frame count, under gusts as assumed."""
    about = SimpleNamespace(frame=frame, likelihood=SimpleNamespace(gust=np.ones(1)))
    off, freed = dict.fromkeys(values, 0.0), frozenset(effect for effect, _ in values)
    return Fit(freed, values, off, np.zeros((len(off), len(off))), cost, about, {})  # type: ignore[arg-type]
