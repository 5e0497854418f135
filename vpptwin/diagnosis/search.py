"""The search for causes: linearise, rank every suspect in closed form, refit the best in the twin, keep what lasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.bench import Bench, Key, Variation
from vpptwin.diagnosis.likelihood import Likelihood, build_likelihood
from vpptwin.diagnosis.suspects import Linearisation, Solution, Unknown, scatter_by_window, solve_hypothesis

ITERATIONS = 5
SHORTLIST = 4
"""Suspects that are refitted in the twin at every step of the search."""
MAX_CAUSES = 6
BAR = 16.0
"""Drop in cost (twice the log-likelihood) that a cause must bring, beyond what build tolerances explain: 4 sigma."""
WORTH_A_REFIT = 2.0
"""Drop in cost by linearisation from which a suspect is refitted; the first one always is."""
SETTLED = 0.3
"""Drop in cost under which Gauss-Newton stops."""


@dataclass(frozen=True)
class Fit:
    """Effects fitted together in the twin.

    Attributes:
        effects: ids that were freed.
        values: their parameters.
        std: standard deviation of each, the other effects uncertain within their tolerance.
        cost: penalised misfit on the fitted windows.
        about: linearisation near `values`.
        tolerated: what the effects that were not freed moved within their tolerance, parameter → value.
    """

    effects: frozenset[str]
    values: dict[Key, float]
    std: dict[Key, float]
    cost: float
    about: Linearisation
    tolerated: dict[Key, float]


@dataclass(frozen=True)
class Step:
    """One step of the search: the fit before it, and every shortlisted suspect added to it."""

    before: Fit
    tried: dict[str, Fit]

    def drop(self, effect: str) -> float:
        """Drop in cost that adding an effect brought."""
        return self.before.cost - self.tried[effect].cost

    @property
    def best(self) -> str:
        """The effect whose addition brought most."""
        return max(self.tried, key=self.drop)


def weigh_windows(residual: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Square roots of Student-t weights, one a window, for whitened residuals (K, M); flat, (K M,).

    A window that fits no better than three times the usual misfit counts less: a collision, a glitch, or a slip that
    came early there must not outvote all the others.
    """
    square = (residual**2).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
    usual = 3.0 * float(np.median(square))
    weight = np.sqrt(2.0 * usual / (usual + np.maximum(square, usual)))
    return np.repeat(weight, residual.shape[1])


