"""The Gaussian linear model of windows, compressed to inner products, and its log marginal likelihood.

In window k the residual is r = J θ + X x + U n + e: θ parameters that all windows share, x ~ N(0, I) the error of the
starting state, n ~ N(0, g²) force pulses, e ~ N(0, σ²) sensor noise. Given the scales σ of every channel and g of
every degree of freedom all of it is linear and Gaussian, so that x and n are integrated out in closed form, and inner
products of columns are all that is ever needed (BDA3, ch. 14).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from vpptwin.inference.bounded import solve_bounded
from vpptwin.inference.covariance import factor, invert_factored

ROUNDING = 1e-12
"""Added to the diagonal of matrices that are scaled to ones there."""
MARGIN = 1e-9
"""By which bounds are apart at least, in standard deviations."""
SETTLED = {"ftol": 1e-6, "gtol": 0.02}
MAX_SEARCH = 40
"""Steps at most of the search for noise scales."""
LOWEST, HIGHEST = 1e-4, 5e3
"""Bounds of the process noise, in its prior median; of a joint the latter is twice the force that drives it."""


@dataclass(frozen=True)
class Scales:
    """Logarithms of the noise scales: `sensor` of every channel, (C,), and `process` of every degree of freedom, (D,).

    In units of the standard deviations that the columns and residuals were divided by.
    """

    sensor: np.ndarray
    process: np.ndarray


@dataclass(frozen=True)
class ScalePrior:
    """Log-normal priors of the scales.

    Attributes:
        sensor_std: standard deviation of their logarithms, (C,): small where a data sheet is believed.
        sensor_low: least values, (C,): half of a step of quantisation is noise in any case.
        process_median: (D,), most of the mass near zero.
        process_std: of the logarithms, (D,).
    """

    sensor_std: np.ndarray
    sensor_low: np.ndarray
    process_median: np.ndarray
    process_std: np.ndarray

    def strain(self, scales: Scales) -> float:
        """By how many of its standard deviations the log of process noise is above its median, at the most."""
        return float(np.max((scales.process - np.log(self.process_median)) / self.process_std, initial=0.0))

    def cost(self, scales: Scales) -> float:
        """Minus twice the log of the prior density, up to a constant."""
        return float(
            ((scales.sensor / self.sensor_std) ** 2).sum()
            + (((scales.process - np.log(self.process_median)) / self.process_std) ** 2).sum()
        )

    def slope(self, scales: Scales) -> tuple[np.ndarray, np.ndarray]:
        """Its derivatives, (C,) and (D,)."""
        away = scales.process - np.log(self.process_median)
        return 2.0 * scales.sensor / self.sensor_std**2, 2.0 * away / self.process_std**2

    @property
    def start(self) -> Scales:
        """Where a search starts."""
        return Scales(np.log(np.maximum(1.0, self.sensor_low)), np.log(self.process_median) + self.process_std)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Of sensor scales, then of process scales."""
        sensor = [(float(np.log(low)), 9.0) for low in self.sensor_low]
        return sensor + [(float(np.log(m * LOWEST)), float(np.log(m * HIGHEST))) for m in self.process_median]


@dataclass(frozen=True)
class Prior:
    """Of parameters, (P,) each: where they are expected, how widely, and the bounds that they cannot leave."""

    mean: np.ndarray
    std: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def take(self, chosen: np.ndarray) -> Prior:
        """Of some of them."""
        return Prior(self.mean[chosen], self.std[chosen], self.low[chosen], self.high[chosen])


class Layout(NamedTuple):
    """How M measured values of K windows lie side by side."""

    noise: np.ndarray  # their assumed standard deviation, (K, M); infinite where nothing was measured
    columns: Sequence[slice]  # where every channel lies among the M
    process: np.ndarray  # degree of freedom of every force pulse, (G,)


