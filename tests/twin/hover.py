"""The nominal rig held up by its rotors: starts and coasting under steady blades, for tests of what else acts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from unittest.mock import patch

import numpy as np

from vpptwin.robots.planar_drone.vehicle import load_vehicle
from vpptwin.twin import Twin, TwinSpec, TwinState, load_twin

X, Z, PITCH = 0, 1, 2
SPEC = load_twin()
VEHICLE = load_vehicle()
WEIGHT = (VEHICLE.airframe.mass + VEHICLE.rig.slider_mass) * VEHICLE.gravity
MASS_X = VEHICLE.airframe.mass + VEHICLE.rig.slider_mass + VEHICLE.rig.carriage_mass
BLADE_PER_NEWTON = 1.0 / (VEHICLE.rotor.k_t * VEHICLE.rotor.speed)


def place(
    twin: Twin, pose: np.ndarray | None = None, velocity: np.ndarray | None = None, thrust: float = 0.0
) -> TwinState:
    """A state at a pose and velocity at one time, (N, 3), the blades already where they give `thrust` [N] in all."""
    pose = np.array([[0.0, 1.0, 0.0]]) if pose is None else pose
    velocity = np.zeros_like(pose) if velocity is None else velocity
    state = twin.initial_state(qpos=twin.pose_for_engine(pose, velocity), qvel=velocity)
    for name in ("horn", "blade", "output", "mean", "history"):
        state.actuators[name] = 0.5 * thrust * BLADE_PER_NEWTON
    return state


def coast(twin: Twin, state: TwinState, seconds: float, thrust: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Poses and velocities after every step, (N, steps, 3), under blades that ask for `thrust` [N] in all."""
    steps = round(seconds / twin.dt)
    commands = np.full((twin.num_sims, steps, 2), 0.5 * thrust * BLADE_PER_NEWTON)
    _, qpos, qvel, _ = twin.replay_commands(state, commands)
    return twin.pose_at_time(qpos, qvel), qvel


def make_twin(count: int, effects: Mapping[str, Mapping[str, np.ndarray | float]], spec: TwinSpec = SPEC) -> Twin:
    """A twin of `count` simulations with these effects."""
    twin = Twin(spec, count, active=effects, num_threads=1)
    for effect_id, values in effects.items():
        for name, value in values.items():
            twin.set_parameter(effect_id, name, value)
    return twin


def share_kernel() -> Any:  # noqa: ANN401
    """In this context twins of whatever step hold as many commands: what is compiled for one step serves all."""
    return patch("vpptwin.twin.stepping.kernel.delay_depth", lambda effects, dt: 1000)


def assert_states(found: TwinState, expected: TwinState, share: float = 0.0) -> None:
    """Equal in everything: to the last bit, or to a share of the largest value of each array."""
    for name, values in expected.arrays().items():
        scale = max(float(np.abs(values).max(initial=0.0)), 1e-3)
        np.testing.assert_allclose(found.arrays()[name], values, rtol=0, atol=share * scale, err_msg=name)
