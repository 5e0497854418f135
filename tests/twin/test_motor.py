"""Rotor speeds of the twin against those of the independent simulation of proving/drone, under the same commands."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from proving.drone.rig import Rig
from proving.drone.rotor import Motor, Servo
from vpptwin.twin import Twin, TwinSpec, load_twin

HOLD, START = 0.05, 10.0
"""Commands are held for, and the log is old at the start, so many s."""
STEP = 0.001
"""Coarser step of both [s]."""
FLIGHTS, COMMANDS = 8, 12
CASES: dict[str, dict[str, dict[str, float]]] = {
    "none": {},
    "drag": {"rotor.drag": {"gain": 0.85}},
    "sag": {"battery.sag": {"rate": 0.005}},
    "trim": {"servo.trim": {"offset_1": 0.008, "offset_2": -0.005}},
    "lag": {"servo.lag": {"time_constant": 0.035}},
    "delay": {"command.delay": {"delay": 0.0107}},
    "all": {
        "rotor.drag": {"gain": 1.2},
        "battery.sag": {"rate": 0.008},
        "servo.trim": {"offset_1": -0.008, "offset_2": 0.01},
        "servo.lag": {"time_constant": 0.03},
        "command.delay": {"delay": 0.0053},
    },
}
Effects = dict[str, dict[str, float]]


@pytest.fixture(scope="module")
def spec() -> TwinSpec:
    """The nominal twin."""
    return load_twin()


def draw_commands(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random blade pitches [rad] and throttles, (FLIGHTS, COMMANDS, 2) each."""
    rng, shape = np.random.default_rng(seed), (FLIGHTS, COMMANDS, 2)
    return rng.uniform(-0.2, 0.2, shape), rng.uniform(0.35, 0.48, shape)


def spin_twin(spec: TwinSpec, effects: Effects, commands: tuple[np.ndarray, np.ndarray], step: float) -> np.ndarray:
    """Speeds of the twin's motors at the end of every command, beside a measured speed, (FLIGHTS, COMMANDS, 2)."""
    model = copy.copy(spec.model)
    model.opt.timestep = step
    twin = Twin(spec.with_robot(model=model), FLIGHTS, effects, num_threads=1)
    for effect, parameters in effects.items():
        for name, value in parameters.items():
            twin.set_parameter(effect, name, value)
    state = twin.initial_state(qpos=np.array([0.0, 1.5, 0.0]), time=START)
    per = round(HOLD / step)
    pitch, throttle = (np.repeat(given, per, axis=1) for given in commands)
    speed = twin.replay_commands(state, pitch, np.full_like(pitch, 471.0), throttle).rotor_speed
    assert speed is not None
    return speed[:, per - 1 :: per]


def spin_reality(effects: Effects, commands: tuple[np.ndarray, np.ndarray], step: float) -> np.ndarray:
    """Speeds of the independent simulation's motors at the same times."""
    rig = Rig([effects] * FLIGHTS, [None] * FLIGHTS)
    pitch, throttle = (given.transpose(1, 2, 0) for given in commands)
    servo, motor = Servo(rig, np.zeros_like(pitch[0]), step), Motor(rig, step)
    per, speeds = round(HOLD / step), []
    for k in range(COMMANDS * per):
        motor.advance(throttle[k // per], servo.advance(pitch[k // per]), START + k * step)
        if (k + 1) % per == 0:
            speeds.append(motor.speed)
    return np.array(speeds).transpose(2, 0, 1)


@pytest.mark.slow  # a step of another length compiles anew
@pytest.mark.parametrize("case", CASES)
def test_motors_agree_with_an_independent_model(spec: TwinSpec, case: str) -> None:
    """Speeds are equal at their finer steps, but for what halving both steps changes; drag 1 % off would show."""
    effects, commands = CASES[case], draw_commands(seed=list(CASES).index(case))
    twin, finer = (spin_twin(spec, effects, commands, step) for step in (STEP, STEP / 2))
    reality, finer_reality = (spin_reality(effects, commands, step) for step in (STEP, STEP / 2))
    bound = np.abs(twin - finer).max() + np.abs(reality - finer_reality).max()
    assert np.abs(finer - finer_reality).max() <= bound
    wrong = effects | {"rotor.drag": {"gain": 0.01 + effects.get("rotor.drag", {"gain": 1.0})["gain"]}}
    assert np.abs(spin_twin(spec, wrong, commands, STEP / 2) - finer_reality).max() > 4 * bound
    assert np.ptp(finer) > 50.0  # rad/s
