"""Sensors: what they show is worked out by hand, off values change no bit, past poses are found where they were."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.effects import CATALOGUE
from vpptwin.robots.planar_drone.vehicle import load_vehicle
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.sensors import (
    PERFECT,
    age_of_pose,
    measure_pose,
    measure_rate,
    measure_velocity,
    perfect_sensors,
    sensor_noise,
)
from vpptwin.twin.stepping.past import SensorState, history_depth, look_back, record_poses, start_sensors

PERIOD = 0.01


def fly_curve(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose and velocity of two crafts on sines of 2 and 3 rad/s at times (T,), (T, 2, 3) each."""
    rate = np.array([2.0, 3.0])[:, None]
    phase = rate * time[:, None, None] + np.array([0.0, 0.4, 0.9])
    return np.sin(phase), rate * np.cos(phase)


def record_curve(depth: int, steps: int) -> SensorState:
    """What a ring holds after so many steps of `fly_curve`."""
    pose, velocity = fly_curve(PERIOD * np.arange(steps + 1))
    state = start_sensors(pose[0], velocity[0], depth, PERIOD)
    for k in range(1, steps + 1):
        record_poses(state, pose[k], velocity[k])
    return state


def test_measurements_by_hand() -> None:
    """Lengths are scaled, the angle shifted, the rate scaled and shifted; age grows with the drift."""
    values = {"pose.scale": [1.02, 1.02, 1.0], "pose.offset": [0.0, 0.0, 0.1], "rate.scale": [1.0, 1.0, 0.9]}
    values |= {"pose.delay": [0.004] * 3, "pose.drift": [-1e-3] * 3, "rate.bias": [0.0, 0.0, 0.05]}
    constants = perfect_sensors(1) | {name: np.array([value]) for name, value in values.items()}
    np.testing.assert_allclose(measure_pose(constants, np.array([[0.5, 1.0, -0.3]])), [[0.51, 1.02, -0.2]])
    np.testing.assert_allclose(measure_velocity(constants, np.array([[1.0, -2.0, 9.0]])), [[1.02, -2.04]])
    np.testing.assert_allclose(measure_rate(constants, np.array([2.0])), [1.85])  # 0.9 * 2 + 0.05
    np.testing.assert_allclose(age_of_pose(constants, 3.0), [0.001])  # 4 ms - 3 s * 1 ms/s


def test_perfect_sensors_change_no_bit() -> None:
    """Without errors the truth comes through bit-equal, also through a ring without age."""
    rng, constants = np.random.default_rng(0), perfect_sensors(2)
    state = record_curve(4, 9)
    pose, velocity = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    record_poses(state, pose, velocity)
    past = look_back(state, age_of_pose(constants, 7.0), PERIOD)
    np.testing.assert_array_equal(measure_pose(constants, past[0]), pose)
    np.testing.assert_array_equal(measure_velocity(constants, past[1]), velocity[:, :2])
    np.testing.assert_array_equal(measure_rate(constants, velocity[:, 2]), velocity[:, 2])


@pytest.mark.parametrize("steps", [5, 6, 23])
def test_past_poses_are_found(steps: int) -> None:
    """At any age that the ring spans it shows where the craft was, to the error that it states."""
    state = record_curve(6, steps)
    now = PERIOD * steps
    for age in np.linspace(0.0, 0.05, 41):
        pose, velocity = look_back(state, np.full(2, age), PERIOD)
        true_pose, true_velocity = fly_curve(np.array([now - age]))
        # fourth derivatives of sin(w t) are at most w^4 = 81: h^4/384 * 81 = 2.1e-9, h^3/125 * 81 = 6.5e-7
        np.testing.assert_allclose(pose, true_pose[0], atol=2.2e-9)
        np.testing.assert_allclose(velocity, true_velocity[0], atol=6.6e-7)


