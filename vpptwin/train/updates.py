"""Hooks of the PPO update: advantages once per batch, minibatches, and the schedule of the exploration."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.objectives.value import GAE
from torchrl.trainers import Trainer, TrainerHookBase

from vpptwin.train.config import Ramp
from vpptwin.train.networks import Exploration


class Advantages:
    """Value estimates of a collected batch, with rewards scaled so that a return is of order one.

    TorchRL's trainer calls its estimator before every epoch; the result of the first call is kept for the others.

    Args:
        gae: TorchRL's estimator.
        reward_scale: multiplies rewards, for the critic's sake.
    """

    def __init__(self, gae: GAE, reward_scale: float) -> None:
        self.gae, self.reward_scale = gae, reward_scale
        self._done: tuple[TensorDictBase, TensorDictBase] | None = None

    @torch.no_grad()
    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """What the loss needs of the batch (N, T), advantages included."""
        if self._done is not None and self._done[0] is batch:
            return self._done[1]
        wanted = ("observation", "action", "action_log_prob")
        following = batch["next"].select("observation", "reward", "done", "terminated")
        work = batch.select(*wanted).set("next", following)
        work["next", "reward"] = work["next", "reward"] * self.reward_scale
        result = self.gae(work).select(*wanted, "advantage", "value_target")
        self._done = (batch, result)
        return result


class Minibatches(TrainerHookBase):
    """Shuffles the batch before every epoch and hands out minibatches until it is used up.

    It stands in for TorchRL's replay buffer, which copies the batch every epoch and, for (N, T, 1) flags, marks every
    step as truncated.

    Args:
        size: samples per minibatch; a remainder smaller than half of it is left out.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._order: list[torch.Tensor] = []

    def shuffle(self, batch: TensorDictBase) -> TensorDictBase:
        """Flatten the batch (N, T) and draw a new order."""
        flat = batch.reshape(-1)
        parts = torch.randperm(len(flat)).split(self.size)
        self._order = [ids for ids in parts if 2 * len(ids) >= min(self.size, len(flat))]
        return flat

    def take(self, flat: TensorDictBase) -> TensorDictBase:
        """The next minibatch.

        Raises:
            StopIteration: when the epoch is over.
        """
        if not self._order:
            raise StopIteration
        return flat[self._order.pop()]

    def register(self, trainer: Trainer, name: str = "minibatches") -> None:
        """Hook into epochs and optimization steps."""
        trainer.register_op("pre_epoch", self.shuffle)
        trainer.register_op("process_optim_batch", self.take)
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """Nothing survives a batch."""
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Nothing to restore."""


class ExplorationRamp(TrainerHookBase):
    """Schedules the standard deviation of the exploring actor.

    Args:
        exploration: module whose `std` is set.
        ramp: the schedule.
    """

    def __init__(self, exploration: Exploration, ramp: Ramp) -> None:
        self.exploration, self.ramp = exploration, ramp
        self.trainer: Trainer | None = None

    def __call__(self) -> None:
        """Set the value that belongs to the steps collected so far."""
        assert self.trainer is not None
        progress = self.trainer.collected_frames / self.trainer.total_frames
        self.exploration.std.fill_(self.ramp.at(progress))

    def register(self, trainer: Trainer, name: str = "exploration_ramp") -> None:
        """Run after the updates of every batch, so that a batch is collected and learned from with one value."""
        self.trainer = trainer
        trainer.register_op("post_steps", self)
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """Nothing: the value follows from the trainer's step count."""
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Nothing to restore."""
