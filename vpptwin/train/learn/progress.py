"""Hooks that tell how training goes: statistics of finished episodes and a progress bar."""

from __future__ import annotations

from collections import deque
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torchrl.trainers import Trainer
from tqdm import tqdm

from vpptwin.system.progress import open_bar
from vpptwin.train.learn.hook import Hook

MEMORY = 200
"""Episodes that the running statistics cover."""

LAYOUT = "{percentage:3.0f}%|{bar:20}| {n_fmt}/{total_fmt} [{rate_fmt}, left {remaining}{postfix}]"


class Simulations(Protocol):
    """What is reported of the simulations that are trained on, wherever they are."""

    faults: int  # number of simulations so far that diverged and were started afresh

    @property
    def difficulty(self) -> float:
        """Level of the curriculum, 0 to 1."""


class EpisodeStatistics(Hook):
    """Running means over the last finished episodes, logged with every batch.

    Logs `reward` (per step of the batch), `return` (sum over an episode), `error_m` (distance at the end of episodes
    that did not fail), `failures` and `success` (shares), `difficulty` (of the curriculum) and `faults` (simulations
    that diverged since the start).

    Args:
        simulations: whose faults and difficulty are reported.
    """

    place, name = "pre_steps_log", "episode_statistics"  # of every collected batch

    def __init__(self, simulations: Simulations) -> None:
        self.simulations = simulations
        self.returns, self.errors, self.failed, self.success = (deque[float](maxlen=MEMORY) for _ in range(4))

    def __call__(self, batch: TensorDictBase) -> dict[str, float]:
        """Statistics up to and including the batch (N, T)."""
        last = batch["next"]
        done, terminated = last["done"], last["terminated"]
        self.returns.extend(last["episode_return"][done].tolist())
        self.failed.extend(terminated[done].float().tolist())
        self.success.extend(last["success"][done].tolist())
        self.errors.extend(last["position_error"][done & ~terminated].tolist())
        return {
            "reward": float(last["reward"].mean()),
            "return": mean(self.returns),
            "error_m": mean(self.errors),
            "failures": mean(self.failed),
            "success": mean(self.success),
            "difficulty": self.simulations.difficulty,
            "faults": float(self.simulations.faults),
        }

    def state_dict(self) -> dict[str, Any]:
        """The episodes remembered."""
        return {key: list(getattr(self, key)) for key in ("returns", "errors", "failed", "success")}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Remember the episodes of a saved run."""
        for key, values in state_dict.items():
            setattr(self, key, deque(values, maxlen=MEMORY))


class ProgressBar(Hook):
    """One line on stderr: steps, steps per second, time left, return, success, position error, difficulty.

    Args:
        statistics: where the numbers come from.
        total: steps when training is over.
        shown: whether to show it.
    """

    place, name = "post_steps", "progress_bar"

    def __init__(self, statistics: EpisodeStatistics, total: int, shown: bool = True) -> None:
        self.statistics, self.total, self.shown = statistics, total, shown
        self.bar: tqdm | None = None

    def open(self) -> None:
        """Start at the steps already collected, which a resumed run has."""
        start = self.trainer.collected_frames
        self.bar = open_bar(total=self.total, initial=start, delay=0.0, disable=not self.shown, bar_format=LAYOUT)

    def __call__(self) -> None:
        """Advance to the trainer's count."""
        assert self.bar is not None
        known = self.statistics
        shown = f"return {mean(known.returns):.0f}, success {mean(known.success):.0%}"
        shown += f", error {mean(known.errors) * 100.0:.1f} cm, difficulty {known.simulations.difficulty:.2f}"
        self.bar.set_postfix_str(shown, False)
        self.bar.update(self.trainer.collected_frames - self.bar.n)

    def close(self) -> None:
        """Leave the last line standing."""
        if self.bar is not None:
            self.bar.close()

    def register(self, trainer: Trainer, name: str | None = None) -> None:
        """Hook into start, batches and end of training."""
        trainer.register_op("setup", self.open)
        super().register(trainer, name)
        trainer.register_op("shutdown", self.close)


def mean(values: deque[float]) -> float:
    """Mean, NaN of nothing."""
    return float(torch.tensor(list(values)).mean()) if values else float("nan")
