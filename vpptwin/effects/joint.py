"""Effects on any joint but dry friction: viscous friction, constant force, spring, inertia. On ours and on any rig."""

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
"""What the typical force of a joint accelerates its inertia by [m/s^2], [rad/s^2]."""


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
    """

    joint: str
    where: str
    rotary: bool = False
    scale: float = 1.0
    tolerance: float = TOLERANCE
    size: float = SIZE

    def parameter(self, name: str, unit: str, low: float, high: float, prior: Prior) -> Parameter:
        """A parameter that is off at 0; bounds and prior are shares of `scale`."""
        scaled = Prior(prior.kind, prior.a * self.scale, prior.b * self.scale)
        bounds = (low * self.scale, high * self.scale)
        return Parameter(name, unit, 0.0, *bounds, scaled, self.size * self.scale, self.tolerance * self.scale)


def apply_viscous(constants: Constants, site: Site, /, damping: np.ndarray) -> None:
    """Viscous friction -b v, integrated implicitly by the engine."""
    constants["dof_damping"][:, site.dof] += damping


def apply_bias(motion: Motion, /, force: float) -> float:
    """Constant force or torque along the joint."""
    return force


def apply_spring(motion: Motion, /, stiffness: float, rest: float) -> float:
    """Elastic force towards a rest position, -k (q - rest)."""
    return -stiffness * (motion.position - rest)


def apply_inertia(constants: Constants, site: Site, /, inertia: np.ndarray) -> None:
    """Inertia of the joint added to what it carries [kg, kg m^2]."""
    constants["dof_armature"][:, site.dof] += inertia


def viscous(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Viscous friction on a joint."""
    unit = "N m s/rad" if place.rotary else "N s/m"
    parameter = place.parameter("damping", unit, 0.0, 5.0, Prior("halfnormal", 0.0, 0.3))
    return Effect(
        f"{place.joint}.viscous", f"viscous friction {place.where}", "-damping v", (parameter,), Stage.CONSTANT,
        apply_viscous, JOINT_SHOWS, look_alikes, ("dof_damping",), place.joint, dissipative=True,
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
    stiffness = place.parameter("stiffness", unit, 0.0, 5.0, Prior("halfnormal", 0.0, 0.3))
    rest = Parameter("rest", length, 0.0, -reach, reach, Prior("normal", 0.0, 0.1 * reach), 0.1 * reach, reach)
    return Effect(
        f"{place.joint}.spring", f"an elastic force {place.where}", "-stiffness (q - rest)", (stiffness, rest),
        Stage.FORCE, apply_spring, JOINT_SHOWS, look_alikes, (), place.joint, follows="position",
    )  # fmt: skip


def inertia(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Mass or moment of inertia that a joint moves besides what the model says."""
    kind, unit = ("moment of inertia", "kg m^2") if place.rotary else ("mass", "kg")
    carried = place.scale / (HINGE_ACCELERATION if place.rotary else SLIDE_ACCELERATION)
    low, high, size, tolerance = (share * carried for share in (-0.2, 2.0, 0.05, 0.005))
    parameter = Parameter("inertia", unit, 0.0, low, high, Prior("normal", 0.0, 0.05 * carried), size, tolerance)
    return Effect(
        f"{place.joint}.inertia", f"a wrong {kind} {place.where}", "M + inertia", (parameter,), Stage.CONSTANT,
        apply_inertia, JOINT_SHOWS, look_alikes, ("dof_armature",), place.joint, follows="command",
    )  # fmt: skip
