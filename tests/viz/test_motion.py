"""Sampling logs and predictions at frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.viz.conftest import make_flight, make_prediction
from vpptwin.robots.planar_drone.display.rotors import hold, read_setpoint, turn_rotors
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import load_twin
from vpptwin.viz.scene.show import choose_frames, count_frames, prepare_show, sample_prediction


def test_commands_hold_until_the_next() -> None:
    """A command acts from its stamp on; before the first there is only the first."""
    time, values = np.array([1.0, 2.0]), np.array([10.0, 20.0])
    np.testing.assert_array_equal(hold(time, values, np.array([0.0, 1.0, 1.99, 2.0, 9.0])), [10, 10, 10, 20, 20])


def test_frame_rate_is_capped() -> None:
    """50 frames a second while there is room, fewer over the same span otherwise."""
    assert len(choose_frames(2.0, 4.0, most=1000)) == 101
    capped = choose_frames(2.0, 4.0, most=21)
    np.testing.assert_allclose(capped, np.arange(2.0, 4.05, 0.1))


def test_more_bodies_leave_room_for_fewer_frames() -> None:
    """A second copy of the rig halves the frames."""
    model = load_twin().model
    assert count_frames(model, 2) == count_frames(model, 1) // 2


def test_rotors_turn_by_the_integral_of_their_speed() -> None:
    """400 rad/s for 1 s, then 500 rad/s: 400 + 0.5 * 500 = 650 rad at 1.5 s; thrust is k_t omega alpha."""
    time = np.array([0.0, 1.0, 1.0 + 1e-9, 2.0])
    speed = np.array([400.0, 400.0, 500.0, 500.0])[:, None] * np.ones((1, 2))
    rotors = turn_rotors(time, speed, np.full((1, 2), 0.1), np.array([1.5]), load_twin().vehicle)
    np.testing.assert_allclose(rotors.angle, [[650.0, 650.0]], rtol=1e-6)
    np.testing.assert_allclose(rotors.thrust, 0.0505 * 500.0 * 0.1)


def test_twin_is_hidden_in_gaps() -> None:
    """Between 1 and 2 s the prediction has no sample: nothing is shown there, however straight the line would be."""
    whole = make_prediction(make_flight())
    keep = (whole.time <= 1.0) | (whole.time >= 2.0)
    torn = replace(whole, time=whole.time[keep], qpos=whole.qpos[keep])
    shown = sample_prediction(torn, np.array([0.2, 0.8, 1.0, 1.5, 1.9, 2.0, 3.0])).shown
    np.testing.assert_array_equal(shown, [False, True, True, False, False, True, True])


def test_prediction_without_a_finite_state_is_refused() -> None:
    """A twin that blew up at once cannot be played."""
    flight = make_flight()
    prediction = make_prediction(flight)
    prediction.qpos[:] = np.nan
    with pytest.raises(InputError, match="finite"):
        prepare_show(flight, prediction, load_twin())


def test_target_starts_with_the_setpoint_that_holds() -> None:
    """Of setpoints stamped before the first frame only the last counts, as if it came at the first frame."""
    target = read_setpoint(make_flight(), start=1.5, end=4.0)
    assert target is not None
    np.testing.assert_allclose(target.time, [0.0, 0.5])
    np.testing.assert_allclose(target.x, [0.0, 0.5])
