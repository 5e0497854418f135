"""Two twins on the same held-out data: every comparison of their errors, and the rules that decide on a cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.blocks import resample, sum_blocks, tell_apart, to_deviations
from vpptwin.diagnosis.search.suspects import Unknown

TOLD = 3.0
"""Observations for which the errors of a block count, over all horizons: those near, and those far ahead."""
FELT, CLEAR = 1.1, 1.5
"""Error without a cause over that with it, at one horizon at least; and from which on densities have no veto: where
joints stick, they rest on a linear model."""
NAMES = {"m": "position_rmse_m", "rad": "angle_rmse_rad"}
"""Poses, as verdict.json calls their errors."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Errors of two twins in one unit.

    Attributes:
        before, after: squares in every window near every horizon, (K, H); NaN where nothing was measured.
        noise: variance that sensors and estimates of starting states put into them, (H,).
        blocks: stretch of log of every window, (K,).
    """

    before: np.ndarray
    after: np.ndarray
    noise: np.ndarray
    blocks: np.ndarray

    @cached_property
    def sums(self) -> np.ndarray:
        """Sums of squares of both over every block, (2, B, H)."""
        return np.stack([sum_blocks(np.nan_to_num(part), self.blocks) for part in (self.before, self.after)])

    @cached_property
    def ratios(self) -> np.ndarray:
        """Log of error after over error before in every block, (B, H); NaN in one without measurements.

        Root mean squares of blocks are compared, noise of the sensors added to both: no single slip decides.
        """
        measured = sum_blocks(np.isfinite(self.before).astype(float), self.blocks)
        first, second = self.sums + self.noise * measured
        with np.errstate(invalid="ignore"):
            return np.asarray(0.5 * np.log(second / first))

    @property
    def change(self) -> list[tuple[float, float]]:
        """90 % intervals of the change per horizon, as a share of the error before, by resampling blocks."""
        drawn = resample(self.sums)  # both are divided by the same number of windows
        share = np.sqrt(drawn[:, 1] / np.maximum(drawn[:, 0], 1e-30)) - 1.0
        low, high = np.quantile(share, [0.05, 0.95], axis=0)
        return [(float(a), float(b)) for a, b in zip(low, high)]

    @property
    def growth(self) -> float:
        """Root mean square error after over that before, where it is largest of all horizons."""
        before, after = np.nanmean(self.before, axis=0), np.nanmean(self.after, axis=0)
        return float(np.nanmax(np.sqrt(after / np.maximum(before, 1e-30))))


@dataclass(frozen=True, eq=False)
class Case:
    """A twin with some parameters against one with others.

    Attributes:
        pairs: their errors: of slides "m", of hinges "rad", and of the rates that were logged.
        criteria: thresholds.
    """

    pairs: Mapping[str, Pair]
    criteria: Criteria

    @property
    def poses(self) -> list[Pair]:
        """Errors of the pose."""
        return [pair for name, pair in self.pairs.items() if name in NAMES]

    @property
    def rise(self) -> float:
        """Largest share by which an error of the pose grows at any horizon; none that is within its standard error.

        That is of the mean over blocks of held-out log of the logarithm of error after over error before, Student's
        where the blocks are few; one block alone tells nothing.
        """
        least, found = np.log1p(self.criteria.even), [0.0]
        for pair in self.poses:
            mean, error = tell_apart(pair.ratios)
            for growth, doubt, number in zip(mean, error, np.isfinite(pair.ratios).sum(axis=0)):
                if to_deviations(max(growth - least, 0.0) / max(doubt, 1e-12), int(number)) > 1.0:
                    found.append(float(np.expm1(growth)))
        return max(found)

    @property
    def gain(self) -> float:
        """Log of the error of the pose before over that after, summed over blocks.

        The mean over horizons: half of a Gaussian loss with unknown scale, every block counting as `TOLD` observations.
        """
        if not self.poses:
            return 0.0
        rows = [pair.ratios for pair in self.poses]
        number = np.isfinite(rows).sum(axis=(0, 2))  # none in a block without measurements
        return -TOLD * float((np.nansum(rows, axis=(0, 2)) / np.maximum(number, 1)).sum())

    @property
    def growth(self) -> float:
        """Largest root mean square error after over that before, of all horizons, poses and rates."""
        return max((pair.growth for pair in self.pairs.values()), default=1.0)

    @property
    def change(self) -> dict[str, list[tuple[float, float]]]:
        """90 % intervals of the change in every error per horizon, by the names of verdict.json."""
        return {NAMES.get(name, name): pair.change for name, pair in self.pairs.items()}


class Rule(NamedTuple):
    """A number that a decision rests on."""

    name: str
    statistic: float
    threshold: float
    passed: bool


def need_more(name: str, statistic: float, threshold: float) -> Rule:
    """A rule that is passed above its threshold."""
    return Rule(name, float(statistic), float(threshold), bool(statistic > threshold))


def judge_cause(
    own: Sequence[Unknown], values: Mapping[Key, float], gain: float, without: Case, tolerances: float
) -> list[Rule]:
    """Rules that an effect has to pass beside the other causes, on stretches of log that no fit has seen.

    Args:
        own: its parameters.
        values: of all parameters.
        gain: log weight of predictions of held-out data that it brings.
        without: twins with it and without.
        tolerances: build tolerances by which one of its parameters must leave its nominal value.
    """
    off = max(abs(values[u.key] - u.nominal) / max(u.parameter.tolerance, 1e-12) for u in own)
    predicts = need_more("log predictive density of held-out data that it adds", gain, 0.0)
    return [
        predicts._replace(passed=predicts.passed or without.growth > CLEAR),
        need_more("distance from nominal, in build tolerances", off, tolerances),
        need_more("largest error without it, over the error with it", without.growth, FELT),
    ]


def judge_twin(extended: Case) -> Rule:
    """The rule that the extended twin has to pass against the twin as it was."""
    rise, even = extended.rise, extended.criteria.even
    return Rule("largest growth of an error with all causes", rise, even, rise <= even)
