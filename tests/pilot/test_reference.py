"""Plans: what a reference holds after each way of filling it."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.robots.planar_drone.pilot.reference import HEIGHT, POP, Plan, Reference, minimum_jerk

PERIOD = 0.01


def plan(duration: float = 3.0) -> Plan:
    """A plan of 100 Hz."""
    return Plan(duration, PERIOD, 9.81)


def test_an_empty_plan_stays_where_it_starts() -> None:
    """As many ticks as fit, all above the middle of the rail, nothing asked for."""
    reference = plan().finish()
    assert len(reference) == 300
    np.testing.assert_array_equal(reference.pose, np.tile([0.0, HEIGHT, 0.0], (300, 1)))
    assert not reference.velocity.any()
    assert not reference.acceleration.any()


def test_a_step_holds_until_the_next() -> None:
    """From its tick on the target is another; the coordinate that was not named stays."""
    filled = plan()
    filled.wait(1.0)
    filled.step(x=0.5)
    filled.wait(1.0)
    filled.step(z=1.6)
    pose = filled.finish().pose
    np.testing.assert_array_equal(pose[[99, 100, 199, 200, 299], 0], [0.0, 0.5, 0.5, 0.5, 0.5])
    np.testing.assert_array_equal(pose[[199, 200]][:, 1], [HEIGHT, 1.6])


def check_consistent(reference: Reference, until: int) -> None:
    """Velocity and acceleration are the derivatives of the pose, to what 10 ms resolve."""
    pose, velocity = reference.pose[:until, :2], reference.velocity[:until, :2]
    np.testing.assert_allclose(np.gradient(pose, PERIOD, axis=0)[1:-1], velocity[1:-1], atol=0.04)
    np.testing.assert_allclose(
        np.gradient(velocity, PERIOD, axis=0)[2:-2], reference.acceleration[2 : until - 2], atol=0.8
    )


def test_a_move_is_smooth_and_arrives() -> None:
    """It ends where it was told to, at rest; by hand: minimum jerk over 0.6 m in 2 s peaks at 1.875 * 0.3 m/s."""
    filled = plan()
    filled.move(2.0, x=0.6, z=1.5)
    reference = filled.finish()
    np.testing.assert_allclose(reference.pose[200:, :2], np.tile([0.6, 1.5], (100, 1)), atol=1e-12)
    assert reference.velocity[:, 0].max() == pytest.approx(0.5625, rel=0.01)
    check_consistent(reference, 200)


def test_a_cruise_keeps_its_speed() -> None:
    """Half of 1.2 m at 0.4 m/s is flown at that speed; it starts and ends at 3 m/s²."""
    filled = plan(5.0)
    filled.step(x=-0.6)
    filled.cruise(0.6, 0.4, 3.0)
    reference = filled.finish()
    middle = np.abs(reference.pose[:, 0]) < 0.3
    np.testing.assert_allclose(reference.velocity[middle, 0], 0.4, rtol=1e-6)
    assert np.abs(reference.acceleration).max() == pytest.approx(3.0, rel=0.01)
    assert reference.pose[-1, 0] == pytest.approx(0.6, abs=1e-9)


def test_a_short_cruise_does_not_reach_its_speed() -> None:
    """Over 3 cm at 3 m/s² by hand: sqrt(3 * 0.03) = 0.3 m/s at most."""
    filled = plan()
    filled.cruise(0.03, 1.0, 3.0)
    reference = filled.finish()
    assert reference.velocity[:, 0].max() <= 0.3 + 1e-9
    assert reference.pose[-1, 0] == pytest.approx(0.03, abs=1e-9)


def test_a_turn_pops_up_and_ends_turned() -> None:
    """Upward acceleration first, then the angle on a path whose rate is its derivative, then at rest inverted."""
    filled = plan()
    filled.turn(np.pi, 0.6)
    reference = filled.finish()
    assert reference.acceleration[0, 1] == POP
    assert reference.pose[-1, 2] == np.pi
    turning = slice(24, 80)
    rate = np.gradient(reference.pose[:, 2], PERIOD)
    np.testing.assert_allclose(rate[turning], reference.velocity[turning, 2], atol=0.1)
    assert reference.velocity[:, 2].max() == pytest.approx(1.875 * np.pi / 0.6, rel=0.01)


def test_a_nudge_goes_both_ways() -> None:
    """As long one way as the other, and nothing after."""
    filled = plan()
    filled.nudge(0.4, 0.15)
    nudge = filled.finish().nudge
    np.testing.assert_array_equal(nudge, np.repeat([0.4, -0.4, 0.0], [15, 15, 270]))


def test_a_plan_that_is_full_takes_no_more() -> None:
    """What does not fit is cut off at the end."""
    filled = plan(1.0)
    filled.move(3.0, x=1.0)
    filled.turn(np.pi, 0.6)
    filled.step(z=2.0)
    reference = filled.finish()
    assert len(reference) == 100
    third = float(minimum_jerk(np.array([0.33]))[0])
    assert reference.pose[-1, 0] == pytest.approx(third, abs=1e-9)
    assert filled.left == 0.0
