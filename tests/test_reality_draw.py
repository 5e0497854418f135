"""What is hidden and how strongly: sizes, strengths, effects drawn together, small distractors and outliers."""

from __future__ import annotations

import numpy as np
import pytest

from proving.drone import (
    COMPANIONS,
    CORE,
    EXTENDED,
    LOOK_ALIKES,
    draw_effect,
    draw_together,
    fly_many,
    measure_strength,
    true_size,
)
from proving.drone.rig import draw_tolerances
from proving.sessions import read_seed

ALL = (*CORE, *EXTENDED)


@pytest.mark.parametrize("effect", ALL)
def test_strength_tells_faint_from_ordinary(effect: str) -> None:
    """What is drawn has a strength of 1 or more, what is drawn as faint one between the least asked for and 1."""
    rng = np.random.default_rng(read_seed())
    for _ in range(20):
        assert measure_strength(effect, draw_effect(rng, (effect,))[effect]) > 1 - 1e-3
        assert measure_strength(effect, draw_effect(rng, (effect,), least=0.5)[effect]) > 1 + 1e-3
        assert 0.4 - 1e-3 < measure_strength(effect, draw_effect(rng, (effect,), 0.4)[effect]) < 1 + 1e-3


@pytest.mark.parametrize(
    ("effect", "values", "strength"),
    [
        ("rail_x.coulomb", {"force": 0.25}, 2.5),  # the least is 0.10 N
        ("rotor.thrust_gain", {"gain": 0.9}, 2.0),  # 0.95
        ("airframe.mass", {"mass": -0.05}, 2.0),  # -0.025 kg
        ("servo.lag", {"time_constant": 0.024}, 0.5),  # 8 ms more than the nominal 20
    ],
)
def test_strength_is_that_of_the_faint_end(effect: str, values: dict[str, float], strength: float) -> None:
    """Strength is the distance from doing nothing in units of the faintest size drawn."""
    assert measure_strength(effect, values) == pytest.approx(strength)


def test_effects_drawn_together_are_no_look_alikes() -> None:
    """Three effects hidden at once are three, and no two stand in one group of look-alikes."""
    rng = np.random.default_rng(read_seed())
    for _ in range(50):
        hidden = set(draw_together(rng, 3, ALL))
        assert len(hidden) == 3
        assert max(len(group & hidden) for group in LOOK_ALIKES) < 2
    # Two kinds of dry friction of one rail: refused in a line, not tried for ever.
    with pytest.raises(ValueError, match="no 2 effects that can be told apart among"):
        draw_together(np.random.default_rng(0), 2, ("rail_x.coulomb", "rail_x.stiction"))
    # Every id in a group can be drawn.
    assert set().union(*LOOK_ALIKES) <= {*ALL, *COMPANIONS}


def test_true_size_has_the_tolerance_of_the_rig() -> None:
    """A rig's own friction and mass error add to what is hidden; a delay has no tolerance."""
    rig = draw_tolerances(5)
    assert true_size("rail_x.coulomb", "force", 0.3, 5) == pytest.approx(0.3 + rig["friction_x"])
    assert true_size("airframe.mass", "mass", 0.05, 5) == pytest.approx(0.05 + 0.45 * rig["mass"])
    assert true_size("command.delay", "delay", 0.01, 5) == 0.01


@pytest.mark.slow
def test_distractors_are_small() -> None:
    """Thrust ripple and gyro wander move a flight of 2 s by less than gusts of 1 % of weight do."""
    calm, small, gusty = fly_many(
        [
            {"manoeuvre": "x_steps", "duration": 2.0, "seed": 9, "gusts": gusts, "distractors": distractors}
            for gusts, distractors in ((False, False), (False, True), (True, False))
        ]
    )
    moved = np.abs(small.truth["position"] - calm.truth["position"]).max(axis=0)
    blown = np.abs(gusty.truth["position"] - calm.truth["position"]).max(axis=0)
    assert (moved > 0).all()
    assert (moved < 0.5 * blown).all()


@pytest.mark.slow
def test_outliers_are_in_the_log_only() -> None:
    """About one recorded pose in 200 is far off; the flight itself is the same."""
    plain, wild = fly_many([{"manoeuvre": "hover", "duration": 6.0, "seed": 3, "outliers": o} for o in (False, True)])
    np.testing.assert_array_equal(plain.truth["position"], wild.truth["position"])
    off = wild.topics["/mocap/pose"].columns["x"] != plain.topics["/mocap/pose"].columns["x"]
    assert 0.001 < off.mean() < 0.015