def test_nothing_shows_the_future_or_what_is_forgotten() -> None:
    """Ages below zero show the present, ages beyond the ring its oldest entry."""
    state = record_curve(3, 10)
    present, oldest = (fly_curve(np.array([t]))[0][0] for t in (0.10, 0.08))
    np.testing.assert_array_equal(look_back(state, np.array([-0.004, -1.0]), PERIOD)[0], present)
    np.testing.assert_allclose(look_back(state, np.array([0.03, 9.0]), PERIOD)[0], oldest, atol=1e-15)


def test_before_the_start_lies_a_straight_line() -> None:
    """A state that was just started has a past at constant velocity."""
    pose, velocity = np.array([[0.1, 1.2, 0.3]]), np.array([[1.0, -2.0, 4.0]])
    state = start_sensors(pose, velocity, 6, PERIOD)
    seen, speed = look_back(state, np.array([0.034]), PERIOD)
    np.testing.assert_allclose(seen, pose - 0.034 * velocity, atol=1e-15)
    np.testing.assert_allclose(speed, velocity, atol=1e-12)


def test_rows_are_independent_and_can_be_put_back() -> None:
    """Rows taken, saved and written elsewhere continue bit-equal; the other rows do not notice."""
    state, other = record_curve(4, 9), record_curve(4, 6)
    kept = state.take(np.array([0]))
    state.write_rows(np.array([1]), other.take(np.array([1])))
    for name, values in state.arrays().items():
        np.testing.assert_array_equal(values[:1], kept.arrays()[name])
        np.testing.assert_array_equal(values[1:], other.arrays()[name][1:])
    copy = SensorState.from_arrays(state.arrays())
    record_poses(copy, np.zeros((2, 3)), np.zeros((2, 3)))
    assert (copy.newest != state.newest).all()
    age = np.array([0.013, 0.021])
    np.testing.assert_array_equal(look_back(state, age, PERIOD)[0][0], look_back(kept, age[:1], PERIOD)[0][0])


def test_ring_holds_every_age_of_the_catalogue() -> None:
    """Delay and drift of any value within bounds fit; without such effects there is no ring."""
    assert history_depth((), PERIOD, 5.0) == 0
    late = [e for e in CATALOGUE if e.id == "mocap.delay"]
    assert history_depth(late, PERIOD, 5.0) == 6  # 0.05 s and the present
    assert history_depth(CATALOGUE, PERIOD, 5.0) == 11  # and 5 s * 0.01 s/s
    empty = start_sensors(np.zeros((2, 3)), np.zeros((2, 3)), 0, PERIOD)
    record_poses(empty, np.ones((2, 3)), np.ones((2, 3)))
    assert empty.depth == 0


def test_constants_come_from_the_twin() -> None:
    """The records of a twin serve as they are, follow its parameters, and are not to be written."""
    twin = Twin(load_twin(), 2, active=["mocap.scale", "gyro.bias"], num_threads=1)
    np.testing.assert_array_equal(measure_rate(twin.constants, np.ones(2)), [1.0, 1.0])
    for name, value in PERFECT.items():
        np.testing.assert_array_equal(twin.constants[name], np.full((2, 3), value))
    twin.set_parameter("gyro.bias", "bias", np.array([0.1, -0.1]))
    twin.set_parameter("mocap.scale", "scale", 1.1)
    np.testing.assert_array_equal(measure_rate(twin.constants, np.ones(2)), [1.1, 0.9])
    np.testing.assert_allclose(measure_pose(twin.constants, np.ones((2, 3))), [[1.1, 1.1, 1.0]] * 2)
    with pytest.raises(ValueError, match="read-only"):
        twin.constants["rate.bias"][:] = 0.0


def test_sensor_noise_follows_the_vehicle() -> None:
    """Pose noise is the capture's; velocity noise is that of a difference over 10 ms: √2 * 0.4 mm * 100 Hz."""
    pose, velocity = sensor_noise(load_vehicle())
    np.testing.assert_allclose(pose, [0.0004, 0.0004, 0.003])
    np.testing.assert_allclose(velocity, [0.0565685, 0.0565685, 0.02], rtol=1e-5)
