"""Effects on what the sensors say: alignment and scale of the motion capture, bias and scale of the gyro."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior


def apply_misalignment(constants: Constants, site: Site, /, angle: np.ndarray) -> None:
    """Angle added to the measured θ [rad]."""
    constants["mocap.angle"][:] += angle


def apply_mocap_scale(constants: Constants, site: Site, /, scale: np.ndarray) -> None:
    """Measured lengths are off by a factor."""
    constants["mocap.scale"][:] *= scale


def apply_gyro_bias(constants: Constants, site: Site, /, bias: np.ndarray) -> None:
    """Angular rate added to the measured q [rad/s]."""
    constants["gyro.bias"][:] += bias


def apply_gyro_scale(constants: Constants, site: Site, /, scale: np.ndarray) -> None:
    """Measured angular rates are off by a factor."""
    constants["gyro.scale"][:] *= scale


MOCAP_MISALIGNMENT = Effect(
    id="mocap.misalignment",
    summary="a motion capture body that is not aligned with the craft",
    equation="θ + angle",
    parameters=(Parameter("angle", "rad", 0.0, -0.3, 0.3, Prior("normal", 0.0, 0.01), 0.02, 0.002),),
    stage=Stage.CONSTANT,
    apply=apply_misalignment,
    shows=("/mocap/pose",),
    look_alikes=("rail_x.bias", "rail.tilt"),
    writes=("mocap.angle",),
    follows="position",
)
MOCAP_SCALE = Effect(
    id="mocap.scale",
    summary="a wrong length scale of the motion capture",
    equation="(x, z) × scale",
    parameters=(Parameter("scale", "", 1.0, 0.8, 1.2, Prior("normal", 1.0, 0.005), 0.02, 0.001),),
    stage=Stage.CONSTANT,
    apply=apply_mocap_scale,
    shows=("/mocap/pose",),
    writes=("mocap.scale",),
    follows="position",
)
GYRO_BIAS = Effect(
    id="gyro.bias",
    summary="a bias of the gyro",
    equation="q + bias",
    parameters=(Parameter("bias", "rad/s", 0.0, -0.5, 0.5, Prior("normal", 0.0, 0.02), 0.04, 0.004),),
    stage=Stage.CONSTANT,
    apply=apply_gyro_bias,
    shows=("/imu/data",),
    writes=("gyro.bias",),
)
GYRO_SCALE = Effect(
    id="gyro.scale",
    summary="a wrong scale of the gyro",
    equation="q × scale",
    parameters=(Parameter("scale", "", 1.0, 0.7, 1.3, Prior("normal", 1.0, 0.02), 0.04, 0.004),),
    stage=Stage.CONSTANT,
    apply=apply_gyro_scale,
    shows=("/imu/data",),
    look_alikes=("airframe.inertia", "rotor.thrust_gain"),
    writes=("gyro.scale",),
)
