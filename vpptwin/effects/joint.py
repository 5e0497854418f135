"""Effects on any joint: dry friction, viscous friction, constant force. On our rails and on any other rig."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vpptwin.effects.base import Constants, Effect, Plant, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior

JOINT_SHOWS = ("/mocap/pose", "/imu/data", "/joint_states")
TOLERANCE = 0.012
"""Friction that a well-built rail may have unremarked, as a share of the typical force."""
SIZE = 0.1
"""Physical size for secants, as a share of the typical force."""


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


def apply_coulomb(constants: Constants, site: Site, /, force: np.ndarray) -> None:
    """Dry friction -F sgn(v), held exactly at rest by the engine's friction constraint."""
    constants["dof_frictionloss"][:, site.dof] += force


def apply_viscous(constants: Constants, site: Site, /, damping: np.ndarray) -> None:
    """Viscous friction -b v, integrated implicitly by the engine."""
    constants["dof_damping"][:, site.dof] += damping


def apply_bias(total: np.ndarray, plant: Plant, site: Site, /, force: np.ndarray) -> np.ndarray:
    """Constant force or torque along the joint."""
    result = total.copy()
    result[:, site.dof] += force
    return result


def apply_spring(total: np.ndarray, plant: Plant, site: Site, /, stiffness: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Elastic force towards a rest position, -k (q - rest)."""
    result = total.copy()
    result[:, site.dof] -= stiffness * (plant.qpos[:, site.dof] - rest)
    return result


def coulomb(place: Place, others: tuple[str, ...] = ()) -> Effect:
    """Dry friction on a joint."""
    name, unit = ("torque", "N m") if place.rotary else ("force", "N")
    parameter = place.parameter(name, unit, 0.0, 2.0, Prior("halfnormal", 0.0, 0.3))

    def apply(constants: Constants, site: Site, /, **values: np.ndarray) -> None:
        apply_coulomb(constants, site, values[name])

    return Effect(
        f"{place.joint}.coulomb", f"dry friction {place.where}", f"-{name} sgn(v)", (parameter,), Stage.CONSTANT, apply,
        JOINT_SHOWS, (f"{place.joint}.viscous", *others), ("dof_frictionloss",), place.joint, dissipative=True,
    )  # fmt: skip


def viscous(place: Place, others: tuple[str, ...] = ()) -> Effect:
    """Viscous friction on a joint."""
    unit = "N m s/rad" if place.rotary else "N s/m"
    parameter = place.parameter("damping", unit, 0.0, 5.0, Prior("halfnormal", 0.0, 0.3))
    return Effect(
        f"{place.joint}.viscous", f"viscous friction {place.where}", "-damping v", (parameter,), Stage.CONSTANT,
        apply_viscous, JOINT_SHOWS, (f"{place.joint}.coulomb", *others), ("dof_damping",), place.joint,
        dissipative=True,
    )  # fmt: skip


def bias(place: Place, others: tuple[str, ...] = ()) -> Effect:
    """Constant force or torque on a joint."""
    kind, unit = ("torque", "N m") if place.rotary else ("force", "N")
    parameter = place.parameter("force", unit, -2.0, 2.0, Prior("normal", 0.0, 0.2))
    return Effect(
        f"{place.joint}.bias", f"a constant {kind} {place.where}", "+force", (parameter,), Stage.FORCE,
        apply_bias, JOINT_SHOWS, others, (), place.joint, follows="position",
    )  # fmt: skip


def spring(place: Place, others: tuple[str, ...] = ()) -> Effect:
    """Elastic force on a joint."""
    unit, reach, length = ("N m/rad", 3.2, "rad") if place.rotary else ("N/m", 2.0, "m")
    stiffness = place.parameter("stiffness", unit, 0.0, 5.0, Prior("halfnormal", 0.0, 0.3))
    rest = Parameter("rest", length, 0.0, -reach, reach, Prior("normal", 0.0, 0.1 * reach), 0.1 * reach, reach)
    return Effect(
        f"{place.joint}.spring", f"an elastic force {place.where}", "-stiffness (q - rest)", (stiffness, rest),
        Stage.FORCE, apply_spring, JOINT_SHOWS, (f"{place.joint}.bias", *others), (), place.joint, follows="position",
    )  # fmt: skip
