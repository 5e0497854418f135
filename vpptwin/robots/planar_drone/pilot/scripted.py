"""A pilot that follows a script of targets, upright or inverted, with the same commands as a policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.robots.planar_drone.pilot.reference import Reference
from vpptwin.robots.planar_drone.vehicle import Vehicle

STIFFNESS, DAMPING = 12.0, 6.0
"""Acceleration asked for per metre and per m/s off the target [1/s², 1/s]."""
TURN = 8.0
"""Rate asked for per radian of angle error [1/s]."""
LEAN = 0.7
"""Largest angle that the pilot leans away from upright or inverted to move sideways [rad]."""
INTEGRAL, MAX_TRIM, NEAR = 3.0, 1.5, 0.3
"""Acceleration gathered per metre and second off the target [1/s³], its limit [m/s²], and how near it begins [m]."""


@dataclass(frozen=True)
class Script:
    """Targets over time, each holding until the next."""

    time: np.ndarray  # when each target begins, (M,) s, rising from 0
    target: np.ndarray  # x, z, θ, (M, 3) m, m, rad; θ is a multiple of π

    def at(self, time: float) -> np.ndarray:
        """The target at a time [s], (3,)."""
        current: np.ndarray = self.target[max(int(np.searchsorted(self.time, time, side="right")) - 1, 0)]
        return current


class ScriptedPilot:
    """Flies N crafts along references of the same length, one each.

    Args:
        vehicle: believed numbers.
        references: N of them.
    """

    def __init__(self, vehicle: Vehicle, references: Sequence[Reference]) -> None:
        self.vehicle, self.count, self.ticks = vehicle, len(references), len(references[0])
        self._pose, self._velocity, self._acceleration = (
            np.stack([getattr(r, name) for r in references]) for name in ("pose", "velocity", "acceleration")
        )
        self._nudge = np.stack([r.nudge for r in references])

    def target(self, tick: int) -> np.ndarray:
        """Target x, z, θ of a tick, (N, 3) m, m, rad; before the first tick the first target."""
        target: np.ndarray = self._pose[:, max(tick, 0)]
        return target

    def command(
        self, tick: int, pose: np.ndarray, velocity: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Commands of a tick, and what to remember until the next.

        Args:
            tick: number of the policy period.
            pose: x, z, θ as estimated, (N, 3) m, m, rad.
            velocity: (N, 3) m/s, rad/s.
            memory: (N, 2), what the tick before gave; zero before the first. Here it is the trim [m/s²].

        Returns:
            Thrust [N] and rate [rad/s], (N, 2), and the memory, (N, 2).
        """
        target, period = self.target(tick), 1.0 / self.vehicle.control.policy_rate
        off = (target - pose)[:, :2]
        calm = (np.abs(off) < NEAR) & is_level(target[:, 2])[:, None]
        memory = np.clip(memory + np.where(calm, period * INTEGRAL * off, 0.0), -MAX_TRIM, MAX_TRIM)
        now = max(tick, 0)
        acceleration = self._acceleration[:, now] + memory
        command = pilot_commands(
            self.vehicle, pose, velocity, target, self._velocity[:, now], acceleration, self._nudge[:, now]
        )
        return command, memory


def is_level(angle: np.ndarray) -> np.ndarray:
    """Whether target angles [rad] are upright or inverted, not part of a turn; any shape."""
    return np.abs(np.sin(angle)) < 1e-6


def pilot_commands(
    vehicle: Vehicle, pose: np.ndarray, velocity: np.ndarray, target: np.ndarray,
    target_velocity: np.ndarray | float = 0.0, acceleration: np.ndarray | float = 0.0, nudge: np.ndarray | float = 0.0,
) -> np.ndarray:  # fmt: skip
    """Thrust and rate commands that bring N crafts to their targets.

    Args:
        vehicle: believed numbers.
        pose: x, z, θ, (N, 3) m, m, rad.
        velocity: (N, 3) m/s, rad/s.
        target: x, z, θ, (N, 3) or (3,); where θ is an odd multiple of π the craft hovers inverted, between multiples it
            only follows the angle and lets its place go.
        target_velocity: of the target, (N, 3) m/s, rad/s.
        acceleration: of the target's x and z, added to what is asked for, (N, 2) m/s².
        nudge: angle added to the lean, (N,) rad.

    Returns:
        Thrust [N] and rate [rad/s], (N, 2), within the vehicle's limits.
    """
    control, airframe, rig = vehicle.control, vehicle.airframe, vehicle.rig
    off, slip = target - pose, target_velocity - velocity
    lifted = airframe.mass + rig.slider_mass
    # a = k (r - p) + d (ṙ - v) + r̈; F_x = (m + m_slider + m_carriage) a_x, F_z = (m + m_slider) (a_z + g)
    asked = STIFFNESS * off[:, :2] + DAMPING * slip[:, :2] + acceleration
    force_x = (lifted + rig.carriage_mass) * asked[:, 0]
    force_z = lifted * (asked[:, 1] + vehicle.gravity)
    upward = np.where(np.cos(target[..., 2]) > 0.0, 1.0, -1.0)
    lean = np.clip(np.arctan2(-force_x, np.maximum(force_z, 0.3 * lifted * vehicle.gravity)), -LEAN, LEAN)
    wanted = target[..., 2] + np.where(is_level(target[..., 2]), lean + nudge, 0.0)
    # along body z: T = F_z cos θ - F_x sin θ
    thrust = force_z * np.cos(pose[:, 2]) - force_x * np.sin(pose[:, 2])
    turning = np.cos(pose[:, 2]) * upward < 0.3  # far from the wanted attitude thrust would throw the craft aside
    thrust = np.where(turning, 0.0, thrust)
    rate = TURN * (wanted - pose[:, 2]) + np.broadcast_to(target_velocity, pose.shape)[:, 2]
    limit = np.array([control.thrust_max, control.rate_max])
    return np.clip(np.column_stack([thrust, rate]), -limit, limit)