@dataclass(frozen=True, eq=False)
class Nuisance:
    """What starting states and force pulses do in K windows: hypotheses that respond alike share it.

    Attributes:
        columns: [X | U] over the assumed noise, (K, M, N).
        layout: of the M values.
        states: number of columns of X.
        gram: their inner products in every window and channel, (K, C, N²).
        counts: measured values in every window and channel, (K, C).
    """

    columns: np.ndarray
    layout: Layout
    states: int
    gram: np.ndarray
    counts: np.ndarray

    @classmethod
    def of(cls, states: np.ndarray, pushes: np.ndarray, layout: Layout) -> Nuisance:
        """From columns X (K, M, S) and U (K, M, G)."""
        columns = np.concatenate([states, pushes], axis=2) / layout.noise[..., None]
        gram = [np.swapaxes(columns[:, c], 1, 2) @ columns[:, c] for c in layout.columns]
        counts = np.stack([np.isfinite(layout.noise[:, c]).sum(axis=1) for c in layout.columns], axis=1)
        return cls(columns, layout, states.shape[2], np.stack(gram, axis=1).reshape(*counts.shape, -1), counts)

    def take(self, rows: np.ndarray) -> Nuisance:
        """Some of the windows."""
        layout = self.layout._replace(noise=self.layout.noise[rows])
        return Nuisance(self.columns[rows], layout, self.states, self.gram[rows], self.counts[rows])

    def size(self, scales: Scales) -> np.ndarray:
        """Standard deviations of starting states and pulses, in units of their priors, (N,)."""
        return np.concatenate([np.ones(self.states), np.exp(scales.process)[self.layout.process]])

    def merge(self, scales: Scales) -> Nuisance:
        """With all channels in one, whose noise is that of scales."""
        factor = np.ones(self.columns.shape[1])
        for some, scale in zip(self.layout.columns, np.exp(scales.sensor)):
            factor[some] = scale
        columns = self.columns / factor[:, None]
        layout = self.layout._replace(noise=self.layout.noise * factor, columns=[slice(None)])
        gram, counts = np.swapaxes(columns, 1, 2) @ columns, self.counts.sum(axis=1, keepdims=True)
        return Nuisance(columns, layout, self.states, gram.reshape(len(gram), 1, -1), counts)

    def compress(
        self, slopes: np.ndarray, residual: np.ndarray, at: np.ndarray, path: np.ndarray | None = None
    ) -> Windows:
        """Windows from derivatives (P, K, M) at a point (P,) and a residual (K, M), about a path (K, N) or none."""
        outer = np.concatenate([slopes, residual[None]]) / self.layout.noise
        outer = np.moveaxis(outer, 0, -1)
        shape = *self.counts.shape, -1
        across, products = [], []
        for c in self.layout.columns:
            across.append(np.swapaxes(self.columns[:, c], 1, 2) @ outer[:, c])
            products.append(np.swapaxes(outer[:, c], 1, 2) @ outer[:, c])
        path = np.zeros(self.columns[:, 0].shape) if path is None else path
        crossed, own = (np.stack(parts, axis=1).reshape(shape) for parts in (across, products))
        return Windows(self, crossed, own, at, path)


