"""The likeliest starting states and force pulses of windows: what sticks is simulated about them, not about none.

Whether something sticks depends on the forces upon it, and those on a motion that strays within a window from what was
measured: linearised about no pulses, dry friction is taken for noise (an iterated Kalman smoother; Bell and Cathey,
IEEE Transactions on Automatic Control 38, 1993).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from vpptwin.inference.model import Nuisance, Scales, Windows

Point = Mapping[tuple[str, str], float]
TURNS = 3
"""Steps of a smoother at most."""
ASTRAY = 10.0
"""What a window that goes astray counts at most, as a square."""
SLIGHT = 0.02
"""Gain of a window's square, on average, with which it has settled."""


class Moving(Protocol):
    """K windows of a simulation that starts from any states and feels any pulses."""

    def residuals(self, points: Sequence[Point], about: Point, path: np.ndarray | None = None) -> np.ndarray:
        """See `vpptwin.inference.fit.Simulator`."""


def smooth(
    simulator: Moving, values: Point, paths: Sequence[np.ndarray], nuisance: Nuisance, scales: Scales
) -> np.ndarray:
    """The likeliest path at a point, (K, N) in units of its priors.

    Steps of Gauss-Newton that are shortened where they lead uphill.

    Args:
        simulator: of the windows.
        values: the point.
        paths: where to begin, (K, N) each: in every window the likeliest of them.
        nuisance: derivatives by a path, at the point or near it.
        scales: of the noises.
    """
    nuisance, size = nuisance.merge(scales), nuisance.size(scales)
    noise, columns = nuisance.layout.noise, nuisance.columns * size
    gram = nuisance.gram.reshape(len(columns), len(size), -1) * size * size[:, None] + np.eye(len(size))

    def weigh(path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is missed about a path, over the noise, (K, M), and its square with that of the path, (K,)."""
        missed = simulator.residuals([values], values, path)[0] / noise
        return missed, (missed**2).sum(axis=1) + ((path / size) ** 2).sum(axis=1)

    path = paths[0]
    missed, cost = weigh(path)

    def take(found: np.ndarray) -> np.ndarray:
        """Take another path in the windows where it is likelier, (K,) bool."""
        nonlocal path, missed, cost
        there, price = weigh(found)
        better = price < cost
        missed, path = np.where(better[:, None], there, missed), np.where(better[:, None], found, path)
        cost = np.where(better, price, cost)
        return better

    for other in paths[1:]:
        take(other)
    stride = np.ones(len(path))
    for _ in range(TURNS):
        downhill = (np.swapaxes(columns, 1, 2) @ missed[..., None])[..., 0] - path / size
        found = path + stride[:, None] * size * np.linalg.solve(gram, downhill[..., None])[..., 0]
        before = cost
        better = take(found)
        stride = np.where(better, np.minimum(1.0, 3.0 * stride), 0.3 * stride)
        if float((before - cost).sum()) < SLIGHT * len(path):
            break
    return path


def foretell(windows: Windows, at: np.ndarray, scales: Scales) -> np.ndarray:
    """The likeliest path of windows with parameters `at`, (P,), by their linear model, (K, N)."""
    e = windows.eliminate(scales)
    return np.asarray(windows.path + e.size * (e.solved @ np.append(windows.at - at, 1.0)))


def strain(windows: Windows, scales: Scales) -> float:
    """By how much the square of the path, with what it misses, is above the least of the linear model about it.

    That is 0 about the likeliest path. Where it is not, no simulation has borne out what the linear model promises. A
    window in which no better path is found, as where a joint breaks loose too early, must not outvote the others.
    """
    e = windows.eliminate(scales)
    away = e.solved[:, :, -1]
    each = np.einsum("ki,kij,kj->k", away, np.linalg.inv(e.inverse), away)
    return float((each / (1.0 + each / ASTRAY)).sum())
