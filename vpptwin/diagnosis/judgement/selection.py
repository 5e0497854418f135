"""The causes that were selected, and what speaks for and against each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.verdict import Rival
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects import Stage
from vpptwin.inference.calibrate import Calibration


def load_calibration() -> Calibration:
    """The map from log odds to confidence; its file has seeds and commit (`benchmarks/calibration.py`)."""
    told = json.loads(files("vpptwin.diagnosis.judgement").joinpath("calibration.json").read_text())
    return Calibration(told["intercept"], told["slope"], told["highest"])


CALIBRATION = load_calibration()


@dataclass(frozen=True, eq=False)
class Explanation:
    """Effects fitted together.

    Attributes:
        effects: ids that were freed.
        values: their parameters.
        std: standard deviation of each, averaged over the sets of effects that have it.
        tolerated: what the effects that were not freed moved within their tolerance, parameter → value.
        gust: strength of the process noise as a multiple of what the robot states, (nv,).
        criteria: thresholds.
    """

    effects: frozenset[str]
    values: dict[Key, float]
    std: dict[Key, float]
    tolerated: dict[Key, float]
    gust: np.ndarray
    criteria: Criteria

    @property
    def likeliest(self) -> dict[Key, float]:
        """Every parameter where it is likeliest: those of the effects, the others within their tolerance."""
        return self.tolerated | self.values

    def stated_std(self, unknown: Unknown) -> float:
        """Standard deviation as reported: tempered as evidence is; of a strength also what its law may be wrong by."""
        criteria = self.criteria
        std = float(np.sqrt(criteria.temper)) * self.std[unknown.key]
        if unknown.parameter not in unknown.effect.strengths:
            return std
        share = criteria.inexact_friction if unknown.effect.stage is Stage.FRICTION else criteria.inexact
        value = self.values[unknown.key]
        return float(np.hypot(std, share * abs(value if unknown.is_limit else value - unknown.nominal)))


@dataclass(frozen=True)
class Alternative:
    """Effects with their parameters that may be there instead, and standard deviations of these."""

    effects: frozenset[str]
    values: Mapping[Key, float]
    std: Mapping[Key, float]


@dataclass(frozen=True)
class Selection:
    """The causes, and what speaks for and against each.

    Attributes:
        fit: the causes fitted together.
        first: every suspect's drop in cost as the only cause, best first, as `rank_first` has it.
        rivals: cause → effects that explain the fitted windows nearly as well in its place.
        instead: cause → the fits with those effects in its place, in the same order.
        evidence: cause → drop in cost that it brings beside the others.
        odds: cause → posterior log odds that it is there.
        kinds: cause → its kind, and the log odds that anything of that kind is there.
        left_out: effects that fitted windows asked for, and held-out ones are predicted worse with.
        reduced: whether others were left out of what is written, so that these were found beside what is not there.
        unrivalled: causes in whose place no other was fitted.
        not_done: what was left out as it was stopped, in words.
    """

    fit: Explanation
    first: list[tuple[str, float]]
    rivals: dict[str, list[Rival]]
    instead: dict[str, list[Alternative]]
    evidence: dict[str, float]
    odds: Mapping[str, float]
    kinds: Mapping[str, tuple[str, float]]
    left_out: frozenset[str] = frozenset()
    reduced: bool = False
    unrivalled: frozenset[str] = frozenset()
    not_done: tuple[str, ...] = ()

    def reduce_to(self, fit: Explanation) -> Selection:
        """The selection with a fit of fewer causes: with all of them held-out log was predicted worse."""
        gone, kept = self.fit.effects - fit.effects, fit.effects
        rivals = {e: [r for r in self.rivals[e] if r.effect not in gone] for e in kept}
        instead = {
            e: [
                replace(f, effects=f.effects - gone, values={k: v for k, v in f.values.items() if k[0] not in gone})
                for rival, f in zip(self.rivals[e], self.instead[e]) if rival.effect not in gone
            ]
            for e in kept
        }  # fmt: skip
        evidence = {e: self.evidence[e] for e in kept}
        return replace(self, fit=fit, rivals=rivals, instead=instead, evidence=evidence, left_out=self.left_out | gone,
                       reduced=True)  # fmt: skip

    def confidence(self, effect: str) -> float:
        """Calibrated probability that the cause is right, among its rivals and that nothing is there."""
        return CALIBRATION.apply(self.odds[effect])
