"""The Gaussian linear model of windows, against normal densities with every covariance written out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime, lsq_linear, minimize

from tests.inference.toys import PUSH, Toy, draw_linear, draw_prior, simulate
from vpptwin.inference import model
from vpptwin.inference.model import Posterior, Scales, find_mode, infer, predict_folds

TRUE = np.concatenate([np.zeros(2), np.log(PUSH)])
ODD = Scales(np.array([0.3, -0.2]), np.array([-0.5, 0.4]))
"""Scales that are nothing special."""
INSIDE = 1.6449
"""Standard deviations to either side that hold 90 %."""


def draw(seed: int, number: int = 2, missing: float = 0.0, **size: int) -> tuple[Toy, np.ndarray, np.ndarray]:
    """Measurements of a linear law, its slopes (P, K, M), and its parameters drawn from their prior, (P,)."""
    law = draw_linear("abcdef"[:number], seed, **size)
    truth = np.random.default_rng([seed, 3]).normal(size=number)
    toy = simulate(law, dict(zip(law.slopes, truth.tolist())), seed, missing)
    return toy, law.array if number else np.empty((0, *toy.noise.shape)), truth


def profile(toy: Toy, slopes: np.ndarray, x: np.ndarray) -> float:
    """Deviance by brute force at scales x, (4,), at the most probable parameters, with the priors of both."""
    scales, seen = Scales(x[:2], x[2:]), np.isfinite(toy.noise)
    precision, along = np.eye(len(slopes)), np.zeros(len(slopes))
    for row, cov in enumerate(toy.covariance(scales)):
        columns = slopes[:, row, seen[row]]
        weighted = np.linalg.solve(cov, columns.T)
        precision, along = precision + columns @ weighted, along + toy.measured[row, seen[row]] @ weighted
    mean = np.linalg.solve(precision, along)
    left = toy.measured - np.tensordot(mean, slopes, 1)
    return -2.0 * toy.density(left, scales) + float(mean @ mean) + toy.scale_prior.cost(scales)


@pytest.mark.parametrize("scales", [ODD, Scales(TRUE[:2], TRUE[2:]), Scales(np.full(2, 2.0), np.full(2, -6.0))])
def test_marginal_likelihood_is_the_multivariate_normal(scales: Scales) -> None:
    """Density at any parameters, inner products of all columns, with a tenth of the values missing."""
    toy, slopes, _ = draw(1, missing=0.1)
    eliminated = toy.windows(slopes).eliminate(scales)
    for theta in (np.zeros(2), np.array([0.7, -1.3])):
        left = np.append(-theta, 1.0)
        squares = eliminated.square(left)
        found = -0.5 * (squares + eliminated.logdet).sum()
        expected = toy.density(toy.measured - np.tensordot(theta, slopes, 1), scales)
        assert found == pytest.approx(expected, abs=1e-6)
    seen = np.isfinite(toy.noise)
    every = np.concatenate([slopes, toy.measured[None]])
    for row, cov in enumerate(toy.covariance(scales)):
        columns = every[:, row, seen[row]]
        expected = columns @ np.linalg.solve(cov, columns.T)
        alone = toy.windows(slopes).take(np.array([row])).eliminate(scales).information
        np.testing.assert_allclose(alone, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("reach", [5.0, 0.1])
def test_gradient_of_the_deviance_is_that_of_finite_differences(monkeypatch: pytest.MonkeyPatch, reach: float) -> None:
    """At odd scales, with parameters inside of their bounds and with all of them at a bound."""
    asked: list[Callable[[np.ndarray], tuple[float, np.ndarray]]] = []

    def record(function: Any, x0: np.ndarray, **options: Any) -> Any:  # noqa: ANN401
        asked.append(function)
        return minimize(function, x0, **options)

    monkeypatch.setattr(model, "minimize", record)
    toy, slopes, _ = draw(6, missing=0.1)
    posterior = infer(toy.windows(slopes), draw_prior(2, reach), toy.scale_prior, toy.scale_prior.start)
    assert np.all((np.abs(posterior.mean) == reach) == (reach < 1.0))
    for x in (TRUE, np.concatenate([ODD.sensor, ODD.process]), np.array([-1.0, 1.0, -3.0, 2.0])):
        numeric = approx_fprime(x, lambda x: asked[0](x)[0], 1e-5)
        np.testing.assert_allclose(asked[0](x)[1], numeric, rtol=1e-3, atol=0.02)


def test_infer_finds_the_most_probable_scales() -> None:
    """No other scales have a lower deviance by brute force, and that of the posterior is the same."""
    toy, slopes, _ = draw(3)
    posterior = infer(toy.windows(slopes), draw_prior(2), toy.scale_prior, toy.scale_prior.start)
    found = np.concatenate([posterior.scales.sensor, posterior.scales.process])
    least = minimize(lambda x: profile(toy, slopes, x), TRUE, method="L-BFGS-B")
    assert posterior.deviance == pytest.approx(profile(toy, slopes, found), abs=1e-5)
    assert posterior.deviance == pytest.approx(least.fun, abs=0.01)
    np.testing.assert_allclose(found, least.x, atol=0.03)


@pytest.mark.parametrize(("sensor", "process"), [(-4.0, -8.0), (-4.0, 6.0), (6.0, -8.0), (6.0, 6.0), (0.0, -8.0)])
def test_infer_ends_at_the_same_scales_wherever_it_starts(sensor: float, process: float) -> None:
    """Also where the noise that it starts from is thousands of times too small or hundreds of times too large."""
    toy, slopes, _ = draw(3)
    near = infer(toy.windows(slopes), draw_prior(2), toy.scale_prior, toy.scale_prior.start)
    start = Scales(np.full(2, sensor), np.full(2, process))
    far = infer(toy.windows(slopes), draw_prior(2), toy.scale_prior, start)
    assert far.deviance == pytest.approx(near.deviance, abs=0.01)
    np.testing.assert_allclose(far.mean, near.mean, atol=1e-3)


def test_scales_are_recovered_within_their_error() -> None:
    """Over 40 sets of data, errors over the standard deviations that the curvature gives have a square near one."""
    errors = []
    for seed in range(40):
        toy, slopes, _ = draw(100 + seed)
        scales = infer(toy.windows(slopes), draw_prior(2), toy.scale_prior, toy.scale_prior.start).scales
        found, step, curvature = np.concatenate([scales.sensor, scales.process]), 0.05, np.empty(4)
        middle = profile(toy, slopes, found)
        for i, move in enumerate(step * np.eye(4)):
            ahead, behind = profile(toy, slopes, found + move), profile(toy, slopes, found - move)
            curvature[i] = 0.5 * (ahead - 2.0 * middle + behind) / step**2
        errors.append((found - TRUE) * np.sqrt(curvature))
    errors = np.array(errors)
    assert np.abs(errors).max() < 4.0
    # 40 squares of a standard normal have a mean within 0.4 and 1.8 of one, to 3.5 standard deviations (0.22 each).
    assert np.all((errors**2).mean(axis=0) > 0.4)
    assert np.all((errors**2).mean(axis=0) < 1.8)


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_parameters_hardly_change_where_noise_is_misjudged(factor: float) -> None:
    """Noise assumed five times too small or too large moves them by a tenth of their error, and keeps that error."""
    toy, slopes, _ = draw(4, number=3)
    right, wrong = (
        infer(each.windows(slopes), draw_prior(3), each.scale_prior, each.scale_prior.start)
        for each in (toy, toy.misjudge(factor))
    )
    std = np.sqrt(np.diag(right.covariance))
    assert np.all(np.abs(wrong.mean - right.mean) < 0.1 * std)
    np.testing.assert_allclose(np.sqrt(np.diag(wrong.covariance)), std, rtol=0.05)
    np.testing.assert_allclose(wrong.scales.sensor, right.scales.sensor - np.log(factor), atol=0.05)


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Of 90 % intervals of three parameters in 200 sets of data, 86 to 94 % hold what the data were made with."""
    held = []
    for seed in range(200):
        toy, slopes, truth = draw(1000 + seed, number=3)
        posterior = infer(toy.windows(slopes), draw_prior(3), toy.scale_prior, toy.scale_prior.start)
        held.append(np.abs(posterior.mean - truth) < INSIDE * np.sqrt(np.diag(posterior.covariance)))
    assert 0.86 <= np.mean(held) <= 0.94


