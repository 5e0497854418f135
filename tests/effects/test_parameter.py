"""Parameters and priors: draws, bounds, and off values read from a vehicle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vpptwin.effects import CATALOGUE, Parameter, Prior, find_effect

COUNT = 20000


@pytest.mark.parametrize(
    ("prior", "mean", "deviation"),
    [
        (Prior("normal", 2.0, 0.5), 2.0, 0.5),
        (Prior("uniform", -1.0, 3.0), 1.0, 4.0 / np.sqrt(12.0)),
        (Prior("halfnormal", 1.0, 0.5), 1.0 + 0.5 * np.sqrt(2 / np.pi), 0.5 * np.sqrt(1 - 2 / np.pi)),
    ],
    ids=lambda value: str(value) if isinstance(value, Prior) else "",
)
def test_priors_are_what_they_are_called(prior: Prior, mean: float, deviation: float) -> None:
    """Draws have the distribution's mean and deviation, and follow their generator."""
    drawn = prior.draw(np.random.default_rng(3), COUNT)
    assert drawn.mean() == pytest.approx(mean, abs=4 * deviation / np.sqrt(COUNT))  # 4 sigma of the mean
    assert drawn.std() == pytest.approx(deviation, rel=4 / np.sqrt(COUNT))
    np.testing.assert_array_equal(drawn, prior.draw(np.random.default_rng(3), COUNT))
    if prior.kind == "halfnormal":
        assert drawn.min() >= prior.a
    if prior.kind == "uniform":
        assert prior.a <= drawn.min()
        assert drawn.max() <= prior.b


def test_positional_numbers_are_refused() -> None:
    """Eight numbers in a row say nothing of which is which: a parameter takes keywords only."""
    prior = Prior("normal", 0.0, 1.0)
    with pytest.raises(TypeError, match="positional"):
        Parameter("force", "N", 0.0, -0.1, 0.1, prior, 0.05)  # type: ignore[misc]
    with pytest.raises(TypeError, match="positional"):
        Parameter("force", unit="N", off=0.0, low=-0.1, high=0.1, prior=prior, size=0.05)  # type: ignore[misc]


def test_draws_are_clipped_to_the_bounds() -> None:
    """A prior wider than the bounds yields values on them, none beyond."""
    prior = Prior("normal", 0.0, 1.0)
    parameter = Parameter(name="force", unit="N", off=0.0, low=-0.1, high=0.1, prior=prior, size=0.05)
    drawn = parameter.draw(np.random.default_rng(0), 100)
    assert (drawn.min(), drawn.max()) == (-0.1, 0.1)


@pytest.mark.parametrize(("prior", "moved"), [("normal", (0.03, 0.003)), ("uniform", (0.03, 0.013))])
def test_off_from_a_vehicle_moves_the_prior(prior: str, moved: tuple[float, float]) -> None:
    """With another nominal value the off value and the prior shift by the same amount, the prior's width stays."""
    parameter = replace(
        find_effect(CATALOGUE, "servo.lag").parameters[0],
        prior=Prior(prior, 0.02, 0.003),  # type: ignore[arg-type]
    )
    bound = parameter.with_off(0.03)
    assert (bound.off, bound.prior.a) == (0.03, pytest.approx(moved[0]))
    assert bound.prior.b == pytest.approx(moved[1])
    assert (parameter.off, parameter.prior.a) == (0.02, 0.02)


@given(st.floats(1e-4, 10.0))
def test_off_from_any_vehicle_is_within_the_bounds(time_constant: float) -> None:
    """However fast or slow a vehicle's servo, not to differ from it is allowed, and draws stay within the bounds."""
    effect = find_effect(CATALOGUE, "servo.lag").bind(lambda key: {"servo.time_constant": time_constant}[key])
    (parameter,) = effect.parameters
    assert parameter.off == time_constant
    assert parameter.low <= parameter.off <= parameter.high
    assert parameter.low > 0.0
    drawn = parameter.draw(np.random.default_rng(2), 50)
    assert ((drawn >= parameter.low) & (drawn <= parameter.high)).all()


def test_unbound_parameters_keep_their_off_value() -> None:
    """Only parameters that name a key of the vehicle ask for it."""

    def refuse(key: str) -> float:
        raise AssertionError(f"asked for {key}")

    effect = find_effect(CATALOGUE, "rail_x.coulomb")
    assert effect.bind(refuse) == effect


def test_parameter_of_an_effect_by_name() -> None:
    """A parameter is found by name, and a name that is none raises."""
    effect = find_effect(CATALOGUE, "air.drag")
    assert effect.parameter("k_d").unit == "N s^2/m^2"
    with pytest.raises(KeyError, match="kd"):
        effect.parameter("kd")
