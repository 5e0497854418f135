"""What hooks into the trainer, and the hooks that tell how training goes: episodes, a progress bar, loggers."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol

import torch
from tensordict import TensorDictBase
from torchrl.record import CSVLogger
from torchrl.record.loggers import Logger, TensorboardLogger
from torchrl.trainers import Trainer, TrainerHookBase
from tqdm import tqdm

from vpptwin.system.progress import open_bar

MAX_EPISODES = 200
"""Episodes that the running statistics cover."""

LAYOUT = "{percentage:3.0f}%|{bar:20}| {n_fmt}/{total_fmt} [{rate_fmt}, left {remaining}{postfix}]"


class Hook(TrainerHookBase):
    """A hook that is called at one place of the trainer."""

    place: ClassVar[str]  # where the trainer calls it
    name: ClassVar[str]  # of its state in a checkpoint
    kept: ClassVar[tuple[str, ...]] = ()  # attributes that are its state
    trainer: Trainer  # from `register` on

    def register(self, trainer: Trainer, name: str | None = None) -> None:
        """Have the trainer call it at `place`, and save its state."""
        self.trainer = trainer
        trainer.register_op(self.place, self)
        trainer.register_module(name or self.name, self)

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps of it."""
        return {name: getattr(self, name) for name in self.kept}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from a saved run."""
        for name, value in state_dict.items():
            setattr(self, name, value)


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
    """

    place, name = "pre_steps_log", "episode_statistics"  # of every collected batch

    def __init__(self, simulations: Simulations) -> None:
        self.simulations = simulations
        self.returns, self.errors, self.failed, self.success = (deque[float](maxlen=MAX_EPISODES) for _ in range(4))

    def __call__(self, batch: TensorDictBase) -> dict[str, float]:
        """Statistics up to and including the batch (N, T)."""
        last = batch["next"]
        done, terminated = last["done"], last["terminated"]
        self.returns.extend(last["episode_return"][done].tolist())
        self.failed.extend(terminated[done].float().tolist())
        self.success.extend(last["success"][done].tolist())
        self.errors.extend(last["position_error"][done & ~terminated].tolist())
        return {
            "reward": float(last["reward"].mean()), "return": mean(self.returns), "error_m": mean(self.errors),
            "failures": mean(self.failed), "success": mean(self.success), "difficulty": self.simulations.difficulty,
            "faults": float(self.simulations.faults),
        }  # fmt: skip

    def state_dict(self) -> dict[str, Any]:
        """The episodes remembered."""
        return {key: list(getattr(self, key)) for key in ("returns", "errors", "failed", "success")}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Remember the episodes of a saved run."""
        for key, values in state_dict.items():
            setattr(self, key, deque(values, maxlen=MAX_EPISODES))


class ProgressBar(Hook):
    """One line on stderr: steps, steps per second, time left, return, success, position error, difficulty."""

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


class Loggers(Logger):
    """Several of TorchRL's loggers as one: scalars go to each of them, and a run logs nothing else."""

    def __init__(self, loggers: Sequence[Logger], folder: Path) -> None:
        self.loggers = list(loggers)
        super().__init__(exp_name="log", log_dir=str(folder))

    def _create_experiment(self) -> None:
        """Each has its own."""

    def log_scalar(self, name: str, value: float, step: int | None = None) -> None:
        """Log a number at a step."""
        for logger in self.loggers:
            logger.log_scalar(name, value, step)

    def _refuse(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401
        raise NotImplementedError

    log_video = log_hparams = log_histogram = _refuse

    def __repr__(self) -> str:
        return f"Loggers({self.loggers})"


def make_logger(names: Sequence[str], folder: Path) -> Logger:
    """The loggers of a run: `csv` writes log/scalars/*.csv, `tensorboard` tensorboard/."""
    kinds = {"csv": (CSVLogger, "log"), "tensorboard": (TensorboardLogger, "tensorboard")}
    return Loggers([kind(name, log_dir=str(folder)) for key, (kind, name) in kinds.items() if key in names], folder)
