"""The search over sets of effects, and what their log marginal likelihoods say of every effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest

import numpy as np
from scipy.special import expit, logsumexp

from vpptwin.inference.fit import BRIEF, Fit, Fitter, Point
from vpptwin.inference.model import Prior, Scales, find_mode

FEW, PROMISING, IN_PLACE = 14, 7, 5
"""Candidates that are fitted by themselves, beside others, and in the place of one, at most."""
MOST_TIMES = 10.0
"""Times that a trial may be as strong."""
REACH = 12.0
"""Log weight by which a brief fit may be behind the best to go on."""
LEAST = 0.5
"""Half of a square that an effect must take away to be fitted at all."""
STARTS = 2
"""Places from which a candidate is fitted."""
USUAL, STRAINED = 1.0, 1.0
"""Strain that is usual, and growth of the log of what evidence is divided by per standard deviation beyond."""
MOST_EFFECTS, MOST_SETS = 6, 12
"""Effects in a set at most, and times that the most probable set is extended or exchanged at most."""


@dataclass
class Comparison:
    """Sets of effects that were fitted, and their weights.

    No simulation is exact, so that log evidence is divided by a temper (Miller and Dunson, Robust Bayesian inference
    via coarsening, JASA 114, 2019): the more, the stronger process noise has to be to make up for what no set explains.
    What then decides is the loss itself, by how much predictions improve (Bissiri, Holmes and Walker, A general
    framework for updating belief distributions, JRSS B 78, 2016).

    Attributes:
        temper: by which log evidence is divided at least.
        odds: effect → log of the prior odds that it is there.
        predict: log weight that a fit gains by how well it predicts, over nothing.
        strain: by how many standard deviations of its prior a fit's process noise is stronger than expected.
        fits: set → fit.
    """

    temper: float
    odds: Mapping[str, float]
    predict: Callable[[Fit], float] = lambda fit: 0.0
    strain: Callable[[Fit], float] = lambda fit: 0.0
    fits: dict[frozenset[str], Fit] = field(default_factory=dict)
    _gains: dict[frozenset[str], float] = field(default_factory=dict)

    def add(self, fit: Fit) -> None:
        """Keep a fit if it is the best of its set; one with lent responses only until there is another."""
        known = self.fits.get(fit.effects)
        if known is None or (known.lent, fit.evidence) > (fit.lent, known.evidence):
            self.fits[fit.effects], self._gains[fit.effects] = fit, self.predict(fit)

    @property
    def divisor(self) -> float:
        """By what log evidence is divided: `temper`, and more from twice the usual spread of process noise on."""
        least = min((self.strain(fit) for fit in self.fits.values()), default=0.0)
        return self.temper * float(np.exp(STRAINED * max(least - USUAL, 0.0)))

    def log_weight(self, effects: frozenset[str]) -> float:
        """Of a set that was fitted, up to a constant."""
        told = self.fits[effects].evidence / self.divisor + self._gains[effects]
        return told + sum(self.odds[effect] for effect in sorted(effects))

    @property
    def ordered(self) -> list[frozenset[str]]:
        """Sets, the most probable first; names break ties."""
        return sorted(self.fits, key=lambda effects: (-self.log_weight(effects), sorted(effects)))

    @property
    def best(self) -> Fit:
        """The most probable."""
        return self.fits[self.ordered[0]]

    @property
    def probabilities(self) -> dict[frozenset[str], float]:
        """Posterior probability of every set among those that were fitted."""
        logs = np.array([self.log_weight(effects) for effects in self.fits])
        weights = np.exp(logs - logs.max())
        return dict(zip(self.fits, (weights / weights.sum()).tolist(), strict=True))

    def inclusion(self, effects: frozenset[str]) -> float:
        """Posterior probability that any of some effects is there."""
        return float(expit(self.log_odds(effects)))

    def log_odds(self, effects: frozenset[str]) -> float:
        """Posterior log odds that any of some effects is there, among the sets that were fitted."""
        logs = {found: self.log_weight(found) for found in self.fits}
        there, not_there = ([w for found, w in logs.items() if bool(found & effects) == side] for side in (True, False))
        return float(logsumexp(there) - logsumexp(not_there)) if there and not_there else np.inf if there else -np.inf


class Searcher:
    """Finds the sets that carry weight.

    Args:
        fitter: fits them.
        comparison: where what was fitted is kept.
        modifies: effect → effects of which it needs one beside it.
        told: called before every fit.
    """

    def __init__(
        self, fitter: Fitter, comparison: Comparison,
        modifies: Mapping[str, Sequence[str]] | None = None, told: Callable[[frozenset[str]], None] = lambda s: None,
    ) -> None:  # fmt: skip
        self.fitter, self.comparison = fitter, comparison
        self.modifies, self.told = dict(modifies or {}), told
        self.extended: set[frozenset[str]] = set()
        self.exchanged: set[frozenset[str]] = set()
        self.effects = sorted({u.key[0] for u in fitter.unknowns})

    def search(self) -> Comparison:
        """Fit sets until none that carries weight is left to extend."""
        comparison = self.comparison
        self.try_set(frozenset(), {})
        for _ in range(MOST_SETS):
            best = comparison.ordered[0]
            if best not in self.extended and len(best) < MOST_EFFECTS:
                self.extend(best)
            elif best and best not in self.exchanged:
                self.exchange(best)
            else:
                break
        return comparison

    def impose(self, effects: Sequence[str]) -> Fit:
        """Fit exactly these effects, each from its best starts beside those before it, all of them together in the end.

        Those that the windows do not show at all, as limits that nothing comes near, have no start and are left out.
        """
        fit = self.try_set(frozenset(), {})
        for effect in effects:
            ranked = [self.rank(fit, [effect], information)[effect] for information in self.fitter.screen(fit)]
            starts = [point for row in ranked for gain, point in row[:STARTS] if gain > 0.0]
            freed = fit.effects | {effect}
            for point in starts:
                self.try_set(freed, point, fit.posterior.scales, fit)
            fit = self.comparison.fits.get(freed, fit)
        return fit

    def try_set(
        self, effects: frozenset[str], start: Point, scales: Scales | None = None, beside: Fit | None = None
    ) -> Fit:
        """Fit a set and keep it."""
        self.told(effects)
        fit = self.fitter.fit(effects, start, scales, beside=beside)
        self.comparison.add(fit)
        return self.comparison.fits[effects]

    def extend(self, effects: frozenset[str], barred: frozenset[str] = frozenset()) -> None:
        """Fit every promising effect beside a set: all of them briefly, and those that may carry weight to the end."""
        fit = self.comparison.fits[effects]
        self.extended.add(effects)
        scales, brief = fit.posterior.scales, []
        for effect, starts in self.propose(fit, barred):
            self.told(effects | {effect})
            fits = [self.fitter.fit(effects | {effect}, start, scales, BRIEF, fit) for start in starts]
            best = max(fits, key=lambda each: each.evidence)
            if not self.fitter.is_slight(best, effect):
                brief.append(best)
        for each in brief:
            self.comparison.add(each)
        weights = [self.comparison.log_weight(each.effects) for each in brief]
        least = max([*weights, self.comparison.log_weight(effects)]) - REACH
        for each, weight in zip(brief, weights):
            hope = max(each.hope - each.evidence, 0.0) / self.comparison.divisor
            if weight + hope > least:
                found = self.try_set(each.effects, each.values, each.posterior.scales, each)
                if self.comparison.best is found:
                    self.lessen(found, effects)  # both along paths as likely as can be

    def lessen(self, fit: Fit, rest: frozenset[str]) -> None:
        """Fit some effects of a set, from where the posterior of all of them has these if the others are off."""
        self.try_set(rest, self.fitter.condition(fit, rest), fit.posterior.scales, fit)

    def reduce(self, effects: frozenset[str]) -> None:
        """Fit a set without each of its effects."""
        fit = self.comparison.fits[effects]
        for effect in sorted(effects):
            rest = effects - {effect}
            if rest not in self.comparison.fits and self.is_whole(rest):
                self.lessen(fit, rest)

    def exchange(self, effects: frozenset[str]) -> None:
        """Fit others in the place of each effect of a set."""
        self.exchanged.add(effects)
        self.reduce(effects)
        for effect in sorted(effects):
            rest = effects - {effect}
            if rest not in self.extended and self.is_whole(rest):
                self.extend(rest, frozenset({effect}))

    def is_whole(self, effects: frozenset[str]) -> bool:
        """Whether every effect that only modifies others has one of them beside it."""
        return all(not self.modifies.get(e) or effects & set(self.modifies[e]) for e in effects)

    def propose(self, fit: Fit, barred: frozenset[str]) -> list[tuple[str, list[Point]]]:
        """Effects worth fitting beside a fit, each with places to start from, most promising first."""
        free = [
            e for e in self.effects
            if e not in fit.effects | barred and (not self.modifies.get(e) or set(self.modifies[e]) & fit.effects)
        ]  # fmt: skip
        ranks = [self.rank(fit, free, information) for information in self.fitter.screen(fit)]
        # What these measurements tell nothing of would only be its prior.
        orders = [
            [e for e in sorted(free, key=lambda e: (-starts[e][0][0], e)) if starts[e][0][0] > LEAST]
            for starts in ranks
        ]
        names = list(dict.fromkeys(e for row in zip_longest(*orders) for e in row if e is not None))
        most, each = IN_PLACE if barred else PROMISING if fit.effects else FEW, STARTS // len(ranks)
        return [
            (e, [point for starts in ranks for gain, point in starts[e][:each] if gain > LEAST]) for e in names[:most]
        ]

    def rank(self, fit: Fit, effects: Sequence[str], information: np.ndarray) -> dict[str, list[tuple[float, Point]]]:
        """Half the square that effects would take away in the linear model, and parameters there, the best first."""
        fitter = self.fitter
        unknowns, last = fitter.unknowns, len(information) - 1
        at = np.array([fit.values.get(u.key, u.mean) for u in unknowns] + [0.0] * len(fitter.trials))
        old = [i for i, u in enumerate(unknowns) if u.key[0] in fit.effects]

        def solve(rows: list[int], extra: tuple[float, ...] = ()) -> tuple[float, np.ndarray]:
            """Square that is left with parameters, one trial perhaps, and tolerances free; most probable values."""
            loose = fitter.loose({unknowns[i].key[0] for i in rows})
            prior = fitter.prior_of([unknowns[i] for i in rows])
            if extra:
                prior = Prior(*(np.append(a, b) for a, b in zip(
                    (prior.mean, prior.std, prior.low, prior.high), extra[1:]
                )))  # fmt: skip
            kept = [*rows, *loose, *(int(e) for e in extra[:1])]
            mean, _, square = find_mode(information[np.ix_([*kept, last], [*kept, last])], at[kept], prior)
            return square, mean

        base = solve(old)[0]
        found: dict[str, list[tuple[float, Point]]] = {}
        for effect in effects:
            rows = old + [i for i, u in enumerate(unknowns) if u.key[0] == effect]
            square, mean = solve(rows)
            found[effect] = [(0.5 * (base - square), {unknowns[i].key: float(v) for i, v in zip(rows, mean)})]
        for number, trial in enumerate(fitter.trials):
            if trial.effect not in found:
                continue
            low, high = (0.0, MOST_TIMES) if trial.scales else (1.0, 1.0)
            square, mean = solve(old, (len(unknowns) + number, 0.0, MOST_TIMES, low, high))
            point = {unknowns[i].key: float(v) for i, v in zip(old, mean)} | dict(trial.values)
            if trial.scales:
                unknown = trial.scales
                value = unknown.mean + mean[-1] * (trial.values[unknown.key] - unknown.mean)
                point[unknown.key] = float(np.clip(value, unknown.low, unknown.high))
            found[trial.effect].append((0.5 * (base - square), point))
        return {effect: sorted(rows, key=lambda row: -row[0]) for effect, rows in found.items()}
