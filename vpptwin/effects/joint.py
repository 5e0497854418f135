"""Laws of any joint but dry friction: damping, drag, bias, spring, cogging, fade, inertia, zero, elastic mode.

A law is one function and one `JointLaw`, which makes it an effect of a joint; `catalogue.GENERIC_JOINT` names those
that every joint has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.effects.base import ApplyFunction, Effect, Motion, Stage, State
from vpptwin.effects.constants import add
from vpptwin.effects.parameter import Parameter, Prior

JOINT_SHOWS = ("/mocap/pose", "/imu/data", "/joint_states")
TOLERANCE = 0.012
"""Friction that a well-built rail may have unremarked, as a share of the typical force."""
SIZE = 0.1
"""Physical size for secants, as a share of the typical force."""
SLIDE_ACCELERATION, HINGE_ACCELERATION = 10.0, 30.0
"""What the typical force of a joint accelerates what it carries by [m/s^2], [rad/s^2]: an order of magnitude."""


@dataclass(frozen=True)
class JointScale:
    """A joint that effects are made for.

    Attributes:
        joint: its MJCF name.
        where: how a sentence names it, e.g. "on the horizontal rail".
        rotary: whether it is a hinge.
        scale: a typical force there [N], or torque [N m]; damping and stiffness scale with it too.
        tolerance: what a well-built joint may show unremarked, as a share of `scale`.
        size: step for secants, as a share of `scale`.
        reason: what makes that scale typical.
        speed: a typical speed there [m/s, rad/s], at which damping makes `scale` a typical force.
        travel: how far from its `middle` it gets; 0 for not known [m, rad].
        middle: position midway along its travel [m, rad].
        carried: mass or moment of inertia that it moves; 0 for what `scale` would accelerate typically [kg, kg m²].
        room: factor on bounds: what a YAML may say has more room than what a diagnosis looks through.
        driven: whether an actuator acts on it.
        dof: its degree of freedom.
        stepped: inertia that the engine's step seems to add [kg, kg m²].
    """

    joint: str
    where: str
    rotary: bool = False
    scale: float = 1.0
    tolerance: float = TOLERANCE
    size: float = SIZE
    reason: str = "a typical one"
    speed: float = 1.0
    travel: float = 0.0
    middle: float = 0.0
    carried: float = 0.0
    room: float = 1.0
    driven: bool = False
    dof: int = 0
    stepped: float = 0.0

    @property
    def effort(self) -> str:
        """Unit of the force or torque there."""
        return "N m" if self.rotary else "N"

    @property
    def length(self) -> str:
        """Unit of its position."""
        return "rad" if self.rotary else "m"

    @property
    def reach(self) -> float:
        """How far from its middle it gets, or may get [m, rad]."""
        return self.travel or (3.2 if self.rotary else 2.0)

    def parameter(self, name: str, unit: str, low: float, high: float, prior: Prior, over: float = 1.0) -> Parameter:
        """A parameter that is off at 0; bounds and prior are shares of `scale` at a speed or deflection `over`."""
        scale = self.scale / over
        return Parameter(
            name=name, unit=unit, off=0.0, low=low * scale * self.room, high=high * scale * self.room,
            prior=Prior(prior.kind, prior.a * scale, prior.b * scale), size=self.size * scale,
            tolerance=self.tolerance * scale, source=f"assumption: shares of {scale:.3g} {unit} ({self.reason})",
        )  # fmt: skip


@dataclass(frozen=True)
class JointLaw:
    """A law that joints may have: called with a joint, it gives the effect `JOINT.kind`.

    In `summary`, `equation` and units of `states`, `{where}` stands for the joint, `{force}` for "force" or "torque",
    `{mass}` for "mass" or "moment of inertia", `{length}` for the unit of its position.

    Attributes:
        kind: what ids end with, and `summary`, `equation`, `stage`, `apply`, `shows`, `dissipative`, `follows`,
            `placed`, `states` as those of an `Effect`.
        parameters: those of a joint.
        alike: kinds of effects on the same joint that are hard to tell from it.
        modifies: kinds that it modifies.
        only: the attribute of `JointScale` without which a joint lacks it: "rotary" or "driven", "" for none.
    """

    kind: str
    summary: str
    equation: str
    stage: Stage
    apply: ApplyFunction
    parameters: Callable[[JointScale], tuple[Parameter, ...]]
    alike: tuple[str, ...] = ()
    shows: tuple[str, ...] = JOINT_SHOWS
    modifies: tuple[str, ...] = ()
    only: str = ""
    dissipative: bool = False
    follows: str = "velocity"
    placed: bool = False
    states: tuple[State, ...] = ()

    def __call__(
        self, place: JointScale, look_alikes: tuple[str, ...] = (), modifies: tuple[str, ...] | None = None,
        needs: tuple[str, ...] = (),
    ) -> Effect:  # fmt: skip
        """The effect on a joint; look-alikes are ids, and so many kinds are modified as the joint has."""
        words = {"where": place.where, "length": place.length}
        words["force"], words["mass"] = ("torque", "moment of inertia") if place.rotary else ("force", "mass")
        modified = self.modifies if modifies is None else modifies
        return Effect(
            f"{place.joint}.{self.kind}", self.summary.format(**words), self.equation.format(**words),
            self.parameters(place), self.stage, self.apply, self.shows, look_alikes, target=place.joint, needs=needs,
            modifies=tuple(f"{place.joint}.{kind}" for kind in modified), follows=self.follows, placed=self.placed,
            states=tuple(replace(state, unit=state.unit.format(**words)) for state in self.states),
            dissipative=self.dissipative,
        )  # fmt: skip


viscous = JointLaw(
    "viscous", "viscous friction {where}", "-damping v", Stage.CONSTANT, add(("dof_damping", "dof")),
    lambda place: (place.parameter("damping", f"{place.effort} s/{place.length}", 0.0, 5.0,
                                   Prior("halfnormal", 0.0, 0.3), place.speed),),
    ("coulomb", "fade", "drag"), dissipative=True,
)  # fmt: skip
"""F = -b v, integrated implicitly by the engine."""


def apply_drag(motion: Motion, /, drag: float) -> float:
    """Force of a fluid that a joint moves through fast, -c |v| v."""
    # F = -½ ρ C_d A |v| v, whose factors are one number c (Batchelor, An Introduction to Fluid Dynamics).
    return -drag * np.abs(motion.velocity) * motion.velocity


drag = JointLaw(
    "drag", "quadratic drag {where}", "-drag |v| v", Stage.FORCE, apply_drag,
    lambda place: (place.parameter("drag", f"{place.effort} s^2/{place.length}^2", 0.0, 5.0,
                                   Prior("halfnormal", 0.0, 0.3), place.speed**2),),
    ("viscous", "fade"), dissipative=True,
)  # fmt: skip


def apply_bias(motion: Motion, /, force: float) -> float:
    """Constant force or torque along the joint."""
    return force


bias = JointLaw(
    "bias", "a constant {force} {where}", "+force", Stage.FORCE, apply_bias,
    lambda place: (place.parameter("force", place.effort, -2.0, 2.0, Prior("normal", 0.0, 0.2)),),
    ("spring", "offset"), follows="position",
)  # fmt: skip


def apply_spring(motion: Motion, /, stiffness: float, rest: float) -> float:
    """Elastic force towards a rest position, -k (q - rest) (Hooke)."""
    return -stiffness * (motion.position - rest)


def list_spring(place: JointScale) -> tuple[Parameter, ...]:
    """Stiffness of a spring, and where it is at rest."""
    reach = 3.2 if place.rotary else 2.0
    travel, most = place.travel or 1.0, max(reach, abs(place.middle) + 2.0 * place.travel)
    return (
        place.parameter("stiffness", f"{place.effort}/{place.length}", 0.0, 5.0, Prior("halfnormal", 0.0, 0.3), travel),
        Parameter(name="rest", unit=place.length, off=0.0, low=-most * place.room, high=most * place.room,
                  prior=Prior("normal", 0.0, 0.1 * reach), size=0.1 * reach, tolerance=most,
                  source="assumption: anywhere a joint gets to, mostly midway"),
    )  # fmt: skip


spring = JointLaw(
    "spring", "an elastic force {where}", "-stiffness (q - rest)", Stage.FORCE, apply_spring, list_spring,
    ("bias", "inertia", "offset", "cogging"), follows="position",
)  # fmt: skip


def apply_cogging(motion: Motion, /, force: float, waves: float, phase: float) -> float:
    """Force of magnets or teeth, which comes again every 1/waves [rad, m] of the way."""
    # F sin(2π n q + φ): the first harmonic of a force that is periodic in q.
    return force * np.sin(2.0 * np.pi * waves * motion.position + phase)


def list_cogging(place: JointScale) -> tuple[Parameter, ...]:
    """Strength of cogging, how often it comes again, and where."""
    reach = place.reach
    return (
        place.parameter("force", place.effort, 0.0, 2.0, Prior("halfnormal", 0.0, 0.1)),
        Parameter(name="waves", unit=f"1/{place.length}", off=3.0 / reach, low=0.4 / reach / place.room,
                  high=15.0 / reach * place.room, prior=Prior("normal", 3.0 / reach, 1.0 / reach), size=0.05 / reach,
                  tolerance=15.0 / reach, source="assumption: a handful of teeth along the way"),
        Parameter(name="phase", unit="rad", off=0.0, low=-7.0, high=7.0, prior=Prior("normal", 0.0, 2.0), size=0.3,
                  tolerance=7.0, source="assumption: anywhere"),
    )  # fmt: skip


cogging = JointLaw(
    "cogging", "cogging {where}", "+force sin(2π waves q + phase)", Stage.FORCE, apply_cogging, list_cogging,
    ("spring",), follows="position", placed=True,
)  # fmt: skip


def apply_fade(motion: Motion, /, slope: float) -> float:
    """What the force of the actuators lacks at speed, as far as it drives the joint: of a motor at full voltage."""
    # τ = τ_stall (1 - |ω|/ω_0): the torque-speed line of a DC motor, slope = 1/ω_0.
    share = np.minimum(slope * np.abs(motion.velocity), 1.0)
    return -share * motion.load * (0.5 + 0.5 * np.sign(motion.load * motion.velocity))


fade = JointLaw(
    "fade", "a drive {where} whose force falls with speed", "-slope |v| of the force that drives it", Stage.FORCE,
    apply_fade,
    lambda place: (
        Parameter(name="slope", unit=f"s/{place.length}", off=0.0, low=0.0, high=2.0 / place.speed * place.room,
                  size=0.05 / place.speed, tolerance=0.005 / place.speed,
                  prior=Prior("halfnormal", 0.0, 0.1 / place.speed), source="assumption: a tenth at its usual speed"),
    ),
    ("viscous", "drag", "load"), only="driven", follows="command",
)  # fmt: skip


def list_inertia(place: JointScale) -> tuple[Parameter, ...]:
    """Mass or moment of inertia that a joint moves besides what the model says."""
    driven = place.scale / (HINGE_ACCELERATION if place.rotary else SLIDE_ACCELERATION)
    carried = place.carried or driven
    return (
        Parameter(name="inertia", unit="kg m^2" if place.rotary else "kg", off=0.0, low=-0.8 * carried,
                  high=20.0 * max(carried, driven) * place.room, prior=Prior("normal", 0.0, 0.2 * carried),
                  size=0.05 * carried, tolerance=0.005 * carried + place.stepped,
                  source="assumption: shares of what the joint carries, 20 % likely"),
    )  # fmt: skip


inertia = JointLaw(
    "inertia", "a wrong {mass} {where}", "M + inertia", Stage.CONSTANT, add(("dof_armature", "dof")), list_inertia,
    ("spring",), follows="command",
)  # fmt: skip
offset = JointLaw(
    "offset", "a wrong zero of the encoder {where}", "q + angle", Stage.CONSTANT,
    add(("qpos0", "place"), ("qpos_spring", "place")),
    lambda place: (
        Parameter(name="angle", unit="rad", off=0.0, low=-1.0, high=1.0, prior=Prior("normal", 0.0, 0.03), size=0.02,
                  tolerance=0.001, source="assumption: zeroed by hand to 2 degrees"),
    ),
    ("bias", "spring"), only="rotary", follows="position",
)  # fmt: skip
"""Angle by which an encoder reads too much; springs stay with the link, end stops with the encoder. A slide's zero
moves nothing."""


def apply_elastic(
    motion: Motion, /, position: float, velocity: float, dt: float, share: float, frequency: float, zeta: float
) -> tuple[float, float, float]:
    """A mass on a spring and a damper that the joint drags along [N, N m]; stepped as the engine steps the joint."""
    # s̈ = ω² (q - s) + 2 ζ ω (q̇ - ṡ), by the semi-implicit Euler rule; the joint feels -share M s̈.
    rate = 2.0 * np.pi * frequency
    pull = rate * (rate * (motion.position - position) + 2.0 * zeta * (motion.velocity - velocity))
    faster = velocity + dt * pull
    return -share * motion.inertia * pull, position + dt * faster, faster


elastic = JointLaw(
    "elastic", "an elastic mode {where}", "share M (ω² (s - q) + 2 zeta ω d(s - q)/dt), ω = 2π frequency", Stage.FORCE,
    apply_elastic,
    lambda place: (
        Parameter(name="share", unit="", off=0.0, low=0.0, high=0.5, prior=Prior("halfnormal", 0.0, 0.05), size=0.05,
                  tolerance=0.005, source="assumption: some 5 % of what it carries"),
        Parameter(name="frequency", unit="Hz", off=8.0, low=2.0, high=40.0, prior=Prior("normal", 8.0, 2.0), size=0.5,
                  tolerance=40.0, source="assumption: a frame of profiles and boards, 4 to 12 Hz"),
        Parameter(name="zeta", unit="", off=0.03, low=0.0, high=0.3, prior=Prior("normal", 0.03, 0.01), size=0.02,
                  tolerance=0.3, source="assumption: bolted metal, 1 to 5 % of critical"),
    ),
    follows="command", states=(State("position", "{length}", "position"), State("velocity", "{length}/s", "velocity")),
)  # fmt: skip
