"""Hooks of the PPO update: advantages once per batch, minibatches, exploration, Lipschitz bound, averaged weights."""

from __future__ import annotations

import copy
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.objectives.value.functional import generalized_advantage_estimate
from torchrl.trainers import Trainer

from vpptwin.system.errors import InputError
from vpptwin.train.config import Ramp
from vpptwin.train.learn.networks import Exploration, Policy, bound_layers
from vpptwin.train.learn.progress import Hook


class Advantages:
    """Value estimates of a collected batch, with rewards scaled so that a return is of order one.

    TorchRL's trainer calls its estimator before every epoch; the result of the first call is kept for the others. Its
    `GAE` would run the critic twice over every step; here values of following steps are looked up where they exist.

    Args:
        critic: from `critic_observation` to values.
        gamma: discount per step.
        lmbda: λ.
        reward_scale: multiplies rewards, for the critic's sake.
        groups: see `normalize`.
    """

    def __init__(self, critic: nn.Module, gamma: float, lmbda: float, reward_scale: float, groups: int = 1) -> None:
        self.critic, self.gamma, self.lmbda, self.reward_scale = critic, gamma, lmbda, reward_scale
        self.groups = groups
        self._done: tuple[TensorDictBase, TensorDictBase] | None = None

    @torch.no_grad()
    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """What the loss needs of the batch (N, T), normalized advantages included."""
        if self._done is not None and self._done[0] is batch:
            return self._done[1]
        last = batch["next"]
        # Inside an episode the value of the following step is the next one's, and need not be computed again.
        value = self.critic(batch["critic_observation"])
        ends = last["done"][..., 0].clone()
        ends[:, -1] = True
        following = torch.roll(value, -1, 1)
        following[ends] = self.critic(last["critic_observation"][ends])
        # Valued as if the target had stayed, where it is worth as much as a step before.
        surprised = last["surprised"] > 0.0
        following = torch.where(surprised, value, following)
        advantage, target = generalized_advantage_estimate(
            self.gamma, self.lmbda, value, following, last["reward"] * self.reward_scale, last["done"] | surprised,
            last["terminated"],
        )  # fmt: skip
        result = batch.select("observation", "critic_observation", "action", "action_log_prob")
        result["advantage"] = normalize(advantage, value, self.groups)
        result["value_target"] = target
        self._done = (batch, result)
        return result


def normalize(advantage: torch.Tensor, value: torch.Tensor, groups: int) -> torch.Tensor:
    """Advantages with mean 0 and deviation 1 within each of so many groups of steps, of like value and equal size.

    Which group a step is in depends on its state only, so that an action stays as much better than another as it was.
    With one group for all, the many steps at rest, whose advantages are small, hardly count beside a few in falling.
    """
    flat = advantage.flatten()
    result = torch.empty_like(flat)
    for ids in value.flatten().argsort().chunk(groups):
        part = flat[ids]
        result[ids] = (part - part.mean()) / part.std(correction=min(1, len(part) - 1)).clamp_min(1e-5)
    return result.reshape(advantage.shape)


class Minibatches(Hook):
    """Shuffles the batch before every epoch and hands out minibatches until it is used up.

    It stands in for TorchRL's replay buffer, which copies the batch every epoch and, for (N, T, 1) flags, marks every
    step as truncated.

    Args:
        size: samples per minibatch; a remainder smaller than half of it is left out.
    """

    name = "minibatches"

    def __init__(self, size: int) -> None:
        self.size = size
        self._parts: list[TensorDictBase] = []

    def shuffle(self, batch: TensorDictBase) -> TensorDictBase:
        """Flatten the batch (N, T) in a new order."""
        flat = batch.reshape(-1)
        mixed = flat[torch.randperm(len(flat), device=flat.device)]
        self._parts = [part for part in mixed.split(self.size) if 2 * len(part) >= min(self.size, len(flat))]
        return mixed

    def take(self, mixed: TensorDictBase) -> TensorDictBase:
        """The next minibatch, a view.

        Raises:
            StopIteration: when the epoch is over.
        """
        if not self._parts:
            raise StopIteration
        return self._parts.pop()

    def register(self, trainer: Trainer, name: str | None = None) -> None:
        """Hook into epochs and optimization steps."""
        trainer.register_op("pre_epoch", self.shuffle)
        trainer.register_op("process_optim_batch", self.take)
        trainer.register_module(name or self.name, self)


class ExplorationRamp(Hook):
    """Schedules the standard deviation of the exploring actor, so that a batch has one value."""

    place, name = "post_steps", "exploration_ramp"  # after the updates of a batch

    def __init__(self, exploration: Exploration, ramp: Ramp) -> None:
        self.exploration, self.ramp = exploration, ramp

    def __call__(self) -> None:
        """Set the value that belongs to the steps collected so far."""
        progress = self.trainer.collected_frames / self.trainer.total_frames
        self.exploration.std.fill_(self.ramp.at(progress))


class LipschitzBound(Hook):
    """Keeps the actor within its Lipschitz bound, if there is one, after every step (paper, Spectral Normalization)."""

    place, name = "post_optim", "lipschitz_bound"

    def __init__(self, policy: Policy, lipschitz: float | None) -> None:
        self.policy, self.lipschitz = policy, lipschitz

    def __call__(self) -> None:
        """Project the weights."""
        if self.lipschitz is not None:
            bound_layers(self.policy, self.lipschitz)

    def register(self, trainer: Trainer, name: str | None = None) -> None:
        """Run now and after every gradient step."""
        self()
        super().register(trainer, name)


class Averaging(Hook):
    """Averages the policy's weights over updates: the average flies better, and differs less from one to the next.

    The average is on the CPU, wherever training is.
    An average of layers within a norm is within it too, so that it keeps the Lipschitz bound.
    """

    place, name = "post_steps", "averaging"  # after the updates of a batch

    def __init__(self, policy: Policy, share: float) -> None:
        self.policy = policy
        self.model = AveragedModel(policy, multi_avg_fn=get_ema_multi_avg_fn(share)).cpu()

    @property
    def averaged(self) -> Policy:
        """The policy to fly."""
        module = self.model.module
        assert isinstance(module, Policy)
        return module

    def __call__(self) -> None:
        """Take in the weights of now.

        Raises:
            InputError: if they are not finite.
        """
        if not all(bool(torch.isfinite(value).all()) for value in self.policy.parameters()):
            expected = "finite ones; the last checkpoint is sound"
            raise InputError("weights that are not finite", expected, "lower learning_rate.start or max_grad_norm")
        on_cpu = next(self.policy.parameters()).device.type == "cpu"
        self.model.update_parameters(self.policy if on_cpu else copy.deepcopy(self.policy).cpu())

    def state_dict(self) -> dict[str, Any]:
        """The average."""
        return dict(self.model.state_dict())

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from a saved one."""
        self.model.load_state_dict(state_dict)
