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
    id="mocap.misalignment", summary="a motion capture body that is not aligned with the craft", equation="θ + angle",
    parameters=(
        Parameter(name="angle", unit="rad", off=0.0, low=-0.3, high=0.3, prior=Prior("normal", 0.0, 0.01), size=0.02,
                  tolerance=0.002, source="assumption: marker body set by hand to 0.6 degrees"),
    ),
    stage=Stage.CONSTANT, apply=apply_misalignment, shows=("/mocap/pose",), look_alikes=("rail_x.bias", "rail.tilt"),
    writes=("mocap.angle",), follows="position",
)  # fmt: skip
MOCAP_SCALE = Effect(
    id="mocap.scale", summary="a wrong length scale of the motion capture", equation="(x, z) × scale",
    parameters=(
        Parameter(name="scale", unit="", off=1.0, low=0.8, high=1.2, prior=Prior("normal", 1.0, 0.005), size=0.02,
                  tolerance=0.001, source="assumption: calibrated to half a percent"),
    ),
    stage=Stage.CONSTANT, apply=apply_mocap_scale, shows=("/mocap/pose",), writes=("mocap.scale",), follows="position",
)  # fmt: skip
GYRO_BIAS = Effect(
    id="gyro.bias", summary="a bias of the gyro", equation="q + bias",
    parameters=(
        Parameter(name="bias", unit="rad/s", off=0.0, low=-0.5, high=0.5, prior=Prior("normal", 0.0, 0.02), size=0.04,
                  tolerance=0.004, source="assumption: a MEMS gyro, some 1 degree/s"),
    ),
    stage=Stage.CONSTANT, apply=apply_gyro_bias, shows=("/imu/data",), writes=("gyro.bias",),
)  # fmt: skip
GYRO_SCALE = Effect(
    id="gyro.scale", summary="a wrong scale of the gyro", equation="q × scale",
    parameters=(
        Parameter(name="scale", unit="", off=1.0, low=0.7, high=1.3, prior=Prior("normal", 1.0, 0.02), size=0.04,
                  tolerance=0.004, source="assumption: a MEMS gyro, scale within 2 %"),
    ),
    stage=Stage.CONSTANT, apply=apply_gyro_scale, shows=("/imu/data",),
    look_alikes=("airframe.inertia", "rotor.thrust_gain"), writes=("gyro.scale",),
)  # fmt: skip
