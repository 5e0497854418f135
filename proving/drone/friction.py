"""Dry friction that really sticks.

Karnopp's law in the limit of a vanishing velocity band: a joint at rest stays exactly at rest while the other forces
are below breakaway, and a joint that comes to rest within a step is stopped where its velocity crosses zero.
"""

from __future__ import annotations

import numpy as np

from .rig import PITCH, Rig, X, Z


class DryFriction:
    """Friction levels of the three joints."""

    def __init__(self, rig: Rig) -> None:
        hidden = rig.hidden
        self.rig = rig
        kinds = "rail_x.stiction rail_z.stiction rail_x.jamming rail_z.jamming rail_x.tight_spot form.stribeck"
        self.active = bool(rig.coulomb.any()) or hidden.any(*kinds.split())
        self.pointed = bool(rig.pointed.any())
        self.stribeck = bool(rig.stiction.any())
        self.lopsided = bool(rig.friction_asymmetry.any())
        self.jamming = hidden.any("rail_x.jamming", "rail_z.jamming")
        self.mu_x, self.mu_z = hidden.get("rail_x.jamming", "mu"), hidden.get("rail_z.jamming", "mu")
        self.tight = hidden.any("rail_x.tight_spot")
        self.spot = [hidden.get("rail_x.tight_spot", name) for name in ("force", "place", "width")]

    def compute_levels(self, position: np.ndarray, velocity: np.ndarray, side_load: np.ndarray | None) -> tuple:
        """Compute sliding and breakaway friction.

        Args:
            position: x m, z m, theta rad. (3, flights).
            velocity: Its rate. (3, flights).
            side_load: Horizontal force between guide and slider, N. (flights,), None without jamming.

        Returns:
            Sliding and breakaway friction, N or N m. Both (3, flights).
        """
        sliding = self.rig.coulomb
        if self.jamming or self.tight:
            sliding = sliding.copy()
        if self.jamming and side_load is not None:
            load = np.abs(side_load)
            lever = np.abs(position[Z] - self.rig.rail_height) / self.rig.bearing_spacing
            sliding[X] += self.mu_x * load * lever
            sliding[Z] += self.mu_z * load
        if self.tight:
            force, place, width = self.spot
            sliding[X] += force * np.exp(-(((position[X] - place) / width) ** 2))
        if not self.stribeck:
            return sliding, sliding
        fall = (velocity / self.rig.stribeck) ** 2
        if self.pointed:
            fall[X] = np.where(self.rig.pointed, np.sqrt(fall[X]), fall[X])
        extra = self.rig.stiction * np.exp(-fall)
        return sliding + extra, sliding + self.rig.stiction

    def orient(self, level: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Scale friction by the direction of motion (asymmetry)."""
        return level * (1 + self.rig.friction_asymmetry * direction) if self.lopsided else level


def settle(push: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Acceleration of a joint at rest: none while the push is below the friction level."""
    return np.sign(push) * np.maximum(np.abs(push) - level, 0.0)


def advance_velocity(
    velocity: np.ndarray, push: np.ndarray, sliding: np.ndarray, breakaway: np.ndarray, step: float
) -> np.ndarray:
    """Advance velocities over one step of constant push.

    Args:
        velocity: At the start of the step. (3, flights).
        push: Acceleration by everything but dry friction. (3, flights).
        sliding: Friction over mass while moving. (3, flights).
        breakaway: Friction over mass at rest. (3, flights).
        step: s.

    Returns:
        Velocity at the end. (3, flights).
    """
    accel = push - np.sign(velocity) * sliding
    after = velocity + step * accel
    turned = after * velocity <= 0.0
    turned[PITCH] &= sliding[PITCH] > 0.0
    if not turned.any():
        return after
    moving = turned & (velocity != 0.0)
    rest = np.full_like(velocity, step)  # time left once the joint has come to rest
    rest[moving] += velocity[moving] / accel[moving]
    return np.where(turned, np.maximum(rest, 0.0) * settle(push, breakaway), after)
