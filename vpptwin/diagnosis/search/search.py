"""The search for causes: linearise, rank every suspect in closed form, refit the best in the twin, keep what lasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench, Key, Variation
from vpptwin.diagnosis.search.likelihood import (
    Likelihood,
    Response,
    assemble,
    couple_gusts,
    measure_response,
    tune_gust,
)
from vpptwin.diagnosis.search.shortlist import Start, advance, imitate, rank_effects, rank_trials
from vpptwin.diagnosis.search.suspects import (
    Linearisation,
    Solution,
    Unknown,
    list_trials,
    price_of_freedom,
    scatter_by_stretch,
    solve_hypothesis,
)
from vpptwin.effects import Stage

ITERATIONS = 6
SHORTLIST = 5
"""Suspects that are refitted in the twin at every step of the search."""
STARTS = 2
"""Places of a shape or a limit from which a refit starts."""
MAX_CAUSES = 5
BAR = 10.0
"""Drop in cost (twice the log of the evidence) that a cause must bring, beyond what build tolerances explain."""
WORTH_A_REFIT = 8.0
"""Drop in cost by linearisation from which a suspect is refitted."""
HOPE = 0.4
"""Share of a cause's drop in cost, by linearisation, from which a rival is refitted."""
CHANCE = 0.25
"""Share of the best suspect's drop in cost from which another is judged under its own likelihood."""
NONLINEAR = 0.1
"""Share of what a twin misses in a window that no linearised gust or starting state is believed to explain."""
YIELDING = 300.0
"""Cost by which a looser response must be likelier to set the parameters: gusts then explain a part of friction."""
POLISH = 2
"""Steps of Gauss-Newton once a hypothesis has its own likelihood."""
SETTLED = 0.3
"""Drop in cost under which Gauss-Newton stops."""


@dataclass(frozen=True)
class Fit:
    """Effects fitted together in the twin.

    Attributes:
        effects: ids that were freed.
        values: their parameters.
        std: standard deviation of each, the other effects uncertain within their tolerance.
        cost: twice the negative log of the evidence on the fitted windows, up to a constant of the search.
        about: linearisation near `values`.
        likelihood: what gusts and starting states do to a twin with `values`, or with values close to them.
        tolerated: what the effects that were not freed moved within their tolerance, parameter → value.
    """

    effects: frozenset[str]
    values: dict[Key, float]
    std: dict[Key, float]
    cost: float
    about: Linearisation
    likelihood: Likelihood
    tolerated: dict[Key, float]

    @property
    def likeliest(self) -> dict[Key, float]:
        """Every parameter where it is likeliest: those of the effects, the others within their tolerance."""
        return self.tolerated | self.values


