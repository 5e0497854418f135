"""The penalised linear fit against a brute-force minimum, and its uncertainties against theory worked by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.builders import lay_bench, linear
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.search.frame import Linearisation
from vpptwin.diagnosis.search.solution import (
    Solution,
    price_of_freedom,
    scatter_by_stretch,
    solve_hypothesis,
)
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects import Effect
from vpptwin.effects.friction import coulomb
from vpptwin.effects.joint import JointScale, bias, spring, viscous

TOLERANCE = 0.02
MEASURED = 300
STRETCH = CRITERIA.stretch


def suspect(effect: Effect, *nominal: float) -> list[Unknown]:
    """An effect's parameters, about the values of a twin."""
    return [Unknown(effect, p, n) for p, n in zip(effect.parameters, nominal, strict=True)]


NOWHERE = np.zeros(1, bool), np.zeros(1, bool)
UNKNOWNS = (
    *suspect(coulomb(JointScale("a", "on a", tolerance=TOLERANCE)), 0.0),
    *suspect(viscous(JointScale("b", "on b", tolerance=TOLERANCE)), 0.5),
    *suspect(bias(JointScale("c", "on c", tolerance=TOLERANCE)), 0.0),
    *suspect(spring(JointScale("d", "on d", tolerance=TOLERANCE)), 0.0, 0.3),
)
"""Five parameters of four effects: bounds 0..2, 0..5, -2..2, 0..5, -2..2."""
RANGES = np.array([0.9, 0.9, 0.6, 0.9, 0.6])
"""Within which they are looked for once they are freed: three times their prior's 0.3, 0.3, 0.2, 0.3 and 0.2."""
NOMINAL = np.array([u.nominal for u in UNKNOWNS])


