"""Whether a flight stayed where it may: off the stops, above the floor, slow enough."""

from __future__ import annotations

import numpy as np

from vpptwin.robots.planar_drone.vehicle import Vehicle

MARGIN = 0.03
"""A safe flight keeps this distance from the ends of both rails and, with its lower tip, from the floor [m]."""
FASTEST, FASTEST_TURN = 5.0, 20.0
"""Largest speed [m/s] and rate [rad/s] of a safe flight."""


def find_danger(vehicle: Vehicle, pose: np.ndarray, velocity: np.ndarray) -> str:
    """What was unsafe about a flight, "" if nothing was.

    Args:
        vehicle: whose rails and arms are meant.
        pose: true x, z, θ, (K, 3) m, m, rad.
        velocity: (K, 3) m/s, rad/s.
    """
    if not (np.isfinite(pose).all() and np.isfinite(velocity).all()):
        return "it diverges"
    travel = (vehicle.rig.travel_x, vehicle.rig.travel_z)
    for axis, name in enumerate(("x", "z")):
        nearest = min(float(pose[:, axis].min()) - travel[axis][0], travel[axis][1] - float(pose[:, axis].max()))
        if nearest < MARGIN:
            return f"it comes within {max(nearest, 0.0):.3f} m of the stops of {name}"
    tip = pose[:, 1] - vehicle.airframe.half_length * np.abs(np.sin(pose[:, 2]))
    if tip.min() < MARGIN:
        return f"an arm comes within {max(float(tip.min()), 0.0):.3f} m of the floor"
    speed, turn = float(np.hypot(*velocity[:, :2].T).max()), float(np.abs(velocity[:, 2]).max())
    if speed > FASTEST:
        return f"it reaches {speed:.1f} m/s"
    return f"it turns at {turn:.0f} rad/s" if turn > FASTEST_TURN else ""
