"""Fits of hypotheses: Gauss-Newton on the simulation itself, noise scales inferred at every step."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from vpptwin.inference.covariance import solve
from vpptwin.inference.model import Nuisance, Posterior, Prior, ScalePrior, Scales, Windows, infer
from vpptwin.inference.path import foretell, smooth, strain

Key = tuple[str, str]
"""Effect id and parameter name."""
Point = Mapping[Key, float]
STEPS = 15
"""Steps of Gauss-Newton at most."""
WIDEST = 3.0
"""Tolerances by which what is not suspected may be off."""
NOTICED, MOST_LOOSE = 0.5, 24
"""Square of the signal to noise from which a tolerance is noticed, and tolerances at most."""
AFFORDABLE = 400_000
"""Values up to which trials are simulated anew beside every fit; beyond, they are as beside nothing."""
BRIEF = 2
"""Steps of a first, brief fit."""
SETTLED, SHORTEST = 2.0, 0.1
"""Gain of log evidence under which a fit has settled, and the shortest stride; what sticks makes both rough."""


@dataclass(frozen=True)
class Unknown:
    """A parameter that may be wrong.

    Attributes:
        key: effect and parameter.
        mean: value that is expected; of a limit, one that nothing reaches.
        std: width of its prior.
        low, high: bounds.
        step: difference by which a derivative is taken from a value.
        tolerance: standard deviation where its effect is not suspected: what a well-built rig shows unremarked.
        slight: distance from the mean up to which it is no finding.
        fine: share of `step` that is taken along a path: pulses there leave of a parameter's effect only what differs
            from theirs, which a large step would overstate.
        centre: middle of its prior where its effect is suspected; None for the mean.
    """

    key: Key
    mean: float
    std: float
    low: float
    high: float
    step: Callable[[float], float]
    tolerance: float = 0.0
    slight: float = 0.0
    fine: float = 1.0
    centre: float | None = None

    @property
    def middle(self) -> float:
        """Of its prior where its effect is suspected."""
        return self.mean if self.centre is None else self.centre


class Simulator(Protocol):
    """K windows of a simulation beside what was measured, M values each in C channels."""

    scale_prior: ScalePrior

    def residuals(self, points: Sequence[Point], about: Point, path: np.ndarray | None = None) -> np.ndarray:
        """Measured less simulated at every point, (V, K, M), finite, from starting states as seen `about` one.

        Along a path of starting states and force pulses in units of their priors, (K, N), if there is one.
        """

    def respond(self, point: Point, path: np.ndarray | None = None) -> Nuisance:
        """What starting states and force pulses do about a point, and a path, in units of their priors."""


@dataclass(frozen=True)
class Trial:
    """Parameters from which a fit of an effect may start where slopes lead nowhere.

    Attributes:
        effect: of which they are.
        values: of its parameters.
        scales: the first of them, in proportion to which it acts; None where it does not.
    """

    effect: str
    values: Mapping[Key, float]
    scales: Unknown | None = None


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its most probable parameters.

    Attributes:
        effects: that are free.
        values: of their parameters.
        posterior: of those, in the order of `values`, and then of what is within its tolerance.
        windows: compressed about `values`.
        prior: of the parameters.
        path: about which all was simulated, (K, N).
        hope: log marginal likelihood where the linear model about `values` has its optimum, paths and all.
        lent: whether responses are those of the fit that it is beside: its evidence is only a first guess.
    """

    effects: frozenset[str]
    values: dict[Key, float]
    posterior: Posterior
    windows: Windows
    prior: Prior
    path: np.ndarray
    hope: float
    lent: bool = False

    @property
    def evidence(self) -> float:
        """Log marginal likelihood, up to a constant of the data (Laplace's approximation)."""
        return -0.5 * (self.posterior.deviance + self.posterior.penalty)

    @property
    def std(self) -> dict[Key, float]:
        """Standard deviation of every parameter."""
        return dict(zip(self.values, np.sqrt(np.diag(self.posterior.covariance)).tolist()))


