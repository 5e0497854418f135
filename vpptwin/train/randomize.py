"""Domain randomization: parameters of the twin drawn from the catalogue's priors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

import numpy as np

from vpptwin.effects import Effect


class Parametrized(Protocol):
    """What randomization needs of a twin."""

    @property
    def effects(self) -> Mapping[str, Effect]:
        """Effects that are switched on, by id."""

    def set_parameter(self, effect: str, parameter: str, values: np.ndarray, ids: np.ndarray | None = None) -> None:
        """Set one parameter of the simulations `ids`."""


def randomize(twin: Parametrized, effects: Iterable[str], ids: np.ndarray, rng: np.random.Generator) -> None:
    """Give the simulations `ids` (n,) fresh parameters.

    Every draw comes from the prior, which is centred on the nominal vehicle, whatever was drawn before.

    Args:
        twin: whose `effects` include those to draw.
        effects: ids.
        ids: simulations to change, (n,) int.
        rng: source of the draws.
    """
    for effect in effects:
        for parameter in twin.effects[effect].parameters:
            twin.set_parameter(effect, parameter.name, parameter.draw(rng, len(ids)), ids=ids)