class Search:
    """Fits on one set of windows.

    Args:
        bench: the windows to fit.
        unknowns: parameters under suspicion.
    """

    def __init__(self, bench: Bench, unknowns: Sequence[Unknown]) -> None:
        self.bench, self.unknowns = bench, tuple(unknowns)
        self.scale = 1.0
        self.likelihood: Likelihood = build_likelihood(bench, {})
        self.weight = np.ones(bench.valid.size)
        self.start = self.adopt(frozenset(), {})

    def linearise(
        self, values: Mapping[Key, float], effects: frozenset[str] | None = None, known: Linearisation | None = None
    ) -> Linearisation:
        """Whitened residual and derivatives about a twin with `values`.

        Args:
            values: parameters of effects that are switched on.
            effects: ids whose derivatives are wanted anew; None for all.
            known: an earlier linearisation whose other derivatives are kept.
        """
        at = np.array([values.get(u.key, u.nominal) for u in self.unknowns])
        wanted = [i for i, u in enumerate(self.unknowns) if known is None or effects is None or u.effect.id in effects]
        steps = np.array([self.unknowns[i].step_from(at[i]) for i in wanted])
        variations = [Variation(dict(values))]
        for i, step in zip(wanted, steps):
            moved = self.unknowns[i].parameter.clip(at[i] + step)  # rounding may lead past a bound
            variations.append(Variation({**values, self.unknowns[i].key: float(moved)}))
        predicted = self.bench.predict(variations)
        residual = np.where(self.bench.valid, self.bench.measured - predicted[0], 0.0)
        slopes = np.where(self.bench.valid, predicted[1:] - predicted[0], 0.0) / steps[:, None, None]
        columns = np.empty((len(at), residual.size)) if known is None else known.columns.copy()
        if wanted:
            columns[wanted] = self.likelihood.whiten(slopes).reshape(len(steps), -1) * self.weight
        return Linearisation(at, columns, self.likelihood.whiten(residual).ravel() * self.weight)

    def fit(self, effects: frozenset[str], values: Mapping[Key, float], known: Linearisation | None) -> Fit:
        """Gauss-Newton on the parameters of `effects`; the others stay linear within their tolerance.

        Args:
            effects: ids to free.
            values: where to start.
            known: linearisation whose derivatives serve for the effects that are not freed; None computes all.
        """
        point = {key: value for key, value in values.items() if key[0] in effects}
        about = self.linearise(point, effects, known)
        solution = solve_hypothesis(about, self.unknowns, effects, self.scale)
        best, stride = (about, solution, point), 1.0
        for _ in range(ITERATIONS if effects else 0):
            about, solution, point = best
            ahead = self._advance(point, effects, solution, stride)
            there = self.linearise(ahead, effects, about)
            found = solve_hypothesis(there, self.unknowns, effects, self.scale)
            # The cost at a point, not at the minimum predicted from it, decides whether the step helped.
            gain = self._cost_here(about, effects) - self._cost_here(there, effects)
            if gain < 0.0:
                stride *= 0.5
                if stride < 0.2:
                    break
                continue
            best, stride = (there, found, ahead), 1.0
            if gain < SETTLED:
                break
        about, solution, point = best
        std, tolerated = {}, {}
        scatter = scatter_by_window(about, solution, len(self.bench.windows), self.scale)
        for i, unknown in enumerate(self.unknowns):
            if unknown.effect.id in effects:
                std[unknown.key] = float(max(np.sqrt(solution.covariance[i, i]), scatter[i]))
            else:
                tolerated[unknown.key] = float(about.at[i] + solution.deviation[i])
        return Fit(effects, point, std, self._cost_here(about, effects), about, tolerated)

    def adopt(self, effects: frozenset[str], values: Mapping[Key, float]) -> Fit:
        """Take effects as the new state of knowledge: gusts and starting states act through them, and they are refit.

        A slider that sticks hardly feels its starting velocity or a gust, so the covariance changes with the effects.
        What is left of the misfit then sets the scale: noise stronger than assumed makes every finding less certain.
        Costs before and after cannot be compared.
        """
        if effects:
            self.likelihood = build_likelihood(self.bench, dict(values))
        self.weight = np.ones(self.bench.valid.size)
        about = self.linearise(values)
        residual = about.residual - self._tolerate(about, effects).deviation @ about.columns
        self.weight = weigh_windows(residual.reshape(len(self.bench.windows), -1), self.bench.valid)
        misfit = float(((residual * self.weight) ** 2).sum()) / self.likelihood.freedom
        self.scale = max(1.0, misfit)
        weighted = Linearisation(about.at, about.columns * self.weight, about.residual * self.weight)
        return self.fit(effects, values, weighted)

    def complete(self, fit: Fit) -> Fit:
        """The same fit with all derivatives taken at its own parameters, and its cost under them."""
        about = self.linearise(fit.values)
        return Fit(fit.effects, fit.values, fit.std, self._cost_here(about, fit.effects), about, fit.tolerated)

    def rank(self, fit: Fit) -> list[tuple[str, float]]:
        """Every other effect with the drop in cost that freeing it too would bring, by linearisation, best first."""
        base = solve_hypothesis(fit.about, self.unknowns, fit.effects, self.scale).cost
        others = {u.effect.id for u in self.unknowns} - fit.effects
        drops = [
            (e, base - solve_hypothesis(fit.about, self.unknowns, fit.effects | {e}, self.scale).cost) for e in others
        ]
        return sorted(drops, key=lambda item: (-item[1], item[0]))

    def extend(self, fit: Fit, count: int = SHORTLIST, barred: frozenset[str] = frozenset()) -> Step:
        """Refit with each of the `count` best-ranked further suspects added in turn."""
        ranked = [item for item in self.rank(fit) if item[0] not in barred][:count]
        names = [name for i, (name, drop) in enumerate(ranked) if i == 0 or drop > WORTH_A_REFIT]
        return Step(fit, {name: self.fit(fit.effects | {name}, fit.values, fit.about) for name in names})

    def drop_superfluous(self, fit: Fit) -> Fit:
        """Leave out every effect without which the rest explains the data as well."""
        while len(fit.effects) > 1:
            without = {e: self.fit(fit.effects - {e}, fit.values, fit.about) for e in sorted(fit.effects)}
            weakest = min(without, key=lambda e: without[e].cost)
            if without[weakest].cost - fit.cost > BAR:
                return fit
            fit = self.adopt(without[weakest].effects, without[weakest].values)
        return fit

    def _cost_here(self, about: Linearisation, effects: frozenset[str]) -> float:
        """Cost at the point itself: freed parameters as they are, the others at their best within tolerance."""
        return self._tolerate(about, effects).cost

    def _tolerate(self, about: Linearisation, effects: frozenset[str]) -> Solution:
        """Freed parameters held where they are, the others moved within their tolerance."""
        frozen = np.array([u.effect.id in effects for u in self.unknowns])
        columns = np.where(frozen[:, None], 0.0, about.columns)
        held = Linearisation(about.at, columns, about.residual)
        return solve_hypothesis(held, self.unknowns, effects, self.scale)

    def _advance(
        self, values: Mapping[Key, float], effects: frozenset[str], solution: Solution, stride: float
    ) -> dict[Key, float]:
        moved = {}
        for unknown, step in zip(self.unknowns, solution.deviation):
            if unknown.effect.id in effects:
                value = values.get(unknown.key, unknown.nominal) + stride * float(step)
                moved[unknown.key] = float(np.clip(value, unknown.parameter.low, unknown.parameter.high))
        return moved
