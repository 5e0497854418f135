"""Actor and critic. The actor is what flies: 96 ReLU, 64 tanh, two outputs (paper, Asymmetric Network Structure)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import ProbabilisticActor, TanhNormal

from vpptwin.train.env.observe import ObservationTerms

INPUT_SCALE = {
    "delta_x": 0.5, "delta_z": 0.5, "velocity_x": 2.0, "velocity_z": 2.0, "rate": 5.0,
    "integral_x": 2.0, "integral_z": 2.0,
}  # fmt: skip
"""Typical size of inputs [m, m, m/s, m/s, rad/s, m, m]; the others, angles and their functions, are of order 1."""


FINE_SCALE = {"delta_x": 0.02, "delta_z": 0.02, "integral_x": 0.2, "integral_z": 0.2}
"""Size of the same inputs within which a network should tell them well apart: those that decide on precision [m]."""
FINE = 0.25
"""How much of a scaled input is spent on that."""


class ScaleInputs(nn.Module):
    """Divides inputs by their typical sizes, so that the exported network takes SI units; small ones are magnified.

    x becomes x / scale + FINE x / (fine + |x|), which rises throughout. Without the second part centimetres are
    hundredths, whose gradient drowns in that of large inputs to the same weights.

    Args:
        names: of the inputs.
        magnify: False for the first part alone.
    """

    scale: torch.Tensor
    fine: torch.Tensor
    share: torch.Tensor

    def __init__(self, names: Sequence[str], magnify: bool = True) -> None:
        super().__init__()
        self.register_buffer("scale", torch.tensor([INPUT_SCALE.get(name, 1.0) for name in names]))
        self.register_buffer("fine", torch.tensor([FINE_SCALE.get(name, 1.0) for name in names]))
        self.register_buffer("share", torch.tensor([FINE * (magnify and name in FINE_SCALE) for name in names]))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Scaled inputs, (..., len(names))."""
        return inputs / self.scale + self.share * inputs / (self.fine + inputs.abs())

    @property
    def steepest(self) -> torch.Tensor:
        """Largest derivative, at zero, (len(names),)."""
        return 1.0 / self.scale + self.share / self.fine