class Fitter:
    """Fits hypotheses on one simulator. What it remembers is keyed by value: the order of questions cannot matter.

    Args:
        simulator: of all windows.
        unknowns: parameters of all effects that are candidates.
        trials: where else fits may start.
        scout: of some of the windows, on which candidates are screened; None for all.
    """

    def __init__(
        self, simulator: Simulator, unknowns: Sequence[Unknown], trials: Sequence[Trial] = (),
        scout: Simulator | None = None,
    ) -> None:  # fmt: skip
        self.simulator, self.scout = simulator, scout or simulator
        self.unknowns = tuple(sorted(unknowns, key=lambda u: u.key))
        self.trials = tuple(sorted(trials, key=lambda t: (t.effect, sorted(t.values.items()))))
        self._fits: dict[Hashable, Fit] = {}
        self._loose: dict[frozenset[int], list[int]] = {}
        self._nominal: dict[int, np.ndarray] = {}

    def of(self, effects: frozenset[str]) -> list[Unknown]:
        """The parameters of some effects, in the order of their keys."""
        return [u for u in self.unknowns if u.key[0] in effects]

    def is_slight(self, fit: Fit, effect: str) -> bool:
        """Whether an effect stays so near to nothing that it would be no finding."""
        return all(abs(fit.values[u.key] - u.mean) <= u.slight for u in self.of(frozenset({effect})))

    def linearise(self, values: Point, unknowns: Sequence[Unknown], nuisance: Nuisance, path: np.ndarray) -> Windows:
        """Windows about a point: derivatives by some parameters, and those of what is within its tolerance."""
        residual, slopes, at = differentiate(self.simulator, values, unknowns, path)
        loose = self.loose({u.key[0] for u in unknowns})
        if new := [i for i in loose if i not in self._nominal]:
            alike = self.scout is self.simulator
            found = (
                self.nominal[0][new] if alike else differentiate(self.simulator, {}, [self.unknowns[i] for i in new])[1]
            )
            self._nominal |= dict(zip(new, found))
        slopes = np.concatenate([slopes, *(self._nominal[i][None] for i in loose)])
        at = np.concatenate([at, [self.unknowns[i].mean for i in loose]])
        return nuisance.compress(slopes, residual, at, path)

    @cached_property
    def nominal(self) -> tuple[np.ndarray, np.ndarray]:
        """Slopes by every parameter about the nominal point, (P, k, M), and changes by trials, (T, k, M), of scouts."""
        _, slopes, _ = differentiate(self.scout, {}, self.unknowns)
        if not self.trials:
            return slopes, np.empty((0, *slopes.shape[1:]))
        residuals = self.scout.residuals([{}, *(t.values for t in self.trials)], {})
        return slopes, residuals[0] - residuals[1:]

    @cached_property
    def noticed(self) -> tuple[list[int], np.ndarray]:
        """Parameters with a tolerance that measurements notice, (L,), and how they do, (L, L).

        That is the information on them, in squares of their tolerances, under the noise that is expected.
        """
        size = np.array([u.tolerance for u in self.unknowns])
        rows = np.flatnonzero(size)
        nuisance = self.scout.respond({})
        windows = nuisance.compress(self.nominal[0][rows], np.zeros(nuisance.columns.shape[:2]), np.zeros(len(rows)))
        found = windows.eliminate(self.simulator.scale_prior.start).information[:-1, :-1]
        found = self._share * found * size[rows] * size[rows, None]
        kept = np.flatnonzero(np.diag(found) > NOTICED)
        return [int(i) for i in rows[kept]], found[np.ix_(kept, kept)]

    @cached_property
    def _share(self) -> float:
        """Windows for every one that scouts look at."""
        count, few = (len(each.respond({}).columns) for each in (self.simulator, self.scout))
        return count / few

    def loose(self, effects: Collection[str]) -> list[int]:
        """Parameters that move within their tolerance beside some effects that are free.

        Those that are noticed and that no others make up for: pivots of a Cholesky factor, the largest first.
        """
        own = frozenset(i for i in self.noticed[0] if self.unknowns[i].key[0] in effects)
        if own not in self._loose:
            rest = [k for k, i in enumerate(self.noticed[0]) if i not in own]
            chosen = pick_pivots(self.noticed[1][np.ix_(rest, rest)], NOTICED, MOST_LOOSE)
            self._loose[own] = sorted(self.noticed[0][rest[k]] for k in chosen)
        return self._loose[own]

    def prior_of(self, unknowns: Sequence[Unknown]) -> Prior:
        """The prior of some parameters, and of what is within its tolerance beside them, as `linearise` has them."""
        loose = [self.unknowns[i] for i in self.loose({u.key[0] for u in unknowns})]
        rows = [(u.middle, u.std, u.low, u.high) for u in unknowns]
        reach = [(u, WIDEST * u.tolerance) for u in loose]
        rows += [(u.mean, u.tolerance, max(u.low, u.mean - r), min(u.high, u.mean + r)) for u, r in reach]
        return Prior(*np.array(rows).reshape(-1, 4).T)

    def condition(self, fit: Fit, effects: frozenset[str]) -> dict[Key, float]:
        """Most probable values of some effects of a fit where the others are off, in its Gaussian posterior.

        E[a | b = b₀] = a - P_aa⁻¹ P_ab (b₀ - b) with the precision P (BDA3, appendix A). Where a limit goes, which is
        off at a value that nothing reaches, the values of the fit.
        """
        unknowns = self.of(fit.effects)
        kept = np.array([u.key[0] in effects for u in unknowns], bool)
        within = np.append(kept, np.ones(len(fit.prior.mean) - len(kept), bool))
        away = np.array([u.mean - fit.values[u.key] for u in unknowns])[~kept]
        if any(u.centre is not None for u, k in zip(unknowns, kept) if not k):
            return {key: value for key, value in fit.values.items() if key[0] in effects}
        precision = fit.posterior.precision
        across = precision[np.ix_(within, np.flatnonzero(~within))]
        moved = -solve(precision[np.ix_(within, within)], across @ away)[: int(kept.sum())]
        own = [u for u, k in zip(unknowns, kept) if k]
        return {u.key: float(np.clip(fit.values[u.key] + m, u.low, u.high)) for u, m in zip(own, moved)}

    def screen(self, fit: Fit) -> list[np.ndarray]:
        """Inner products of parameters, trials and what a fit misses, (P + T + 1, P + T + 1), under its noise.

        Those under a process noise as calm as its prior expects, too: pulses take all that a missing cause does, and
        with as strong ones as that needs no slope leads to it.
        """
        scales, values, nuisance = fit.posterior.scales, fit.values, self.scout.respond(fit.values)
        path = smooth(self.scout, values, [np.zeros((len(nuisance.gram), fit.path.shape[1]))], nuisance, scales)
        nuisance = self.scout.respond(values, path)
        path = smooth(self.scout, values, [path], nuisance, scales)
        residual, slopes, _ = differentiate(self.scout, values, self.unknowns, path)
        changed = self.nominal[1]
        if values and len(self.trials) * residual.size < AFFORDABLE:
            points = [dict(values), *({**values, **t.values} for t in self.trials)]
            residuals = self.scout.residuals(points, values, path)
            changed = residuals[0] - residuals[1:]
        every = np.concatenate([slopes, changed])
        windows = nuisance.merge(scales).compress(every, residual, np.zeros(len(every)), path)
        calm = np.minimum(scales.process, np.log(self.simulator.scale_prior.process_median))
        strengths = [Scales(np.zeros(1), each) for each in (scales.process, calm)]
        return [self._share * windows.eliminate(each).information for each in strengths]

    def fit(
        self, effects: frozenset[str], start: Point, scales: Scales | None = None, steps: int = STEPS,
        beside: Fit | None = None,
    ) -> Fit:  # fmt: skip
        """Most probable parameters of some effects, from a start, after so many steps at most.

        Args:
            effects: that are free.
            start: where their parameters begin.
            scales: where those of the noises do.
            steps: of Gauss-Newton.
            beside: a fit whose path serves to begin with, and in a brief fit its responses.
        """
        unknowns, simulator = self.of(effects), self.simulator
        prior = self.prior_of(unknowns)
        values = {u.key: float(start.get(u.key, u.mean)) for u in unknowns}
        scales = scales or simulator.scale_prior.start
        path, led = (beside.path, beside.values) if beside else (None, values)
        told = None if path is None else (path.tobytes(), frozenset(led.items()))
        key = effects, frozenset(values.items()), steps, scales.sensor.tobytes(), scales.process.tobytes(), told
        if key in self._fits:
            return self._fits[key]
        lent = steps <= BRIEF and path is not None
        nuisance = simulator.respond(led, path)
        if path is None:
            path = np.zeros((len(nuisance.gram), nuisance.columns.shape[2]))
        best, stride, ahead, taken = None, 1.0, np.empty(0), 0
        rough = any(u.fine == 1.0 for u in unknowns)
        anew = rough and beside is not None
        while taken < steps:  # a stride that is too long is no step
            begun = [path] if best is None else [path, best.path]
            if anew:  # a path without friction, or a limit, has pulses that make up for it
                begun.append(smooth(simulator, values, [np.zeros_like(path)], simulator.respond(values), scales))
            path = smooth(simulator, values, begun, nuisance, scales)
            known = nuisance if lent else simulator.respond(values, path)
            fit, there = self._look(values, effects, known, path, scales, prior)
            fit = replace(fit, lent=lent)
            gain = np.inf if best is None or best.lent > lent else fit.evidence - best.evidence
            if gain > 0.0:
                best, ahead, stride, scales, nuisance = fit, there.mean, min(1.0, 2.0 * stride), there.scales, known
                taken += 1
                if lent and taken == steps and fit.hope - fit.evidence > SETTLED:
                    lent, taken = False, taken - 1  # it responds otherwise than what it is beside
                    values, path = dict(best.values), best.path
                    continue
                if gain < SETTLED and (anew or not rough):
                    break
                anew = rough and gain < SETTLED
            else:
                stride *= 0.4
                if stride < SHORTEST:
                    break
            assert best is not None
            at = best.windows.at + stride * (ahead - best.windows.at)
            at[len(unknowns) :] = best.windows.at[len(unknowns) :]
            moved = np.clip(at, prior.low, prior.high)
            values = {u.key: float(v) for u, v in zip(unknowns, moved)}
            path = foretell(best.windows, moved, scales)
        assert best is not None
        self._fits[key] = best
        return best

    def _look(
        self, values: dict[Key, float], effects: frozenset[str], nuisance: Nuisance, path: np.ndarray,
        scales: Scales, prior: Prior,
    ) -> tuple[Fit, Posterior]:  # fmt: skip
        """A hypothesis at given parameters, and the posterior of these by its linear model."""
        unknowns, scale_prior = self.of(effects), self.simulator.scale_prior
        windows = self.linearise(values, unknowns, nuisance, path)
        here = infer(windows, prior, scale_prior, scales, np.arange(len(windows.at)) < len(unknowns))
        there = infer(windows, prior, scale_prior, here.scales) if unknowns else here
        cost = here.deviance + strain(windows, here.scales)
        penalised = Posterior(here.mean, there.precision, cost, there.penalty, here.scales)
        hope = -0.5 * (there.deviance + there.penalty)
        return Fit(effects, values, penalised, windows, prior, path, hope), there


