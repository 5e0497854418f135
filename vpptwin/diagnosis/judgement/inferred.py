"""Causes by comparing hypotheses on all windows of the logs, each judged by fits to other stretches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.case import Rule, judge_cause
from vpptwin.diagnosis.judgement.errors import PredictionErrors
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.selection import CALIBRATION, Alternative, Explanation, Selection
from vpptwin.diagnosis.judgement.verdict import Rival
from vpptwin.diagnosis.search.hypotheses import compare_hypotheses
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.estimation.windows import Windows
from vpptwin.inference.fit import Fit, Fitter
from vpptwin.inference.model import Scales, predict_folds
from vpptwin.inference.select import Comparison
from vpptwin.system.deadline import Deadline

FOLDS = 6
"""Parts of the logs, each judged by fits to the others."""
STRETCHES = 3
"""Stretches of time that a fold has at most."""
ASTRAY = 6.0
"""Times the median gain of a window that one may gain or lose."""
CLOSE = 3.0
"""Sigma within which a rival is reported."""
LEAST = 0.01
"""Probability from which it is."""


@dataclass(frozen=True)
class Inferred:
    """What was inferred from all windows.

    Attributes:
        fitter: of hypotheses.
        windows: that were fitted.
        ahead: errors of predictions.
        comparison: sets of effects with their fits.
        fold: of every window, (K,).
        chosen: the set that becomes the causes.
        fitted: its parameters as fitted to all folds but one, fold by fold.
        gains: cause → out-of-fold gain that it brings beside the others: of log predictive density, divided as evidence
            is, and of errors.
        stopped: whether the search was cut short.
        imposed: whether somebody named the causes.
    """

    fitter: Fitter
    windows: Windows
    ahead: PredictionErrors
    comparison: Comparison
    fold: np.ndarray
    chosen: Fit
    fitted: list[dict[Key, float]]
    gains: dict[str, float]
    stopped: bool = False
    imposed: bool = False

    @property
    def scales(self) -> Scales:
        """Noise that the causes leave."""
        return self.chosen.posterior.scales

    def choose(self, chosen: Fit) -> Inferred:
        """The same with another set, and what each of its effects brings on stretches that no fit has seen."""
        density, ahead, means = self._predict(chosen)
        gains = {}
        for effect in sorted(chosen.effects):
            less, nearer, _ = self._predict(self.without(chosen, effect))
            gains[effect] = sum_gains(density - less) / self.comparison.divisor + ahead - nearer
        return replace(
            self, chosen=chosen, fitted=[dict(zip(chosen.values, row.tolist())) for row in means], gains=gains
        )

    def without(self, fit: Fit, effect: str) -> Fit:
        """A fit without one of its effects."""
        rest = fit.effects - {effect}
        if rest not in self.comparison.fits:
            start = self.fitter.condition(fit, rest)
            self.comparison.add(self.fitter.fit(rest, start, fit.posterior.scales, beside=fit))
        return self.comparison.fits[rest]

    def drop(self, effect: str) -> Inferred:
        """The same without an effect."""
        return self.choose(self.without(self.chosen, effect))

    def _predict(self, fit: Fit) -> tuple[np.ndarray, float, np.ndarray]:
        """Of held-out stretches: log density of windows, (K,), gain of errors, and parameters fold by fold, (F, P)."""
        prior = self.fitter.simulator.scale_prior
        density, means = predict_folds(fit.windows, fit.prior, prior, fit.posterior, self.fold)
        fitted = [dict(zip(fit.values, row.tolist())) for row in means]
        bench = copy(self.ahead.bench)
        bench.folds = self.deal(bench), fitted
        gain = PredictionErrors(bench).compare({}, fit.values).gain
        return density, gain, means

    def deal(self, bench: Bench) -> np.ndarray:
        """Folds of a bench's windows, (K,), each that of the fitted window which starts last before it."""
        windows = self.windows
        fold = np.empty(len(bench.windows), int)
        for k, (flight, start) in enumerate(zip(bench.windows.flight, bench.windows.start)):
            rows = np.flatnonzero(windows.flight == flight)
            before = rows[windows.start[rows] <= start + 1e-9]
            fold[k] = self.fold[before[np.argmax(windows.start[before])] if len(before) else rows[0]]
        return fold


