"""The rig as a plain gymnasium environment: MjModel, MjData, the controller in Python between calls of mj_step."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

from same_rig.cascade import Cascade
from same_rig.rig import EPISODE, START_POSE, START_VELOCITY, SUBSTEPS, TRAVEL
from vpptwin.robots.planar_drone.vehicle import Vehicle


class RailRig(gymnasium.Env):
    """One craft on its rails; observes pose and velocity, pays for closeness to where it started."""

    def __init__(self, rig: Path, vehicle: Vehicle) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(rig))
        self.data = mujoco.MjData(self.model)
        self.cascade = Cascade(vehicle)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (6,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._elapsed = 0

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        """Back to the start, as at power-on."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = START_POSE, START_VELOCITY
        self.cascade.reset()
        self._elapsed = 0
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Fly 10 ms."""
        model, data, cascade = self.model, self.data, self.cascade
        cascade.command(*action.tolist())
        qvel, ctrl = data.qvel, data.ctrl
        for _ in range(SUBSTEPS):
            ctrl[:] = cascade.step(float(qvel[2]))
            mujoco.mj_step(model, data)
        self._elapsed += 1
        x, z, _ = data.qpos.tolist()
        reward = -float(np.hypot(x - START_POSE[0], z - START_POSE[1]))
        inside = TRAVEL[0][0] < x < TRAVEL[0][1] and TRAVEL[1][0] < z < TRAVEL[1][1]
        return self._observe(), reward, not inside, self._elapsed >= EPISODE, {}

    def _observe(self) -> np.ndarray:
        return np.concatenate([self.data.qpos, self.data.qvel])


class AsyncRigs:
    """`AsyncVectorEnv`, which has a process for every rig."""

    title = "gymnasium AsyncVectorEnv"
    leaves_out = "6 observations, reward of one line, no non-finite guard"
    controlled = True

    def __init__(self, rig: Path, vehicle: Vehicle, envs: int, seed: int) -> None:
        self.envs = self.workers = envs
        # Forked workers would inherit the threads of torch, jax and MuJoCo halfway through what they were doing.
        self._env = gymnasium.vector.AsyncVectorEnv([partial(RailRig, rig, vehicle)] * envs, context="forkserver")
        self._observation = self._env.reset(seed=seed)[0]

    def start(self) -> None:
        """Put every rig at the start state."""
        self._observation = self._env.reset()[0]

    def step(self, actions: np.ndarray) -> None:
        """One step of all rigs; one that ended starts anew in its next step."""
        self._observation = self._env.step(actions)[0]

    def positions(self) -> np.ndarray:
        """x, z, θ, (envs, 3)."""
        return self._observation[:, :3].copy()

    def close(self) -> None:
        """End the worker processes."""
        self._env.close()