def differentiate(
    simulator: Simulator, values: Point, unknowns: Sequence[Unknown], path: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual (K, M) at a point, derivatives of the simulation by parameters, (P, K, M), and where, (P,)."""
    at = np.array([values.get(u.key, u.mean) for u in unknowns])
    steps = [u.step(v) * (1.0 if path is None else u.fine) for u, v in zip(unknowns, at)]
    moved = np.array([np.clip(v + step, u.low, u.high) for u, v, step in zip(unknowns, at, steps)])
    points = [dict(values), *({**values, u.key: float(v)} for u, v in zip(unknowns, moved))]
    residuals, apart = simulator.residuals(points, values, path), moved - at
    return residuals[0], (residuals[0] - residuals[1:]) / np.where(apart == 0.0, 1.0, apart)[:, None, None], at


def pick_pivots(matrix: np.ndarray, least: float, most: int) -> list[int]:
    """Rows of a covariance (n, n) that leave no other with a variance above `least`, `most` rows at most.

    Pivots of its Cholesky factor (Higham, Analysis of the Cholesky decomposition of a semi-definite matrix, 1990).
    """
    chosen: list[int] = []
    left, factors = np.diag(matrix).copy(), np.empty((0, len(matrix)))
    while len(chosen) < most and left.size and left.max() > least:
        row = int(left.argmax())
        factor = (matrix[row] - factors[:, row] @ factors) / np.sqrt(left[row])
        factors, left = np.vstack([factors, factor]), left - factor**2
        left[row] = 0.0
        chosen.append(row)
    return chosen
