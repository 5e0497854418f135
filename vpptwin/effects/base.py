"""What an effect is: an id, parameters, where it acts, what shows it, what it is confused with, and one function."""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from vpptwin.effects.parameter import Parameter

Constants = MutableMapping[str, np.ndarray]
"""Named per-simulation constants, each (N, ...): fields of the MuJoCo model, of the actuators and of the sensors."""


class Stage(Enum):
    """Where in the pipeline an effect acts, which fixes the signature of its function.

    CONSTANT: `apply(constants, site, **parameters) -> None` adds to or replaces the named constants in place, starting
    from their nominal values; run when parameters change, never inside the time loop.
    THRUST: `apply(thrust, plant, site, **parameters) -> thrust`, rotor thrust (N, 2) [N], every inner step.
    FORCE: `apply(total, plant, site, **parameters) -> total`, generalized force (N, nv) [N, N m], every inner step.
    Parameters arrive as (N,) arrays by name, the rest by position (declare it with `/`).
    Functions use arithmetic that broadcasts over simulations and keep no state.
    """

    CONSTANT = "constant"
    THRUST = "thrust"
    FORCE = "force"


@dataclass(frozen=True)
class Plant:
    """What a per-step effect may see: qpos, qvel (N, nv), rotor speed (N, nu) [rad/s], blade pitch (N, nu) [rad]."""

    qpos: np.ndarray
    qvel: np.ndarray
    rotor_speed: np.ndarray
    blade_pitch: np.ndarray


@dataclass(frozen=True)
class Site:
    """Where an effect sits in the rig at hand: indices into the MuJoCo model, -1 where it has no such place.

    Attributes:
        dof: index of the degree of freedom it acts on.
        actuator: index of the actuator it acts on.
        body: index of the body it acts on.
        x, z, pitch: degrees of freedom of the planar craft.
    """

    dof: int = -1
    actuator: int = -1
    body: int = -1
    x: int = -1
    z: int = -1
    pitch: int = -1


ApplyFunction = Callable[..., "np.ndarray | None"]


@dataclass(frozen=True)
class Effect:
    """A physical effect that a simulation may lack.

    Attributes:
        id: name in twin YAML and verdict, e.g. `rail_x.coulomb`.
        summary: what it is, in a phrase that fits into a sentence ("dry friction on the horizontal rail").
        equation: how it enters, in plain text.
        parameters: its numbers.
        stage: where it acts.
        apply: the one implementation of its physics; see `Stage` for the signature.
        shows: signals in which it can be seen.
        look_alikes: ids that are hard to tell from it.
        writes: names of the constants it changes (CONSTANT effects declare every one).
        target: the joint or actuator it acts on, "" for the craft.
        dissipative: it can only take energy out.
        follows: what the force it makes follows, against which a report plots the residual: `velocity`, `position`,
            `command` or `command change`.
    """

    id: str
    summary: str
    equation: str
    parameters: tuple[Parameter, ...]
    stage: Stage
    apply: ApplyFunction = field(repr=False)
    shows: tuple[str, ...]
    look_alikes: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    target: str = ""
    dissipative: bool = False
    follows: str = "velocity"

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; KeyError if there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    def apply_step(
        self, total: np.ndarray, plant: Plant, site: Site, parameters: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Run a THRUST or FORCE effect: the total (N, n) with this effect's part in it."""
        result = self.apply(total, plant, site, **parameters)
        if result is None:
            raise TypeError(f"{self.id} acts every step and must return an array")
        return result

    def bind(self, nominal: Callable[[str], float]) -> Effect:
        """The effect with off values read from a vehicle: `nominal("servo.time_constant")` gives the number."""
        bound = tuple(p.with_off(nominal(p.nominal)) if p.nominal else p for p in self.parameters)
        return replace(self, parameters=bound)
