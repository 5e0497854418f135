"""End stops of the slides, floor and wall as springs with dampers that rub.

What models/rail_rig.xml says of them is by the mass that strikes: so much acceleration for so much depth, or for
sliding so fast unless friction gives less. A real wall knows no mass: here the nominal one, as it meets the wall at
that attitude, makes newtons of it.
"""

from __future__ import annotations

import numpy as np

from .rig import PITCH, Rig, X, Z

SOFTNESS, RATIO, FRICTION = 0.01, 0.3, 0.4  # s and 1, time constant and damping ratio; 1
STIFFNESS = (SOFTNESS * RATIO) ** -2  # 1/s^2
DAMPING = 2 / SOFTNESS  # 1/s: a dropped craft rebounds with about 0.4 of its speed
TIP_RADIUS = 0.015  # m
WALL = 1.70  # m, face of the wall
_MARGIN = 0.05  # m, looked at once per millisecond: at 20 m/s the craft moves 0.02 m


class Contact:
    """Whatever stops the craft. The hidden compliance and friction are those of floor and wall."""

    def __init__(self, rig: Rig) -> None:
        nominal = rig.nominal
        travel, airframe = nominal["rig"], nominal["airframe"]
        self.low = np.array([travel["travel_x"][0], travel["travel_z"][0]])[:, None]
        self.high = np.array([travel["travel_x"][1], travel["travel_z"][1]])[:, None]
        falling = airframe["mass"] + travel["slider_mass"]
        self.mass = np.array([[falling + travel["carriage_mass"]], [falling]])
        self.inertia = float(airframe["inertia"])
        self.half_length = rig.half_length
        self.reach = np.array([[-self.half_length], [self.half_length]])
        self.stiffness = STIFFNESS * rig.hidden.get("contact.compliance", "stiffness")
        self.damping = DAMPING * rig.hidden.get("contact.compliance", "damping")
        self.rub = FRICTION * rig.hidden.get("contact.friction", "gain")

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
        on = np.where(under > 0, np.maximum(STIFFNESS * under - DAMPING * rates, 0.0), 0.0)
        return self.mass * (on - back)

    def add_to_tips(
        self, force: np.ndarray, position: np.ndarray, velocity: np.ndarray, sine: np.ndarray, cosine: np.ndarray
    ) -> None:
        """Add what floor and wall do to the craft's arm tips to `force`, N and N m about the hinge. (3, flights)."""
        along = self.reach * cosine, self.reach * sine  # (2, flights): of the tips from the hinge
        lever = {X: -along[1], Z: along[0]}  # of forces along x and z
        rates = {axis: velocity[axis] + lever[axis] * velocity[PITCH] for axis in (X, Z)}
        depths = position[X] + along[0] + TIP_RADIUS - WALL, TIP_RADIUS - (position[Z] + along[1])
        for into, across, side, depth in ((X, Z, -1.0, depths[X]), (Z, X, 1.0, depths[Z])):
            if not (depth > 0).any():
                continue
            # What one newton into the wall or along it accelerates the tip by, m/s^2.
            own, other = (1 / self.mass[i] + lever[i] ** 2 / self.inertia for i in (into, across))
            mixed = side * lever[into] * lever[across] / self.inertia
            wanted = self.stiffness * depth - side * self.damping * rates[into]
            braked = -self.damping * rates[across]
            push = (other * wanted - mixed * braked) / (own * other - mixed**2)
            rub = (braked - mixed * push) / other
            slides = np.abs(rub) > self.rub * push  # then as much as friction gives, which pushes into the wall, too
            slid = np.sign(rub) * self.rub
            push = np.where(slides, wanted / np.maximum(own + slid * mixed, 0.2 * own), push)
            push = np.where(depth > 0, np.maximum(push, 0.0), 0.0)
            rub = np.where(slides, slid * push, np.where(push > 0, rub, 0.0))
            force[into] += side * push.sum(0)
            force[across] += rub.sum(0)
            force[PITCH] += (lever[into] * side * push + lever[across] * rub).sum(0)
