"""Laws on constants: a parameter is added to places of a model, multiplies, bounds or replaces them.

One function, `Change`, is the law of every delay, lag, mass, gain, bias and limit; what differs is data.
"""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from itertools import cycle
from types import EllipsisType

import numpy as np

Constants = MutableMapping[str, np.ndarray]
"""Named per-simulation constants, each (N, ...): fields of the MuJoCo model, of the actuators and of the sensors."""
Where = tuple[str | int | EllipsisType, ...]
"""A constant's name, then its indices: numbers, `...`, or names of fields of `Site`; those left out stay whole."""


@dataclass(frozen=True)
class Site:
    """Where a CONSTANT effect sits in the rig at hand: indices into the MuJoCo model, -1 where it has no such place.

    Attributes:
        dof: index of the degree of freedom it acts on.
        place: index of its joint's position in qpos.
        actuator: index of the actuator it acts on.
        body: index of the body it acts on: `target` where that is a body, else the craft.
        pair: index of the pair of geoms that it acts on.
    """

    dof: int = -1
    place: int = -1
    actuator: int = -1
    body: int = -1
    pair: int = -1


@dataclass(frozen=True)
class Change:
    """A law on constants: combine(constant, parameter) takes the constant's place, for parameters (N,) in turn.

    Attributes:
        combine: numpy's function of the two.
        places: each with a parameter of its own, or all with the one there is.
    """

    combine: Callable[[np.ndarray, np.ndarray], np.ndarray]
    places: tuple[Where, ...]

    @property
    def writes(self) -> tuple[str, ...]:
        """The constants that it changes."""
        return tuple(dict.fromkeys(str(name) for name, *_ in self.places))

    def __call__(self, constants: Constants, site: Site, /, **parameters: np.ndarray) -> None:
        """Write the parameters into the constants."""
        for (name, *index), value in zip(self.places, cycle(parameters.values())):
            indices = (getattr(site, i) if isinstance(i, str) else i for i in index)
            constant = constants[str(name)][(slice(None), *indices)]
            constant[...] = self.combine(constant, value.reshape(-1, *[1] * (constant.ndim - 1)))


def add(*places: Where) -> Change:
    """Constant + parameter."""
    return Change(np.add, places)


def multiply(*places: Where) -> Change:
    """Constant × parameter."""
    return Change(np.multiply, places)


def limit(*places: Where) -> Change:
    """min(constant, parameter)."""
    return Change(np.minimum, places)


def take(constant: np.ndarray, parameter: np.ndarray) -> np.ndarray:
    """The parameter itself, an absolute value."""
    return parameter
