"""What signals say of the truth: pure functions of poses, constants and a record of past poses.

A coordinate stamped t shows what it was at t - pose.delay - pose.drift * t, times pose.scale plus pose.offset; a
rate likewise what it was by rate.delay and rate.drift, times rate.scale plus rate.bias. Attitudes are turned by
pose.offset, about the body's axes, and so are the axes of a gyro by rate.turn. In flight nothing shows the future:
where a slow clock asks for it, the present is what there is.

Constants come by name, each with a last axis of degrees of freedom: rows of `Twin.constants` or a dict of
`Twin.constant(name)`. The drone has its poses from motion capture, its rate of pitch from a gyro.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vpptwin.engine.arrays import library
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.twin.robot.manifold import rotate, turn_to_world
from vpptwin.twin.stepping.past import SensorState, look_back

Constants = Mapping[str, np.ndarray] | np.ndarray
"""Constants of the sensors by name, each (N, nv): a dict or a structured array."""
PERFECT = {
    "pose.delay": 0.0, "pose.drift": 0.0, "pose.scale": 1.0, "pose.offset": 0.0,
    "rate.delay": 0.0, "rate.drift": 0.0, "rate.scale": 1.0, "rate.bias": 0.0,
    "rate.turn": 0.0,
}  # fmt: skip
"""Constants of sensors that show the truth, of every degree of freedom, and the names of all."""
X, Z, PITCH = 0, 1, 2


def perfect_sensors(count: int, dofs: int = 3) -> dict[str, np.ndarray]:
    """Constants of sensors without errors, name → (count, dofs)."""
    return {name: np.full((count, dofs), value) for name, value in PERFECT.items()}


def find_age(constants: Constants, signal: str, dof: int, stamp: np.ndarray | float) -> np.ndarray:
    """How long before its stamp a `pose` or `rate` was what its sensor shows [s].

    Args:
        constants: of the sensors, (N, nv).
        signal: `pose` or `rate`.
        dof: degree of freedom.
        stamp: s since the start of the log, (N,) or one for all.

    Returns:
        (N,) s; negative where a slow clock stamps earlier than what is shown.
    """
    age: np.ndarray = constants[f"{signal}.delay"][..., dof] + constants[f"{signal}.drift"][..., dof] * stamp
    return age


def age_of_pose(constants: Constants, stamp: np.ndarray | float) -> np.ndarray:
    """How long before its stamp the drone was where a motion-capture pose shows it [s], (N,); see `find_age`."""
    return find_age(constants, "pose", X, stamp)


def measure_coordinate(constants: Constants, dof: int, value: np.ndarray) -> np.ndarray:
    """A coordinate as its sensor gives it, noise and age apart [m, rad]; any shape that constants broadcast to."""
    shown: np.ndarray = value * constants["pose.scale"][..., dof] + constants["pose.offset"][..., dof]
    return shown


def measure_pose(constants: Constants, pose: np.ndarray) -> np.ndarray:
    """A pose x, z, θ as motion capture gives it, noise and age apart, (N, 3) m, m, rad."""
    return library(pose).stack([measure_coordinate(constants, axis, pose[:, axis]) for axis in (X, Z, PITCH)], 1)


def measure_velocity(constants: Constants, velocity: np.ndarray) -> np.ndarray:
    """Velocity v_x, v_z of motion-capture positions, noise and age apart, (N, 2) m/s."""
    return velocity[:, :PITCH] * constants["pose.scale"][..., :PITCH]


def measure_rate(constants: Constants, rate: np.ndarray, dof: int | np.ndarray = PITCH) -> np.ndarray:
    """A rate as its sensor gives it, noise and age apart, (N,) m/s, rad/s: by default the drone's gyro's."""
    shown: np.ndarray = constants["rate.scale"][..., dof] * rate + constants["rate.bias"][..., dof]
    return shown


def turn_rates(constants: Constants, rates: np.ndarray, first: int, back: bool = False) -> np.ndarray:
    """Rates about a body's axes, (..., 3) rad/s, about those of a gyro that rate.turn has turned against it; or `back`.

    The body's degrees of freedom of rotation begin at `first`.
    """
    turn = np.stack([constants["rate.turn"][..., first + axis] for axis in range(3)], axis=-1)
    return turn_to_world(rotate(np.array([1.0, 0.0, 0.0, 0.0]), turn if back else -turn), rates)


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
        constants: of the sensors, (N, nv).
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
