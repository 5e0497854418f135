"""Toy simulators with the `Simulator` protocol, and their normal densities with every covariance written out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from vpptwin.inference.fit import Key, Point, Unknown
from vpptwin.inference.model import Layout, Nuisance, Prior, ScalePrior, Scales, Windows

SIGMA, PUSH = np.array([0.1, 0.3]), np.array([0.5, 2.0])
"""True noise of two channels, and of the pulses on two degrees of freedom."""
Law = Callable[[Point], np.ndarray]


@dataclass(eq=False)
class Toy:
    """A simulator whose law is a function of parameters, with given columns of starting states and pulses."""

    law: Law
    measured: np.ndarray  # (K, M)
    noise: np.ndarray  # (K, M)
    states: np.ndarray  # (K, M, S)
    pushes: np.ndarray  # (K, M, G)
    columns: Sequence[slice]
    process: np.ndarray  # (G,)
    scale_prior: ScalePrior

    def residuals(self, points: Sequence[Point], about: Point, path: np.ndarray | None = None) -> np.ndarray:
        """Measured less simulated, (V, K, M)."""
        moved = np.zeros(self.noise.shape)
        if path is not None:
            moved = np.einsum("kmn,kn->km", np.concatenate([self.states, self.pushes], axis=2), path)
        return self.measured - moved - np.stack([self.law(point) for point in points])

    def respond(self, point: Point, path: np.ndarray | None = None) -> Nuisance:
        """The same columns everywhere."""
        return Nuisance.of(self.states, self.pushes, Layout(self.noise, self.columns, self.process))

    def misjudge(self, factor: float) -> Toy:
        """The same measurements, their noise assumed larger by a factor."""
        return replace(self, noise=self.noise * factor)

    def windows(self, slopes: np.ndarray) -> Windows:
        """Compressed about zero, with derivatives (P, K, M)."""
        return self.respond({}).compress(slopes, self.residuals([{}], {})[0], np.zeros(len(slopes)))

    def covariance(self, scales: Scales) -> list[np.ndarray]:
        """Of what was measured in every window: sensor noise, starting states and pulses, (m, m) each."""
        factor, size = np.empty(self.noise.shape[1]), np.exp(scales.process)[self.process]
        for columns, scale in zip(self.columns, np.exp(scales.sensor)):
            factor[columns] = scale
        found = []
        for noise, x, u in zip(self.noise * factor, self.states, self.pushes * size):
            seen = np.isfinite(noise)
            found.append(np.diag(noise[seen] ** 2) + x[seen] @ x[seen].T + u[seen] @ u[seen].T)
        return found

    def density(
        self, residual: np.ndarray, scales: Scales, slopes: np.ndarray | None = None, spread: np.ndarray | None = None
    ) -> float:
        """Log density of a residual (K, M); parameters with a covariance (P, P) are integrated out if there are any.

        Less the constant of the assumed noise and of 2 pi, which `Windows` leaves out.
        """
        seen = np.isfinite(self.noise)
        constant = np.log(self.noise[seen]).sum() + 0.5 * seen.sum() * np.log(2.0 * np.pi)
        if slopes is None:
            each = zip(residual, seen, self.covariance(scales))
            return float(constant + sum(multivariate_normal.logpdf(r[s], cov=c) for r, s, c in each))
        columns = slopes[:, seen].T
        cov = block_diag(*self.covariance(scales)) + columns @ spread @ columns.T
        return float(constant + multivariate_normal.logpdf(residual[seen], cov=cov))

    def take(self, rows: np.ndarray) -> Toy:
        """Some of the windows, of a toy without a law."""
        arrays = {name: getattr(self, name)[rows] for name in ("measured", "noise", "states", "pushes")}
        return replace(self, law=lambda point: np.zeros(arrays["noise"].shape), **arrays)


def simulate(law: Law, truth: Point, seed: int, missing: float = 0.0, sensor_std: float = 2.0) -> Toy:
    """Measurements of a law with known parameters, starting states, pulses and noise drawn from a seed."""
    rng = np.random.default_rng([seed, 1])
    clean = law(truth)
    count, values = clean.shape
    columns, process = [slice(0, values // 2), slice(values // 2, values)], np.array([0, 1, 0, 1])
    noise = np.repeat(SIGMA, values // 2) * np.ones((count, 1))
    states, pushes = 0.5 * rng.normal(size=(count, values, 2)), 0.3 * rng.normal(size=(count, values, 4))
    measured = clean + noise * rng.normal(size=clean.shape)
    measured += np.einsum("kms,ks->km", states, rng.normal(size=(count, 2)))
    measured += np.einsum("kmg,kg->km", pushes, PUSH[process] * rng.normal(size=(count, 4)))
    noise = np.where(rng.random(clean.shape) < missing, np.inf, noise)
    prior = ScalePrior(np.full(2, sensor_std), np.full(2, 1e-3), np.full(2, 0.2), np.full(2, 2.0))
    return Toy(law, measured, noise, states, pushes, columns, process, prior)


@dataclass(frozen=True, eq=False)
class Linear:
    """A law that is linear in its parameters."""

    slopes: Mapping[Key, np.ndarray]  # of every parameter, (K, M)

    def __call__(self, point: Point) -> np.ndarray:
        """Simulated values, (K, M)."""
        return sum((point.get(key, 0.0) * slope for key, slope in self.slopes.items()), np.zeros(self.array.shape[1:]))

    @property
    def array(self) -> np.ndarray:
        """Slopes of all parameters, (P, K, M)."""
        return np.stack(list(self.slopes.values()))


def draw_linear(names: str, seed: int, windows: int = 10, values: int = 24) -> Linear:
    """Effects of one parameter each, as noticeable in one channel as in the other."""
    rng = np.random.default_rng([seed, 2])
    size = np.repeat(SIGMA, values // 2)
    return Linear({(name, "size"): size * rng.normal(size=(windows, values)) for name in names})


def name_unknown(name: str, parameter: str = "size", tolerance: float = 0.0, mean: float = 0.0) -> Unknown:
    """A parameter with a standard normal prior within wide bounds."""
    return Unknown((name, parameter), mean, 1.0, -5.0, 5.0, lambda value: 0.01, tolerance)


def draw_prior(number: int, reach: float = 5.0) -> Prior:
    """Standard normal priors within bounds."""
    return Prior(np.zeros(number), np.ones(number), np.full(number, -reach), np.full(number, reach))
