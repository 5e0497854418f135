"""Actor and critic. The actor is what flies: 96 ReLU, 64 tanh, two outputs (paper, Asymmetric Network Structure)."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator

INPUT_SCALE = (0.5, 0.5, 2.0, 2.0, 1.0, 1.0, 5.0, 2.0, 2.0, 1.0, 1.0)
"""Typical size of every input of `observe.OBSERVATION` [m, m, m/s, m/s, 1, 1, rad/s, m, m, 1, 1]."""


class ScaleInputs(nn.Module):
    """Divides observations by their typical sizes, so that the exported network takes SI units."""

    scale: torch.Tensor

    def __init__(self, num_inputs: int) -> None:
        super().__init__()
        self.register_buffer("scale", torch.tensor(INPUT_SCALE[:num_inputs]))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Scaled observation, (..., num_inputs)."""
        return observation / self.scale


class Policy(nn.Module):
    """The deterministic policy: observation (..., 11 or 9) to action (..., 2) in [-1, 1].

    Args:
        num_inputs: length of the observation.
        hidden: units of the ReLU layer and of the tanh layer.
    """

    def __init__(self, num_inputs: int, hidden: tuple[int, int] = (96, 64)) -> None:
        super().__init__()
        first, second = hidden
        last = nn.Linear(second, 2)
        with torch.no_grad():
            last.weight.mul_(0.1)
            last.bias.zero_()
        self.body = nn.Sequential(
            ScaleInputs(num_inputs), nn.Linear(num_inputs, first), nn.ReLU(), nn.Linear(first, second), nn.Tanh(), last
        )

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Action in [-1, 1]."""
        return torch.tanh(self.body(observation))


class Exploration(nn.Module):
    """A policy's outputs before the squashing as location and scale of the exploring distribution.

    The scale is scheduled from outside, not learned: see `ppo.ExplorationRamp`.
    """

    std: torch.Tensor

    def __init__(self, policy: Policy, std: float) -> None:
        super().__init__()
        self.policy = policy
        self.register_buffer("std", torch.tensor(std))

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Location and scale, each (..., 2)."""
        location = self.policy.body(observation)
        return location, self.std.expand_as(location)


def make_actor(exploration: Exploration) -> ProbabilisticActor:
    """Stochastic actor for collection and loss: `observation` to `action` and its log-probability."""
    return ProbabilisticActor(
        TensorDictModule(exploration, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        out_keys=["action"],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0},
        return_log_prob=True,
    )


def make_critic(num_inputs: int, hidden: tuple[int, ...]) -> ValueOperator:
    """A small critic on the same inputs: tanh layers of the given sizes."""
    layers: list[nn.Module] = [ScaleInputs(num_inputs)]
    width = num_inputs
    for units in hidden:
        layers += [nn.Linear(width, units), nn.Tanh()]
        width = units
    return ValueOperator(nn.Sequential(*layers, nn.Linear(width, 1)), in_keys=["observation"])
