"""What a flight computer on board makes of its sensors while a policy trains: the Kalman filter that `fly` flies on."""

from __future__ import annotations

import numpy as np

from vpptwin.robots.planar_drone.kalman import FilterNoise, KalmanFilter
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.sensors import body_force, measure_rate

Path = tuple[np.ndarray, np.ndarray]
"""Positions and velocities before every inner step of a policy step, (N, steps, 3) each."""


class Onboard:
    """A filter for every simulation of an environment.

    Args:
        twin: whose simulations they are.
        noise: times the noise of the vehicle's IMU.
    """

    def __init__(self, twin: Twin, noise: float) -> None:
        imu = twin.vehicle.sensors.imu
        self._std = noise * np.array([imu.gyro_std, imu.accel_std, imu.accel_std])
        self._gravity = twin.vehicle.gravity
        self.filter = KalmanFilter(twin.num_sims, twin.dt, self._gravity, FilterNoise.of_vehicle(twin.vehicle))

    def begin(self, ids: np.ndarray, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Episodes begin in the rows `ids`: the craft has been flying and knows where it is and how it moves."""
        self.filter.start(ids, pose, velocity)

    def follow(self, twin: Twin, path: Path, state: TwinState, level: float, rng: np.random.Generator) -> None:
        """Feed the IMU's samples of a policy step.

        Args:
            twin: that has flown it.
            path: it flew.
            state: at the end.
            level: of the noise, 0 to 1.
            rng: of it.
        """
        pose, qvel = (np.concatenate([way, end[:, None]], axis=1) for way, end in zip(path, (state.qpos, state.qvel)))
        force = body_force(pose, qvel, twin.dt, self._gravity)
        turn = np.diff(pose[..., 2], axis=1) / twin.dt
        error = level * self._std * rng.standard_normal((*turn.shape, 3))
        for k in range(turn.shape[1]):
            gyro = measure_rate(twin.constants, turn[:, k]) + error[:, k, 0]
            self.filter.predict(gyro, force[:, k] + error[:, k, 1:])

    def correct(self, seen: np.ndarray, rows: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
        """Take in a pose of the motion capture for the rows, (n, 3); pose and velocity as now known, (n, 3) each."""
        pose, new = np.full((len(self.filter.pose), 3), np.nan), np.zeros(len(self.filter.pose), bool)
        pose[rows], new[rows] = seen, True
        self.filter.correct(pose, seen=new)
        return self.filter.pose[rows], self.filter.velocity[rows]
