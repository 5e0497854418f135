"""Fits of hypotheses: Gauss-Newton on the simulation itself, noise scales inferred at every step."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from vpptwin.inference.model import Layout, Posterior, Prior, ScalePrior, Scales, Windows, infer

Key = tuple[str, str]
"""Effect id and parameter name."""
Point = Mapping[Key, float]
STEPS, SHORTEST = 15, 0.1
"""Steps of Gauss-Newton at most, and the shortest stride."""
WIDEST = 3.0
"""Tolerances by which what is not suspected may be off."""
NOTICED = 0.5
"""Square of the signal to noise from which a tolerance is noticed."""
AFFORDABLE = 400_000
"""Values up to which trials are simulated anew beside every fit; beyond, they are as beside nothing."""
SETTLED = 0.15
"""Gain of log evidence under which a fit has settled."""


@dataclass(frozen=True)
class Unknown:
    """A parameter that may be wrong.

    Attributes:
        key: effect and parameter.
        mean: value that is expected.
        std: width of its prior.
        low, high: bounds.
        step: difference by which a derivative is taken from a value.
        tolerance: standard deviation where its effect is not suspected: what a well-built rig shows unremarked.
    """

    key: Key
    mean: float
    std: float
    low: float
    high: float
    step: Callable[[float], float]
    tolerance: float = 0.0


class Simulator(Protocol):
    """K windows of a simulation beside what was measured, M values each in C channels."""

    noise: np.ndarray  # assumed standard deviation of every value, (K, M); infinite where nothing was measured
    columns: Sequence[slice]  # where every channel lies among the M
    process: np.ndarray  # degree of freedom of every force pulse, (G,)
    scale_prior: ScalePrior

    def residuals(self, points: Sequence[Point], about: Point) -> np.ndarray:
        """Measured less simulated at every point, (V, K, M), finite, from starting states as seen `about` one."""

    def respond(self, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by starting states and force pulses, in units of their priors, (K, M, S) and (K, M, G)."""


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
    """

    effects: frozenset[str]
    values: dict[Key, float]
    posterior: Posterior
    windows: Windows
    prior: Prior

    @property
    def evidence(self) -> float:
        """Log marginal likelihood, up to a constant of the data (Laplace's approximation)."""
        return -0.5 * (self.posterior.deviance + self.posterior.penalty)

    @property
    def std(self) -> dict[Key, float]:
        """Standard deviation of every parameter."""
        return dict(zip(self.values, np.sqrt(np.diag(self.posterior.covariance)).tolist()))


class Fitter:
    """Fits hypotheses on one simulator. What it remembers is keyed by value: the order of questions cannot matter."""

    def __init__(self, simulator: Simulator, unknowns: Sequence[Unknown], trials: Sequence[Trial] = ()) -> None:
        self.simulator = simulator
        self.unknowns = tuple(sorted(unknowns, key=lambda u: u.key))
        self.trials = tuple(sorted(trials, key=lambda t: (t.effect, sorted(t.values.items()))))
        self._fits: dict[Hashable, Fit] = {}

    def of(self, effects: frozenset[str]) -> list[Unknown]:
        """The parameters of some effects, in the order of their keys."""
        return [u for u in self.unknowns if u.key[0] in effects]

    def linearise(self, values: Point, unknowns: Sequence[Unknown]) -> Windows:
        """Windows about a point: derivatives by some parameters, and those of what is within its tolerance."""
        residual, slopes, at = self.differentiate(values, unknowns)
        loose = self.loose({u.key[0] for u in unknowns})
        slopes = np.concatenate([slopes, self.nominal[0][loose]]) if loose else slopes
        at = np.concatenate([at, [self.unknowns[i].mean for i in loose]])
        return self.compress(slopes, residual, at, self.simulator.respond(values))

    def differentiate(self, values: Point, unknowns: Sequence[Unknown]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual (K, M) at a point, derivatives of the simulation by parameters, (P, K, M), and where, (P,)."""
        at = np.array([values.get(u.key, u.mean) for u in unknowns])
        moved = np.array([np.clip(v + u.step(v), u.low, u.high) for u, v in zip(unknowns, at)])
        points = [dict(values), *({**values, u.key: float(v)} for u, v in zip(unknowns, moved))]
        residuals, steps = self.simulator.residuals(points, values), moved - at
        return residuals[0], (residuals[0] - residuals[1:]) / np.where(steps == 0.0, 1.0, steps)[:, None, None], at

    @cached_property
    def tolerated(self) -> list[int]:
        """Parameters whose tolerance these measurements would notice."""
        noise = self.simulator.noise
        return [
            i for i, u in enumerate(self.unknowns)
            if u.tolerance > 0.0 and float((((self.nominal[0][i] * u.tolerance) / noise) ** 2).sum()) > NOTICED
        ]  # fmt: skip

    def loose(self, effects: Collection[str]) -> list[int]:
        """Parameters that move within their tolerance beside some effects that are free."""
        return [i for i in self.tolerated if self.unknowns[i].key[0] not in effects]

    def compress(
        self, slopes: np.ndarray, residual: np.ndarray, at: np.ndarray, response: tuple[np.ndarray, np.ndarray]
    ) -> Windows:
        """Windows from derivatives (P, K, M) and a residual (K, M)."""
        simulator = self.simulator
        states, pushes = response
        layout = Layout(simulator.noise, simulator.columns, simulator.process)
        return Windows.compress(slopes, states, pushes, residual, at, layout)

    def prior_of(self, unknowns: Sequence[Unknown]) -> Prior:
        """The prior of some parameters, and of what is within its tolerance beside them, as `linearise` has them."""
        loose = [self.unknowns[i] for i in self.loose({u.key[0] for u in unknowns})]
        rows = [(u.mean, u.std, u.low, u.high) for u in unknowns]
        reach = [(u, WIDEST * u.tolerance) for u in loose]
        rows += [(u.mean, u.tolerance, max(u.low, u.mean - r), min(u.high, u.mean + r)) for u, r in reach]
        return Prior(*np.array(rows).reshape(-1, 4).T)

    @cached_property
    def nominal(self) -> tuple[np.ndarray, np.ndarray]:
        """Slopes by every parameter about the nominal point, (P, K, M), and changes by trials, (T, K, M)."""
        _, slopes, _ = self.differentiate({}, self.unknowns)
        if not self.trials:
            return slopes, np.empty((0, *slopes.shape[1:]))
        residuals = self.simulator.residuals([{}, *(t.values for t in self.trials)], {})
        return slopes, residuals[0] - residuals[1:]

    def screen(self, fit: Fit) -> np.ndarray:
        """Inner products of parameters, trials and what a fit misses, (P + T + 1, P + T + 1), under its noise."""
        simulator, scales, values = self.simulator, fit.posterior.scales, fit.values
        residual, slopes, _ = self.differentiate(values, self.unknowns)
        changed = self.nominal[1]
        if values and len(self.trials) * residual.size < AFFORDABLE:
            points = [dict(values), *({**values, **t.values} for t in self.trials)]
            residuals = simulator.residuals(points, values)
            changed = residuals[0] - residuals[1:]
        noise = simulator.noise.copy()
        for columns, scale in zip(simulator.columns, np.exp(scales.sensor)):
            noise[:, columns] *= scale
        every = np.concatenate([slopes, changed])
        states, pushes = simulator.respond(values)
        layout = Layout(noise, [slice(None)], simulator.process)
        windows = Windows.compress(every, states, pushes, residual, np.zeros(len(every)), layout)
        return windows.eliminate(Scales(np.zeros(1), scales.process)).information

    def fit(self, effects: frozenset[str], start: Point, scales: Scales | None = None, steps: int = STEPS) -> Fit:
        """Most probable parameters of some effects, from a start, after so many steps at most."""
        unknowns = self.of(effects)
        prior = self.prior_of(unknowns)
        values = {u.key: float(start.get(u.key, u.mean)) for u in unknowns}
        scales = scales or self.simulator.scale_prior.start
        key = effects, frozenset(values.items()), steps, scales.sensor.tobytes(), scales.process.tobytes()
        if key in self._fits:
            return self._fits[key]
        scale_prior = self.simulator.scale_prior
        best, stride, ahead, taken = None, 1.0, np.empty(0), 0
        while taken < (steps if unknowns else 1):  # a stride that is too long is no step
            windows = self.linearise(values, unknowns)
            here = infer(windows, prior, scale_prior, scales, np.arange(len(windows.at)) < len(unknowns))
            there = infer(windows, prior, scale_prior, here.scales) if unknowns else here
            penalised = Posterior(here.mean, there.precision, here.deviance, there.penalty, here.scales)
            fit = Fit(effects, values, penalised, windows, prior)
            gain = np.inf if best is None else fit.evidence - best.evidence
            if gain > 0.0:
                best, ahead, stride, scales = fit, there.mean, min(1.0, 2.0 * stride), there.scales
                taken += 1
                if gain < SETTLED:
                    break
            else:
                stride *= 0.4
                if stride < SHORTEST:
                    break
            at = best.windows.at if best else windows.at
            moved = np.clip(at + stride * (ahead - at), prior.low, prior.high)[: len(unknowns)]
            if np.allclose(moved, windows.at[: len(unknowns)], rtol=1e-9, atol=0.0):
                break
            values = {u.key: float(v) for u, v in zip(unknowns, moved)}
        assert best is not None
        self._fits[key] = best
        return best
