"""Effects of the air on the craft as a whole: drag, and the cushion under it near the floor."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Craft, Effect, Rotor, Stage
from vpptwin.effects.parameter import Parameter, Prior


def apply_drag(craft: Craft, /, k_d: float) -> tuple[float, float, float]:
    """Aerodynamic drag f_d = -k_d |v| v on the craft (paper, System Identification, item 2)."""
    resistance = k_d * np.sqrt(craft.v_x * craft.v_x + craft.v_z * craft.v_z)
    return -resistance * craft.v_x, -resistance * craft.v_z, 0.0


def apply_ground_effect(thrust: float, rotor: Rotor, /, gain: float, height: float) -> float:
    """Thrust grows near the floor, fading with `height` [m]; below the floor, where none is, it grows no further."""
    return thrust * (1.0 + gain * np.exp(-np.maximum(rotor.height, 0.0) / height))


DRAG = Effect(
    id="air.drag",
    summary="aerodynamic drag on the craft",
    equation="-k_d |v| v",
    parameters=(Parameter("k_d", "N s^2/m^2", 0.0, 0.0, 1.0, Prior("halfnormal", 0.0, 0.08), 0.05, 0.006),),
    stage=Stage.FORCE,
    apply=apply_drag,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.viscous", "rail_z.viscous", "rotor.in_plane"),
    dissipative=True,
)
GROUND_EFFECT = Effect(
    id="air.ground_effect",
    summary="more thrust near the floor",
    equation="T × (1 + gain exp(-z/height))",
    parameters=(
        Parameter("gain", "", 0.0, 0.0, 2.0, Prior("halfnormal", 0.0, 0.1), 0.1, 0.02),
        Parameter("height", "m", 0.3, 0.05, 2.0, Prior("normal", 0.3, 0.05), 0.1, 2.0),
    ),
    stage=Stage.THRUST,
    apply=apply_ground_effect,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rotor.thrust_gain",),
    follows="position",
)
