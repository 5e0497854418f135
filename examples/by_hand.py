"""Fits by hand, numpy and scipy only: what the examples with real logs hold a diagnosis against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import butter, filtfilt

Array = np.ndarray


@dataclass(frozen=True)
class Estimate:
    """A number with its 90 % interval from a bootstrap by blocks of the log."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """Value [low, high], four digits."""
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}]"


@dataclass(frozen=True)
class Fit:
    """Estimates by name, the share of the variance explained, and rms of what is left per log and channel."""

    estimates: dict[str, Estimate]
    share: float
    left: list[Array]

    def __getitem__(self, name: str) -> float:
        return self.estimates[name].value

    def __str__(self) -> str:
        """All estimates in one line."""
        return "  ".join(f"{name} {estimate}" for name, estimate in self.estimates.items())


def read_columns(path: Path) -> dict[str, Array]:
    """Columns of a CSV with one line of names, by name."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names}


def low_pass(signal: Array, dt: float, cutoff: float, order: int = 3) -> Array:
    """Low-pass that shifts nothing in time, along the last axis; cutoff in Hz, at most 80 % of what dt [s] allows."""
    return filtfilt(*butter(order, min(2.0 * cutoff * dt, 0.8)), signal)


def find_lateness(reference: Array, signal: Array, dt: float, lags: Array) -> tuple[float, float]:
    """How late [s] a signal runs after its reference, and signal per reference there: the best of `lags` [s]."""
    time, edge = dt * np.arange(len(reference)), int(np.abs(lags).max() / dt) + 20

    def score(lag: float) -> tuple[float, float, float]:
        shifted, wanted = np.interp(time - lag, time, reference)[edge:-edge], signal[edge:-edge]
        gain = float(shifted @ wanted / (shifted @ shifted))
        return float(np.std(wanted - gain * shifted)), float(lag), gain

    return min(map(score, lags))[1:]


def fit_linear(rows: Array, target: Array, names: Sequence[str], block: int, groups: Array | None = None) -> Fit:
    """Least squares, with intervals from drawing blocks of consecutive rows anew.

    Args:
        rows: (n, k) regressors.
        target: (n,) what they are to explain.
        names: of the k.
        block: rows that are drawn together.
        groups: (n,) number of the log that a row belongs to; no block spans two.
    """

    def solve(chosen: Array) -> Array:
        return np.linalg.lstsq(rows[chosen], target[chosen], rcond=None)[0]

    everything = np.arange(len(target))
    rng, groups = np.random.default_rng(0), np.zeros(len(target)) if groups is None else groups
    starts = everything[: len(target) - block + 1]
    starts = starts[groups[starts] == groups[starts + block - 1]]
    count = max(1, len(target) // block)
    draws = [solve((rng.choice(starts, count)[:, None] + np.arange(block)).ravel()) for _ in range(300)]
    value, (low, high) = solve(everything), np.percentile(draws, [5.0, 95.0], axis=0)
    left = target - rows @ value
    estimates = {name: Estimate(*numbers) for name, *numbers in zip(names, value, low, high, strict=True)}
    return Fit(estimates, float(1.0 - left.var() / target.var()), [np.sqrt(np.mean(left**2, keepdims=True))])


Residuals = Callable[[Array], list[Array]]
"""(k, m) columns of parameters → per log (times, channels, windows, m) simulated minus measured."""


def fit_simulation(
    residuals: Residuals, start: dict[str, float], steps: dict[str, float], block: int, rounds: int = 15
) -> Fit:
    """Simulate windows from the measured state, and fit what is simulated to what was measured (Levenberg-Marquardt).

    Args:
        residuals: the simulation; several columns of parameters at once.
        start: parameters by name where the search begins.
        steps: what is fitted, with the step of its secant; the others stay.
        block: consecutive windows that the bootstrap draws together; it is linearised at the optimum.
        rounds: at most.
    """
    free = [list(start).index(name) for name in steps]
    value, step = np.array(list(start.values()), float), np.array(list(steps.values()))

    def linearise(at: Array) -> tuple[list[Array], list[Array]]:
        columns = np.repeat(at[:, None], len(free) + 1, axis=1)
        columns[free, 1 + np.arange(len(free))] += step
        found = residuals(columns)
        return [one[..., 0] for one in found], [one[..., 1:] - one[..., :1] for one in found]

    def cost(left: list[Array]) -> float:
        total = sum(float((one**2).sum()) for one in left)
        return total if np.isfinite(total) else np.inf

    damping, (left, slopes) = 1e-3, linearise(value)
    for _ in range(rounds):
        slope = np.concatenate([one.reshape(-1, len(free)) for one in slopes])
        hessian, gradient = slope.T @ slope, slope.T @ np.concatenate([one.ravel() for one in left])
        before = cost(left)
        for _ in range(6):
            trial = value.copy()
            trial[free] -= step * np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
            with np.errstate(over="ignore", invalid="ignore"):
                after = cost([one[..., 0] for one in residuals(trial[:, None])])
            if after < before:
                break
            damping *= 5.0
        else:
            break
        value, damping = trial, damping / 5.0
        left, slopes = linearise(value)
        if before - after < 1e-4 * before:
            break
    errors = step * draw_errors(left, slopes, block)
    low, high = np.percentile(value[free] + errors, [5.0, 95.0], axis=0)
    estimates = {name: Estimate(*numbers) for name, *numbers in zip(steps, value[free], low, high, strict=True)}
    return Fit(estimates, float("nan"), [np.sqrt(np.mean(one**2, axis=(0, 2))) for one in left])


def draw_errors(left: list[Array], slopes: list[Array], block: int) -> Array:
    """Errors of the optimum, in steps: what it would have been with blocks of windows drawn anew, to first order."""
    hessians = np.concatenate([np.einsum("tcwa,tcwb->wab", one, one) for one in slopes])
    gradients = np.concatenate([np.einsum("tcwa,tcw->wa", one, of) for one, of in zip(slopes, left, strict=True)])
    rng, count = np.random.default_rng(0), max(1, len(gradients) // block)
    starts = rng.integers(0, max(1, len(gradients) - block + 1), (300, count, 1)) + np.arange(
        min(block, len(gradients))
    )
    floor = 1e-9 * np.trace(hessians.sum(axis=0)) * np.eye(hessians.shape[1])
    drawn = [(hessians[one].sum(axis=0) + floor, gradients[one].sum(axis=0)) for one in starts.reshape(300, -1)]
    return np.array([-np.linalg.solve(hessian, gradient) for hessian, gradient in drawn])


def integrate(rate: Callable[[Array, Array], Array], state: Array, inputs: Sequence[Array], dt: float) -> Array:
    """One Runge-Kutta step of order four; inputs at its start, middle and end."""
    begin, middle, end = inputs
    first = rate(state, begin)
    second = rate(state + 0.5 * dt * first, middle)
    third = rate(state + 0.5 * dt * second, middle)
    fourth = rate(state + dt * third, end)
    return state + dt / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