class Policy(nn.Module):
    """The deterministic policy: observation (..., inputs) to action (..., 2) in [-1, 1].

    Args:
        observation: what it is shown.
        hidden: units of the ReLU layer and of the tanh layer.
        magnify: see `ScaleInputs`.
    """

    def __init__(self, observation: ObservationTerms, hidden: tuple[int, int] = (96, 64), magnify: bool = True) -> None:
        super().__init__()
        first, second = hidden
        last = nn.Linear(second, 2)
        with torch.no_grad():
            last.weight.mul_(0.1)
            last.bias.zero_()
        scale, inputs = ScaleInputs(observation.names, magnify), len(observation.names)
        self.body = nn.Sequential(scale, nn.Linear(inputs, first), nn.ReLU(), nn.Linear(first, second), nn.Tanh(), last)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Action in [-1, 1]."""
        return torch.tanh(self.body(observation))

    def layers(self) -> Iterator[nn.Linear]:
        """Its linear layers, first to last."""
        return (layer for layer in self.body if isinstance(layer, nn.Linear))

    @torch.no_grad()
    def lipschitz(self) -> float:
        """Upper bound of ‖a(s₁) - a(s₂)‖ / ‖s₁ - s₂‖ for scaled inputs s: the product of the layers' spectral norms.

        ReLU and tanh are 1-Lipschitz. For inputs in SI units it is this times the steepest scaling, `lipschitz_si`.
        """
        bound = 1.0
        for layer in self.layers():
            bound *= float(spectral_norm(layer.weight))
        return bound

    def lipschitz_si(self) -> float:
        """The same for inputs in SI units, as the exported network takes them."""
        scaling = self.body[0]
        assert isinstance(scaling, ScaleInputs)
        return self.lipschitz() * float(scaling.steepest.max())


@torch.no_grad()
def spectral_norm(weight: torch.Tensor) -> torch.Tensor:
    """Largest singular value of a matrix, from the eigenvalues of its smaller Gram matrix; NaN if that overflows."""
    gram = weight @ weight.T if weight.shape[0] <= weight.shape[1] else weight.T @ weight
    if not bool(torch.isfinite(gram).all()):
        return gram.new_tensor(torch.nan)  # eigvalsh would raise; `updates.Averaging` tells what happened
    return torch.linalg.eigvalsh(gram)[-1].clamp_min(0.0).sqrt()


@torch.no_grad()
def bound_layers(policy: Policy, lipschitz: float) -> None:
    """Scale down every layer whose spectral norm exceeds its share of a bound of the whole network.

    Every layer's share is the third root. The paper's spectral normalization, as a projection after each gradient step:
    a layer may be flatter than its bound, which a division by the norm would not allow.
    """
    layers = list(policy.layers())
    share = lipschitz ** (1.0 / len(layers))
    for layer in layers:
        if not surely_within(layer.weight, share):
            layer.weight.mul_((share / spectral_norm(layer.weight).clamp_min(1e-12)).clamp_max(1.0))


@torch.no_grad()
def surely_within(weight: torch.Tensor, bound: float) -> bool:
    """Whether a norm that is cheap, and never below the spectral norm, is within a bound; the exact one costs a lot.

    It is the sixteenth root of the sum of all singular values to the 16th, little above the largest.
    """
    scaled = weight / bound
    gram = scaled @ scaled.T if weight.shape[0] <= weight.shape[1] else scaled.T @ scaled
    return bool(torch.linalg.matrix_power(gram, 4).square().sum() <= 1.0)


class Exploration(nn.Module):
    """A policy's outputs before the squashing as location and scale of the exploring distribution.

    Args:
        policy: whose outputs.
        std: scale to begin with. It is scheduled from outside, see `updates.ExplorationRamp`, unless it is learned.
        learned: one for each output, as PPO has it.
    """

    std: torch.Tensor

    def __init__(self, policy: Policy, std: float, learned: bool = False) -> None:
        super().__init__()
        self.policy = policy
        if learned:
            self.log_std = nn.Parameter(torch.full((2,), std).log())
        else:
            self.register_buffer("std", torch.tensor(std))

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Location and scale, each (..., 2)."""
        location = self.policy.body(observation)
        return location, (self.log_std.exp() if hasattr(self, "log_std") else self.std).expand_as(location)


def make_actor(exploration: Exploration) -> ProbabilisticActor:
    """Stochastic actor for collection and loss: `observation` to `action` and its log-probability."""
    module = TensorDictModule(exploration, in_keys=["observation"], out_keys=["loc", "scale"])
    return ProbabilisticActor(
        module, in_keys=["loc", "scale"], out_keys=["action"], distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0}, return_log_prob=True,
    )  # fmt: skip


class Critic(nn.Module):
    """Value of what a critic is shown, (..., memory, width) to (..., 1).

    Args:
        names: of the inputs that come in SI units, first; what follows is of order 1.
        width: number of all inputs of one step.
        hidden: units of the layers.
        lstm: units of an LSTM over the steps that comes first; 0 for none, and the last step only.
        magnify: see `ScaleInputs`.
    """

    def __init__(
        self, names: Sequence[str], width: int, hidden: Sequence[int], lstm: int = 0, magnify: bool = True
    ) -> None:
        super().__init__()
        self.scale = ScaleInputs([*names, *[""] * (width - len(names))], magnify)
        self.lstm = nn.LSTM(width, lstm, batch_first=True) if lstm else None
        units = lstm or width
        layers: list[nn.Module] = []
        for size in hidden:
            layers += [nn.Linear(units, size), nn.Tanh()]
            units = size
        self.body = nn.Sequential(*layers, nn.Linear(units, 1))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """Value, (..., 1)."""
        if self.lstm is None:
            return self.body(self.scale(seen[..., -1, :]))
        steps, _ = self.lstm(self.scale(seen).flatten(0, -3))
        return self.body(steps[:, -1]).unflatten(0, seen.shape[:-2])