def sum_gains(gains: np.ndarray) -> float:
    """Sum of what windows gain, (K,), none more than `ASTRAY` times the median: one must not outvote all others."""
    most = ASTRAY * float(np.median(np.abs(gains)))
    return float(np.clip(gains, -most, most).sum())


def cut_folds(flight: np.ndarray, start: np.ndarray, window: float) -> np.ndarray:
    """Fold of windows that start at times [s] of flights, (K,): stretches of time are dealt out in turn."""
    stretch = np.zeros(len(start), int)
    count = max(min(FOLDS * STRETCHES, len(start)), 1)
    total = sum(np.ptp(start[flight == f]) + window for f in np.unique(flight))
    length, first = total / count, 0
    for f in np.unique(flight):
        rows = flight == f
        stretch[rows] = first + ((start[rows] - start[rows].min()) / length + 1e-9).astype(int)
        first = int(stretch[rows].max()) + 1
    return np.unique(stretch % FOLDS, return_inverse=True)[1]  # a stretch without windows must leave no fold empty


def infer_causes(
    bench: Bench, scout: Bench, ahead: PredictionErrors, unknowns: Sequence[Unknown], stage: Callable[[str], None],
    deadline: Deadline, imposed: Sequence[str] | None = None,
) -> Inferred:  # fmt: skip
    """Compare hypotheses on a bench of all windows; some of them, which may be all, scout for candidates.

    Errors `ahead` say how well each predicts. Effects that are `imposed` are the causes whatever the evidence.

    Raises:
        Stopped: before every candidate has been tried once.
    """

    def tell(effects: frozenset[str]) -> None:
        stage(f"comparing hypotheses ({', '.join(sorted(effects)) or 'nothing wrong'})")

    comparison, fitter, stopped = compare_hypotheses(
        bench, unknowns, scout, deadline, tell, lambda values: ahead.compare({}, values).gain, imposed
    )
    windows = bench.windows
    fold = cut_folds(windows.flight, windows.start, windows.steps * windows.dt)
    deadline.held = True
    chosen = comparison.best if imposed is None else max(comparison.fits.values(), key=lambda fit: len(fit.effects))
    best = Inferred(fitter, windows, ahead, comparison, fold, chosen, [], {}, stopped, imposed is not None)
    return best.choose(chosen)


def judge_causes(search: Search, held_out: HeldOut, inferred: Inferred) -> dict[str, list[Rule]]:
    """The rules of every cause, passed or not."""
    values, found = inferred.chosen.values, {}
    for effect, gain in inferred.gains.items():
        own = [u for u in search.unknowns if u.effect.id == effect]
        rest = {key: value for key, value in values.items() if key[0] != effect}
        without = held_out.errors.compare(values, rest)
        found[effect] = judge_cause(own, values, gain, without, search.criteria.tolerances)
    return found


def rescale(measurements: Sequence[Measurements], bench: Bench, scales: Scales) -> list[Measurements]:
    """The measurements with the noise that was inferred for every channel of a bench."""
    factors = {(c.kind, c.axis): float(np.exp(s)) for c, s in zip(bench.channels, scales.sensor)}

    def scaled(series: Mapping[int, Series], kind: str) -> dict[int, Series]:
        # Beside noise that is known a roughness is assumed, which stays.
        known = {dof: 1.0 if each.white else factors.get((kind, dof), 1.0) for dof, each in series.items()}
        return {dof: replace(each, std=each.std * known[dof]) for dof, each in series.items()}

    return [
        replace(m, positions=scaled(m.positions, "position"), velocities=scaled(m.velocities, "velocity"))
        for m in measurements
    ]


