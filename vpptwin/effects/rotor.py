"""Effects on the rotors' thrust, and the forces of air that flows through and across their discs."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Craft, Effect, Rotor, Stage
from vpptwin.effects.parameter import Parameter, Prior

LOST_TO_STALL = 0.75
"""Share of the pitch beyond onset that makes no thrust."""


def apply_thrust_gain(thrust: float, rotor: Rotor, /, gain: float) -> float:
    """k_T is off by a factor (paper Eq. 4)."""
    return thrust * gain


def apply_asymmetry(thrust: float, rotor: Rotor, /, fraction: float) -> float:
    """Rotor 1 is stronger and rotor 2 weaker by a fraction."""
    return thrust * (1.0 - rotor.side * fraction)


def apply_negative_thrust(thrust: float, rotor: Rotor, /, loss: float) -> float:
    """Cambered blades make less thrust at negative pitch."""
    return thrust * (1.0 - loss * (rotor.pitch < 0.0))


def apply_stall(thrust: float, rotor: Rotor, /, onset: float) -> float:
    """Only a quarter of the pitch beyond onset [rad] counts."""
    pitch = np.abs(rotor.pitch)
    return thrust * (1.0 - LOST_TO_STALL * np.maximum(pitch - onset, 0.0) / np.maximum(pitch, onset))


def apply_inflow(thrust: float, rotor: Rotor, /, damping: float) -> float:
    """A rotor that climbs along its thrust axis meets the air at a smaller angle."""
    return thrust - damping * rotor.speed * rotor.axial


def apply_in_plane(craft: Craft, /, damping: float) -> tuple[float, float, float]:
    """H-force: the discs resist motion along the arm."""
    along_arm = craft.v_x * craft.cosine + craft.v_z * craft.sine
    force = -damping * (craft.speed_1 + craft.speed_2) * along_arm
    return force * craft.cosine, force * craft.sine, 0.0


THRUST_GAIN = Effect(
    id="rotor.thrust_gain", summary="a wrong thrust constant of the rotors", equation="T × gain",
    parameters=(
        Parameter(name="gain", unit="", off=1.0, low=0.5, high=1.5, prior=Prior("normal", 1.0, 0.05), size=0.04,
                  tolerance=0.004, source="assumption: k_t (vehicle.yaml) within 5 %"),
    ),
    stage=Stage.THRUST, apply=apply_thrust_gain, shows=("/mocap/pose", "/imu/data"),
    look_alikes=("airframe.mass", "rail_z.bias", "airframe.inertia", "gyro.scale", "servo.trim",
                 "rotor.negative_thrust", "rotor.stall", "air.ground_effect"), follows="command",
)  # fmt: skip
ASYMMETRY = Effect(
    id="rotor.asymmetry", summary="rotors of unequal thrust", equation="T_1 × (1 + fraction), T_2 × (1 - fraction)",
    parameters=(
        Parameter(name="fraction", unit="", off=0.0, low=-0.5, high=0.5, prior=Prior("normal", 0.0, 0.02), size=0.02,
                  tolerance=0.003, source="assumption: rotors of one make differ by 2 %"),
    ),
    stage=Stage.THRUST, apply=apply_asymmetry, shows=("/imu/data", "/mocap/pose"),
    look_alikes=("pitch.bias", "airframe.com", "servo.trim"), follows="command",
)  # fmt: skip
NEGATIVE_THRUST = Effect(
    id="rotor.negative_thrust", summary="less thrust at negative blade pitch", equation="T × (1 - loss) where α < 0",
    parameters=(
        Parameter(name="loss", unit="", off=0.0, low=0.0, high=0.9, prior=Prior("halfnormal", 0.0, 0.05), size=0.05,
                  tolerance=0.005, source="assumption: nearly symmetric blades, some 5 %"),
    ),
    stage=Stage.THRUST, apply=apply_negative_thrust, shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rotor.thrust_gain",), follows="command",
)  # fmt: skip
STALL = Effect(
    id="rotor.stall", summary="blades that stall at large pitch", equation="α beyond ±onset counts a quarter",
    parameters=(
        Parameter(name="onset", unit="rad", off=0.5, low=0.05, high=0.5, prior=Prior("uniform", 0.15, 0.25), size=0.36,
                  tolerance=0.005, source="assumption: typical 0.15 rad; no blade is pitched to 0.5"),
    ),
    stage=Stage.THRUST, apply=apply_stall, shows=("/mocap/pose", "/imu/data"), look_alikes=("rotor.thrust_gain",),
    follows="command",
)  # fmt: skip
INFLOW = Effect(
    id="rotor.inflow", summary="thrust lost to the air that flows through the rotors", equation="T - damping ω v_axis",
    parameters=(
        Parameter(name="damping", unit="N s/(m rad)", off=0.0, low=0.0, high=0.005,
                  prior=Prior("halfnormal", 0.0, 3e-4), size=2e-4, tolerance=2e-5,
                  source="assumption: of the order of k_t/(speed × radius)"),
    ),
    stage=Stage.THRUST, apply=apply_inflow, shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_z.viscous", "pitch.viscous"), dissipative=True,
)  # fmt: skip
IN_PLANE = Effect(
    id="rotor.in_plane", summary="drag of the rotors along the arm", equation="-damping (ω_1 + ω_2) v_arm",
    parameters=(
        Parameter(name="damping", unit="N s/(m rad)", off=0.0, low=0.0, high=0.005,
                  prior=Prior("halfnormal", 0.0, 2e-4), size=1e-4, tolerance=1e-5,
                  source="assumption: somewhat less than rotor.inflow"),
    ),
    stage=Stage.FORCE, apply=apply_in_plane, shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.viscous", "air.drag"), dissipative=True,
)  # fmt: skip
