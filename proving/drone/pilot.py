"""Pilots and what they fly by: a state estimate from delayed mocap and IMU; the scripted pilot's loops. 100 Hz.

They know only the nominal rig.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .manoeuvres import PERIOD, Script
from .rig import PITCH, X, Z

_KP, _KD, _KI = np.array([[9.0], [16.0]]), np.array([[5.5], [7.0]]), np.array([[3.0], [8.0]])
_WINDUP = 1.5  # m/s^2, of the integral
_ANGLE_GAIN = 9.0  # 1/s
_TILT_MAX = 0.9  # rad
_RATE_MAX = 11.5  # rad/s
_POSE_GAIN, _VELOCITY_GAIN, _ANGLE_BLEND = 0.25, 2.5, 0.15  # 1, 1/s, 1


class Commander(Protocol):
    """Whoever flies a batch."""

    # x m, z m, theta rad of each policy period, as published on /setpoint/pose. (ticks, 3, flights)
    setpoint: np.ndarray

    def command(
        self, tick: int, pose: np.ndarray, speed: np.ndarray, rate: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Command thrust N and rate rad/s, each (flights,).

        Args:
            tick: Policy period since the start of the log; before it the craft is to settle at its first target.
            pose: Estimated. (3, flights).
            speed: Estimated, m/s. (2, flights).
            rate: Measured q, mean over the last period, rad/s. (flights,).
        """


class Estimator:
    """Complementary filter: inertial prediction, corrected by mocap frames that are some ms old.

    Any attitude will do: nothing in it is linear in the angle, which goes on counting through turns.
    """

    def __init__(self, position: np.ndarray, velocity: np.ndarray, age: np.ndarray, gravity: float) -> None:
        """Start from a known state.

        Args:
            position: x m, z m, theta rad. (3, flights).
            velocity: Their rates. (3, flights).
            age: Of the newest mocap frame at a policy tick, ms. (flights,).
            gravity: m/s^2.
        """
        self.pose, self.speed, self.rate = position.copy(), velocity[:PITCH].copy(), velocity[PITCH].copy()
        self.history = [self.pose.copy(), self.pose.copy()]  # 10 and 20 ms ago
        self.blend = (age - 10.0) / 10.0
        self.gravity = gravity

    def update(self, gyro: np.ndarray, force: np.ndarray, frame: np.ndarray, seen: np.ndarray) -> None:
        """Advance one policy period.

        Args:
            gyro: Mean over the period, rad/s. (flights,).
            force: Mean specific force in body axes, m/s^2. (2, flights).
            frame: Newest mocap frame. (3, flights).
            seen: Whether it arrived. (flights,).
        """
        before = self.pose
        pose = before.copy()
        middle = before[PITCH] + 0.5 * PERIOD * gyro
        sine, cosine = np.sin(middle), np.cos(middle)
        accel = np.stack([force[0] * cosine - force[1] * sine, force[0] * sine + force[1] * cosine - self.gravity])
        pose[:PITCH] += PERIOD * (self.speed + 0.5 * PERIOD * accel)
        pose[PITCH] += PERIOD * gyro
        speed = self.speed + PERIOD * accel
        recent, older = self.history[0], self.history[1]
        miss = np.where(seen, frame - (recent + self.blend * (older - recent)), 0.0)
        miss[PITCH] = np.remainder(miss[PITCH] + np.pi, 2 * np.pi) - np.pi
        pose[:PITCH] += _POSE_GAIN * miss[:PITCH]
        pose[PITCH] += _ANGLE_BLEND * miss[PITCH]
        self.speed = speed + _VELOCITY_GAIN * miss[:PITCH]
        self.pose, self.rate = pose, gyro
        self.history = [pose, recent]


class Pilot:
    """Position and angle loops over the scripts of a batch."""

    def __init__(self, scripts: list[Script], nominal: dict) -> None:
        self.script = {
            name: np.ascontiguousarray(np.stack([getattr(s, name) for s in scripts], axis=-1))
            for name in Script.__dataclass_fields__
        }
        self.setpoint = self.script["setpoint"]
        self.nudge_rate = np.diff(self.script["base"], axis=0, prepend=self.script["base"][:1]) / PERIOD
        rig = nominal["rig"]
        falling = nominal["airframe"]["mass"] + rig["slider_mass"]
        self.mass = np.array([[falling + rig["carriage_mass"]], [falling]])
        self.gravity = nominal["gravity"]
        self.thrust_max = nominal["control"]["thrust_max"]
        self.integral = np.zeros((2, len(scripts)))

    def command(
        self, tick: int, pose: np.ndarray, speed: np.ndarray, rate: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Command thrust N and rate rad/s as `Commander` says; damping the rate is left to the firmware."""
        now = {name: series[max(tick, 0)] for name, series in self.script.items()}
        haste, turning = now["haste"], now["turning"]
        error = np.clip(now["reference"] - pose[:PITCH], -haste, haste)
        small = (np.abs(error) < 0.3) & ~turning
        self.integral = np.clip(self.integral + np.where(small, _KI * PERIOD * error, 0.0), -_WINDUP, _WINDUP)
        accel = now["accel"] + _KP * error + _KD * (now["velocity"] - speed) + self.integral
        force_z = self.mass[Z] * np.clip(accel[1] + self.gravity, 0.25 * self.gravity, 1.9 * self.gravity)
        force_x = np.clip(self.mass[X] * accel[0], -np.tan(_TILT_MAX) * force_z, np.tan(_TILT_MAX) * force_z)
        tilt = np.where(turning, 0.0, np.arctan2(-force_x, force_z) + now["nudge"])
        wanted = now["base"] + tilt
        lead = np.where(turning, self.nudge_rate[max(tick, 0)], 0.0)
        wanted_rate = np.clip(lead + _ANGLE_GAIN * (wanted - pose[PITCH]), -_RATE_MAX, _RATE_MAX)
        sine, cosine = np.sin(pose[PITCH]), np.cos(pose[PITCH])
        thrust = np.clip(force_z * cosine - force_x * sine, -self.thrust_max, self.thrust_max)
        return thrust, wanted_rate
