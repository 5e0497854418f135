"""Checkpoints: one torch file of tensors and plain data that `weights_only` loading accepts, written atomically."""

from __future__ import annotations

import io
from functools import partial
from pathlib import Path
from typing import Any

import torch

from vpptwin.system.files import write_whole
from vpptwin.train.config import TrainConfig, to_plain
from vpptwin.train.env.base_env import BaseEnv
from vpptwin.train.learn.actor import build_actor
from vpptwin.train.learn.networks import Policy
from vpptwin.train.learn.progress import Hook
from vpptwin.train.stored import FORMAT, KIND, find_commit, find_versions, open_checkpoint


def write_checkpoint(
    path: Path, config: TrainConfig, policy: Policy, steps: int, training: dict[str, Any] | None = None
) -> None:
    """Write a policy and, for resuming, the state of its training; the old file stays until the new one is complete."""
    content = {
        "kind": KIND, "format": FORMAT, "commit": find_commit(), "versions": find_versions(),
        "config": to_plain(config), "steps": steps, "policy": policy.state_dict(), "training": training,
    }  # fmt: skip
    data = io.BytesIO()
    torch.save(content, data)
    write_whole(path, data.getvalue())


def read_checkpoint(path: Path | str, flying: bool = True) -> dict[str, Any]:
    """Content of a checkpoint, with torch's tensors; see `stored.open_checkpoint`."""
    return open_checkpoint(path, flying, partial(torch.load, map_location="cpu", weights_only=True))


def build_policy(content: dict[str, Any], source: object) -> tuple[Policy, TrainConfig]:
    """The policy in a checkpoint's content and the configuration it was trained with.

    Raises:
        InputError: if the weights do not fit the network that the configuration describes, or are no numbers.
    """
    _, config = build_actor(content, source)
    policy = make_policy(config)
    policy.load_state_dict(content["policy"])
    return policy.eval(), config


def make_policy(config: TrainConfig) -> Policy:
    """An untrained policy of the configured size."""
    return Policy(config.observation, (config.hidden[0], config.hidden[1]), config.magnify)


class SaveCheckpoint(Hook):
    """Writes a checkpoint every so many steps and after the last one.

    Args:
        path: of the file.
        config: of the run.
        policy: what flies, the average of what is trained.
        env: whose simulations are saved too, so that a resumed run continues as if never interrupted; None if they
            are elsewhere, and new episodes begin.
    """

    place, name, kept = "post_steps_log", "save_checkpoint", ("saved",)  # the last of them that is registered

    def __init__(self, path: Path, config: TrainConfig, policy: Policy, env: BaseEnv | None) -> None:
        self.path, self.config, self.policy, self.env = path, config, policy, env
        self.saved = 0

    def __call__(self, batch: object = None) -> None:
        """Save if it is time."""
        steps = self.trainer.collected_frames
        if steps - self.saved < self.config.checkpoint_every and steps < self.trainer.total_frames:
            return
        self.saved = steps
        env = None if self.env is None else self.env.take_snapshot()
        training = {"trainer": self.trainer.state_dict(), "env": env, "torch_random": torch.get_rng_state()}
        write_checkpoint(self.path, self.config, self.policy, steps, training)
