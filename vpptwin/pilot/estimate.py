"""What a flight computer makes of its sensors: a complementary filter, inertial between poses of the motion capture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PLACE, ANGLE, SPEED = 0.25, 0.15, 2.5
"""Shares of the miss by which a pose corrects position and angle [1], and the velocity [1/s]."""


@dataclass(frozen=True)
class Estimate:
    """Estimated pose (N, 3) [m, m, rad] and velocity (N, 3) [m/s, m/s, rad/s] of N crafts."""

    pose: np.ndarray
    velocity: np.ndarray


def predict(before: Estimate, gyro: np.ndarray, force: np.ndarray, period: float, gravity: float) -> Estimate:
    """Carry an estimate on by what gyro and accelerometer read.

    Args:
        before: one period ago.
        gyro: mean rate over the period, (N,) rad/s.
        force: mean specific force in body axes x, z, (N, 2) m/s².
        period: s.
        gravity: m/s².
    """
    middle = before.pose[:, 2] + 0.5 * period * gyro
    sine, cosine = np.sin(middle), np.cos(middle)
    acceleration = np.column_stack(
        [force[:, 0] * cosine - force[:, 1] * sine, force[:, 0] * sine + force[:, 1] * cosine - gravity]
    )
    pose, velocity = before.pose.copy(), before.velocity.copy()
    pose[:, :2] += period * (velocity[:, :2] + 0.5 * period * acceleration)
    pose[:, 2] += period * gyro
    velocity[:, :2] += period * acceleration
    velocity[:, 2] = gyro
    return Estimate(pose, velocity)


def correct(predicted: Estimate, seen: np.ndarray) -> Estimate:
    """Pull a prediction towards a pose of the motion capture, (N, 3) m, m, rad."""
    miss = seen - predicted.pose
    velocity = predicted.velocity.copy()
    velocity[:, :2] += SPEED * miss[:, :2]
    return Estimate(predicted.pose + miss * np.array([PLACE, PLACE, ANGLE]), velocity)