@pytest.mark.parametrize("seed", range(20))
def test_mode_is_that_of_bounded_least_squares(seed: int) -> None:
    """Within bounds, at many of them, and with the square that scipy's solution leaves."""
    rng = np.random.default_rng([seed, 4])
    columns, residual, at = rng.normal(size=(30, 5)), 3.0 * rng.normal(size=30), 0.1 * rng.normal(size=5)
    columns[:, 4] = columns[:, 3] + 0.05 * columns[:, 4]  # nearly the same
    prior = draw_prior(5, (0.15, 0.4, 9.0)[seed % 3])
    every = np.column_stack([columns, residual])
    mean, precision, square = find_mode(every.T @ every, at, prior)
    stacked, target = np.vstack([columns, np.eye(5)]), np.concatenate([residual + columns @ at, np.zeros(5)])
    expected = lsq_linear(stacked, target, (prior.low, prior.high), method="bvls", tol=1e-12).x
    assert np.all(mean >= prior.low)
    assert np.all(mean <= prior.high)
    np.testing.assert_allclose(mean, expected, atol=1e-5)
    np.testing.assert_allclose(precision, columns.T @ columns + np.eye(5))
    assert square == pytest.approx(np.sum((stacked @ expected - target) ** 2), rel=1e-6)


@pytest.fixture
def folded() -> tuple[Toy, np.ndarray, np.ndarray, Posterior]:
    """Nine windows in three folds of unequal size, slopes, folds, and a fit to all of them."""
    toy, slopes, _ = draw(5, windows=9, values=16)
    posterior = infer(toy.windows(slopes), draw_prior(2), toy.scale_prior, toy.scale_prior.start)
    return toy, slopes, np.array([0, 0, 1, 2, 2, 2, 1, 0, 2]), posterior


