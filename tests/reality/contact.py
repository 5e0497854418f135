"""End stops of the slides, floor and wall as springs with dampers."""

from __future__ import annotations

import numpy as np

from .rig import PITCH, Rig, X, Z

STIFFNESS = 8000.0  # N/m
DAMPING = 38.0  # N s/m: a dropped craft rebounds with about 0.4 of its speed
TIP_RADIUS = 0.015  # m
WALL = 1.70  # m, face of the wall
_MARGIN = 0.05  # m, looked at once per millisecond: at 20 m/s the craft moves 0.02 m


class Contact:
    """Whatever stops the craft."""

    def __init__(self, rig: Rig) -> None:
        travel = rig.nominal["rig"]
        self.low = np.array([travel["travel_x"][0], travel["travel_z"][0]])[:, None]
        self.high = np.array([travel["travel_x"][1], travel["travel_z"][1]])[:, None]
        self.half_length = rig.half_length
        self.reach = np.array([[-self.half_length], [self.half_length]])

    def is_near(self, position: np.ndarray) -> bool:
        """Tell whether any flight may touch something within the next millisecond."""
        arm = self.half_length + TIP_RADIUS + _MARGIN
        near = position[X] > min(self.high[X, 0] - _MARGIN, WALL - arm)
        near |= position[X] < self.low[X, 0] + _MARGIN
        near |= position[Z] < max(self.low[Z, 0] + _MARGIN, arm)
        near |= position[Z] > self.high[Z, 0] - _MARGIN
        return bool(near.any())

    def push_slides(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Forces of the end stops on carriage and slider, N. (2, flights)."""
        slides, rates = position[:PITCH], velocity[:PITCH]
        over, under = slides - self.high, self.low - slides
        back = np.where(over > 0, np.maximum(STIFFNESS * over + DAMPING * rates, 0.0), 0.0)
        return np.where(under > 0, np.maximum(STIFFNESS * under - DAMPING * rates, 0.0), 0.0) - back

    def add_to_tips(
        self, force: np.ndarray, position: np.ndarray, velocity: np.ndarray, sine: np.ndarray, cosine: np.ndarray
    ) -> None:
        """Add what floor and wall do to the craft's arm tips to `force`, N and N m about the hinge. (3, flights)."""
        reach = self.reach  # (2, 1): arm tips in body axes
        depth = TIP_RADIUS - (position[Z] + reach * sine)
        sinking = -(velocity[Z] + reach * cosine * velocity[PITCH])
        push = np.where(depth > 0, np.maximum(STIFFNESS * depth + DAMPING * sinking, 0.0), 0.0)
        force[Z] += push.sum(0)
        force[PITCH] += (reach * cosine * push).sum(0)
        depth = position[X] + reach * cosine + TIP_RADIUS - WALL
        closing = velocity[X] - reach * sine * velocity[PITCH]
        push = np.where(depth > 0, np.maximum(STIFFNESS * depth + DAMPING * closing, 0.0), 0.0)
        force[X] -= push.sum(0)
        force[PITCH] += (reach * sine * push).sum(0)