def draw_problem(truth: list[float], seed: int, about: list[float] | None = None, noise: float = 1.0) -> Linearisation:
    """A linear experiment with five parameters that look somewhat alike, about a point."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((5, MEASURED)) + 0.8 * rng.standard_normal(MEASURED)
    at = NOMINAL if about is None else np.array(about)
    return linear(at, columns, (np.array(truth) - at) @ columns + noise * rng.standard_normal(MEASURED))


def search_minimum(fit: Linearisation, freed: set[str], scale: float, frozen: bool) -> tuple[np.ndarray, float]:
    """Values and cost at the minimum, from the definition, inside the bounds, by L-BFGS-B.

    What is not freed is drawn to its nominal value by its tolerance and pays for leaving it; what is freed is only
    held by its range to where it is now, and pays nothing.
    """
    free = np.array([u.effect.id in freed for u in UNKNOWNS])
    tolerance = np.array([u.parameter.tolerance for u in UNKNOWNS])
    bounds = []
    for u, at in zip(UNKNOWNS, fit.at):
        p = u.parameter
        reach = np.inf if u.effect.id in freed else CRITERIA.most_tolerated * p.tolerance
        bounds.append((max(p.low, u.nominal - reach), min(p.high, u.nominal + reach)))
        if frozen and u.effect.id in freed:
            bounds[-1] = (at, at)

    def cost(value: np.ndarray) -> float:
        left = fit.residual - (value - fit.at) @ fit.columns.common
        return left @ left / scale + (((value - NOMINAL) / tolerance)[~free] ** 2).sum()

    def held(value: np.ndarray) -> float:
        return cost(value) + (((value - fit.at) / RANGES)[free] ** 2).sum()

    found = minimize(held, NOMINAL, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-15, "gtol": 1e-9})
    return found.x, float(cost(found.x))


@pytest.mark.parametrize("frozen", [False, True])
@pytest.mark.parametrize("scale", [1.0, 7.0])
@pytest.mark.parametrize("freed", [set(), {"a.coulomb"}, {"b.viscous", "d.spring"}, {"a.coulomb", "c.bias"}])
@pytest.mark.parametrize(
    ("truth", "about"),
    [
        ([0.8, 0.5, 0.0, 0.0, 0.3], None),
        ([0.8, 0.52, -1.0, 0.7, 0.1], None),
        ([0.0, 0.49, 0.3, 2.0, -0.4], [0.4, 0.7, 0.1, 1.0, 0.0]),
        ([-1.0, 9.0, -3.0, 1.0, 0.0], None),
    ],
)
def test_minimum_is_that_of_brute_force(
    truth: list[float], about: list[float] | None, freed: set[str], scale: float, frozen: bool
) -> None:
    """Deviation and cost, freed, frozen or held within tolerance, inside the bounds or pressed against them."""
    fit = draw_problem(truth, seed=3, about=about)
    fit = replace(fit, frame=replace(fit.frame, scale=scale))
    solution = solve_hypothesis(fit, UNKNOWNS, frozenset(freed), frozen)
    value, cost = search_minimum(fit, freed, scale, frozen)
    np.testing.assert_allclose(fit.at + solution.deviation, value, atol=2e-4)
    assert solution.cost == pytest.approx(cost, rel=1e-6)


def test_bounds_hold_for_what_physics_forbids() -> None:
    """Data that ask for friction of -1 N and damping of 9 N s/m get 0 and 5."""
    fit = draw_problem([-1.0, 9.0, 0.0, 0.0, 0.3], seed=4)
    solution = solve_hypothesis(fit, UNKNOWNS, frozenset({"a.coulomb", "b.viscous"}))
    np.testing.assert_allclose((fit.at + solution.deviation)[:2], [0.0, 5.0], atol=1e-9)
    # A constant force of 1 N is not explained away by one that may be 0.02 N.
    fit = draw_problem([0.0, 0.5, 1.0, 0.0, 0.3], seed=5)
    held = solve_hypothesis(fit, UNKNOWNS, frozenset())
    freed = solve_hypothesis(fit, UNKNOWNS, frozenset({"c.bias"}))
    assert fit.at[2] + held.deviation[2] == pytest.approx(CRITERIA.most_tolerated * TOLERANCE)
    assert fit.at[2] + freed.deviation[2] == pytest.approx(1.0, abs=0.2)
    assert held.cost - freed.cost > 100.0


@pytest.mark.parametrize("about", [[0.0, 0.5, 0.0, 0.0, 0.3], [1.5, 0.5, 0.0, 0.0, 0.3]])
def test_what_is_freed_is_not_drawn_to_its_nominal_value(about: list[float]) -> None:
    """A friction of 1.8 N, twice its range from nominal, is found from either side; a cost that counts none of it.

    300 values of noise 1 with columns of rms 1.3 know it to 0.05 N; the range of 0.9 N draws to 0.3 % of the way.
    """
    fit = draw_problem([1.8, 0.5, 0.0, 0.0, 0.3], seed=8, about=about, noise=0.0)
    solution = solve_hypothesis(fit, UNKNOWNS, frozenset({"a.coulomb"}))
    assert fit.at[0] + solution.deviation[0] == pytest.approx(1.8, abs=0.02)
    assert solution.cost < 0.2


def test_frozen_parameters_stay_and_know_nothing() -> None:
    """What is frozen moves not at all and has no variance; what is beside it moves as if it were known."""
    fit = draw_problem([0.8, 0.52, 0.0, 0.0, 0.3], seed=2, about=[0.6, 0.5, 0.0, 0.0, 0.3])
    solution = solve_hypothesis(fit, UNKNOWNS, frozenset({"a.coulomb"}), frozen=True)
    assert solution.deviation[0] == 0.0
    np.testing.assert_array_equal(solution.covariance[0], 0.0)
    known = linear(fit.at[1:], fit.columns.common[1:], fit.residual)
    beside = solve_hypothesis(known, UNKNOWNS[1:], frozenset())
    np.testing.assert_allclose(solution.deviation[1:], beside.deviation, atol=1e-12)
    np.testing.assert_allclose(solution.covariance[1:, 1:], beside.covariance, atol=1e-12)
    assert solution.cost == pytest.approx(beside.cost)


def test_covariance_is_that_of_repeated_experiments() -> None:
    """Over 400 draws of the noise the fitted force scatters as the covariance says, and centres on the truth."""
    truth = [0.8, 0.5, 0.0, 0.0, 0.3]
    clean = draw_problem(truth, seed=9, noise=0.0)
    rng = np.random.default_rng(10)
    values = []
    for _ in range(400):
        noisy = linear(clean.at, clean.columns.common, clean.residual + rng.standard_normal(MEASURED))
        solution = solve_hypothesis(noisy, UNKNOWNS, frozenset({"a.coulomb"}))
        values.append(noisy.at[0] + solution.deviation[0])
    # The held parameters sit at their nominal value in truth, so the fit scatters a little less than they allow for.
    std = np.sqrt(solution.covariance[0, 0])
    assert 0.7 * std < np.std(values) < 1.1 * std
    assert np.mean(values) == pytest.approx(0.8, abs=4.0 * std / 20.0 + 0.005)


def test_freedom_has_its_price() -> None:
    """Laplace by hand: a force known to 0.03 N of a range of 0.9 N costs 2 ln 30, a pair by its determinant."""
    covariance = np.zeros((3, 3))
    covariance[0, 0] = 0.03**2
    covariance[1:, 1:] = [[0.09**2, 0.5 * 0.09 * 0.06], [0.5 * 0.09 * 0.06, 0.06**2]]
    moving, nowhere = np.array([1.0, 0.0, 0.0, 1.0, 1.0]), np.zeros(5, bool)
    solution = Solution(np.zeros(5), 0.0, np.linalg.inv(covariance), moving, (nowhere, nowhere))
    force = 2.0 * np.log(30.0)
    # Shares 0.1 and 0.1 of their ranges 0.9 and 0.6, correlation 0.5: determinant 1e-4 * 0.75.
    pair = -np.log(1e-4 * 0.75)
    assert price_of_freedom(solution, UNKNOWNS, frozenset({"a.coulomb"})) == pytest.approx(force, rel=1e-6)
    assert price_of_freedom(solution, UNKNOWNS, frozenset({"d.spring"})) == pytest.approx(pair, rel=1e-6)
    both = frozenset({"a.coulomb", "d.spring"})
    assert price_of_freedom(solution, UNKNOWNS, both) == pytest.approx(force + pair, rel=1e-6)
    assert price_of_freedom(solution, UNKNOWNS, frozenset()) == 0.0


def test_evidence_is_the_integral_over_the_range() -> None:
    """Cost and price together are -2 ln of the mean likelihood over a Gaussian range about the fit, by quadrature.

    With R the range: ∫ exp(-cost(x)/2) N(x; fit, R²) dx for one freed parameter, all others known.
    """
    fit = draw_problem([0.8, 0.5, 0.0, 0.0, 0.3], seed=6)
    one = linear(fit.at[:1], fit.columns.common[:1], fit.residual)
    solution = solve_hypothesis(one, UNKNOWNS[:1], frozenset({"a.coulomb"}))
    best = one.at[0] + solution.deviation[0]
    value = best + np.linspace(-0.9, 0.9, 20001)
    cost = ((one.residual - (value - one.at[0])[:, None] * one.columns.common[0]) ** 2).sum(axis=1)
    likelihood = np.exp(-0.5 * (cost - solution.cost)) / (0.9 * np.sqrt(2.0 * np.pi))
    integral = np.trapezoid(likelihood * np.exp(-0.5 * ((value - best) / 0.9) ** 2), value)
    found = price_of_freedom(solution, UNKNOWNS[:1], frozenset({"a.coulomb"}))
    assert found == pytest.approx(-2.0 * np.log(integral), abs=0.02)


def test_scatter_by_hand() -> None:
    """Scores 1, 2, -1, -1 in a stretch of four windows and 6 after it: sums 1 and 6, curvature 16; √37 / 16."""
    bench = lay_bench([0.0, 0.25 * STRETCH, 0.5 * STRETCH, 0.75 * STRETCH, 1.01 * STRETCH])
    fit = linear(np.zeros(1), np.array([[1.0, 2.0, 1.0, 1.0, 3.0]]), np.array([1.0, 1.0, -1.0, -1.0, 2.0]))
    solution = Solution(np.zeros(1), 0.0, np.array([[16.0]]), np.ones(1), NOWHERE)
    np.testing.assert_allclose(scatter_by_stretch(fit, solution, bench), [np.sqrt(37.0) / 16.0])
    # The fit may have moved by 0.5: residuals 0.5, 0, -1.5, -1.5, 0.5; scores 0.5, 0, -1.5, -1.5 and 1.5; over scale 2.
    twice = replace(fit, frame=replace(fit.frame, scale=2.0))
    moved = Solution(np.array([0.5]), 0.0, np.array([[8.0]]), np.ones(1), NOWHERE)
    np.testing.assert_allclose(scatter_by_stretch(twice, moved, bench), [np.hypot(2.5, 1.5) / 2.0 / 8.0])
    # Scores 1, 2 at the same time of two flights: √5, not 3.
    fit = linear(np.zeros(1), np.ones((1, 2)), np.array([1.0, 2.0]))
    solution = Solution(np.zeros(1), 0.0, np.ones((1, 1)), np.ones(1), NOWHERE)
    for flight, expected in (([0, 1], np.sqrt(5.0)), ([0, 0], 3.0)):
        np.testing.assert_allclose(scatter_by_stretch(fit, solution, lay_bench([0.5, 0.5], flight)), [expected])
    # 200 stretches of 20 equal errors: the mean is known to 1/√200, not to 1/√4000.
    error = np.repeat(np.random.default_rng(0).standard_normal(200), 20)
    error -= error.mean()
    fit = linear(np.zeros(1), np.ones((1, len(error))), error)
    solution = Solution(np.zeros(1), 0.0, np.array([[float(len(error))]]), np.ones(1), NOWHERE)
    bench = lay_bench(list(STRETCH * (np.arange(800) // 4 + 0.2 * (np.arange(800) % 4) + 0.1)))
    # 200 draws know their own scatter to 5 %.
    np.testing.assert_allclose(scatter_by_stretch(fit, solution, bench), [1.0 / np.sqrt(200.0)], rtol=0.15)
