"""Evaluation while training: the same flights every time, and the best policy kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from vpptwin.train.config import TrainConfig
from vpptwin.train.env.vpp_env import VppEnv, make_env
from vpptwin.train.evaluate.flights import Flights, fly_tracks
from vpptwin.train.learn.checkpoint import write_checkpoint
from vpptwin.train.learn.hook import Hook
from vpptwin.train.learn.networks import Policy
from vpptwin.train.stored import BEST_NAME

SEED = 2_000_003
"""Of the flights, which are none of those that `vpptwin evaluate` flies by default."""
LOST = 0.5
"""What a failed flight counts as in the score, m."""


class Exam(Hook):
    """Flies a fixed set at full difficulty every so many steps and keeps the best policy as best.pt.

    Logs `exam_score_m` (mean position error, failed flights counted as `LOST`), `exam_error_m` (of those that did not
    fail; not a number if all did), `exam_failures` and `exam_success`. The random numbers of training are left as they
    are.

    Args:
        config: of the run.
        policy: what flies.
        folder: of the run.

    Attributes:
        best: lowest score so far, m.
    """

    place, name = "post_steps_log", "exam"  # after the updates of a batch, before the checkpoint is written

    def __init__(self, config: TrainConfig, policy: Policy, folder: Path) -> None:
        self.config, self.policy, self.path = config, policy, folder / BEST_NAME
        self.best, self.taken = float("inf"), 0
        self._env: VppEnv | None = None

    def __call__(self, batch: object = None) -> dict[str, float] | None:
        """Fly if it is time, and after the last update."""
        steps = self.trainer.collected_frames
        over = steps >= self.trainer.total_frames
        early = steps < self.config.exam_from * self.trainer.total_frames
        if not self.config.exam_every or ((early or steps - self.taken < self.config.exam_every) and not over):
            return None
        self.taken = steps
        flown = self._fly()
        score = flown.score(LOST)
        if score <= self.best:
            self.best = score
            write_checkpoint(self.path, self.config, self.policy, steps)
        kept = flown.position_error[~flown.failed]
        return {
            "exam_score_m": score, "exam_error_m": float(kept.mean()) if len(kept) else np.nan,
            "exam_failures": float(flown.failed.mean()), "exam_success": float(flown.success.mean()),
        }  # fmt: skip

    def _fly(self) -> Flights:
        if self._env is None:
            tracks = self.config.exam_tracks
            self._env = make_env(replace(self.config, num_envs=tracks, seed=SEED, desynchronize=False))
        self._env.set_seed(SEED)
        with torch.random.fork_rng():
            return fly_tracks(self._env, self.policy)

    def state_dict(self) -> dict[str, Any]:
        """When it last flew and how well."""
        return {"best": self.best, "taken": self.taken}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from a saved run."""
        self.best, self.taken = state_dict["best"], state_dict["taken"]
