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
    id="air.drag", summary="aerodynamic drag on the craft", equation="-k_d |v| v",
    parameters=(
        Parameter(name="k_d", unit="N s^2/m^2", off=0.0, low=0.0, high=1.0, prior=Prior("halfnormal", 0.0, 0.08),
                  size=0.05, tolerance=0.006, source="assumption: the paper fits k_d and prints no value"),
    ),
    stage=Stage.FORCE, apply=apply_drag, shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.viscous", "rail_z.viscous", "rotor.in_plane"), dissipative=True,
)  # fmt: skip
GROUND_EFFECT = Effect(
    id="air.ground_effect", summary="more thrust near the floor", equation="T × (1 + gain exp(-z/height))",
    parameters=(
        Parameter(name="gain", unit="", off=0.0, low=0.0, high=2.0, prior=Prior("halfnormal", 0.0, 0.1), size=0.1,
                  tolerance=0.02, source="assumption: some 10 % more at the floor"),
        Parameter(name="height", unit="m", off=0.3, low=0.05, high=2.0, prior=Prior("normal", 0.3, 0.05), size=0.1,
                  tolerance=2.0, source="assumption: fades within some 0.3 m"),
    ),
    stage=Stage.THRUST, apply=apply_ground_effect, shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rotor.thrust_gain",), fades_along="rail_z", follows="position",
)  # fmt: skip
