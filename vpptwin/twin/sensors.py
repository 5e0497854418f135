"""What motion capture and gyro say of the truth: pure functions of poses, constants and a record of past poses.

A motion-capture pose stamped t shows the craft as it was at t - mocap.delay - clock.drift * t, its lengths times
mocap.scale, its angle plus mocap.angle. The gyro shows gyro.scale * q + gyro.bias at once. In flight nothing shows the
future: where a slow clock asks for it, the present is what there is.

Constants come by name, as rows of `Twin.constants` or a dict of `Twin.constant(name)`; angles are the planar craft's.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vpptwin.arrays import library
from vpptwin.twin.past import SensorState, look_back
from vpptwin.vehicle import Vehicle

Constants = Mapping[str, np.ndarray] | np.ndarray
"""Constants of the sensors by name, each (N,): a dict or a structured array."""
PERFECT = {
    "mocap.delay": 0.0, "clock.drift": 0.0, "mocap.scale": 1.0, "mocap.angle": 0.0, "gyro.scale": 1.0, "gyro.bias": 0.0
}  # fmt: skip
"""Constants of sensors that show the truth, and the names of all."""
X, Z, PITCH = 0, 1, 2


def perfect_sensors(count: int) -> dict[str, np.ndarray]:
    """Constants of sensors without errors, name → (count,)."""
    return {name: np.full(count, value) for name, value in PERFECT.items()}


def age_of_pose(constants: Constants, stamp: np.ndarray | float) -> np.ndarray:
    """How long before its stamp the craft was where a motion-capture pose shows it [s].

    Args:
        constants: of the sensors, (N,).
        stamp: of the pose, s since the start of the log, (N,) or one for all.

    Returns:
        (N,) s; negative where a slow clock stamps poses earlier than they are.
    """
    return constants["mocap.delay"] + constants["clock.drift"] * stamp


def measure_coordinate(constants: Constants, axis: int, value: np.ndarray) -> np.ndarray:
    """x, z or θ as motion capture gives it, noise and age apart [m, m, rad]; any shape that constants broadcast to."""
    return value + constants["mocap.angle"] if axis == PITCH else value * constants["mocap.scale"]


def measure_pose(constants: Constants, pose: np.ndarray) -> np.ndarray:
    """A pose x, z, θ as motion capture gives it, noise and age apart, (N, 3) m, m, rad."""
    return library(pose).stack([measure_coordinate(constants, axis, pose[:, axis]) for axis in (X, Z, PITCH)], 1)


def measure_velocity(constants: Constants, velocity: np.ndarray) -> np.ndarray:
    """Velocity v_x, v_z of motion-capture positions, noise and age apart, (N, 2) m/s."""
    return velocity[:, :PITCH] * constants["mocap.scale"][:, None]


def measure_rate(constants: Constants, rate: np.ndarray) -> np.ndarray:
    """The rate q as the gyro gives it, noise apart, (N,) rad/s."""
    return constants["gyro.scale"] * rate + constants["gyro.bias"]


def body_force(pose: np.ndarray, velocity: np.ndarray, dt: float, gravity: float) -> np.ndarray:
    """Specific force at the hinge in body axes x, z at the middle of every step, (K, steps, 2) m/s²."""
    acceleration = np.diff(velocity[..., :2], axis=1) / dt
    theta = 0.5 * (pose[:, 1:, 2] + pose[:, :-1, 2])
    world_x, world_z = acceleration[..., 0], acceleration[..., 1] + gravity
    cos, sin = np.cos(theta), np.sin(theta)
    return np.stack([world_x * cos + world_z * sin, world_z * cos - world_x * sin], axis=-1)


def sensor_noise(vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of a measured pose (3,) [m, m, rad] and velocity (3,) [m/s, m/s, rad/s].

    Position and angle are those of the motion capture and the rate that of the gyro. Velocity is taken as differenced
    over one capture interval, the noisiest estimate a flight computer would accept.
    """
    mocap, imu = vehicle.sensors.mocap, vehicle.sensors.imu
    differenced = np.sqrt(2.0) * mocap.position_std * mocap.rate
    return (
        np.array([mocap.position_std, mocap.position_std, mocap.angle_std]),
        np.array([differenced, differenced, imu.gyro_std]),
    )


def read_sensors(
    constants: Constants, past: SensorState, pose: np.ndarray, velocity: np.ndarray, stamp: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """What a flight computer has of a craft that is here now, noise apart.

    The velocity is the true one of the pose that is shown; the rate is the gyro's, which is never late.

    Args:
        constants: of the sensors, (N,).
        past: its newest entry is the present; without entries no pose comes late.
        pose: x, z, θ now, (N, 3) m, m, rad.
        velocity: v_x, v_z, q now, (N, 3) m/s, m/s, rad/s.
        stamp: s since the start of the log, (N,).
        period: between entries of `past` [s].

    Returns:
        Pose (N, 3) and velocity (N, 3) as measured, fresh arrays.
    """
    rate = measure_rate(constants, velocity[:, PITCH])
    if past.depth:
        pose, velocity = look_back(past, age_of_pose(constants, stamp), period)
    return measure_pose(constants, pose), library(pose).column_stack([measure_velocity(constants, velocity), rate])
