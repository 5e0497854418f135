"""Effects on the rotors' thrust and on the servos that pitch their blades."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Plant, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior


def apply_thrust_gain(thrust: np.ndarray, plant: Plant, site: Site, /, gain: np.ndarray) -> np.ndarray:
    """k_T is off by a factor (paper Eq. 4)."""
    return thrust * gain[:, None]


def apply_asymmetry(thrust: np.ndarray, plant: Plant, site: Site, /, fraction: np.ndarray) -> np.ndarray:
    """Rotor 1 is stronger and rotor 2 weaker by a fraction."""
    return thrust * np.stack([1.0 + fraction, 1.0 - fraction], axis=1)


def apply_servo_lag(constants: Constants, site: Site, /, time_constant: np.ndarray) -> None:
    """The pitch servo's time constant [s] differs from the nominal (paper, System Identification, item 1)."""
    constants["actuator.time_constant"][:] = time_constant[:, None]


THRUST_GAIN = Effect(
    id="rotor.thrust_gain",
    summary="a wrong thrust constant of the rotors",
    equation="T × gain",
    parameters=(Parameter("gain", "", 1.0, 0.5, 1.5, Prior("normal", 1.0, 0.05), 0.04, 0.004),),
    stage=Stage.THRUST,
    apply=apply_thrust_gain,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("airframe.mass", "rail_z.bias", "airframe.inertia"),
    follows="command",
)
ASYMMETRY = Effect(
    id="rotor.asymmetry",
    summary="rotors of unequal thrust",
    equation="T_1 × (1 + fraction), T_2 × (1 - fraction)",
    parameters=(Parameter("fraction", "", 0.0, -0.5, 0.5, Prior("normal", 0.0, 0.02), 0.02, 0.003),),
    stage=Stage.THRUST,
    apply=apply_asymmetry,
    shows=("/imu/data", "/mocap/pose"),
    look_alikes=("pitch.bias",),
    follows="command",
)
SERVO_LAG = Effect(
    id="servo.lag",
    summary="a wrong time constant of the pitch servos",
    equation="α̇ = (α_cmd - α)/time_constant",
    parameters=(
        Parameter(
            "time_constant", "s", 0.020, 0.001, 0.2, Prior("normal", 0.020, 0.003), 0.004, 0.0006, "servo.time_constant"
        ),
    ),
    stage=Stage.CONSTANT,
    apply=apply_servo_lag,
    shows=("/imu/data", "/mocap/pose"),
    look_alikes=("command.delay",),
    writes=("actuator.time_constant",),
    follows="command change",
)
EFFECTS = (THRUST_GAIN, ASYMMETRY, SERVO_LAG)
