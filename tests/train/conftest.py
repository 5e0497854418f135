"""Small environments, ways to fly them, and one brief training that several tests look at."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from tensordict import TensorDict

from vpptwin.train.config import Curriculum, Ramp, Schedule, TrainConfig, to_config, to_plain
from vpptwin.train.env.vpp_env import VppEnv, make_env
from vpptwin.train.main import compose_config, parse_overrides, run_train

TINY = (
    "num_envs=16", "rollout=8", "minibatch=64", "checkpoint_every=128", "exam_every=0", "loggers=csv",
    "progress=false", "sim_threads=1",
)  # fmt: skip
"""A run of a second: enough for everything but learning. 16 drones x 8 steps make batches of 128."""
BRIEF = ("task.episode=0.5", "task.success.window=0.2")
"""Episodes so short that many end within a tiny run, and that not every craft has fallen at the end of one."""
EXAMINED = (
    *TINY, *BRIEF, "total_steps=1024", "randomize=all", "lipschitz=8", "exam_every=256", "exam_from=0", "exam_tracks=8",
)  # fmt: skip
"""1024 steps with noise, every effect randomized, the curriculum, averaging and four exams."""
HOVER = torch.tensor([0.4905, 0.0])
"""Action that carries craft and slider: (0.450 + 0.050) kg * 9.81 m/s^2 of 10 N."""


@cache
def compose_tiny(*choices: str) -> dict[str, Any]:
    """Configuration of a tiny run of a task with a preset, as plain data: Hydra takes a third of a second for it."""
    return to_plain(compose_config([*TINY, *choices]))


def tiny_config(*overrides: str) -> TrainConfig:
    """Configuration of a tiny run."""
    given = parse_overrides(overrides)
    choices = [str(override.input_line) for key, override in given.items() if key in ("task", "preset")]
    config = OmegaConf.create(compose_tiny(*choices))
    for key, override in given.items():
        value = override.value()
        if key not in ("task", "preset"):
            OmegaConf.update(config, key, [value] if key == "randomize" and isinstance(value, str) else value)
    return to_config(OmegaConf.to_container(config))


def tiny_env(*overrides: str, schedule: Schedule | None = None) -> VppEnv:
    """Four drones hovering as nominal, seen without noise, unless overridden."""
    plain = ("num_envs=4", "minibatch=32", "desynchronize=false", "noise=0", "randomize=[]")
    return make_env(tiny_config(*plain, *overrides), schedule=schedule)


def step(env: VppEnv, action: torch.Tensor = HOVER) -> TensorDict:
    """One step of all simulations, without a reset; what `next` holds."""
    return env.step(TensorDict({"action": action.expand(env.batch_size[0], 2)}, batch_size=env.batch_size))["next"]


def reset_rows(env: VppEnv, rows: list[int], last: TensorDict) -> TensorDict:
    """Reset only `rows`, as TorchRL does after the step that returned `last`."""
    mask = torch.zeros(env.batch_size[0], 1, dtype=torch.bool)
    mask[rows] = True
    return env.reset(last.exclude("reward").set("_reset", mask))


def see(env: VppEnv) -> np.ndarray:
    """Measured x, z, θ, v_x, v_z, q, read out of the last observation of the setup `All`, (N, 6)."""
    seen, target = env.episodes.observation.astype(float), env.episodes.target
    angle = target[:, 2] - np.arctan2(seen[:, 4], seen[:, 5])
    return np.column_stack([target[:, :2] - seen[:, :2], angle, seen[:, 2:4], seen[:, 6]])


def truth(env: VppEnv) -> np.ndarray:
    """The true x, z, θ, v_x, v_z, q, (N, 6)."""
    return np.column_stack([env.state.qpos, env.state.qvel])


def read_log(run: Path, name: str) -> np.ndarray:
    """Rows (steps, value) of a logged scalar."""
    return np.loadtxt(run / "log" / "scalars" / f"{name}.csv", delimiter=",", ndmin=2)


def plain_schedule(steps: int) -> Schedule:
    """A curriculum of so many steps: difficulty 0 for 10 % of them, then rising to 1 at 50 %; no nominal twins."""
    return Schedule(Curriculum(difficulty=Ramp(0.0, 1.0, begin=0.1, finish=0.5), single_below=0.4, nominal=0.0), steps)


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished run of `EXAMINED`, logged in both ways."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    return run_train([*EXAMINED, f"out={folder}", "loggers=[csv,tensorboard]"])
