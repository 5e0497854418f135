"""The cascade as one thing: what flies inside the compiled step is what `run_cascade` does with the readings."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.train.conftest import tiny_config
from vpptwin.actuators.adaptive import start_memory
from vpptwin.actuators.controller import run_cascade
from vpptwin.actuators.layer import layer_dtype
from vpptwin.actuators.motor import compute_current
from vpptwin.actuators.numbers import record_vehicle
from vpptwin.robots.planar_drone.vehicle import load_vehicle
from vpptwin.train.env.vpp_env import make_env
from vpptwin.twin import Twin, load_twin

VEHICLE = load_vehicle()
HIDDEN = {"servo.trim": {"offset_1": 0.01, "offset_2": -0.01}, "servo.backlash": {"gap": 0.02},
          "gyro.bias": {"bias": 0.05}, "battery.sag": {"rate": 0.005}}  # fmt: skip
TICKS, STEPS = 40, 10


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
