"""The factories that TorchRL's `rlrender` asks for.

rlrender --ckpt runs/flip/best.pt --env vpptwin.train.evaluate.render:make_env
    --policy vpptwin.train.evaluate.render:make_policy --seed 3 --fps 50 --out flip.gif
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from vpptwin.train.config import to_config
from vpptwin.train.env import vpp_env as environment
from vpptwin.train.learn.checkpoint import build_policy
from vpptwin.train.learn.networks import Policy


def make_env(checkpoint: dict[str, Any], seed: int | None = None) -> environment.VppEnv:
    """One simulation of a checkpoint's task, at full difficulty, with its noise and randomization.

    Args:
        checkpoint: content of a checkpoint file, as rlrender reads it.
        seed: of everything random; None for that of training.
    """
    trained = to_config(checkpoint["config"])
    config = replace(trained, num_envs=1, desynchronize=False, seed=trained.seed if seed is None else seed)
    return environment.make_env(config)


def make_policy(checkpoint: dict[str, Any], ckpt_path: str) -> Policy:
    """A checkpoint's policy: from observations (N, k) to its most likely actions, (N, 2) in [-1, 1]."""
    return build_policy(checkpoint, ckpt_path)[0]