@dataclass(frozen=True)
class Step:
    """One step of the search: the fit before it, and every shortlisted suspect added to it."""

    before: Fit
    tried: dict[str, Fit]

    def drop(self, effect: str) -> float:
        """Drop in cost that adding an effect brought."""
        return self.before.cost - self.tried[effect].cost

    @property
    def ordered(self) -> list[str]:
        """The suspects, the one whose addition brought most first."""
        return sorted(self.tried, key=self.drop, reverse=True)


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
        self.trials = list_trials(self.unknowns, bench)
        self.scale = 1.0
        self.weight = np.ones(bench.valid.size)
        self._library: dict[frozenset[str], Linearisation] = {}
        self._measured: dict[frozenset[str], Response] = {}
        self._floored: dict[frozenset[str], Response] = {}
        self._floor: np.ndarray = np.zeros(bench.valid.shape)
        self.start = self._settle(frozenset(), {}, self._rubbing(frozenset()))

    def linearise(
        self,
        values: Mapping[Key, float],
        likelihood: Likelihood,
        effects: frozenset[str] = frozenset(),
        known: Linearisation | None = None,
    ) -> Linearisation:
        """Whitened residual and derivatives about a twin with `values`.

        Args:
            values: parameters of effects that are switched on.
            likelihood: what whitens.
            effects: ids whose derivatives are wanted anew, if not all are.
            known: an earlier linearisation, whitened by the same likelihood, whose other derivatives are kept; None
                computes all, trials too.
        """
        at = np.array([values.get(u.key, u.nominal) for u in self.unknowns])
        wanted = [i for i, u in enumerate(self.unknowns) if known is None or u.effect.id in effects]
        trials = self.trials if known is None else ()
        steps = np.array([self.unknowns[i].step_from(at[i]) for i in wanted])
        variations = [Variation(dict(values))]
        for i, step in zip(wanted, steps):
            moved = self.unknowns[i].parameter.clip(at[i] + step)  # rounding may lead past a bound
            variations.append(Variation({**values, self.unknowns[i].key: float(moved)}))
        # A trial of what is switched on already would replace it.
        on = {key[0] for key in values}
        variations += [Variation({**values, **({} if t.effect in on else t.values)}) for t in trials]
        predicted = self.bench.predict(variations, values)
        valid = self.bench.valid
        missed = np.where(valid, self.bench.measured - predicted[0], 0.0)
        changed = np.where(valid, predicted[1:] - predicted[0], 0.0)
        fresh = changed[: len(wanted)] / steps[:, None, None]
        if known is None:
            return self.whiten(at, fresh, missed, changed[len(wanted) :], likelihood)
        slopes, columns = known.slopes.copy(), known.columns.copy()
        slopes[wanted], columns[wanted] = fresh, self._whiten(fresh, likelihood)
        residual = self._whiten(missed[None], likelihood)[0]
        return Linearisation(at, slopes, missed, known.trials, columns, residual, known.tried)

    def whiten(
        self, at: np.ndarray, slopes: np.ndarray, missed: np.ndarray, trials: np.ndarray, likelihood: Likelihood
    ) -> Linearisation:
        """A linearisation whitened by a likelihood, and by the present weights."""
        columns, residual, tried = (self._whiten(rows, likelihood) for rows in (slopes, missed[None], trials))
        return Linearisation(at, slopes, missed, trials, columns, residual[0], tried)

    def _whiten(self, raw: np.ndarray, likelihood: Likelihood) -> np.ndarray:
        """Rows (V, K, M) whitened and weighted, (V, K M)."""
        if not len(raw):
            return np.empty((0, self.weight.size))
        return likelihood.whiten(raw).reshape(len(raw), -1) * self.weight

    def fit(
        self,
        effects: frozenset[str],
        values: Mapping[Key, float],
        known: Linearisation,
        likelihood: Likelihood,
        iterations: int = ITERATIONS,
    ) -> Fit:
        """Gauss-Newton on the parameters of `effects`; the others stay linear within their tolerance.

        Args:
            effects: ids to free.
            values: where to start.
            known: linearisation whose derivatives serve for the effects that are not freed.
            likelihood: what whitens, `known` too.
            iterations: at most.
        """
        point = {key: value for key, value in values.items() if key[0] in effects}
        about = self.linearise(point, likelihood, effects, known)
        best, stride = (about, point, self._cost_at(about, effects)), 1.0
        for _ in range(iterations if effects else 0):
            about, point, cost = best
            solution = solve_hypothesis(about, self.unknowns, effects, self.scale)
            ahead = advance(about, self.unknowns, effects, solution, stride)
            there = self.linearise(ahead, likelihood, effects, about)
            # The cost at a point, not at the minimum predicted from it, decides whether the step helped.
            cost_there = self._cost_at(there, effects)
            if cost_there > cost:
                stride *= 0.4
                if stride < 0.1:
                    break
                continue
            best, stride = (there, ahead, cost_there), min(1.0, 2.0 * stride)
            if cost - cost_there < SETTLED:
                break
        about, point, cost = best
        return self._sum_up(effects, point, about, likelihood, cost)

    def own(self, fit: Fit) -> Fit:
        """The same hypothesis judged by its own likelihood: gusts as strong as it needs, acting through its own twin.

        A slider that sticks hardly feels its starting velocity or a gust; other effects leave the response to them
        nearly as it is. A real slider may yield where the twin's stands still, so that the likelier of its response
        and the nominal one sets the cost; parameters come from its own unless that is far less likely. The fit is
        polished; derivatives by effects that are not freed are kept.
        """
        loose = self._polish(fit, self.gliding_response)
        rubbing = self._rubbing(fit.effects)
        if not rubbing:
            return loose
        tight = self._polish(fit, self._respond(rubbing, fit.values, fit.likelihood.gust))
        chosen = tight if tight.cost < loose.cost + YIELDING else loose
        return replace(chosen, cost=min(tight.cost, loose.cost))

    @property
    def gliding_response(self) -> Response:
        """The response of the nominal twin without dry friction."""
        return self._respond(frozenset(), self.bench.gliding, None)

    def _respond(self, rubbing: frozenset[str], values: Mapping[Key, float], gust: np.ndarray | None) -> Response:
        """The response of a twin with these effects of dry friction, no measurement believed better than the floor."""
        if rubbing not in self._measured:
            self._measured[rubbing] = measure_response(self.bench, values, gust)
        if rubbing not in self._floored:
            found = self._measured[rubbing]
            self._floored[rubbing] = assemble(self.bench, found.state, found.state_std, found.push, self._floor)
        return self._floored[rubbing]

    def _raise_floor(self, missed: np.ndarray) -> None:
        """Set the floor from what a twin misses, (K, M): a part of it is beyond what linearisation can follow."""
        floor = np.empty_like(missed)
        for columns in self.bench.columns:
            number = np.maximum(self.bench.valid[:, columns].sum(axis=1, keepdims=True), 1)
            floor[:, columns] = NONLINEAR * np.sqrt((missed[:, columns] ** 2).sum(axis=1, keepdims=True) / number)
        self._floor, self._floored = floor, {}

    def _polish(self, fit: Fit, response: Response) -> Fit:
        likelihood = self._tune(fit.about, fit.effects, response)
        about = fit.about
        known = self.whiten(about.at, about.slopes, about.missed, about.trials, likelihood)
        return self.fit(fit.effects, fit.values, known, likelihood, POLISH)

    def _tune(self, about: Linearisation, effects: frozenset[str], response: Response) -> Likelihood:
        """The likelihood of a response under gusts as strong as the residual of a linearisation tells."""
        deviation = self._tolerate(about, effects).deviation
        left = about.missed - np.einsum("p,pkm->km", deviation, about.slopes)
        return couple_gusts(self.bench, response, tune_gust(self.bench, response, left, self.scale))

    def _sum_up(
        self,
        effects: frozenset[str],
        point: dict[Key, float],
        about: Linearisation,
        likelihood: Likelihood,
        cost: float,
    ) -> Fit:
        solution = solve_hypothesis(about, self.unknowns, effects, self.scale)
        std, tolerated = {}, {}
        scatter = scatter_by_stretch(about, solution, self.bench, self.scale)
        for i, unknown in enumerate(self.unknowns):
            if unknown.effect.id in effects:
                std[unknown.key] = float(max(np.sqrt(solution.covariance[i, i]), scatter[i]))
            elif not unknown.is_limit:  # a limit has no tolerance about its nominal, which is far away
                tolerated[unknown.key] = float(unknown.parameter.clip(about.at[i] + solution.deviation[i]))
        cost += float(likelihood.logdet.sum()) + price_of_freedom(solution, self.unknowns, effects)
        return Fit(effects, point, std, cost, about, likelihood, tolerated)

    def adopt(self, fit: Fit) -> Fit:
        """Take a fit as the new state of knowledge: derivatives that belong to it, and a refit.

        What is left of the misfit sets the scale: noise stronger than assumed makes every finding less certain.
        Costs before and after cannot be compared.
        """
        tight = fit.likelihood.response is not self.gliding_response
        return self._settle(fit.effects, fit.values, self._rubbing(fit.effects) if tight else frozenset())

    def _settle(self, effects: frozenset[str], values: Mapping[Key, float], rubbing: frozenset[str]) -> Fit:
        self.weight, self.scale = np.ones(self.bench.valid.size), 1.0
        plain = couple_gusts(self.bench, self._respond(rubbing, values, None), np.ones(self.bench.spec.model.nv))
        about = self.linearise(values, plain, effects, self._derive(effects, values, plain))
        self._raise_floor(about.missed)
        response = self._respond(rubbing, values, None)
        likelihood = self._tune(about, effects, response)
        about = self.whiten(about.at, about.slopes, about.missed, about.trials, likelihood)
        residual = about.residual - self._tolerate(about, effects).deviation @ about.columns
        self.weight = weigh_windows(residual.reshape(len(self.bench.windows), -1), self.bench.valid)
        self.scale = max(1.0, float(((residual * self.weight) ** 2).sum()) / response.freedom)
        weighted = self.whiten(about.at, about.slopes, about.missed, about.trials, likelihood)
        return self.own(self.fit(effects, values, weighted, likelihood))

    def complete(self, fit: Fit) -> Fit:
        """The same fit with derivatives that belong to it."""
        known = self._derive(fit.effects, fit.values, fit.likelihood)
        return self.own(replace(fit, about=self.linearise(fit.values, fit.likelihood, fit.effects, known)))

    def _derive(self, effects: frozenset[str], values: Mapping[Key, float], likelihood: Likelihood) -> Linearisation:
        """Derivatives about a twin with these effects.

        Only what sticks changes the derivatives by everything else much, so that they are taken once for every set of
        effects that make dry friction.
        """
        rubbing = self._rubbing(effects)
        if rubbing not in self._library:
            self._library[rubbing] = self.linearise(values, likelihood)
        known = self._library[rubbing]
        return self.whiten(known.at, known.slopes, known.missed, known.trials, likelihood)

    def sticks(self, effects: frozenset[str]) -> bool:
        """Whether any of the effects makes dry friction."""
        return bool(self._rubbing(effects))

    def _rubbing(self, effects: frozenset[str]) -> frozenset[str]:
        """Those of the effects, and of the nominal twin's, that make dry friction."""
        on = effects | {effect for effect, _ in self.bench.gliding}
        return frozenset(u.effect.id for u in self.unknowns if u.effect.stage is Stage.FRICTION) & on

    def rank(self, fit: Fit, barred: frozenset[str] = frozenset()) -> list[Start]:
        """Where to start refitting every other effect beside those of a fit, by linearisation, most promising first."""
        base = solve_hypothesis(fit.about, self.unknowns, fit.effects, self.scale)
        starts = rank_effects(fit.about, self.unknowns, base, fit.effects, barred, self.scale)
        starts += rank_trials(fit.about, self.unknowns, self.trials, base, fit.effects | barred, self.scale)
        known = {key: value for key, value in fit.values.items() if key[0] in fit.effects}
        starts = [replace(start, values={**known, **start.values}) for start in starts]
        return sorted(starts, key=lambda start: (-start.drop, start.effect))

    def extend(
        self,
        fit: Fit,
        barred: frozenset[str] = frozenset(),
        against: str = "",
        values: Mapping[Key, float] | None = None,
    ) -> Step:
        """Refit with each of the best-ranked further suspects added in turn, each under its own likelihood.

        Those that the catalogue calls hard to tell from the best, or from the cause whose place they take, are tried
        from where they do the same: of a large effect derivatives at the nominal twin tell little.

        Args:
            fit: what they are added to.
            barred: suspects that are not tried.
            against: a cause in whose place the others stand; those that fall far behind it are not tried.
            values: its parameters.
        """
        starts: dict[str, list[Start]] = {}
        for start in self.rank(fit, barred):
            starts.setdefault(start.effect, []).append(start)
        least = WORTH_A_REFIT
        if against in starts:
            least = max(least, HOPE * starts.pop(against)[0].drop)
        names = [name for name in starts if starts[name][0].drop > least][:SHORTLIST]
        found: dict[str, Fit] = {}
        for name in names:
            self._refit(found, fit, starts[name][:STARTS])
        leader = min(found, key=lambda name: found[name].cost, default="")
        if leader:
            for start in imitate(fit.about, self.unknowns, leader, found[leader].values, fit.values):
                if start.effect in starts and start.effect not in found:
                    self._refit(found, fit, [start])
        if values:
            # Without the cause the others have moved to make up for it: beside a look-alike they are as they were.
            rest = {key: value for key, value in values.items() if key[0] != against}
            for start in imitate(fit.about, self.unknowns, against, values, rest):
                if start.effect in starts and (rest or start.effect not in found):
                    self._refit(found, fit, [start])
        most = max((fit.cost - f.cost for f in found.values()), default=0.0)
        chosen = {name: f for name, f in found.items() if fit.cost - f.cost >= max(CHANCE * most, 0.0)}
        return Step(fit, {name: self.own(f) for name, f in chosen.items()})

    def _refit(self, found: dict[str, Fit], fit: Fit, starts: Sequence[Start]) -> None:
        """Add to `found` the best refit of one suspect beside the effects of a fit, unless a better one is there."""
        effect = starts[0].effect
        refits = [self.fit(fit.effects | {effect}, start.values, fit.about, fit.likelihood) for start in starts]
        refits += [found[effect]] if effect in found else []
        found[effect] = min(refits, key=lambda f: f.cost)

    def without(self, fit: Fit, effect: str) -> Fit:
        """The fit without one of its effects, under its own likelihood."""
        return self.own(self.fit(fit.effects - {effect}, fit.values, fit.about, fit.likelihood))

    def drop_superfluous(self, fit: Fit) -> Fit:
        """Leave out every effect without which the rest explains the data as well."""
        while len(fit.effects) > 1:
            without = {e: self.without(fit, e) for e in sorted(fit.effects)}
            weakest = min(without, key=lambda e: without[e].cost)
            if without[weakest].cost - fit.cost > BAR:
                return fit
            fit = self.adopt(without[weakest])
        return fit

    def _cost_at(self, about: Linearisation, effects: frozenset[str]) -> float:
        """Cost at the point itself: freed parameters as they are, the others at their best within tolerance."""
        return self._tolerate(about, effects).cost

    def _tolerate(self, about: Linearisation, effects: frozenset[str]) -> Solution:
        """Freed parameters held where they are, the others moved within their tolerance."""
        return solve_hypothesis(about, self.unknowns, effects, self.scale, frozen=True)
