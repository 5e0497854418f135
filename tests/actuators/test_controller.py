"""Gyro filter, rate PD and allocation by hand; what flies inside the compiled step is `run_cascade` of the readings."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict

from tests.train.conftest import tiny_config
from vpptwin.actuators.adaptive import start_memory
from vpptwin.actuators.blade import max_thrust
from vpptwin.actuators.controller import allocate, compute_torque, filter_gyro, run_cascade
from vpptwin.actuators.layer import layer_dtype
from vpptwin.actuators.motor import compute_current
from vpptwin.actuators.numbers import record_vehicle
from vpptwin.robots.planar_drone.vehicle import Vehicle, load_vehicle
from vpptwin.train.env.vpp_env import make_env
from vpptwin.twin import Twin, load_twin

VEHICLE = load_vehicle()
HIDDEN = {"servo.trim": {"offset_1": 0.01, "offset_2": -0.01}, "servo.backlash": {"gap": 0.02},
          "gyro.bias": {"bias": 0.05}, "battery.sag": {"rate": 0.005}}  # fmt: skip
TICKS, STEPS = 40, 10


def test_gyro_filter_by_hand(vehicle: Vehicle) -> None:
    """From 0, a rate of 1 passes as 0.4, 0.4 + 0.4 * 0.6 = 0.64, 0.64 + 0.4 * 0.36 = 0.784."""
    filtered, seen = 0.0, []
    for _ in range(3):
        filtered = filter_gyro(vehicle, filtered, 1.0)
        seen.append(filtered)
    assert seen == pytest.approx([0.4, 0.64, 0.784], rel=1e-14)


def test_torque_by_hand(vehicle: Vehicle) -> None:
    """Rates 0.9 then 1.0 in 1 ms towards 2 rad/s: 0.12 * (2 - 1) - 0.0003 * 0.1/0.001 = 0.12 - 0.03 = 0.09 N m."""
    assert compute_torque(vehicle, 2.0, 1.0, 0.9, dt=0.001) == pytest.approx(0.09, rel=1e-12)


@pytest.mark.parametrize(
    ("thrust", "torque", "expected"),
    [
        pytest.param(4.0, 0.0, (2.0, 2.0), id="thrust is shared"),
        pytest.param(0.0, 0.5, (-1.0, 1.0), id="positive torque lifts the right arm"),  # 0.5 / (2 * 0.25) = 1 N each
        pytest.param(4.0, 0.5, (1.0, 3.0), id="both"),
        pytest.param(-4.0, 0.5, (-3.0, -1.0), id="inverted"),
        pytest.param(20.0, 0.0, (5.0, 5.0), id="thrust saturates"),
        pytest.param(10.0, 1.0, (1.0, 5.0), id="thrust gives way to rate"),  # half difference 2, so the mean is 3
        pytest.param(-10.0, 1.0, (-5.0, -1.0), id="thrust gives way when inverted"),
        pytest.param(4.0, 2.0, (-3.0, 5.0), id="thrust gives way in part"),  # half difference 4, so the mean is 1
        pytest.param(10.0, 5.0, (-5.0, 5.0), id="all for rate"),  # asks for 10 N each way
        pytest.param(10.0, -5.0, (5.0, -5.0), id="all for the other rate"),
    ],
)
def test_allocation_by_hand(vehicle: Vehicle, thrust: float, torque: float, expected: tuple[float, float]) -> None:
    """f_1,2 = f/2 ∓ τ/(2 l) within ±5 N, thrust giving way to torque."""
    np.testing.assert_allclose(allocate(vehicle, thrust, torque), expected, rtol=1e-14, atol=1e-14)


@given(st.floats(-30.0, 30.0), st.floats(-3.0, 3.0))
def test_rate_control_wins(thrust: float, torque: float) -> None:
    """Torque is met up to what the rotors can give at all, thrust as far as the room that is left allows."""
    limit, length = max_thrust(VEHICLE.rotor), VEHICLE.airframe.half_length
    first, second = allocate(VEHICLE, thrust, torque)
    assert max(abs(first), abs(second)) <= limit * (1 + 1e-15)
    possible = float(np.clip(torque, -2 * limit * length, 2 * limit * length))
    assert (second - first) * length == pytest.approx(possible, abs=1e-14)
    room = 2 * (limit - abs(possible) / (2 * length))
    assert first + second == pytest.approx(float(np.clip(thrust, -room, room)), abs=1e-13)


def draw_commands() -> np.ndarray:
    """Thrust and rate at every tick, (TICKS, 2) N, rad/s, up and down, as wild as a flip."""
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(-8.0, 10.0, TICKS), rng.uniform(-8.0, 8.0, TICKS)])


@pytest.mark.parametrize("controller", ["map", "adaptive"])
def test_recorded_readings_give_the_same_commands(controller: str) -> None:
    """Gyro, speeds and currents of a flight, fed to the plain functions, give its pitches and throttles."""
    twin = Twin(load_twin().with_effects(HIDDEN).with_controller(controller), 1, num_threads=1)
    state, vehicle = twin.initial_state(time=0.0), record_vehicle(VEHICLE)[0]
    memory = np.zeros(1, layer_dtype(2, 0, controller == "adaptive")).view(np.recarray)[0]
    if controller == "adaptive":
        memory.adaptive[:] = start_memory(VEHICLE.rotor.speed)
    for thrust, rate in draw_commands():
        for _ in range(STEPS):
            speed, before = state.rotor_speed[0].copy(), state.throttle[0].copy()
            supply = VEHICLE.motor.battery * (1.0 - 0.005 * state.time[0])
            current = [float(compute_current(vehicle.motor, before[i] * supply, speed[i])) for i in range(2)]
            turn = float(state.qvel[0, 2]) + 0.05
            twin.advance_policy(state, np.array([[thrust, rate]]), twin.dt)
            pitch = run_cascade(
                vehicle, memory, thrust, rate, turn, (speed[0], speed[1]), (current[0], current[1]), twin.dt
            )
            layer = state.actuators[0]
            np.testing.assert_allclose(pitch, layer["history"][layer["newest"]], rtol=0.0, atol=1e-12)
            np.testing.assert_allclose(memory.throttle, state.throttle[0], rtol=0.0, atol=1e-12)
    assert state.finite().all()


@pytest.mark.parametrize("controller", ["map", "adaptive"])
def test_training_flies_the_same_cascade(controller: str) -> None:
    """An environment under a policy's actions goes where the twin goes under the commands that they stand for."""
    config = tiny_config(
        f"controller={controller}", "num_envs=2", "minibatch=16", "noise=0", "randomize=[]", "task=hover"
    )
    env = make_env(config)
    env.set_seed(1)
    env.reset()
    twin, state = Twin(load_twin().with_controller(controller), 2, num_threads=1), env.state.copy()
    scale = np.array([VEHICLE.control.thrust_max, VEHICLE.control.rate_max])
    for command in draw_commands()[:15]:
        action = torch.tensor(np.tile(0.3 * command / scale, (2, 1)))
        env.step(TensorDict({"action": action}, [2]))
        twin.advance_policy(state, action.numpy() * scale)
        np.testing.assert_array_equal(env.state.qpos, state.qpos)
        np.testing.assert_array_equal(env.state.actuators["throttle"], state.actuators["throttle"])
