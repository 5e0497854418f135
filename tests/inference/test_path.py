"""Paths: windows that are simulated about their likeliest starting states and pulses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from tests.inference.toys import Toy, draw_linear, name_unknown, simulate
from vpptwin.inference.fit import Fitter, Point
from vpptwin.inference.model import Layout, Nuisance, Scales
from vpptwin.inference.path import smooth, strain

SIZE = ("a", "size")
BEND = 0.5
"""By which a standard deviation of the starting state multiplies a motion, as its logarithm."""
STATES = np.linspace(-4.0, 4.0, 801)


@dataclass(eq=False)
class Bent(Toy):
    """Motions in proportion to an effect's size and to the exponential of the starting state."""

    def move(self, point: Point, path: np.ndarray | None) -> np.ndarray:
        """What is simulated, (K, M)."""
        state = np.zeros(len(self.noise)) if path is None else path[:, 0]
        return self.law(point) * np.exp(BEND * state)[:, None]

    def residuals(self, points: Sequence[Point], about: Point, path: np.ndarray | None = None) -> np.ndarray:
        """Measured less simulated, (V, K, M)."""
        return self.measured - np.stack([self.move(point, path) for point in points])

    def respond(self, point: Point, path: np.ndarray | None = None) -> Nuisance:
        """Slopes by the starting state; pulses do nothing."""
        slope = BEND * self.move(point, path)[..., None]
        return Nuisance.of(slope, self.pushes, Layout(self.noise, self.columns, self.process))

    def density(self, size: float) -> float:  # type: ignore[override]
        """Log density of what was measured, starting states integrated out, up to a constant."""
        every = np.array([self.move({SIZE: size}, np.full((len(self.noise), 1), state)) for state in STATES])
        squares = (((self.measured - every) / self.noise) ** 2).sum(axis=2) + STATES[:, None] ** 2
        return float(
            np.log(np.exp(-0.5 * (squares - squares.min(axis=0))).sum(axis=0)).sum() - 0.5 * squares.min(axis=0).sum()
        )


def draw_bent(size: float, seed: int) -> Bent:
    """Measurements of thirty windows with starting states of their own and noise of 0.1."""
    rng, shape = np.random.default_rng(seed), np.linspace(0.5, 1.5, 8)

    def law(point: Point) -> np.ndarray:
        return point.get(SIZE, 0.0) * np.tile(shape, (30, 1))

    plain = simulate(draw_linear("a", 1), {}, 1)
    prior = replace(
        plain.scale_prior, sensor_std=np.full(1, 1e-3), sensor_low=np.full(1, 1e-3), process_std=np.full(2, 1e-3)
    )
    nothing, process = np.zeros((30, 8, 2)), np.arange(2)
    toy = Bent(law, nothing[..., 0], np.full((30, 8), 0.1), nothing[..., :1], nothing, [slice(0, 8)], process, prior)
    moved = toy.move({SIZE: size}, rng.normal(size=(30, 1)))
    return replace(toy, measured=moved + 0.1 * rng.normal(size=moved.shape))


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_along_paths_finds_the_mode_of_what_is_not_linear_in_them(seed: int) -> None:
    """A size of 1: the most probable one by integrals over every starting state."""
    toy = draw_bent(1.0, seed)
    unknown = replace(name_unknown("a"), std=10.0, low=0.0, high=10.0)
    followed = Fitter(toy, [unknown]).fit(frozenset("a"), {SIZE: 0.5})
    mode = minimize_scalar(lambda size: -toy.density(size), bounds=(0.2, 5.0), method="bounded").x
    assert followed.std[SIZE] == pytest.approx(BEND / np.sqrt(30.0), rel=0.4)  # of the mean of thirty starting states
    assert abs(followed.values[SIZE] - mode) < 0.3 * followed.std[SIZE]
    assert strain(followed.windows, followed.posterior.scales) < 0.1


def test_evidence_along_paths_is_the_integral() -> None:
    """Drop of log density from the fit's size to another, by integrals over every starting state."""
    toy = draw_bent(1.0, 5)
    sizes = [0.8, 1.0, 1.25]
    fits = []
    for size in sizes:
        pinned = replace(name_unknown("a", mean=size), std=1e-6, low=size - 1e-9, high=size + 1e-9, step=lambda v: 1e-9)
        fits.append(Fitter(toy, [pinned]).fit(frozenset("a"), {}).posterior.deviance)
    found, exact = -0.5 * np.diff(fits), np.diff([toy.density(size) for size in sizes])
    np.testing.assert_allclose(found, exact, atol=0.05)


def test_a_smoother_finds_the_likeliest_starting_states() -> None:
    """Of every window, as a search over it does; and never leads uphill."""
    toy, scales = draw_bent(1.0, 7), Scales(np.zeros(1), np.zeros(2))
    point, path = {SIZE: 1.0}, np.zeros((30, 3))
    for _ in range(4):
        path = smooth(toy, point, [path], toy.respond(point, path), scales)
    grid = np.array([toy.residuals([point], point, np.full((30, 1), state))[0] for state in STATES])
    squares = ((grid / 0.1) ** 2).sum(axis=2) + STATES[:, None] ** 2
    np.testing.assert_allclose(path[:, 0], STATES[squares.argmin(axis=0)], atol=0.011)
    assert np.all(path[:, 1:] == 0.0)


def test_candidates_are_also_screened_under_calm_process_noise() -> None:
    """Strong pulses on one degree of freedom take what a missing effect does; calm ones leave it to be told."""
    toy = simulate(draw_linear("ab", 4), {("a", "size"): 1.0}, 4)
    pushed = replace(toy, pushes=np.concatenate([toy.pushes[..., :2], np.zeros((*toy.noise.shape, 2))], axis=2))
    fitter = Fitter(pushed, [name_unknown(name) for name in "ab"])
    strong, calm = fitter.screen(fitter.fit(frozenset("a"), {}))
    assert np.all(np.diag(calm) >= np.diag(strong) * (1.0 - 1e-9))
    assert np.any(np.diag(calm) > 1.01 * np.diag(strong))
