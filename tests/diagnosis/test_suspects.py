"""The penalised linear fit against a brute-force minimum, and its uncertainties against theory worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from vpptwin.diagnosis.holdout import improvement
from vpptwin.diagnosis.search import weigh_windows
from vpptwin.diagnosis.suspects import (
    MOST_TOLERATED,
    STRETCH,
    Linearisation,
    Solution,
    Unknown,
    list_unknowns,
    scatter_by_window,
    solve_hypothesis,
)
from vpptwin.effects import Effect
from vpptwin.effects.friction import coulomb
from vpptwin.effects.joint import Place, bias, spring, viscous
from vpptwin.twin.spec import load_twin

TOLERANCE = 0.02
MEASURED = 300


def suspect(effect: Effect, *nominal: float) -> list[Unknown]:
    """An effect's parameters, about the values of a twin."""
    return [Unknown(effect, p, n) for p, n in zip(effect.parameters, nominal, strict=True)]


UNKNOWNS = (
    *suspect(coulomb(Place("a", "on a", tolerance=TOLERANCE)), 0.0),
    *suspect(viscous(Place("b", "on b", tolerance=TOLERANCE)), 0.5),
    *suspect(bias(Place("c", "on c", tolerance=TOLERANCE)), 0.0),
    *suspect(spring(Place("d", "on d", tolerance=TOLERANCE)), 0.0, 0.3),
)
"""Five parameters of four effects: bounds 0..2, 0..5, -2..2, 0..5, -2..2."""
NOMINAL = np.array([u.nominal for u in UNKNOWNS])


