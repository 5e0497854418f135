"""Effects on the craft as a body: errors of mass and inertia, drag through the air."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Plant, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior

Y = 1
"""Index of the axis into the page in a body's diagonal inertia."""


def apply_mass(constants: Constants, site: Site, /, mass: np.ndarray) -> None:
    """Mass added to the nominal craft [kg]."""
    constants["body_mass"][:, site.body] += mass


def apply_inertia(constants: Constants, site: Site, /, inertia: np.ndarray) -> None:
    """Inertia about the hinge added to the nominal craft [kg m^2]."""
    constants["body_inertia"][:, site.body, Y] += inertia


def apply_drag(total: np.ndarray, plant: Plant, site: Site, /, k_d: np.ndarray) -> np.ndarray:
    """Aerodynamic drag f_d = -k_d |v| v on the craft (paper, System Identification, item 2)."""
    v_x, v_z = plant.qvel[:, site.x], plant.qvel[:, site.z]
    speed = np.sqrt(v_x * v_x + v_z * v_z)
    result = total.copy()
    result[:, site.x] -= k_d * speed * v_x
    result[:, site.z] -= k_d * speed * v_z
    return result


MASS = Effect(
    id="airframe.mass",
    summary="a wrong mass of the craft",
    equation="m + mass",
    parameters=(Parameter("mass", "kg", 0.0, -0.09, 0.15, Prior("normal", 0.0, 0.02), 0.02, 0.0018),),
    stage=Stage.CONSTANT,
    apply=apply_mass,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rotor.thrust_gain", "rail_z.bias"),
    writes=("body_mass",),
    follows="command",
)
INERTIA = Effect(
    id="airframe.inertia",
    summary="a wrong moment of inertia of the craft",
    equation="I + inertia",
    parameters=(Parameter("inertia", "kg m^2", 0.0, -0.003, 0.006, Prior("normal", 0.0, 0.0004), 0.0004, 0.00008),),
    stage=Stage.CONSTANT,
    apply=apply_inertia,
    shows=("/imu/data", "/mocap/pose"),
    look_alikes=("rotor.thrust_gain", "servo.lag"),
    writes=("body_inertia",),
    follows="command",
)
DRAG = Effect(
    id="air.drag",
    summary="aerodynamic drag on the craft",
    equation="-k_d |v| v",
    parameters=(Parameter("k_d", "N s^2/m^2", 0.0, 0.0, 1.0, Prior("halfnormal", 0.0, 0.08), 0.05, 0.006),),
    stage=Stage.FORCE,
    apply=apply_drag,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.viscous", "rail_z.viscous"),
    dissipative=True,
)
EFFECTS = (MASS, INERTIA, DRAG)
