"""Effects on any joint: dry friction, viscous friction, constant force. On our rails and on any other rig."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Plant, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior

JOINT_SHOWS = ("/mocap/pose", "/imu/data", "/joint_states")
TOLERANCE = 0.012
"""Friction that a well-built rail may have unremarked, as a share of the typical force."""
SIZE = 0.1
"""Physical size for secants, as a share of the typical force."""


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


def coulomb(
    joint: str,
    where: str,
    rotary: bool = False,
    scale: float = 1.0,
    others: tuple[str, ...] = (),
    tolerance: float = TOLERANCE,
    size: float = SIZE,
) -> Effect:
    """Dry friction on a joint; `scale` is a typical force [N] or torque [N m] there."""
    name, unit = ("torque", "N m") if rotary else ("force", "N")
    parameter = Parameter(
        name, unit, 0.0, 0.0, 2.0 * scale, Prior("halfnormal", 0.0, 0.3 * scale), size * scale, tolerance * scale
    )

    def apply(constants: Constants, site: Site, /, **values: np.ndarray) -> None:
        apply_coulomb(constants, site, values[name])

    return Effect(
        f"{joint}.coulomb", f"dry friction {where}", f"-{name} sgn(v)", (parameter,), Stage.CONSTANT, apply,
        JOINT_SHOWS, (f"{joint}.viscous", *others), ("dof_frictionloss",), joint, dissipative=True,
    )  # fmt: skip


def viscous(
    joint: str,
    where: str,
    rotary: bool = False,
    scale: float = 1.0,
    others: tuple[str, ...] = (),
    tolerance: float = TOLERANCE,
    size: float = SIZE,
) -> Effect:
    """Viscous friction on a joint; `scale` is a typical damping [N s/m] or [N m s/rad] there."""
    unit = "N m s/rad" if rotary else "N s/m"
    parameter = Parameter(
        "damping", unit, 0.0, 0.0, 5.0 * scale, Prior("halfnormal", 0.0, 0.3 * scale), size * scale, tolerance * scale
    )
    return Effect(
        f"{joint}.viscous", f"viscous friction {where}", "-damping v", (parameter,), Stage.CONSTANT, apply_viscous,
        JOINT_SHOWS, (f"{joint}.coulomb", *others), ("dof_damping",), joint, dissipative=True,
    )  # fmt: skip


def bias(
    joint: str,
    where: str,
    rotary: bool = False,
    scale: float = 1.0,
    others: tuple[str, ...] = (),
    tolerance: float = TOLERANCE,
    size: float = SIZE,
) -> Effect:
    """Constant force [N] or torque [N m] on a joint; `scale` is a typical size."""
    unit = "N m" if rotary else "N"
    parameter = Parameter(
        "force",
        unit,
        0.0,
        -2.0 * scale,
        2.0 * scale,
        Prior("normal", 0.0, 0.2 * scale),
        size * scale,
        tolerance * scale,
    )

    return Effect(
        f"{joint}.bias", f"a constant {'torque' if rotary else 'force'} {where}", "+force", (parameter,), Stage.FORCE,
        apply_bias, JOINT_SHOWS, others, (), joint, follows="position",
    )  # fmt: skip


def spring(
    joint: str,
    where: str,
    rotary: bool = False,
    scale: float = 1.0,
    others: tuple[str, ...] = (),
    tolerance: float = TOLERANCE,
    size: float = SIZE,
) -> Effect:
    """Elastic force on a joint; `scale` is a typical stiffness [N/m] or [N m/rad]."""
    unit, reach, angle = ("N m/rad", 3.2, "rad") if rotary else ("N/m", 2.0, "m")
    stiffness = Parameter(
        "stiffness", unit, 0.0, 0.0, 5.0 * scale, Prior("halfnormal", 0.0, 0.3 * scale), size * scale, tolerance * scale
    )
    rest = Parameter("rest", angle, 0.0, -reach, reach, Prior("normal", 0.0, 0.1 * reach), 0.1 * reach, reach)
    return Effect(
        f"{joint}.spring", f"an elastic force {where}", "-stiffness (q - rest)", (stiffness, rest), Stage.FORCE,
        apply_spring, JOINT_SHOWS, (f"{joint}.bias", *others), (), joint, follows="position",
    )  # fmt: skip
