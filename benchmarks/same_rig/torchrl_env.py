"""The rig on TorchRL's MuJoCo environment base with its native backend, MuJoCo's C bindings."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs.custom.mujoco.base import MujocoEnv

from same_rig.cascade import Cascade
from same_rig.rig import EPISODE, START_POSE, START_VELOCITY, SUBSTEPS, TRAVEL
from vpptwin.robots.planar_drone.vehicle import Vehicle


class RailRig(MujocoEnv):
    """One craft on its rails; observes pose and velocity, pays for closeness to where it started.

    The base holds `ctrl` during its frame skip; a Python callback in MuJoCo's control stage runs the controller there.
    Stepping the backend once a physics step instead would cross between torch and MuJoCo ten times as often.
    """

    FRAME_SKIP = SUBSTEPS
    RESET_NOISE_SCALE = 0.0

    def __init__(self, vehicle: Vehicle, **kwargs: Any) -> None:  # noqa: ANN401
        super().__init__(max_episode_steps=EPISODE, **kwargs)
        self._cascade = Cascade(vehicle)
        self._low, self._high = torch.tensor(TRAVEL, dtype=self.dtype).T
        self._goal = torch.tensor(START_POSE[:2])

    def _sample_initial_state(
        self, n: int, tensordict: TensorDictBase | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.tensor([START_POSE] * n), torch.tensor([START_VELOCITY] * n)

    def _on_reset_all(self, tensordict: TensorDictBase | None = None) -> None:
        self._cascade.reset()

    def _on_reset_mask(self, mask: torch.Tensor, tensordict: TensorDictBase | None = None) -> None:
        if bool(mask.any()):
            self._cascade.reset()

    def _prepare_ctrl(self, action: torch.Tensor) -> torch.Tensor:
        self._cascade.command(*action[0].tolist())
        return action

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        mujoco.set_mjcb_control(self._control)
        try:
            return super()._step(tensordict)
        finally:
            mujoco.set_mjcb_control(None)

    def _control(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.ctrl[:] = self._cascade.step(float(data.qvel[2]))

    def _compute_reward(self, state: TensorDictBase, action: torch.Tensor, next_state: TensorDictBase) -> torch.Tensor:
        return -(next_state["qpos"][:, :2] - self._goal).norm(dim=-1)

    def _compute_done(self, state: TensorDictBase, next_state: TensorDictBase) -> torch.Tensor:
        position = next_state["qpos"][:, :2]
        return ((position <= self._low) | (position >= self._high)).any(dim=-1)


class SerialRigs:
    """The base's own way to batch its native backend in one process: `num_envs=N, parallel=False`, a SerialEnv."""

    title = "TorchRL MujocoEnv, SerialEnv"
    leaves_out = "6 observations, reward of one line, no non-finite guard; one core"
    controlled = True
    parallel: ClassVar[bool] = False

    def __init__(self, rig: Path, vehicle: Vehicle, envs: int, seed: int) -> None:
        self.envs, self.workers = envs, envs if self.parallel else 0
        native = {"xml_path": rig, "patch_xml": False, "backend": "mujoco"}
        self._env = RailRig(vehicle, **native, num_envs=envs, parallel=self.parallel, seed=seed)
        self.start()

    def start(self) -> None:
        """Put every rig at the start state."""
        self._step = self._env.reset()

    def step(self, actions: np.ndarray) -> None:
        """One step of all rigs, with resets of those that ended."""
        self._step["action"] = torch.from_numpy(actions).unflatten(0, self._env.batch_size)
        _, self._step = self._env.step_and_maybe_reset(self._step)

    def positions(self) -> np.ndarray:
        """x, z, θ, (envs, 3)."""
        return self._step["observation"].flatten(0, -2)[:, :3].double().numpy()

    def close(self) -> None:
        """End the worker processes, if any."""
        self._env.close()


class ParallelRigs(SerialRigs):
    """The base's default for `num_envs=N` on its native backend: a ParallelEnv with a process for every rig."""

    title = "TorchRL MujocoEnv, ParallelEnv"
    leaves_out = "6 observations, reward of one line, no non-finite guard"
    parallel = True