def draw_problem(truth: list[float], seed: int, about: list[float] | None = None, noise: float = 1.0) -> Linearisation:
    """A linear experiment with five parameters that look somewhat alike, about a point."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((5, MEASURED)) + 0.8 * rng.standard_normal(MEASURED)
    at = NOMINAL if about is None else np.array(about)
    return Linearisation(at, columns, (np.array(truth) - at) @ columns + noise * rng.standard_normal(MEASURED))


def search_minimum(fit: Linearisation, freed: set[str], scale: float) -> tuple[np.ndarray, float]:
    """Values and cost at the minimum, from the definition: misfit plus priors, inside the bounds, by L-BFGS-B."""
    width, bounds = [], []
    for u in UNKNOWNS:
        p = u.parameter
        free = u.effect.id in freed
        width.append(0.5 * (p.high - p.low) if free else p.tolerance)
        reach = np.inf if free else MOST_TOLERATED * p.tolerance
        bounds.append((max(p.low, u.nominal - reach), min(p.high, u.nominal + reach)))

    def cost(value: np.ndarray) -> float:
        left = fit.residual - (value - fit.at) @ fit.columns
        return left @ left / scale + (((value - NOMINAL) / width) ** 2).sum()

    found = minimize(cost, NOMINAL, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-15, "gtol": 1e-9})
    return found.x, float(found.fun)


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
    truth: list[float], about: list[float] | None, freed: set[str], scale: float
) -> None:
    """Deviation and cost, freed or held within tolerance, inside the bounds or pressed against them."""
    fit = draw_problem(truth, seed=3, about=about)
    solution = solve_hypothesis(fit, UNKNOWNS, frozenset(freed), scale)
    value, cost = search_minimum(fit, freed, scale)
    np.testing.assert_allclose(fit.at + solution.deviation, value, atol=2e-4)
    assert solution.cost == pytest.approx(cost, rel=1e-6)


def test_bounds_hold_for_what_physics_forbids() -> None:
    """Data that ask for friction of -1 N and damping of 9 N s/m get 0 and 5."""
    fit = draw_problem([-1.0, 9.0, 0.0, 0.0, 0.3], seed=4)
    solution = solve_hypothesis(fit, UNKNOWNS, frozenset({"a.coulomb", "b.viscous"}), 1.0)
    np.testing.assert_allclose((fit.at + solution.deviation)[:2], [0.0, 5.0], atol=1e-9)


def test_what_is_not_freed_stays_within_three_tolerances() -> None:
    """A constant force of 1 N is not explained away by one that may be 0.02 N."""
    fit = draw_problem([0.0, 0.5, 1.0, 0.0, 0.3], seed=5)
    held = solve_hypothesis(fit, UNKNOWNS, frozenset(), 1.0)
    freed = solve_hypothesis(fit, UNKNOWNS, frozenset({"c.bias"}), 1.0)
    assert fit.at[2] + held.deviation[2] == pytest.approx(MOST_TOLERATED * TOLERANCE)
    assert fit.at[2] + freed.deviation[2] == pytest.approx(1.0, abs=0.2)
    assert held.cost - freed.cost > 100.0


def test_covariance_is_that_of_repeated_experiments() -> None:
    """Over 400 draws of the noise the fitted force scatters as the covariance says, and centres on the truth."""
    truth = [0.8, 0.5, 0.0, 0.0, 0.3]
    fits = [draw_problem(truth, seed=9, noise=0.0)]
    rng = np.random.default_rng(10)
    values = []
    for _ in range(400):
        noisy = Linearisation(fits[0].at, fits[0].columns, fits[0].residual + rng.standard_normal(MEASURED))
        solution = solve_hypothesis(noisy, UNKNOWNS, frozenset({"a.coulomb"}), 1.0)
        values.append(noisy.at[0] + solution.deviation[0])
    # The held parameters sit at their nominal value in truth, so the fit scatters a little less than they allow for.
    std = np.sqrt(solution.covariance[0, 0])
    assert 0.7 * std < np.std(values) < 1.1 * std
    assert np.mean(values) == pytest.approx(0.8, abs=4.0 * std / 20.0 + 0.002)


def test_scatter_by_hand() -> None:
    """Scores 1, 2, -1, -1 in a stretch of four windows and 6 after it: sums 1 and 6, curvature 16; √37 / 16."""
    assert STRETCH == 4
    fit = Linearisation(np.zeros(1), np.array([[1.0, 2.0, 1.0, 1.0, 3.0]]), np.array([1.0, 1.0, -1.0, -1.0, 2.0]))
    solution = Solution(np.zeros(1), 0.0, np.array([[1.0 / 16.0]]))
    np.testing.assert_allclose(scatter_by_window(fit, solution, 5, 1.0), [np.sqrt(37.0) / 16.0])


def test_scatter_notices_stretches_that_agree_with_themselves() -> None:
    """200 stretches of 20 equal errors: the mean is known to 1/√200, not to 1/√4000."""
    error = np.repeat(np.random.default_rng(0).standard_normal(200), 5 * STRETCH)
    error -= error.mean()
    fit = Linearisation(np.zeros(1), np.ones((1, len(error))), error)
    solution = Solution(np.zeros(1), 0.0, np.array([[1.0 / len(error)]]))
    # 200 draws know their own scatter to 5 %.
    np.testing.assert_allclose(scatter_by_window(fit, solution, 200 * STRETCH, 1.0), [1.0 / np.sqrt(200.0)], rtol=0.15)


def test_a_window_that_goes_astray_counts_less() -> None:
    """Mean squares 1, 1, 9 and 299 with median 5: usual misfit 15; weights 1, 1, 1, and √(30 / 314)."""
    residual = np.sqrt(np.array([1.0, 1.0, 9.0, 299.0]))[:, None] * np.ones((4, 2))
    weight = weigh_windows(residual, np.ones((4, 2), dtype=bool))
    np.testing.assert_allclose(weight, np.repeat([1.0, 1.0, 1.0, np.sqrt(30.0 / 314.0)], 2))


def test_bins_without_samples_do_not_excuse_a_window() -> None:
    """A window measured in one bin of four has the mean square of that bin: 400, not 100."""
    residual, valid = np.ones((3, 4)), np.ones((3, 4), dtype=bool)
    residual[2], valid[2] = [20.0, 0.0, 0.0, 0.0], [True, False, False, False]
    weight = weigh_windows(residual, valid).reshape(3, 4)
    np.testing.assert_allclose(weight[2], np.sqrt(6.0 / 403.0))


def test_improvement_by_hand() -> None:
    """Costs 3, 3, 1 become 1, 1, 1: drops of ln 4 - ln 2 = ln 2 twice and 0; mean 2/3 ln 2, standard error 1/3 ln 2."""
    gain, error = improvement(np.array([3.0, 3.0, 1.0]), np.ones(3))
    assert gain == pytest.approx(2.0 / 3.0 * np.log(2.0))
    assert error == pytest.approx(np.log(2.0) / 3.0)


def test_one_window_decides_nothing() -> None:
    """A single window that gets a thousand times better has no standard error; one among twenty doesn't convince."""
    assert improvement(np.array([1000.0]), np.array([1.0]))[1] == np.inf
    before, after = np.full(20, 10.0), np.full(20, 10.5)
    before[7], after[7] = 1e4, 10.0
    gain, error = improvement(before, after)
    assert gain < 2.0 * error


def test_secants_turn_around_at_the_bounds() -> None:
    """A step is as long as the parameter's size and never leaves its bounds, from wherever in them it starts."""
    for unknown in list_unknowns(load_twin()):
        p = unknown.parameter
        for value in (p.low, unknown.nominal, p.high):
            step = unknown.step_from(value)
            assert abs(step) == p.size
            assert p.low <= value + step <= p.high, unknown.key
