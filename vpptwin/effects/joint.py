"""Effects on any joint but dry friction: viscous, drag, bias, spring, cogging, fade, inertia, an encoder's zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vpptwin.effects.base import Constants, Effect, Motion, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior

JOINT_SHOWS = ("/mocap/pose", "/imu/data", "/joint_states")
TOLERANCE = 0.012
"""Friction that a well-built rail may have unremarked, as a share of the typical force."""
SIZE = 0.1
"""Physical size for secants, as a share of the typical force."""
SLIDE_ACCELERATION, HINGE_ACCELERATION = 10.0, 30.0
"""What the typical force of a joint accelerates what it carries by [m/s^2], [rad/s^2]: an order of magnitude."""


@dataclass(frozen=True)
class Place:
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


def apply_viscous(constants: Constants, site: Site, /, damping: np.ndarray) -> None:
    """Viscous friction -b v, integrated implicitly by the engine."""
    constants["dof_damping"][:, site.dof] += damping


def apply_drag(motion: Motion, /, drag: float) -> float:
    """Force of a fluid that a joint moves through fast, -c |v| v."""
    return -drag * np.abs(motion.velocity) * motion.velocity


def apply_bias(motion: Motion, /, force: float) -> float:
    """Constant force or torque along the joint."""
    return force


def apply_spring(motion: Motion, /, stiffness: float, rest: float) -> float:
    """Elastic force towards a rest position, -k (q - rest)."""
    return -stiffness * (motion.position - rest)


def apply_cogging(motion: Motion, /, force: float, waves: float, phase: float) -> float:
    """Force of magnets or teeth, which comes again every 1/waves [rad, m] of the way."""
    return force * np.sin(2.0 * np.pi * waves * motion.position + phase)


def apply_fade(motion: Motion, /, slope: float) -> float:
    """What the force of the actuators lacks at speed, as far as it drives the joint: of a motor at full voltage."""
    share = np.minimum(slope * np.abs(motion.velocity), 1.0)
    return -share * motion.load * (0.5 + 0.5 * np.sign(motion.load * motion.velocity))


def apply_inertia(constants: Constants, site: Site, /, inertia: np.ndarray) -> None:
    """Inertia of the joint added to what it carries [kg, kg m^2]."""
    constants["dof_armature"][:, site.dof] += inertia


def apply_offset(constants: Constants, site: Site, /, angle: np.ndarray) -> None:
    """Angle by which an encoder reads too much [rad]; springs stay with the link, end stops with the encoder."""
    for name in ("qpos0", "qpos_spring"):
        constants[name][:, site.place] += angle


def viscous(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Viscous friction on a joint."""
    unit = "N m s/rad" if place.rotary else "N s/m"
    parameter = place.parameter("damping", unit, 0.0, 5.0, Prior("halfnormal", 0.0, 0.3), place.speed)
    return Effect(
        f"{place.joint}.viscous", f"viscous friction {place.where}", "-damping v", (parameter,), Stage.CONSTANT,
        apply_viscous, JOINT_SHOWS, look_alikes, ("dof_damping",), place.joint, dissipative=True,
    )  # fmt: skip