def select_inferred(inferred: Inferred, search: Search) -> Selection:
    """The causes as the verdict takes them."""
    comparison, chosen, fitter = inferred.comparison, inferred.chosen, inferred.fitter
    loose = [fitter.unknowns[i].key for i in fitter.loose(chosen.effects)]
    tolerated = dict(zip(loose, chosen.posterior.mean[len(chosen.values) :].tolist(), strict=True))
    std, gust = average_std(comparison, chosen), np.exp(inferred.scales.process)
    fit = Explanation(chosen.effects, dict(chosen.values), std, tolerated, gust, search.criteria)
    empty = comparison.fits[frozenset()]
    first = {next(iter(s)): 2.0 * (f.evidence - empty.evidence) for s, f in comparison.fits.items() if len(s) == 1}
    odds = {e: np.inf if inferred.imposed else comparison.log_odds(frozenset({e})) for e in chosen.effects}
    rivals = {effect: list_rivals(comparison, chosen, effect) for effect in chosen.effects}
    instead = {effect: [Alternative(f.effects, f.values, f.std) for _, f in row] for effect, row in rivals.items()}
    evidence = {e: 2.0 * (chosen.evidence - comparison.fits[chosen.effects - {e}].evidence) for e in chosen.effects}
    kinds = {effect: judge_kind(search, comparison, effect) for effect in chosen.effects}
    ranked = sorted(first.items(), key=lambda item: -item[1])
    told = {effect: share_doubt([rival for rival, _ in row], odds[effect]) for effect, row in rivals.items()}
    cut = ("fitting further sets of effects",) if inferred.stopped else ()
    return Selection(fit, ranked, told, instead, evidence, odds, kinds, not_done=cut,
                     unrivalled=chosen.effects if cut else frozenset())  # fmt: skip


def judge_kind(search: Search, comparison: Comparison, name: str) -> tuple[str, float]:
    """An effect's kind, and the log odds that anything of that kind is at its place."""
    effects = {unknown.effect.id: unknown.effect for unknown in search.unknowns}
    own = effects[name]
    same = {e.id for e in effects.values() if own.kind and (e.kind, e.places) == (own.kind, own.places)}
    return own.kind, comparison.log_odds(frozenset(same | {name}))


def share_doubt(rivals: Sequence[Rival], odds: float) -> list[Rival]:
    """Rivals with what calibration leaves to them, in proportion to their posterior probabilities."""
    times = (1.0 - CALIBRATION.apply(odds)) / max(float(expit(-odds)), 1e-300)
    return [replace(rival, confidence=min(times * rival.confidence, 1.0)) for rival in rivals]


def average_std(comparison: Comparison, chosen: Fit) -> dict[Key, float]:
    """Standard deviation of every parameter of a set, averaged over all sets with its effect that were fitted.

    Var = Σ p (s² + (v - v₀)²) / Σ p over the sets (Hoeting et al., Bayesian Model Averaging, Stat. Sci. 14, 1999).
    """
    probabilities, found = comparison.probabilities, {}
    for key, value in chosen.values.items():
        sets = [effects for effects in comparison.fits if key[0] in effects]
        weights = np.array([probabilities[effects] for effects in sets])
        stds = np.array([comparison.fits[effects].std[key] for effects in sets])
        away = np.array([comparison.fits[effects].values[key] - value for effects in sets])
        found[key] = float(np.sqrt(weights @ (stds**2 + away**2) / weights.sum()))
    return found


def list_rivals(comparison: Comparison, chosen: Fit, effect: str) -> list[tuple[Rival, Fit]]:
    """Effects that may stand in the place of a cause, the most probable first, each with the set in which it does."""
    found: dict[str, tuple[float, float, Fit]] = {}
    mine = comparison.log_weight(chosen.effects)
    for effects, probability in comparison.probabilities.items():
        if effect in effects or not (others := effects - chosen.effects):
            continue
        sigma = float(np.sqrt(max(2.0 * (mine - comparison.log_weight(effects)), 0.0)))
        for other in others:
            before = found.get(other, (0.0, np.inf, comparison.fits[effects]))
            nearer = sigma < before[1]
            found[other] = (
                before[0] + probability,
                min(sigma, before[1]),
                comparison.fits[effects] if nearer else before[2],
            )
    rows = [(Rival(name, p, sigma), fit) for name, (p, sigma, fit) in found.items() if sigma < CLOSE or p > LEAST]
    return sorted(rows, key=lambda row: (-row[0].confidence, row[0].effect))
