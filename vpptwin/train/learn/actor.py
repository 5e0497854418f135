"""A trained policy in NumPy, for those who fly it or write it down: torch is for training."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from vpptwin.system.errors import InputError
from vpptwin.train.config import TrainConfig, to_config
from vpptwin.train.stored import TRAIN_AGAIN

LAYERS = ("body.1", "body.3", "body.5")
"""Names of its linear layers: `networks.Policy` has scaling, ReLU, tanh between them."""


class Actor:
    """What `vpptwin.train.learn.networks.Policy` computes.

    Attributes:
        weights: float32.
    """

    def __init__(self, weights: Mapping[str, Any]) -> None:
        self.weights = {name: np.asarray(values, np.float32) for name, values in weights.items()}

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Actions (N, 2) in [-1, 1] of observations (N, inputs), float32."""
        inputs = observation.astype(np.float32, copy=False)
        scale, fine, share = (self.weights[f"body.0.{name}"] for name in ("scale", "fine", "share"))
        first, second, last = self.layers()
        units = inputs / scale + share * inputs / (fine + np.abs(inputs))
        units = np.maximum(units @ first[0].T + first[1], 0.0)
        units = np.tanh(units @ second[0].T + second[1])
        action: np.ndarray = np.tanh(units @ last[0].T + last[1])
        return action

    def layers(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Weights (outputs, inputs) and biases (outputs,) of its linear layers, first to last."""
        return ((self.weights[f"{name}.weight"], self.weights[f"{name}.bias"]) for name in LAYERS)


def build_actor(content: Mapping[str, Any], source: object) -> tuple[Actor, TrainConfig]:
    """The policy in a checkpoint's content and the configuration it was trained with.

    Args:
        content: of `open_checkpoint`, tensors of torch or NumPy.
        source: where it comes from, for messages.

    Raises:
        InputError: if the weights do not fit the network that the configuration describes, or are no numbers.
    """
    try:
        config = to_config(content["config"])
    except InputError as error:
        raise InputError(f"{source}: {error.found}", error.expected, error.action) from error
    sizes = [len(config.observation.names), *config.hidden, 2]
    shapes: dict[str, tuple[int, ...]] = {f"body.0.{name}": (sizes[0],) for name in ("scale", "fine", "share")}
    for name, inputs, outputs in zip(LAYERS, sizes, sizes[1:]):
        shapes |= {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}
    try:
        if {name: tuple(values.shape) for name, values in content["policy"].items()} != shapes:
            raise ValueError
        actor = Actor(content["policy"])
    except (RuntimeError, TypeError, AttributeError, ValueError) as error:
        found = f"{source}: weights of another architecture than hidden={config.hidden}"
        raise InputError(found, "the network that its configuration describes", TRAIN_AGAIN) from error
    wrong = [name for name, values in actor.weights.items() if not np.isfinite(values).all()]
    if wrong:
        raise InputError(f"{source}: NaN or infinity in weights {wrong[0]}", "finite numbers", TRAIN_AGAIN)
    return actor, config
