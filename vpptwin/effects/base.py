"""What an effect is: an id, parameters, where it acts, what shows it, what it is confused with, and one function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, Literal, NamedTuple

from vpptwin.effects.parameter import Parameter


class Stage(Enum):
    """Where in the pipeline an effect acts, which fixes the signature of its function.

    CONSTANT: `apply(constants, site, /, *, parameter, ...) -> None` adds to or replaces rows of the named constants in
    place, starting from their nominal values; parameters are (n,) arrays. Run when parameters change, never inside the
    time loop.
    THRUST: `apply(thrust, rotor, /, parameter, ...) -> thrust` of one rotor [N], every inner step.
    FORCE: every inner step; on a joint (`target`) `apply(motion, /, parameter, ...) -> force` [N, N m], on a free body
    `apply(body, /, parameter, ...) -> (f_x, f_y, f_z, m_x, m_y, m_z)`, forces in the world's axes [N], moments about
    the body's own origin in its own [N m], as MuJoCo applies them; on the craft
    `apply(craft, /, parameter, ...) -> (f_x, f_z, moment)` [N, N, N m] in the world's axes, about the hinge.
    FRICTION: `apply(level, motion, /, parameter, ...) -> level` [N, N m], every inner step: the dry friction that the
    joint can muster against `motion.direction`; the engine room turns it into a force that sticks.
    SLIP: `apply(motion, forward, backward, /, parameter, ...) -> force` [N, N m], every inner step: how the joint's dry
    friction acts, given its levels against motion forward and backward, in place of the force that sticks.

    Functions of the last four are compiled by numba and called with numbers. They use arithmetic and numpy functions
    that take numbers and arrays alike (np.exp, np.minimum; not np.where, which allocates), so that they also run on
    arrays as they are. Parameters arrive in the order of `Effect.parameters`.

    What evolves is no secret of the function: an effect that declares `states` gets their values at the start of the
    step, and the step `dt` [s], before its parameters, and returns the new values behind its result:
    `apply(motion, /, state, ..., dt, parameter, ...) -> (force, state, ...)`. They lie in `TwinState.effects`, for a
    rotor's THRUST one of each kind per rotor, and stay as they are while the effect is off, when it is not called. A
    FRICTION effect is called for both senses: what it returns for the sense of motion is kept.
    """

    CONSTANT = "constant"
    THRUST = "thrust"
    FORCE = "force"
    FRICTION = "friction"
    SLIP = "slip"


class Motion(NamedTuple):
    """One joint, as FORCE, FRICTION and SLIP effects on a joint see it.

    Attributes:
        position: q [m, rad].
        velocity: q̇ [m/s, rad/s].
        direction: +1 or -1, the sense of motion that friction would oppose; 0 for FORCE and SLIP.
        load: horizontal force between guide and slider [N]; on other rigs what the actuators exert on it [N, N m].
        lever: height of the slider above the rail over the spacing of the bearings; 0 on other rigs.
        inertia: that the joint moves [kg, kg m²].
    """

    position: float
    velocity: float
    direction: float
    load: float
    lever: float
    inertia: float


class Body(NamedTuple):
    """A free body, as FORCE effects on it see it.

    Attributes:
        x, y, z: position [m].
        w, i, j, k: attitude, a unit quaternion.
        v_x, v_y, v_z: velocity, in the world's axes [m/s].
        p, q, r: rate about its own axes [rad/s].
        time: s since the start of the log.
    """

    x: float
    y: float
    z: float
    w: float
    i: float
    j: float
    k: float
    v_x: float
    v_y: float
    v_z: float
    p: float
    q: float
    r: float
    time: float


ApplyFunction = Callable[..., Any]


@dataclass(frozen=True)
class State:
    """A number of an effect that evolves.

    Attributes:
        name: argument of the function.
        unit: SI unit in plain text, "" for none.
        start: value at the start of a simulation; "position" or "velocity" for the joint's own there.
    """

    name: str
    unit: str
    start: float | Literal["position", "velocity"] = 0.0


@dataclass(frozen=True)
class Effect:
    """A physical effect that a simulation may lack.

    Attributes:
        id: name in twin YAML and verdict, e.g. `rail_x.coulomb`.
        summary: what it is, in a phrase that fits into a sentence ("dry friction on the horizontal rail").
        equation: how it enters, in plain text.
        parameters: its numbers, strengths first: while they are at their off value, those that shape the effect
            (speed, place, width) do nothing. Their off value is a typical one.
        stage: where it acts.
        apply: the one implementation of its physics; see `Stage` for the signature.
        shows: signals in which it can be seen.
        look_alikes: ids that are hard to tell from it.
        writes: names of the constants it changes (CONSTANT effects declare every one; a `Change` tells them itself).
        target: the joint, actuator or body it acts on, "" for the craft.
        members: names of the actuators or joints that it acts on alike, all in the place of one `target`.
        needs: joints and bodies that the model must have besides those of the planar craft.
        dissipative: it can only take energy out.
        modifies: ids of effects that it only modifies: without any of them it does nothing.
        follows: what the force it makes follows, against which a report plots the residual: `velocity`, `position`,
            `command` or `command change`.
        states: what evolves, of effects that act every step.
        touching: it acts where bodies touch and nowhere else, on all geoms alike or on a pair.
        placed: it acts here or there along its joint: logs are looked through for where, before any fit.
        fades_along: joint with whose position it fades: only low enough on it can it be seen. "" for none.
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
    members: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    dissipative: bool = False
    modifies: tuple[str, ...] = ()
    follows: str = "velocity"
    states: tuple[State, ...] = ()
    fades_along: str = ""
    placed: bool = False
    touching: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "writes", self.writes or getattr(self.apply, "writes", ()))

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; KeyError if there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def places(self) -> tuple[str, ...]:
        """What it acts on: `members`, or else the `target`."""
        return self.members or (self.target,)

    @property
    def kind(self) -> str:
        """What it is, whatever its law: effects of one kind on one place do much the same. "" where it is its own."""
        if self.stage in (Stage.FRICTION, Stage.SLIP):
            return "dry friction"
        if self.dissipative:
            return "damping"
        if self.follows == "command change":
            return "a late response"
        return "a wrong gain" if any(name.startswith("actuator.") for name in self.writes) else ""

    @property
    def brakes(self) -> bool:
        """Whether it is dry friction, or damping in proportion to speed."""
        return self.stage is Stage.FRICTION or (self.dissipative and self.stage is Stage.CONSTANT)

    @property
    def strengths(self) -> tuple[Parameter, ...]:
        """Its strengths: the first parameter, and others of its unit that are off where it is, as axes of a vector."""
        first = self.parameters[0]
        return tuple(p for p in self.parameters if (p.unit, p.off) == (first.unit, first.off))

    def bind(self, nominal: Callable[[str], float]) -> Effect:
        """The effect with off values read from a vehicle: `nominal("servo.time_constant")` gives the number."""
        bound = tuple(p.with_off(nominal(p.nominal)) if p.nominal else p for p in self.parameters)
        return replace(self, parameters=bound)