@dataclass(frozen=True, eq=False)
class Windows:
    """K windows about one point, as inner products.

    Attributes:
        nuisance: what starting states and pulses do.
        across: products of [X | U] with [J | r] in every window and channel, (K, C, N (P + 1)).
        outer: those among [J | r], (K, C, (P + 1)²).
        at: the point, (P,).
        path: starting states and pulses about which the residual is, (K, N). What is missed about the likeliest path is
            small, and numbers that are small have no digits to lose.
    """

    nuisance: Nuisance
    across: np.ndarray
    outer: np.ndarray
    at: np.ndarray
    path: np.ndarray

    def take(self, rows: np.ndarray) -> Windows:
        """Some of the windows."""
        return Windows(self.nuisance.take(rows), self.across[rows], self.outer[rows], self.at, self.path[rows])

    def restrict(self, parameters: np.ndarray) -> Windows:
        """With some of the parameters, the others staying where they are."""
        free = len(self.at) + 1
        if len(parameters) == free - 1:
            return self
        kept, shape = np.append(parameters, free - 1).astype(int), self.nuisance.counts.shape
        across = self.across.reshape(*shape, -1, free)[..., kept].reshape(*shape, -1)
        outer = self.outer.reshape(*shape, free, free)[:, :, kept[:, None], kept].reshape(*shape, -1)
        return Windows(self.nuisance, across, outer, self.at[parameters], self.path)

    @cached_property
    def total(self) -> np.ndarray:
        """Products among [J | r] of all windows together, (C, (P + 1)²)."""
        return np.asarray(self.outer.sum(axis=0))

    def eliminate(self, scales: Scales) -> Eliminated:
        """Integrate the starting states and force pulses out."""
        nuisance, weight, free = self.nuisance, np.exp(-2.0 * scales.sensor), len(self.at) + 1
        size = nuisance.size(scales)
        noise = (weight @ nuisance.gram).reshape(-1, len(size), len(size))
        across = (weight @ self.across).reshape(-1, len(size), free) * size[:, None]
        across[:, :, -1] -= self.path / size  # their priors are about none
        inner = noise * size * size[:, None] + np.eye(len(size))
        unit = 1.0 / np.sqrt(np.diagonal(inner, axis1=1, axis2=2))
        even = inner * unit[:, :, None] * unit[:, None, :] + ROUNDING * np.eye(len(size))
        root = factor(even)
        inverse = unit[:, :, None] * invert_factored(root) * unit[:, None, :]
        logdet = 2.0 * (np.log(np.diagonal(root, axis1=1, axis2=2)) - np.log(unit)).sum(axis=1)
        logdet += 2.0 * nuisance.counts @ scales.sensor
        return Eliminated(self, scales, logdet, inverse, across, inverse @ across, size)


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Windows in which only the parameters are left.

    Attributes:
        windows: as they were.
        scales: of their noises.
        logdet: log determinant of S, up to a constant, (K,).
        inverse: N⁻¹ of N = I + D [X U]ᵀ [X U] D / σ², with D the scales of states and pulses, (K, N, N).
        across: D [X U]ᵀ [J | r] / σ², (K, N, P + 1), less D⁻¹ p of a path p in its last column.
        solved: N⁻¹ times that, (K, N, P + 1).
        size: D, (N,).
    """

    windows: Windows
    scales: Scales
    logdet: np.ndarray
    inverse: np.ndarray
    across: np.ndarray
    solved: np.ndarray
    size: np.ndarray

    @cached_property
    def information(self) -> np.ndarray:
        """Inner products of [J | r] under S = σ² + X Xᵀ + U g² Uᵀ of all windows together, (P + 1, P + 1)."""
        free = self.across.shape[2]
        outer = (np.exp(-2.0 * self.scales.sensor) @ self.windows.total).reshape(free, free)
        outer[-1, -1] += ((self.windows.path / self.size) ** 2).sum()
        return np.asarray(outer - self.across.reshape(-1, free).T @ self.solved.reshape(-1, free))

    def square(self, left: np.ndarray) -> np.ndarray:
        """Square of [J | r] times `left`, (P + 1,), under S in every window, (K,); the last of `left` is 1."""
        outer = np.exp(-2.0 * self.scales.sensor) @ self.windows.outer @ np.outer(left, left).ravel()
        outer += ((self.windows.path / self.size) ** 2).sum(axis=1)
        return np.asarray(outer - ((self.across @ left) * (self.solved @ left)).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Posterior:
    """Of the parameters of a hypothesis given the scales.

    Attributes:
        mean: most probable values, (P,).
        precision: inverse covariance, (P, P).
        deviance: minus twice the log likelihood there, up to a constant.
        penalty: minus twice the log of prior over posterior density there (Laplace): what freedom costs.
        scales: of the noises.
    """

    mean: np.ndarray
    precision: np.ndarray
    deviance: float
    penalty: float
    scales: Scales

    @property
    def covariance(self) -> np.ndarray:
        """Of the parameters, (P, P)."""
        unit = 1.0 / np.sqrt(np.diag(self.precision))
        return np.linalg.pinv(self.precision * unit * unit[:, None], hermitian=True) * unit * unit[:, None]


def make_definite(matrix: np.ndarray) -> np.ndarray:
    """A symmetric matrix without the negative directions that rounding left where a simulation went far astray."""
    unit = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    sizes, axes = np.linalg.eigh(matrix / unit / unit[:, None])
    if sizes[0] >= -ROUNDING:
        return matrix
    return (axes * np.maximum(sizes, 0.0)) @ axes.T * unit * unit[:, None]


def find_mode(information: np.ndarray, at: np.ndarray, prior: Prior) -> tuple[np.ndarray, np.ndarray, float]:
    """Most probable parameters within bounds, their precision, and r's square there with the prior's (P + 1, P + 1)."""
    if not len(at):
        return at, np.empty((0, 0)), float(information[-1, -1])
    gram, along = information[:-1, :-1], information[:-1, -1]
    gram = make_definite(gram)
    precision = gram + np.diag(prior.std**-2)
    target = along + (prior.mean - at) / prior.std**2
    unit = 1.0 / np.sqrt(np.diag(precision))
    scaled = precision * unit * unit[:, None] + 1e-10 * np.eye(len(at))
    low, high = prior.low - at, prior.high - at
    step = np.clip(
        solve_bounded(scaled, target * unit, (low / unit - MARGIN, high / unit + MARGIN))[0] * unit, low, high
    )
    square = information[-1, -1] - 2.0 * along @ step + step @ gram @ step
    away = (at + step - prior.mean) / prior.std
    return np.clip(at + step, prior.low, prior.high), precision, float(square + away @ away)


def infer(
    windows: Windows, prior: Prior, scale_prior: ScalePrior, start: Scales, held: np.ndarray | None = None
) -> Posterior:
    """Posterior of parameters with the most probable noise scales.

    Args:
        windows: K windows with P parameters.
        prior: of the parameters.
        scale_prior: of the noise scales.
        start: scales from which the search begins.
        held: which parameters stay where they are, (P,) bool; None for none.
    """
    nuisance, at = windows.nuisance, windows.at
    channels, driven = nuisance.counts.shape[1], nuisance.layout.process
    held = np.zeros(len(at), bool) if held is None else held
    still, own = windows.restrict(np.flatnonzero(~held)), prior.take(~held)

    # Its curvature by every log σ is 4 a value at the mode, and by log g up to 4 a pulse.
    count = len(nuisance.counts)
    informed = np.concatenate([nuisance.counts.sum(axis=0), count * np.bincount(driven)])
    unit = 0.5 / np.sqrt(np.maximum(informed, 1.0))

    def deviance(moved: np.ndarray) -> tuple[float, np.ndarray]:
        x = unit * moved
        scales = Scales(x[:channels], x[channels:])
        e = still.eliminate(scales)
        mean, _, square = find_mode(e.information, still.at, own)
        left = np.concatenate([still.at - mean, [1.0]])
        away = e.solved @ left  # posterior mean of states and pulses, in their own scale, from the path
        noise = away + still.path / e.size
        # d log det / d log g = 2 (1 - N⁻¹ᵢᵢ), d square / d log g = -2 nᵢ², of every pulse i.
        drive = 2.0 * (1.0 - np.diagonal(e.inverse, axis1=1, axis2=2) - noise**2).sum(axis=0)[nuisance.states :]
        process = np.bincount(driven, drive, minlength=len(scales.process))
        pulses = away * e.size
        shrunk = e.inverse * e.size * e.size[:, None] + pulses[:, :, None] * pulses[:, None, :]
        # d (log det + square) / d log σ of a channel = 2 (values - trace of N⁻¹ - squares left at the posterior mean).
        spent = (nuisance.gram @ shrunk.reshape(count, -1, 1)).sum(axis=(0, 2))
        met = still.across.reshape(-1, len(left)) @ left
        spent -= 2.0 * (met.reshape(*nuisance.counts.shape, -1) @ pulses[:, :, None]).sum(axis=(0, 2))
        spent += still.total @ np.outer(left, left).ravel()
        sensor = 2.0 * nuisance.counts.sum(axis=0) - 2.0 * np.exp(-2.0 * scales.sensor) * spent
        by_sensor, by_process = scale_prior.slope(scales)
        slope = unit * np.concatenate([sensor + by_sensor, process + by_process])
        return square + float(e.logdet.sum()) + scale_prior.cost(scales), slope

    x0 = np.concatenate([start.sensor, start.process])
    bounds = np.array(scale_prior.bounds) / unit[:, None]
    x0 = np.clip(x0 / unit, *bounds.T)
    found = minimize(
        deviance, x0, jac=True, method="L-BFGS-B", bounds=bounds, options=SETTLED | {"maxiter": MAX_SEARCH}
    )
    x = unit * found.x
    scales = Scales(x[:channels], x[channels:])
    total = windows.eliminate(scales)
    information = total.information
    free = np.append(np.flatnonzero(~held), len(at))
    mean = at.copy()
    mean[~held], _, square = find_mode(information[np.ix_(free, free)], still.at, own)
    away = ((at - prior.mean) / prior.std)[held]
    cost = square + float(away @ away) + float(total.logdet.sum()) + scale_prior.cost(scales)
    precision = make_definite(information[:-1, :-1]) + np.diag(prior.std**-2) if len(at) else np.empty((0, 0))
    penalty = float(np.linalg.slogdet(precision * prior.std * prior.std[:, None])[1]) if len(at) else 0.0
    return Posterior(mean, precision, cost, penalty, scales)


def predict_folds(
    windows: Windows, prior: Prior, scale_prior: ScalePrior, posterior: Posterior, fold: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Log predictive density of every window under a fit to the other folds, (K,), and the parameters then, (F, P).

    The density of a fold's windows together, parameters integrated out (Vehtari, Gelman and Gabry, Statistics and
    Computing 27, 2017, with blocks in place of points); its windows share it alike but for their squares.
    """
    density, means = np.zeros(len(fold)), []
    for number in np.unique(fold):
        test, train = np.flatnonzero(fold == number), np.flatnonzero(fold != number)
        fitted = infer(windows.take(train), prior, scale_prior, posterior.scales)
        e = windows.take(test).eliminate(fitted.scales)
        left = np.concatenate([windows.at - fitted.mean, [1.0]])
        square = e.square(left)
        shared = 0.0
        if len(left) > 1:
            total = e.information
            along = total[:-1] @ left
            joint = fitted.precision + total[:-1, :-1]
            widening = np.linalg.slogdet(joint)[1] - np.linalg.slogdet(fitted.precision)[1]
            shared = float(widening - along @ np.linalg.solve(joint, along)) / len(test)
        density[test] = -0.5 * (square + e.logdet + shared)
        means.append(fitted.mean)
    return density, np.array(means)
