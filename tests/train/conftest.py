"""Small environments and one brief training that several tests look at."""

from __future__ import annotations

from pathlib import Path

import pytest

from vpptwin.train.config import TrainConfig
from vpptwin.train.env import VppEnv, make_env
from vpptwin.train.main import run_train
from vpptwin.train.overrides import compose_config

TINY = ("num_envs=16", "rollout=8", "minibatch=64", "checkpoint_every=128", "progress=false", "sim_threads=1")
"""A run of a second: enough for everything but learning."""


def tiny_config(*overrides: str) -> TrainConfig:
    """Configuration of a tiny run."""
    return compose_config([*TINY, *overrides])


def tiny_env(*overrides: str) -> VppEnv:
    """Four drones hovering, unless overridden."""
    return make_env(tiny_config("num_envs=4", "minibatch=32", "desynchronize=false", *overrides))


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished tiny run of 1024 steps with noise and every effect randomized."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    return run_train([*TINY, f"out={folder}", "total_steps=1024", "noise=1", "randomize=all"])
