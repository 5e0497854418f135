"""The layer as a whole: rate loop, delay before lag before play, state as an explicit record."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vpptwin.actuators.layer import (
    NO_LIMIT,
    command_from_policy,
    constants_dtype,
    layer_dtype,
    limit_control,
    move_actuator,
    push_commands,
    spin_rotor,
)
from vpptwin.robots.planar_drone.vehicle import load_vehicle

DT = 0.001
VEHICLE = load_vehicle()


def rest(count: int, depth: int = 0) -> np.ndarray:
    """Rotors at governed speed and zero pitch, (count,) records."""
    layer = np.zeros(count, layer_dtype(2, depth))
    layer["rotor_speed"] = VEHICLE.rotor.speed
    return layer


def constants(count: int, **changed: Any) -> np.ndarray:  # noqa: ANN401
    """Nominal constants, (count,) records; those given, with _ for the dot, are other than nominal."""
    table = np.zeros(count, constants_dtype(2, 3))
    nominal = {"actuator.time_constant": VEHICLE.servo.time_constant, "actuator.gain": 1.0}
    nominal |= {"actuator.rate_limit": NO_LIMIT, "actuator.limit": NO_LIMIT, "rate.scale": 1.0, "rotor.drag_gain": 1.0}
    for name, value in (nominal | {key.replace("_", ".", 1): value for key, value in changed.items()}).items():
        table[name] = value
    return table


def move(state: Any, parameters: Any, pitch: tuple[float, float]) -> None:  # noqa: ANN401
    """Both actuators of one simulation follow their commands for one step."""
    push_commands(state)
    for i in range(2):
        move_actuator(state, parameters, i, pitch[i], DT)


def advance(layer: np.ndarray, table: np.ndarray, policy: np.ndarray, turn: np.ndarray) -> None:
    """One pass through the layer, in place, of N simulations under thrust and rate (N, 2) at true rates (N,)."""
    rows, parameters = layer.view(np.recarray), table.view(np.recarray)
    for n in range(len(layer)):
        pitch = command_from_policy(VEHICLE, rows[n], parameters[n], policy[n, 0], policy[n, 1], turn[n], 0.0, DT)
        move(rows[n], parameters[n], pitch)
        for i in range(2):
            spin_rotor(VEHICLE, rows[n], parameters[n], i, 0.0, DT)


def fly_rate(thrust: float, rate: np.ndarray, seconds: float, **changed: float) -> np.ndarray:
    """Rates q [rad/s] (steps, N) of a craft that only pitches, under a thrust and rate commands (N,)."""
    layer, table, count = rest(len(rate)), constants(len(rate), **changed), len(rate)
    policy, q, seen = np.stack([np.full(count, thrust), rate], axis=1), np.zeros(count), []
    for _ in range(round(seconds / DT)):
        advance(layer, table, policy, q)
        force = VEHICLE.rotor.k_t * layer["rotor_speed"] * layer["mean"]
        q = q + DT * (force[:, 1] - force[:, 0]) * VEHICLE.airframe.half_length / VEHICLE.airframe.inertia
        seen.append(q)
    return np.array(seen)


@pytest.mark.parametrize("thrust", [-5.7, 0.0, 5.7])
def test_rate_loop_settles(thrust: float) -> None:
    """A rate command is reached within 2 % after 0.35 s with an overshoot below 10 %, upright or inverted."""
    # I s (T s + 1) + kd s + kp = 0 has a damping of about 0.8 and 30 rad/s: settled in 4/(0.8 * 30) = 0.17 s; from
    # ±12 rad/s on the torque saturates for the first tenth of a second.
    commands = np.array([-12.0, -5.0, -0.5, 0.5, 5.0, 12.0])
    rate = fly_rate(thrust, commands, seconds=0.6)
    np.testing.assert_allclose(rate[350:], np.broadcast_to(commands, rate[350:].shape), rtol=0.02)
    overshoot = (rate / commands).max(axis=0) - 1
    assert overshoot.max() < 0.10
    assert (rate / commands).min() >= 0.0


def test_rate_loop_does_not_know_left_from_right() -> None:
    """Opposite rate commands give opposite rates."""
    rate = fly_rate(3.0, np.array([4.0, -4.0]), seconds=0.2)
    np.testing.assert_allclose(rate[:, 0], -rate[:, 1], rtol=0, atol=1e-12)


def test_rate_loop_believes_the_gyro() -> None:
    """With a gyro that says 1.1 q + 0.2 the loop settles where that reading is the command: q = (4 - 0.2)/1.1."""
    rate = fly_rate(3.0, np.array([4.0]), seconds=0.6, rate_scale=1.1, rate_bias=0.2)
    np.testing.assert_allclose(rate[-1], 3.8 / 1.1, rtol=1e-3)


def follow(steps: int, pitch: float, depth: int = 8, **changed: Any) -> np.ndarray:  # noqa: ANN401
    """Records of a layer (steps,) after each step under a blade-pitch command from rest."""
    layer, table = rest(1, depth).view(np.recarray), constants(1, **changed).view(np.recarray)
    states = []
    for _ in range(steps):
        move(layer[0], table[0], (pitch, -pitch))
        states.append(layer.copy())
    return np.concatenate(states)


def test_delay_comes_before_lag() -> None:
    """A step command leaves the blade at rest for the delay, then moves it along the lag's exponential."""
    blade = follow(10, 0.1, actuator_delay=0.002)["output"]
    elapsed = np.maximum(np.arange(1, 11) * DT - 0.002, 0.0)
    np.testing.assert_allclose(blade[:, 0], 0.1 * (1 - np.exp(-elapsed / 0.02)), atol=1e-16)
    np.testing.assert_array_equal(blade[:, 1], -blade[:, 0])


