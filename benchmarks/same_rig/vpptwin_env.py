"""vpptwin's training environment with dry friction on both rails, through its public interface."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import torch

from same_rig.rig import FRICTION, START_POSE, START_VELOCITY
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.train.env.base_env import EnvConfig
from vpptwin.train.env.tasks import HOVER
from vpptwin.train.env.vpp_env import VppEnv
from vpptwin.twin import Twin, load_twin

RAILS = ("rail_x.coulomb", "rail_z.coulomb")


def make_twin(count: int) -> Twin:
    """The nominal twin with dry friction on both rails."""
    spec = load_twin("nominal")
    spec.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    twin = Twin(spec, count, active=RAILS)
    for effect in RAILS:
        twin.set_parameter(effect, "force", FRICTION)
    return twin


def fly_twin(actions: np.ndarray) -> np.ndarray:
    """Positions of a twin after every control step under actions in [-1, 1], (steps, 2): (steps, 3) m, m, rad."""
    twin = make_twin(1)
    control = twin.vehicle.control
    scale = np.array([control.thrust_max, control.rate_max])
    state, positions = twin.initial_state(np.array(START_POSE), np.array(START_VELOCITY)), []
    for action in actions.astype(float):
        state = twin.step_policy(state, (action * scale)[None], 1.0 / control.policy_rate)
        positions.append(state.qpos[0].copy())
    return np.array(positions)


class TwinRigs:
    """`VppEnv` on the nominal twin; the rig's file is its own, so `rig` is not read."""

    title = "vpptwin VppEnv"
    leaves_out = (
        "nothing that the others have; besides 11 observations with error integral, shaped reward, non-finite guard"
    )
    controlled = True
    workers = 0

    def __init__(self, rig: Path, vehicle: Vehicle, envs: int, seed: int) -> None:
        self.envs, self._twin = envs, make_twin(envs)
        self._env = VppEnv(self._twin, EnvConfig(HOVER, seed, desynchronize=True))
        self._step = self._env.reset()

    def start(self) -> None:
        """Put every rig at the start state."""
        self._step = self._env.reset()
        self._env.state = self._twin.initial_state(np.array(START_POSE), np.array(START_VELOCITY))
        self._env.episodes.elapsed[:] = 0.0  # none ends during the flight that is compared

    def step(self, actions: np.ndarray) -> None:
        """One step of the environment, with resets of the rows that ended."""
        self._step["action"] = torch.from_numpy(actions)
        _, self._step = self._env.step_and_maybe_reset(self._step)

    def positions(self) -> np.ndarray:
        """x, z, θ, (envs, 3)."""
        return self._env.state.qpos.copy()

    def close(self) -> None:
        """Nothing to end."""
