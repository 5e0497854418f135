"""The unknowns of a diagnosis: every parameter of every effect, with what is believed of it before any data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.optimize import lsq_linear

from vpptwin.diagnosis.evidence.bench import Bench, Key
from vpptwin.effects import Effect, Parameter
from vpptwin.twin.spec import TwinSpec

STRETCH = 1.2
"""Windows within this time [s] count as one when the scatter of a parameter is judged: gusts outlast a window."""
LIMIT_STEP = 0.15
"""Secant step of a limit, as a share of its value."""
MOST_TOLERATED = 3.0
"""An effect that is not freed stays within this many of its build tolerances."""


@dataclass(frozen=True)
class Unknown:
    """One parameter under suspicion: nominal is its value in the twin that is diagnosed."""

    effect: Effect
    parameter: Parameter
    nominal: float

    @property
    def key(self) -> Key:
        """Effect id and parameter name."""
        return self.effect.id, self.parameter.name

    @property
    def is_limit(self) -> bool:
        """A rate, an angle, an output that nothing exceeds: off at the upper bound, it acts far below it or not."""
        parameter = self.parameter
        typical = parameter.prior.b if parameter.prior.kind == "uniform" else parameter.prior.a
        return parameter.off >= parameter.high and self.nominal > typical

    @property
    def width(self) -> float:
        """Range within which the parameter is looked for once its effect is under suspicion."""
        prior, parameter = self.parameter.prior, self.parameter
        spread = prior.b - prior.a if prior.kind == "uniform" else 3.0 * prior.b
        return spread if self.is_limit else min(max(spread, 3.0 * parameter.size), parameter.high - parameter.low)

    def scale_at(self, value: float) -> float:
        """A natural unit of the parameter about a value, for well-conditioned algebra."""
        return LIMIT_STEP * value if self.is_limit else max(self.parameter.size, 1e-12)

    def step_from(self, value: float) -> float:
        """Secant step from a value: a physically typical size, turned or shortened where the bounds leave no room."""
        low, high = self.parameter.low, self.parameter.high
        if self.is_limit:
            return -LIMIT_STEP * value if value * (1.0 - LIMIT_STEP) >= low else LIMIT_STEP * value
        for step in (self.parameter.size, -self.parameter.size):
            if low <= value + step <= high:
                return step
        return high - value if high - value > value - low else low - value


def list_unknowns(spec: TwinSpec) -> tuple[Unknown, ...]:
    """All parameters of all effects that this rig can have."""
    return tuple(Unknown(e, p, spec.value(e, p.name)) for e in spec.catalogue for p in e.parameters)


@dataclass(frozen=True)
class Trial:
    """An effect switched on at one place of its range: shapes and limits show in no derivative at the off value."""

    effect: str
    values: Mapping[Key, float]
    limit: bool


def list_trials(unknowns: tuple[Unknown, ...], bench: Bench) -> tuple[Trial, ...]:
    """Trials of every effect that has a limit, or a shape that matters more than its typical size tells."""
    effects: dict[str, list[Unknown]] = {}
    for unknown in unknowns:
        effects.setdefault(unknown.effect.id, []).append(unknown)
    trials = []
    for effect, (strength, *shapes) in effects.items():
        if strength.nominal != strength.parameter.off:
            continue
        if strength.is_limit:
            for value in list_limits(strength, bench):
                trials.append(Trial(effect, {strength.key: value}, True))
            continue
        grids = [grid_of_shape(shape, len(shapes) == 1) for shape in shapes]
        places = list(product(*grids))
        if len(places) < 2:
            continue
        size = strength.nominal + strength.step_from(strength.nominal)
        for place in places:
            values = {shape.key: float(value) for shape, value in zip(shapes, place)}
            trials.append(Trial(effect, {strength.key: size, **values}, False))
    return tuple(trials)


def grid_of_shape(shape: Unknown, alone: bool) -> np.ndarray:
    """Values of a parameter of shape from which a fit may start.

    Args:
        shape: a place, a speed, a width.
        alone: it is the only one of its effect. Then speeds and widths are tried at either side of their typical size;
            places always are, three of their typical sizes apart over the likely part of their prior.
    """
    parameter = shape.parameter
    grid: np.ndarray
    if parameter.low > 0.0:
        grid = np.array([0.6, 1.0, 1.6] if alone else [1.0]) * shape.nominal
    else:
        count = int(1.5 * parameter.prior.b / (3.0 * parameter.size))
        grid = np.arange(-count, count + 1) * 3.0 * parameter.size + shape.nominal
    return grid[(grid >= parameter.low) & (grid <= parameter.high)]


def list_limits(limit: Unknown, bench: Bench) -> list[float]:
    """Limits that the logged commands would run into, from hardly to badly."""
    if limit.effect.follows == "command change":
        span = float(np.ptp(np.percentile(bench.windows.command, [2.0, 98.0])))
        found = span / np.array([0.03, 0.06, 0.12, 0.25, 0.5])
    else:
        found = np.percentile(np.abs(bench.windows.command), [98.0, 90.0, 75.0, 50.0]) * 0.97
    inside = (found >= limit.parameter.low) & (found <= limit.parameter.high)
    return [float(value) for value in found[inside]]


@dataclass(frozen=True)
class Linearisation:
    """Whitened residual and its derivative by every unknown, about a twin with the parameters `at`.

    Attributes:
        at: (P,) in the parameters' units; deviations count from here.
        slopes: derivative of the prediction, (P, K, M).
        missed: residual, (K, M).
        trials: change of the prediction by every trial, (T, K, M).
        columns: whitened derivative, (P, K M).
        residual: whitened residual, (K M,).
        tried: whitened change of the prediction by every trial, (T, K M).
    """

    at: np.ndarray
    slopes: np.ndarray
    missed: np.ndarray
    trials: np.ndarray
    columns: np.ndarray
    residual: np.ndarray
    tried: np.ndarray

    @cached_property
    def gram(self) -> np.ndarray:
        """Inner products of the columns, (P, P)."""
        return self.columns @ self.columns.T

    @cached_property
    def slope(self) -> np.ndarray:
        """Inner products of columns and residual, (P,)."""
        return self.columns @ self.residual


@dataclass(frozen=True)
class Solution:
    """Minimum of a penalised fit: parameter deviations from the point of linearisation, and the cost there."""

    deviation: np.ndarray
    cost: float
    covariance: np.ndarray


def solve_hypothesis(
    fit: Linearisation,
    unknowns: tuple[Unknown, ...],
    freed: frozenset[str],
    scale: float,
    frozen: bool = False,
) -> Solution:
    """Most probable parameters if the effects `freed` are wrong and all others sit within their build tolerance.

    Args:
        fit: the linearised windows.
        unknowns: their parameters.
        freed: ids of effects whose parameters the data may move anywhere inside the bounds.
        scale: variance of the whitened residual under the model: costs are divided by it.
        frozen: the freed parameters stay where they are; only the others move.
    """
    nominal = np.array([u.nominal for u in unknowns])
    free = np.array([u.effect.id in freed for u in unknowns])
    width = np.array([u.width if f else max(u.parameter.tolerance, 1e-12) for u, f in zip(unknowns, free)])
    low = np.array([u.parameter.low for u in unknowns])
    high = np.array([u.parameter.high for u in unknowns])
    low = np.where(free, low, np.maximum(low, nominal - MOST_TOLERATED * width)) - fit.at
    high = np.where(free, high, np.minimum(high, nominal + MOST_TOLERATED * width)) - fit.at
    # A freed parameter is not drawn anywhere: only its range is known.
    pull = np.where(free, 0.0, nominal - fit.at)
    moving = ~(free & frozen)
    unit = np.array([u.scale_at(at) for u, at in zip(unknowns, fit.at)])[moving]
    gram, slope = fit.gram[np.ix_(moving, moving)], fit.slope[moving]
    hessian = gram / scale * unit[:, None] * unit + np.diag((unit / width[moving]) ** 2)
    target = slope / scale * unit + unit / width[moving] ** 2 * pull[moving]
    factor = np.linalg.cholesky(hessian + 1e-9 * np.diag(np.diag(hessian)))
    wanted = np.linalg.solve(factor, target)
    margin = 1e-12
    bounds = (low[moving] - margin) / unit, (high[moving] + margin) / unit
    inside = np.linalg.solve(factor.T, wanted)
    if np.any(inside < bounds[0]) or np.any(inside > bounds[1]):
        inside = lsq_linear(factor.T, wanted, bounds=bounds, method="bvls").x
    step = inside * unit
    deviation = np.zeros(len(unknowns))
    deviation[moving] = step
    cost = (fit.residual @ fit.residual - 2.0 * slope @ step + step @ gram @ step) / scale
    held = ~free
    cost += float(np.sum(((deviation[held] - pull[held]) / width[held]) ** 2))
    covariance = np.zeros((len(unknowns), len(unknowns)))
    covariance[np.ix_(moving, moving)] = np.linalg.inv(hessian) * unit[:, None] * unit
    return Solution(deviation, float(cost), covariance)


def price_of_freedom(solution: Solution, unknowns: tuple[Unknown, ...], freed: frozenset[str]) -> float:
    """What a fit must gain to pay for its freedom: twice the log of prior range over posterior width (Laplace)."""
    free = [i for i, u in enumerate(unknowns) if u.effect.id in freed]
    if not free:
        return 0.0
    width = np.array([unknowns[i].width for i in free])
    share = solution.covariance[np.ix_(free, free)] / width[:, None] / width
    return float(-np.linalg.slogdet(share + 1e-12 * np.eye(len(free)))[1])


def scatter_by_stretch(fit: Linearisation, solution: Solution, bench: Bench, scale: float) -> np.ndarray:
    """Standard deviation of every parameter from how much stretches of flight disagree about it, (P,).

    The sandwich estimate with stretches of a few windows as clusters: unlike the curvature alone it notices residuals
    that are larger, or more alike from window to window, than the noise model says.
    """
    residual = fit.residual - solution.deviation @ fit.columns
    scores = (fit.columns * residual).reshape(len(fit.columns), len(bench.windows), -1).sum(axis=2) / scale
    stretch = np.floor(bench.windows.start / STRETCH).astype(int) + 10**6 * bench.windows.flight
    _, index = np.unique(stretch, return_inverse=True)
    sums = np.zeros((index.max() + 1, len(scores)))
    np.add.at(sums, index, scores.T)
    return np.sqrt(((sums @ solution.covariance) ** 2).sum(axis=0))
