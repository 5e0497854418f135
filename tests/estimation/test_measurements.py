"""Streams of a log sorted by degree of freedom, on the drone and on other rigs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.effects.rigs import CART_PENDULUM, CART_TWIN
from tests.estimation.synthetic import draw_commands, fly_own
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Flight, Stream
from vpptwin.system.errors import InputError
from vpptwin.twin import TwinSpec, load_twin

SPEC = load_twin()
TIME = np.arange(0.0, 4.0, 0.01)
NOISE = 0.02


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """The cart with a pendulum."""
    folder: Path = tmp_path_factory.mktemp("cart")
    (folder / "cart_pendulum.xml").write_text(CART_PENDULUM)
    (folder / "cart.yaml").write_text(CART_TWIN)
    return load_twin(folder / "cart.yaml")


def log_cart() -> Flight:
    """A log of the cart: positions of both joints, one velocity, and the motor's effort at other stamps."""
    rng = np.random.default_rng(4)
    slide = np.sin(TIME) + NOISE * rng.normal(size=len(TIME))
    joints = {
        "slide": Stream(TIME, {"position": slide, "velocity": np.cos(TIME) + 2 * NOISE * rng.normal(size=len(TIME))}),
        "swing": Stream(TIME[10:], {"position": 0.5 * np.cos(3 * TIME[10:])}),
    }
    motor = Stream(np.array([0.05, 0.105, 3.5]), {"effort": np.array([1.0, -2.0, 0.5])})
    return Flight(Path("cart.mcap"), 0, {}, {"/joint_states": joints, "/actuator_command": {"motor": motor}})


def without(flight: Flight, topic: str, name: str, column: str | None = None) -> Flight:
    """The flight without a joint, or without a column of it."""
    joints = {t: dict(names) for t, names in flight.joints.items()}
    if column is None:
        del joints[topic][name]
    else:
        stream = joints[topic][name]
        joints[topic][name] = replace(stream, values={k: v for k, v in stream.values.items() if k != column})
    return replace(flight, joints=joints)


def test_drone_streams_are_sorted() -> None:
    """Poses, rate, specific force, commands and speeds of the drone find their places, with the sensors' noise."""
    flight = fly_own(SPEC, draw_commands(300, seed=1)).flight
    measured = read_measurements(SPEC, flight)
    sensors = SPEC.vehicle.sensors  # type: ignore[union-attr]
    pose, imu = flight.streams["/mocap/pose"], flight.streams["/imu/data"]
    for dof, column in enumerate(("x", "z", "theta")):
        np.testing.assert_array_equal(measured.positions[dof].value, pose[column])
    assert [measured.positions[dof].unit for dof in range(3)] == ["m", "m", "rad"]
    stds = [measured.positions[dof].std for dof in range(3)]
    assert stds == [sensors.mocap.position_std, sensors.mocap.position_std, sensors.mocap.angle_std]
    assert list(measured.velocities) == [2]
    np.testing.assert_array_equal(measured.velocities[2].value, imu["rate"])
    assert measured.specific_force is not None
    np.testing.assert_array_equal(measured.specific_force.value, np.stack([imu["accel_x"], imu["accel_z"]], axis=1))
    np.testing.assert_array_equal(measured.command.value, flight.streams["/rotor/command"]["blade_pitch"])
    assert measured.rotor_speed is not None
    assert measured.delayed == (0, 1, 2)


def test_usable_span_is_common_to_all() -> None:
    """A flight is usable from the latest first sample to the earliest last one."""
    flight = fly_own(SPEC, draw_commands(300, seed=1)).flight
    measured = read_measurements(SPEC, flight)
    assert (measured.start, measured.end) == (0.0005, 0.299)  # first IMU sample, last command
    assert measured.duration == pytest.approx(0.2985)


def test_other_rigs_streams_are_sorted(cart: TwinSpec) -> None:
    """Positions and velocities of a rig's joints go to their degrees of freedom, noise read off the samples.

    What is smooth to the last digit somebody smoothed: it is not believed better than 0.3 % of its range.
    """
    measured = read_measurements(cart, log_cart())
    assert sorted(measured.positions) == [0, 1]
    assert sorted(measured.velocities) == [0]
    assert (measured.positions[0].unit, measured.positions[1].unit, measured.velocities[0].unit) == ("m", "rad", "m/s")
    # Third differences of 400 samples give the noise within 4/sqrt(2 * 400/3) or so.
    assert measured.positions[0].std == pytest.approx(NOISE, rel=0.25)
    assert measured.velocities[0].std == pytest.approx(2 * NOISE, rel=0.25)
    low, high = np.percentile(measured.positions[1].value, [1.0, 99.0])
    assert measured.positions[1].std == pytest.approx(0.003 * (high - low), rel=0.02)  # noise-free
    assert measured.specific_force is None
    assert measured.rotor_speed is None
    assert measured.delayed == ()
    assert (measured.start, measured.end) == (0.1, 3.5)


def test_efforts_are_held(cart: TwinSpec) -> None:
    """A control input counts from its stamp to the next."""
    command = read_measurements(cart, log_cart()).command
    np.testing.assert_array_equal(command.time, [0.05, 0.105, 3.5])
    np.testing.assert_array_equal(command.value, [[1.0], [-2.0], [0.5]])


def test_rig_without_actuator_signals_is_passive(cart: TwinSpec) -> None:
    """If no actuator is mapped to a topic its control input is zero throughout."""
    passive = cart.with_robot(signals=cart.robot.signals.model_copy(update={"actuators": {}}))
    command = read_measurements(passive, log_cart()).command
    np.testing.assert_array_equal(command.value, 0.0)
    assert (command.time[0], command.time[-1]) == (0.0, TIME[-1])


@pytest.mark.parametrize(
    ("flight", "found"),
    [
        (replace(log_cart(), joints={}), "no topic /joint_states.*no JointState topic at all"),
        (without(log_cart(), "/joint_states", "swing"), "/joint_states has no 'swing'; expected one of slide"),
        (without(log_cart(), "/joint_states", "swing", "position"), "no position of joint 'swing'.*wheels only"),
        (without(log_cart(), "/actuator_command", "motor"), "/actuator_command has no 'motor'"),
        (
            without(log_cart(), "/actuator_command", "motor", "effort"),
            "has nothing of actuator 'motor'; expected .effort.",
        ),
    ],
    ids=["no topic", "no joint", "no position", "no actuator", "no effort"],
)
def test_missing_signals_are_refused(cart: TwinSpec, flight: Flight, found: str) -> None:
    """A log that lacks what the twin's signals name is refused in one line that says what it has."""
    with pytest.raises(InputError, match=f"cart\\.mcap.*{found}"):
        read_measurements(cart, flight)