def test_lag_within_a_rate_limit() -> None:
    """A servo of 2 rad/s ramps by 2 mrad in every 1 ms until the lag alone, of (0.1 - α)/0.02, is slower."""
    blade = follow(100, 0.1, actuator_rate_limit=2.0)["output"][:, 0]
    np.testing.assert_allclose(blade[:29], 0.002 * np.arange(1, 30), rtol=1e-12)  # 0.06 is where (0.1 - α)/0.02 is 2
    assert (np.diff(blade[31:]) < 0.002).all()
    np.testing.assert_allclose(np.diff(blade[31:]), (0.1 - blade[31:-1]) * (1 - np.exp(-0.05)), rtol=1e-9)


def test_play_comes_after_the_servo_and_trim_after_play() -> None:
    """The blade follows the horn half a gap behind, and trim is added to where it is, one way and back."""
    states = follow(200, 0.1, actuator_gap=0.02, actuator_trim=np.array([0.005, 0.0]))
    np.testing.assert_allclose(states["horn"][-1], [0.1, -0.1], atol=1e-5)
    np.testing.assert_allclose(states["blade"][-1], [0.09, -0.09], atol=1e-5)
    np.testing.assert_allclose(states["output"][-1], [0.095, -0.09], atol=1e-5)
    assert states["blade"][1, 0] == 0.0  # 0.1 (1 - e^-0.1) = 0.0095: still in the play


def test_control_has_gain_then_limit() -> None:
    """A control of 3 at gain 0.5 is 1.5, within a limit of 1 it is 1, and -1 on the other side."""
    table = constants(1, actuator_gain=0.5, actuator_limit=np.array([NO_LIMIT, 1.0])).view(np.recarray)[0]
    assert [limit_control(table, i, u) for i, u in ((0, 3.0), (1, 3.0), (1, -3.0), (1, 1.0))] == [1.5, 1.0, -1.0, 0.5]


def test_battery_sags_with_time() -> None:
    """A battery that loses 1 % a second turns a rotor, around 10 s, as one of 0.9 times the voltage does at once."""
    fresh, old = rest(1).view(np.recarray), rest(1).view(np.recarray)
    fresh.throttle, old.throttle = 0.9 * 0.5, 0.5
    spin_rotor(VEHICLE, fresh[0], constants(1).view(np.recarray)[0], 0, 10.0 - 0.5 * DT, DT)
    spin_rotor(VEHICLE, old[0], constants(1, battery_sag=0.01).view(np.recarray)[0], 0, 10.0 - 0.5 * DT, DT)
    assert old.rotor_speed[0, 0] == pytest.approx(fresh.rotor_speed[0, 0], rel=1e-14)
    assert old.rotor_speed[0, 1] == VEHICLE.rotor.speed  # the other one was not asked to turn


def draw_layer(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """States, constants, policy commands and rates at random, everything different in every simulation."""
    layer = rest(count, depth=4)
    layer["history"] = rng.normal(size=(count, 4, 2)) * 0.05
    layer["rotor_speed"] = rng.uniform(440, 500, (count, 2))
    layer["gyro"], layer["newest"] = rng.normal(size=count), rng.integers(0, 4, count)
    table = constants(
        count, actuator_delay=rng.uniform(0, 0.002, (count, 2)), actuator_time_constant=rng.uniform(0.01, 0.04),
        actuator_gap=rng.uniform(0, 0.001, (count, 2)), actuator_rate_limit=rng.uniform(5, 20, (count, 2)),
        rate_bias=rng.normal(size=(count, 3)), rate_scale=rng.uniform(0.9, 1.1, (count, 3)),
    )  # fmt: skip
    return layer, table, rng.normal(size=(count, 2)) * 5, rng.normal(size=count)


def test_only_the_state_is_written() -> None:
    """One pass through the layer writes to the state and to nothing else."""
    layer, *given = draw_layer(3, np.random.default_rng(5))
    before = layer.copy()
    for array in given:
        array.flags.writeable = False  # writing to one would raise
    advance(layer, *given)
    for name in ("horn", "blade", "output", "mean", "history", "newest", "rotor_speed", "throttle", "gyro"):
        assert not np.array_equal(layer[name], before[name]), name


def test_rows_do_not_mix() -> None:
    """Row i of three goes through the layer bit for bit as it does alone."""
    together, *given = draw_layer(3, np.random.default_rng(6))
    start = together.copy()
    for _ in range(5):
        advance(together, *given)
    for i in range(3):
        alone = start[i : i + 1].copy()
        for _ in range(5):
            advance(alone, *(array[i : i + 1] for array in given))
        assert alone[0] == together[i]


def test_saved_layer_goes_on() -> None:
    """Copied between two steps, with commands on their way, a layer goes on bit for bit."""
    layer, *given = draw_layer(3, np.random.default_rng(7))
    for _ in range(3):
        advance(layer, *given)
    saved = np.frombuffer(layer.tobytes(), layer.dtype).copy()
    for state in (layer, saved):
        for _ in range(6):
            advance(state, *given)
    assert (layer == saved).all()
