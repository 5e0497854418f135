"""Hooks that tell how training goes: statistics of finished episodes and a progress bar."""

from __future__ import annotations

from collections import deque
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torchrl.trainers import Trainer, TrainerHookBase
from tqdm import tqdm

from vpptwin.progress import open_bar

MEMORY = 200
"""Episodes that the running statistics cover."""

LAYOUT = "{percentage:3.0f}%|{bar:20}| {n_fmt}/{total_fmt} [{rate_fmt}, left {remaining}{postfix}]"


class Simulations(Protocol):
    """What is reported of the simulations that are trained on, wherever they are.

    Attributes:
        faults: number of simulations so far that diverged and were started afresh.
    """

    faults: int

    @property
    def difficulty(self) -> float:
        """Level of the curriculum, 0 to 1."""


class EpisodeStatistics(TrainerHookBase):
    """Running means over the last finished episodes, logged with every batch.

    Logs `reward` (per step of the batch), `return` (sum over an episode), `error_m` (distance at the end of episodes
    that did not fail), `failures` and `success` (shares), `difficulty` (of the curriculum) and `faults` (simulations
    that diverged since the start).

    Args:
        simulations: whose faults and difficulty are reported.
    """

    def __init__(self, simulations: Simulations) -> None:
        self.simulations = simulations
        self.returns: deque[float] = deque(maxlen=MEMORY)
        self.errors: deque[float] = deque(maxlen=MEMORY)
        self.failed: deque[float] = deque(maxlen=MEMORY)
        self.success: deque[float] = deque(maxlen=MEMORY)

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

    def register(self, trainer: Trainer, name: str = "episode_statistics") -> None:
        """Run on every collected batch."""
        trainer.register_op("pre_steps_log", self)
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """The episodes remembered."""
        return {key: list(getattr(self, key)) for key in ("returns", "errors", "failed", "success")}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Remember the episodes of a saved run."""
        for key, values in state_dict.items():
            setattr(self, key, deque(values, maxlen=MEMORY))


class ProgressBar(TrainerHookBase):
    """One line on stderr: steps, steps per second, time left, return, success, position error, difficulty.

    Args:
        statistics: where the numbers come from.
        total: steps when training is over.
        shown: whether to show it.
    """

    def __init__(self, statistics: EpisodeStatistics, total: int, shown: bool = True) -> None:
        self.statistics, self.total, self.shown = statistics, total, shown
        self.trainer: Trainer | None = None
        self.bar: tqdm | None = None

    def open(self) -> None:
        """Start at the steps already collected, which a resumed run has."""
        assert self.trainer is not None
        start = self.trainer.collected_frames
        self.bar = open_bar(total=self.total, initial=start, delay=0.0, disable=not self.shown, bar_format=LAYOUT)

    def __call__(self) -> None:
        """Advance to the trainer's count."""
        assert self.bar is not None
        assert self.trainer is not None
        known = self.statistics
        shown = f"return {mean(known.returns):.0f}, success {mean(known.success):.0%}"
        shown += f", error {mean(known.errors) * 100.0:.1f} cm, difficulty {known.simulations.difficulty:.2f}"
        self.bar.set_postfix_str(shown, False)
        self.bar.update(self.trainer.collected_frames - self.bar.n)

    def close(self) -> None:
        """Leave the last line standing."""
        if self.bar is not None:
            self.bar.close()

    def register(self, trainer: Trainer, name: str = "progress_bar") -> None:
        """Hook into start, batches and end of training."""
        self.trainer = trainer
        trainer.register_op("setup", self.open)
        trainer.register_op("post_steps", self)
        trainer.register_op("shutdown", self.close)
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """Nothing: the count is the trainer's."""
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Nothing to restore."""


def mean(values: deque[float]) -> float:
    """Mean, NaN of nothing."""
    return float(torch.tensor(list(values)).mean()) if values else float("nan")
