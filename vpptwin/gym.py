"""The environments for Gymnasium: `import vpptwin.gym`, then `gymnasium.make("vpptwin/flip-v0")`, or `make_vec`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vpptwin.system.errors import explain_missing

try:
    import gymnasium
    import torch
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
    from tensordict import TensorDict, TensorDictBase
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(explain_missing(error, __name__) or error, name=error.name) from error

from vpptwin.train.env.base_env import BaseEnv
from vpptwin.train.env.environments import make_task_env
from vpptwin.train.env.tasks import TASKS

Info = dict[str, Any]
METADATA: Info = {"render_modes": ["rgb_array"], "render_fps": 100}
INFO = ("position_error", "success")
"""What `info` holds: m, and whether an episode that ends here was one."""


class TwinEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One drone flying a task: what docs/train.md says is observed, thrust and rate in [-1, 1] of the vehicle's limits.

    Args:
        task: one of `vpptwin.train.env.tasks.TASKS`.
        render_mode: `rgb_array`, or None.
        options: twin, noise, randomize, as of `vpptwin.make_env`.

    Raises:
        InputError: as `vpptwin.make_env`.
    """

    metadata = METADATA

    def __init__(self, task: str = "flip", render_mode: str | None = None, **options: Any) -> None:  # noqa: ANN401
        self._env = make_task_env(task, num_envs=1, **options)
        self.observation_space, self.action_space = make_spaces(self._env)
        self.render_mode = render_mode

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[np.ndarray, Info]:
        """Begin an episode: observation and info."""
        super().reset(seed=seed)
        self._env.rng = self.np_random
        shown = self._env.reset()
        return shown["observation"][0].numpy(), make_info(shown, 0)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Info]:
        """Fly a policy step, 0.01 s: observation, reward, terminated, truncated, info."""
        after = advance(self._env, action[None])
        terminated, truncated = (bool(after[name][0]) for name in ("terminated", "truncated"))
        return after["observation"][0].numpy(), float(after["reward"][0]), terminated, truncated, make_info(after, 0)

    def render(self) -> np.ndarray | None:
        """The drone from the side, (400, 640, 3) uint8; None without a render mode."""
        return None if self.render_mode is None else self._env.render()


class TwinVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N drones in one simulation; those whose episode ends begin anew in the same step.

    Args:
        num_envs: N.
        task: one of `vpptwin.train.env.tasks.TASKS`.
        render_mode: `rgb_array`, or None.
        options: twin, noise, randomize, as of `vpptwin.make_env`.

    Raises:
        InputError: as `vpptwin.make_env`.
    """

    metadata = METADATA | {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self, num_envs: int = 1, task: str = "flip", render_mode: str | None = None, **options: Any  # noqa: ANN401
    ) -> None:  # fmt: skip
        self._env = make_task_env(task, num_envs=num_envs, **options)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.single_observation_space, self.single_action_space = make_spaces(self._env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | Sequence[int] | None = None, options: Info | None = None) -> tuple[np.ndarray, Info]:
        """Begin all episodes: observations (N, inputs) and info."""
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self._env.rng = self.np_random
        shown = self._env.reset()
        return shown["observation"].numpy(), make_info(shown)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Fly a policy step; where an episode ended, `final_obs` of info is what it ended with."""
        after = advance(self._env, actions)
        terminated, truncated = (after[name].numpy()[:, 0] for name in ("terminated", "truncated"))
        done, info, seen = terminated | truncated, make_info(after), after["observation"].numpy()
        if done.any():
            last = np.full(self.num_envs, None, object)
            for row in np.flatnonzero(done):
                last[row] = seen[row]
            info |= {"final_obs": last, "_final_obs": done, "final_info": dict(info), "_final_info": done}
            mask = TensorDict({"_reset": torch.from_numpy(done[:, None])}, self._env.batch_size)
            seen = self._env.reset(mask)["observation"].numpy()
        return seen, after["reward"].numpy()[:, 0].astype(np.float64), terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """The first drone from the side, (400, 640, 3) uint8; None without a render mode."""
        return None if self.render_mode is None else (self._env.render(),)


def make_spaces(env: BaseEnv) -> tuple[Box, Box]:
    """What one drone shows and takes."""
    inputs = env.observation_spec["observation"].shape[-1]
    return Box(-np.inf, np.inf, (inputs,), np.float32), Box(-1.0, 1.0, (2,), np.float32)


def advance(env: BaseEnv, actions: np.ndarray) -> TensorDictBase:
    """What follows on actions (N, 2)."""
    given = torch.from_numpy(np.asarray(actions, np.float32))
    after: TensorDictBase = env.step(TensorDict({"action": given}, env.batch_size))["next"]
    return after


def make_info(shown: TensorDictBase, row: int | slice = slice(None)) -> Info:
    """The info of one drone, or of all."""
    return {name: shown[name].numpy()[row, 0] for name in INFO}


for name in TASKS:
    gymnasium.register(
        f"vpptwin/{name}-v0",
        f"{__name__}:TwinEnv",
        vector_entry_point=f"{__name__}:TwinVectorEnv",
        kwargs={"task": name},
    )