def drag(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Quadratic drag on a joint: of the air, or of a liquid."""
    unit = "N m s^2/rad^2" if place.rotary else "N s^2/m^2"
    parameter = place.parameter("drag", unit, 0.0, 5.0, Prior("halfnormal", 0.0, 0.3), place.speed**2)
    return Effect(
        f"{place.joint}.drag", f"quadratic drag {place.where}", "-drag |v| v", (parameter,), Stage.FORCE,
        apply_drag, JOINT_SHOWS, look_alikes, (), place.joint, dissipative=True,
    )  # fmt: skip


def bias(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Constant force or torque on a joint."""
    kind, unit = ("torque", "N m") if place.rotary else ("force", "N")
    parameter = place.parameter("force", unit, -2.0, 2.0, Prior("normal", 0.0, 0.2))
    return Effect(
        f"{place.joint}.bias", f"a constant {kind} {place.where}", "+force", (parameter,), Stage.FORCE,
        apply_bias, JOINT_SHOWS, look_alikes, (), place.joint, follows="position",
    )  # fmt: skip


def spring(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Elastic force on a joint."""
    unit, reach, length = ("N m/rad", 3.2, "rad") if place.rotary else ("N/m", 2.0, "m")
    travel, most = place.travel or 1.0, max(reach, abs(place.middle) + 2.0 * place.travel)
    stiffness = place.parameter("stiffness", unit, 0.0, 5.0, Prior("halfnormal", 0.0, 0.3), travel)
    rest = Parameter(
        name="rest", unit=length, off=0.0, low=-most * place.room, high=most * place.room,
        prior=Prior("normal", 0.0, 0.1 * reach), size=0.1 * reach, tolerance=most,
        source="assumption: anywhere a joint gets to, mostly midway",
    )  # fmt: skip
    return Effect(
        f"{place.joint}.spring", f"an elastic force {place.where}", "-stiffness (q - rest)", (stiffness, rest),
        Stage.FORCE, apply_spring, JOINT_SHOWS, look_alikes, (), place.joint, follows="position",
    )  # fmt: skip


def cogging(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Force on a joint that is periodic in its position."""
    (unit, per), reach = ("N m", "1/rad") if place.rotary else ("N", "1/m"), place.reach
    waves = Parameter(
        name="waves", unit=per, off=3.0 / reach, low=0.4 / reach / place.room,
        high=15.0 / reach * place.room,
        prior=Prior("normal", 3.0 / reach, 1.0 / reach), size=0.05 / reach, tolerance=15.0 / reach,
        source="assumption: a handful of teeth along the way",
    )  # fmt: skip
    phase = Parameter(
        name="phase", unit="rad", off=0.0, low=-7.0, high=7.0, prior=Prior("normal", 0.0, 2.0), size=0.3, tolerance=7.0,
        source="assumption: anywhere",
    )  # fmt: skip
    return Effect(
        f"{place.joint}.cogging", f"cogging {place.where}", "+force sin(2π waves q + phase)",
        (place.parameter("force", unit, 0.0, 2.0, Prior("halfnormal", 0.0, 0.1)), waves, phase), Stage.FORCE,
        apply_cogging, JOINT_SHOWS, look_alikes, (), place.joint, follows="position", placed=True,
    )  # fmt: skip


def fade(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Force of what drives a joint that falls with its speed, to none at 1/slope."""
    unit, speed = "s/rad" if place.rotary else "s/m", place.speed
    slope = Parameter(
        name="slope", unit=unit, off=0.0, low=0.0, high=2.0 / speed * place.room, size=0.05 / speed,
        tolerance=0.005 / speed, prior=Prior("halfnormal", 0.0, 0.1 / speed),
        source="assumption: a tenth at its usual speed",
    )  # fmt: skip
    return Effect(
        f"{place.joint}.fade", f"a drive {place.where} whose force falls with speed",
        "-slope |v| of the force that drives it", (slope,), Stage.FORCE, apply_fade, JOINT_SHOWS, look_alikes,
        (), place.joint, follows="command",
    )  # fmt: skip


def inertia(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Mass or moment of inertia that a joint moves besides what the model says."""
    kind, unit = ("moment of inertia", "kg m^2") if place.rotary else ("mass", "kg")
    driven = place.scale / (HINGE_ACCELERATION if place.rotary else SLIDE_ACCELERATION)
    carried = place.carried or driven
    parameter = Parameter(
        name="inertia", unit=unit, off=0.0, low=-0.8 * carried, high=20.0 * max(carried, driven) * place.room,
        prior=Prior("normal", 0.0, 0.2 * carried), size=0.05 * carried,
        tolerance=0.005 * carried + place.stepped, source="assumption: shares of what the joint carries, 20 % likely",
    )  # fmt: skip
    return Effect(
        f"{place.joint}.inertia", f"a wrong {kind} {place.where}", "M + inertia", (parameter,), Stage.CONSTANT,
        apply_inertia, JOINT_SHOWS, look_alikes, ("dof_armature",), place.joint, follows="command",
    )  # fmt: skip


def offset(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Wrong zero of a hinge's encoder."""
    angle = Parameter(
        name="angle", unit="rad", off=0.0, low=-1.0, high=1.0, prior=Prior("normal", 0.0, 0.03), size=0.02,
        tolerance=0.001, source="assumption: zeroed by hand to 2 degrees",
    )  # fmt: skip
    return Effect(
        f"{place.joint}.offset", f"a wrong zero of the encoder {place.where}", "q + angle", (angle,), Stage.CONSTANT,
        apply_offset, JOINT_SHOWS, look_alikes, ("qpos0", "qpos_spring"), place.joint, follows="position",
    )  # fmt: skip
