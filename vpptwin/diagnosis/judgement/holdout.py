"""Flights that no fit has seen: what a twin's predictions are worth on them, before and after it was extended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import SHOWN
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.blocks import blocks_of, resample, sum_blocks
from vpptwin.diagnosis.judgement.errors import PredictionErrors, mean_over
from vpptwin.diagnosis.search.likelihood import measure_response

Folds = tuple[np.ndarray, Sequence[Mapping[Key, float]]]
"""Fold of every window, and parameters fitted to all other folds."""
Values = frozenset[tuple[Key, float]]
LEAST = 0.01
"""Least excess chi² of which there are shares."""


@dataclass(frozen=True)
class Score:
    """Error of one twin on held-out windows.

    Attributes:
        position_rmse_m: root mean square over slide joints per horizon; None where the rig has none.
        angle_rmse_rad: the same over hinges.
        velocity_rmse: joint → root mean square error of its velocity per horizon [m/s or rad/s], where logged.
        chi2: mean squared pose residual over sensor variance, starting states fitted; 1 is the noise floor.
    """

    position_rmse_m: list[float] | None
    angle_rmse_rad: list[float] | None
    velocity_rmse: dict[str, list[float]]
    chi2: float

    @property
    def ahead(self) -> dict[str, float]:
        """Errors of the pose `SHOWN` ahead, by their keys."""
        poses = {"position_rmse_m": self.position_rmse_m, "angle_rmse_rad": self.angle_rmse_rad}
        return {name: errors[SHOWN] for name, errors in poses.items() if errors is not None}

    def as_dict(self) -> dict[str, object]:
        """The score as `before` and `after` of verdict.json have it (docs/diagnose.md)."""
        return asdict(self)


class HeldOut:
    """Held-out windows, short ones to judge likelihood and long ones for errors over the horizon.

    Args:
        short: windows of the length that is fitted, channels observed.
        long: windows as long as the last horizon, started from states estimated without looking ahead.
    """

    def __init__(self, short: Bench, long: Bench) -> None:
        self.short, self.errors, self.criteria = short, PredictionErrors(long), short.criteria
        self._misfits: dict[Values, tuple[np.ndarray, np.ndarray]] = {}

    def divide(self, short: Folds, long: Folds) -> None:
        """Judge every window by parameters of fits that have not seen it: see `Bench.folds`."""
        self.short.folds, self.errors.bench.folds = short, long

    @property
    def count(self) -> int:
        """Number of windows that judge."""
        return len(self.short.windows)

    def chi2(self, values: Mapping[Key, float]) -> float:
        """Mean squared pose residual over sensor variance, starting states fitted; 1 is the noise floor."""
        squares, count = self.chi2_by_window(values)
        return float(squares.sum() / max(count.sum(), 1))

    def chi2_by_window(self, values: Mapping[Key, float]) -> tuple[np.ndarray, np.ndarray]:
        """Squared pose residual over sensor variance and its degrees of freedom in every short window, (K,) each."""
        key = frozenset(values.items())
        if key not in self._misfits:
            pose, residual = self.short.of_poses, self.short.residual(values)
            # What sticks leaves a wrong starting state no way out; a real slider yields.
            twins = {frozenset(twin.items()): twin for twin in (self.short.loosen(values), values)}
            starts = [measure_response(self.short, twin, pushed=False) for twin in twins.values()]
            found = [(start.whiten_some(pose).apply(residual[:, pose]) ** 2).sum(axis=1) for start in starts]
            free = self.short.valid[:, pose].sum(axis=1) - 2 * self.short.windows.free_dofs
            self._misfits[key] = min(found, key=lambda square: float(square.sum())), free
        return self._misfits[key]

    def score(self, values: Mapping[Key, float]) -> Score:
        """Errors over the horizon from causally estimated states, and chi2."""
        found = {name: mean_over(parts) for name, parts in self.errors.squares(values).items()}
        rates = {name: found[name] for name in found if name not in ("m", "rad")}
        return Score(found.get("m"), found.get("rad"), rates, self.chi2(values))

    def share_removed(
        self, without: Mapping[Key, float], after: Mapping[Key, float], before: Mapping[Key, float]
    ) -> tuple[float, tuple[float, float]]:
        """Share of the excess chi2 of `before` by which `after` is better than `without`, with its 90 % interval."""
        found = [self.chi2_by_window(values) for values in (without, after, before)]
        squares = np.stack([squares for squares, _ in found])
        number = found[0][1]
        blocks = blocks_of(self.short.windows, self.criteria.block)
        sums = np.stack([sum_blocks(row[:, None], blocks) for row in (*squares, number)])
        drawn = resample(sums)[..., 0]
        drawn = np.concatenate([sums.sum(axis=1).T, drawn])
        excess = np.maximum(drawn[:, 2] - drawn[:, 3], LEAST * drawn[:, 3])
        share = (drawn[:, 0] - drawn[:, 1]) / excess
        low, high = np.quantile(share[1:], [0.05, 0.95])
        return float(share[0]), (float(low), float(high))
