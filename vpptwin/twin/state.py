"""Everything that evolves in a twin, as plain arrays: copy it, save it, put it back, continue bit-equal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple, Self

import numpy as np


@dataclass(frozen=True)
class RowArrays:
    """Arrays of N simulations, leading axis N each."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Every array by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Self:
        """The state of which `arrays()` gave these arrays; copies."""
        return cls(**{f.name: arrays[f.name].copy() for f in fields(cls)})

    def take(self, ids: np.ndarray | slice) -> Self:
        """The rows `ids` as a state of their own (a copy), repeats allowed; or those of a slice (a view)."""
        return type(self)(**{f.name: getattr(self, f.name)[ids] for f in fields(self)})

    def copy(self) -> Self:
        """A deep copy."""
        return type(self)(**{f.name: getattr(self, f.name).copy() for f in fields(self)})

    def write_rows(self, ids: np.ndarray, rows: Self) -> None:
        """Put `rows`, which has len(ids) rows, in place of the rows `ids` of this very state."""
        for f in fields(self):
            getattr(self, f.name)[ids] = getattr(rows, f.name)


@dataclass(frozen=True)
class TwinState(RowArrays):
    """State of N simulations, leading axis N.

    Attributes:
        time: (N,) s.
        qpos: generalized positions, (N, nq) m, rad; x, z, θ on the drone.
        qvel: generalized velocities, (N, nv) m/s, rad/s.
        warmstart: accelerations of the last step, (N, nv): the constraint solver starts from them.
        memory: of the last step the force on the carriage [N], the number of constraints, their forces, (N, 2 + nv).
        effects: what evolves of the catalogue's effects, (N, S) in the order of the compiled pipeline.
        actuators: state of the actuator layer, (N,) records of `vpptwin.actuators.layer.layer_dtype`.
    """

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    warmstart: np.ndarray
    memory: np.ndarray
    effects: np.ndarray
    actuators: np.ndarray

    @property
    def blade_pitch(self) -> np.ndarray:
        """Blade pitch, (N, nu) rad (the control input on other rigs)."""
        return self.actuators["output"]

    @property
    def rotor_speed(self) -> np.ndarray:
        """Rotor speed, (N, nu) rad/s."""
        return self.actuators["rotor_speed"]

    @property
    def throttle(self) -> np.ndarray:
        """Throttle, (N, nu), 0..1 of battery voltage."""
        return self.actuators["throttle"]

    def arrays(self) -> dict[str, np.ndarray]:
        """Every array by name; numbers only, the records of the actuators as `actuators.horn` and so on."""
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "actuators"}
        return plain | {f"actuators.{name}": self.actuators[name] for name in self.actuators.dtype.names or ()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> TwinState:
        """The state of which `arrays()` gave these arrays; copies."""
        prefix = "actuators."
        layer = {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
        records = np.zeros(len(arrays["time"]), [(name, v.dtype, v.shape[1:]) for name, v in layer.items()])
        for name, values in layer.items():
            records[name] = values
        plain = {f.name: arrays[f.name].copy() for f in fields(cls) if f.name != "actuators"}
        return cls(**plain, actuators=records)

    def replace_rows(self, ids: np.ndarray, rows: TwinState) -> TwinState:
        """This state with its rows `ids` exchanged for `rows`, which has len(ids) rows; neither argument changes."""
        result = self.copy()
        result.write_rows(ids, rows)
        return result

    def overwrite(self, other: TwinState) -> None:
        """Put every number of `other`, a state of the same twin, in place of this very state's."""
        for f in fields(self):
            mine, given = getattr(self, f.name), getattr(other, f.name)
            if mine.dtype.names:  # ten times faster than field by field
                mine, given = as_numbers(mine), as_numbers(given)
            mine[...] = given

    def finite(self) -> np.ndarray:
        """Which simulations hold only finite numbers, (N,) bool."""
        total = np.zeros(len(self.time))
        with np.errstate(invalid="ignore", over="ignore"):
            for f in fields(self):
                total += np.einsum("ij->i", as_numbers(getattr(self, f.name)))  # a sum, twice as fast as np.sum
        return np.isfinite(total)


def as_numbers(values: np.ndarray) -> np.ndarray:
    """Arrays and records (N, ...) as the numbers that they hold, (N, k), a counter as the float of the same bits."""
    width = math.prod(values.shape[1:]) * values.dtype.itemsize // 8
    return values.view(np.float64).reshape(len(values), width)


@dataclass(frozen=True)
class Driven:
    """Joints and free bodies that follow a log."""

    dofs: np.ndarray  # their degrees of freedom, (D,)
    pose: np.ndarray  # whole poses at every step, of which theirs count, (N, steps, nq) m, rad, unit quaternions
    velocity: np.ndarray  # likewise, (N, steps, nv) m/s, rad/s


class Trajectory(NamedTuple):
    """What became of N simulations under logged commands."""

    state: TwinState  # the final state
    qpos: np.ndarray  # the engine's positions after every step, (N, steps, nq) m, rad
    qvel: np.ndarray  # velocities after every step, (N, steps, nv) m/s, rad/s
    # of the simulated motors after every step, (N, steps, 2) rad/s; None where none is simulated
    rotor_speed: np.ndarray | None
