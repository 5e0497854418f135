"""The layer as a whole: rate loop, delay before lag, state as an argument and a result."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from vpptwin.actuators.layer import (
    ActuatorConstants,
    ActuatorState,
    command_from_policy,
    move_actuators,
    rotor_thrust,
    spin_rotors,
)
from vpptwin.vehicle import load_vehicle

DT = 0.001
VEHICLE = load_vehicle()


def rest(count: int, depth: int = 0) -> ActuatorState:
    """Rotors at governed speed and zero pitch."""
    speed = np.full((count, 2), VEHICLE.rotor.speed)
    pairs = [np.zeros((count, 2)) for _ in range(4)]
    return ActuatorState(pairs[0], pairs[1], np.zeros((count, depth, 2)), speed, pairs[2], np.zeros(count), pairs[3])


def constants(count: int, delay: float = 0.0, time_constant: float = VEHICLE.servo.time_constant) -> ActuatorConstants:
    """The same delay and lag everywhere, gain one."""
    shape = (count, 2)
    return ActuatorConstants(np.full(shape, delay), np.full(shape, time_constant), np.ones(shape))


def fly_rate(thrust: np.ndarray, rate: np.ndarray, seconds: float) -> np.ndarray:
    """Rates q [rad/s] (steps, N) of a craft that only pitches, under thrust and rate commands (N,)."""
    layer, count = rest(len(rate)), len(rate)
    policy, q, seen = np.stack([thrust, rate], axis=1), np.zeros(count), []
    for _ in range(round(seconds / DT)):
        pitch, throttle, layer = command_from_policy(VEHICLE, layer, policy, q, layer.rotor_speed, DT)
        layer = spin_rotors(VEHICLE, move_actuators(layer, constants(count), pitch, DT), throttle, DT)
        force = rotor_thrust(VEHICLE, layer)
        q = q + DT * (force[:, 1] - force[:, 0]) * VEHICLE.airframe.half_length / VEHICLE.airframe.inertia
        seen.append(q)
    return np.array(seen)


@pytest.mark.parametrize("thrust", [-5.7, 0.0, 5.7])
def test_rate_loop_settles(thrust: float) -> None:
    """A rate command is reached within 2 % after 0.35 s with an overshoot below 10 %, upright or inverted."""
    # I s (T s + 1) + kd s + kp = 0 has a damping of about 0.8 and 30 rad/s: settled in 4/(0.8 * 30) = 0.17 s; from
    # ±12 rad/s on the torque saturates for the first tenth of a second.
    commands = np.array([-12.0, -5.0, -0.5, 0.5, 5.0, 12.0])
    rate = fly_rate(np.full(6, thrust), commands, seconds=0.6)
    np.testing.assert_allclose(rate[350:], np.broadcast_to(commands, rate[350:].shape), rtol=0.02)
    overshoot = (rate / commands).max(axis=0) - 1
    assert overshoot.max() < 0.10
    assert (rate / commands).min() >= 0.0


def test_rate_loop_does_not_know_left_from_right() -> None:
    """Opposite rate commands give opposite rates."""
    rate = fly_rate(np.full(2, 3.0), np.array([4.0, -4.0]), seconds=0.2)
    np.testing.assert_allclose(rate[:, 0], -rate[:, 1], rtol=0, atol=1e-12)


def test_delay_comes_before_lag() -> None:
    """A step command leaves the blade at rest for the delay, then moves it along the lag's exponential."""
    layer, parameters = rest(1, depth=8), constants(1, delay=0.002, time_constant=0.02)
    blade = []
    for _ in range(10):
        layer = move_actuators(layer, parameters, np.full((1, 2), 0.1), DT)
        blade.append(layer.output[0, 0])
    elapsed = np.maximum(np.arange(1, 11) * DT - 0.002, 0.0)
    np.testing.assert_allclose(blade, 0.1 * (1 - np.exp(-elapsed / 0.02)), atol=1e-16)


def test_thrust_is_the_mean_over_the_step() -> None:
    """Rotor thrust follows the blade's mean pitch, not its last one: 0.0505 * 471.239 * 0.1 = 2.37976 N."""
    layer = replace(rest(1), output=np.full((1, 2), 0.2), mean=np.full((1, 2), 0.1))
    np.testing.assert_allclose(rotor_thrust(VEHICLE, layer), 2.37975695, rtol=1e-8)


def test_arguments_stay_as_they_were() -> None:
    """One pass through the layer modifies none of its arguments, and its result shares no memory with a later one."""
    rng = np.random.default_rng(5)
    layer = replace(rest(3, depth=4), gyro=rng.normal(size=3), history=rng.normal(size=(3, 4, 2)) * 0.05)
    arguments = (rng.normal(size=(3, 2)), rng.normal(size=3), np.full((3, 2), 460.0))
    before = {f.name: getattr(layer, f.name).copy() for f in fields(layer)}
    copies = [a.copy() for a in arguments]
    for array in (*arguments, *(getattr(layer, f.name) for f in fields(layer))):
        array.flags.writeable = False  # writing to one would raise
    pitch, throttle, after = command_from_policy(VEHICLE, layer, *arguments, DT)
    after = spin_rotors(VEHICLE, move_actuators(after, constants(3, delay=0.001), pitch, DT), throttle, DT)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(layer, name), value, err_msg=name)
    for argument, copy in zip(arguments, copies):
        np.testing.assert_array_equal(argument, copy)
    assert not np.array_equal(after.gyro, layer.gyro)
    assert not np.array_equal(after.rotor_speed, layer.rotor_speed)


def test_rows_do_not_mix() -> None:
    """Row i of three goes through the layer bit for bit as it does alone."""
    rng = np.random.default_rng(6)
    policy, rate, speed = rng.normal(size=(3, 2)) * 5, rng.normal(size=3), rng.uniform(440, 500, (3, 2))
    layer = replace(rest(3, depth=4), history=rng.normal(size=(3, 4, 2)) * 0.05, rotor_speed=speed)
    delay, lag = rng.uniform(0, 0.002, (3, 2)), rng.uniform(0.01, 0.04, (3, 2))

    def advance(rows: slice) -> ActuatorState:
        part = ActuatorState(**{f.name: getattr(layer, f.name)[rows] for f in fields(layer)})
        parameters = ActuatorConstants(delay[rows], lag[rows], np.ones_like(lag[rows]))
        for _ in range(5):
            pitch, throttle, part = command_from_policy(VEHICLE, part, policy[rows], rate[rows], part.rotor_speed, DT)
            part = spin_rotors(VEHICLE, move_actuators(part, parameters, pitch, DT), throttle, DT)
        return part

    together = advance(slice(None))
    for i in range(3):
        alone = advance(slice(i, i + 1))
        for f in fields(alone):
            np.testing.assert_array_equal(getattr(alone, f.name)[0], getattr(together, f.name)[i], err_msg=f.name)
