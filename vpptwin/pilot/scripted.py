"""A pilot that follows a script of targets, upright or inverted, with the same commands as a policy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vpptwin.vehicle import Vehicle

STIFFNESS, DAMPING = 12.0, 6.0
"""Acceleration asked for per metre and per m/s off the target [1/s², 1/s]."""
TURN = 8.0
"""Rate asked for per radian of angle error [1/s]."""
LEAN = 0.7
"""Largest angle that the pilot leans away from upright or inverted to move sideways [rad]."""


@dataclass(frozen=True)
class Script:
    """Targets over time, each holding until the next.

    Attributes:
        time: when each target begins, (M,) s, rising from 0.
        target: x, z, θ, (M, 3) m, m, rad; θ is a multiple of π.
    """

    time: np.ndarray
    target: np.ndarray

    def at(self, time: float) -> np.ndarray:
        """The target at a time [s], (3,)."""
        current: np.ndarray = self.target[max(int(np.searchsorted(self.time, time, side="right")) - 1, 0)]
        return current


def pilot_commands(vehicle: Vehicle, pose: np.ndarray, velocity: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Thrust and rate commands that bring N crafts to their targets.

    Args:
        vehicle: believed numbers.
        pose: x, z, θ, (N, 3) m, m, rad.
        velocity: (N, 3) m/s, rad/s.
        target: x, z, θ, (N, 3) or (3,); θ a multiple of π: where it is odd the craft hovers inverted.

    Returns:
        Thrust [N] and rate [rad/s], (N, 2), within the vehicle's limits.
    """
    control, airframe, rig = vehicle.control, vehicle.airframe, vehicle.rig
    off = target - pose
    lifted = airframe.mass + rig.slider_mass
    asked = STIFFNESS * off[:, :2] - DAMPING * velocity[:, :2]
    force_x = (lifted + rig.carriage_mass) * asked[:, 0]
    force_z = lifted * (asked[:, 1] + vehicle.gravity)
    upward = np.where(np.cos(target[..., 2]) > 0.0, 1.0, -1.0)
    lean = np.clip(np.arctan2(-force_x, np.maximum(force_z, 0.3 * lifted * vehicle.gravity)), -LEAN, LEAN)
    wanted = target[..., 2] + lean
    thrust = force_z * np.cos(pose[:, 2]) - force_x * np.sin(pose[:, 2])
    turning = np.cos(pose[:, 2]) * upward < 0.3  # far from the wanted attitude thrust would throw the craft aside
    thrust = np.where(turning, 0.0, thrust)
    rate = TURN * (wanted - pose[:, 2])
    limit = np.array([control.thrust_max, control.rate_max])
    return np.clip(np.column_stack([thrust, rate]), -limit, limit)
