"""The unknowns of a diagnosis: every parameter of every effect, with what is believed of it before any data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from vpptwin.diagnosis.bench import Key
from vpptwin.effects import Effect, Parameter
from vpptwin.twin.spec import TwinSpec

STRETCH = 4
"""Neighbouring windows that count as one when the scatter of a parameter is judged: gusts outlast a window."""
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
    def step(self) -> float:
        """Secant step: a physically typical size, turned around where it would leave the bounds."""
        size = self.parameter.size
        return size if self.nominal + size <= self.parameter.high else -size

    def step_from(self, value: float) -> float:
        """Secant step from a value other than the nominal, shortened where neither way has room for all of it."""
        low, high = self.parameter.low, self.parameter.high
        for step in (self.step, -self.step):
            if low <= value + step <= high:
                return step
        return high - value if high - value > value - low else low - value


def list_unknowns(spec: TwinSpec) -> tuple[Unknown, ...]:
    """All parameters of all effects that this rig can have."""
    return tuple(Unknown(e, p, spec.value(e, p.name)) for e in spec.catalogue for p in e.parameters)


@dataclass(frozen=True)
class Linearisation:
    """Whitened residual and its derivative by every unknown, about a twin with the parameters `at`.

    Attributes:
        at: (P,) in the parameters' units; deviations count from here.
        columns: derivative of the whitened prediction, (P, M).
        residual: whitened residual, (M,).
    """

    at: np.ndarray
    columns: np.ndarray
    residual: np.ndarray


@dataclass(frozen=True)
class Solution:
    """Minimum of a penalised fit: parameter deviations from the point of linearisation, and the cost there."""

    deviation: np.ndarray
    cost: float
    covariance: np.ndarray


def solve_hypothesis(
    fit: Linearisation, unknowns: tuple[Unknown, ...], freed: frozenset[str], scale: float
) -> Solution:
    """Most probable parameters if the effects `freed` are wrong and all others sit within their build tolerance.

    Args:
        fit: the linearised windows.
        unknowns: their parameters.
        freed: ids of effects whose parameters the data may move anywhere inside the bounds.
        scale: variance of the whitened residual under the model: costs are divided by it.
    """
    nominal = np.array([u.nominal for u in unknowns])
    width = np.array(
        [
            0.5 * (u.parameter.high - u.parameter.low) if u.effect.id in freed else max(u.parameter.tolerance, 1e-12)
            for u in unknowns
        ]
    )
    held = np.array([u.effect.id not in freed for u in unknowns])
    low = np.array([u.parameter.low for u in unknowns])
    high = np.array([u.parameter.high for u in unknowns])
    low = np.where(held, np.maximum(low, nominal - MOST_TOLERATED * width), low) - fit.at
    high = np.where(held, np.minimum(high, nominal + MOST_TOLERATED * width), high) - fit.at
    pull = nominal - fit.at
    unit = np.maximum(np.array([u.parameter.size for u in unknowns]), 1e-12)
    full_gram, slope = fit.columns @ fit.columns.T, fit.columns @ fit.residual
    gram = full_gram / scale * unit[:, None] * unit
    hessian = gram + np.diag((unit / width) ** 2)
    target = slope / scale * unit + unit / width**2 * pull
    factor = np.linalg.cholesky(hessian + 1e-9 * np.diag(np.diag(hessian)))
    wanted = np.linalg.solve(factor, target)
    margin = 1e-12
    bounded = lsq_linear(factor.T, wanted, bounds=((low - margin) / unit, (high + margin) / unit))
    deviation = bounded.x * unit
    cost = (fit.residual @ fit.residual - 2.0 * slope @ deviation + deviation @ full_gram @ deviation) / scale
    cost += float(np.sum(((deviation - pull) / width) ** 2))
    covariance = np.linalg.inv(hessian) * unit[:, None] * unit
    return Solution(deviation, float(cost), covariance)


def scatter_by_window(fit: Linearisation, solution: Solution, windows: int, scale: float) -> np.ndarray:
    """Standard deviation of every parameter from how much stretches of flight disagree about it, (P,).

    The sandwich estimate with stretches of a few windows as clusters: unlike the curvature alone it notices residuals
    that are larger, or more alike from window to window, than the noise model says.
    """
    residual = fit.residual - solution.deviation @ fit.columns
    scores = (fit.columns * residual).reshape(len(fit.columns), windows, -1).sum(axis=2) / scale
    starts = np.arange(0, windows, STRETCH)
    spread = solution.covariance @ np.add.reduceat(scores, starts, axis=1)
    return np.sqrt((spread**2).sum(axis=1))