def test_density_of_a_fold_is_the_predictive_one(folded: tuple[Toy, np.ndarray, np.ndarray, Posterior]) -> None:
    """Windows of a fold together are normal about what the others predict, wider by how unsure that is."""
    toy, slopes, fold, posterior = folded
    density, means = predict_folds(toy.windows(slopes), draw_prior(2), toy.scale_prior, posterior, fold)
    for number in range(3):
        rest, test = toy.take(fold != number), toy.take(fold == number)
        fit = infer(rest.windows(slopes[:, fold != number]), draw_prior(2), toy.scale_prior, posterior.scales)
        np.testing.assert_allclose(means[number], fit.mean, atol=1e-9)
        own = slopes[:, fold == number]
        left = test.measured - np.tensordot(fit.mean, own, 1)
        expected = test.density(left, fit.scales, own, np.linalg.inv(fit.precision))
        assert density[fold == number].sum() == pytest.approx(expected, abs=1e-6)


def test_parameters_of_a_fold_do_not_depend_on_its_data(folded: tuple[Toy, np.ndarray, np.ndarray, Posterior]) -> None:
    """Other measurements in one fold change what the others give, and nothing of its own."""
    toy, slopes, fold, posterior = folded
    _, before = predict_folds(toy.windows(slopes), draw_prior(2), toy.scale_prior, posterior, fold)
    toy.measured[fold == 1] += slopes[0][fold == 1]
    changed = infer(toy.windows(slopes), draw_prior(2), toy.scale_prior, toy.scale_prior.start)
    _, after = predict_folds(toy.windows(slopes), draw_prior(2), toy.scale_prior, changed, fold)
    std = np.sqrt(np.diag(posterior.covariance))
    assert np.all(np.abs(after[1] - before[1]) < 0.02 * std)  # the search for scales starts elsewhere, and ends nearby
    assert np.all(np.abs(after[[0, 2], 0] - before[[0, 2], 0]) > std[0])
