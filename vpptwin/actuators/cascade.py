"""Rate loop and allocation: from a thrust and rate command to the thrusts of two rotors (SPEC 2)."""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.blade import max_thrust
from vpptwin.vehicle import Vehicle


def filter_gyro(vehicle: Vehicle, filtered: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """One inner step of the gyro low-pass, (N,) rad/s."""
    return filtered + vehicle.control.gyro_filter * (rate - filtered)


def compute_torque(
    vehicle: Vehicle, rate_command: np.ndarray, filtered: np.ndarray, previous: np.ndarray, dt: float
) -> np.ndarray:
    """PD on angular rate: torque command [N m], positive for positive q̇, from filtered rates [rad/s] one step apart."""
    slope = (filtered - previous) / dt
    return vehicle.control.rate_kp * (rate_command - filtered) - vehicle.control.rate_kd * slope


def allocate(vehicle: Vehicle, thrust: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Rotor thrusts f_1,2 = f/2 ∓ τ/(2 l) within what a rotor can give, (N, 2) N; rate control wins over thrust.

    Args:
        vehicle: nominal numbers.
        thrust: total thrust f, (N,) N.
        torque: torque τ, positive for positive q̇, (N,) N m.
    """
    limit = max_thrust(vehicle.rotor)
    difference = np.clip(torque / (2.0 * vehicle.airframe.half_length), -limit, limit)
    room = limit - np.abs(difference)
    common = np.clip(0.5 * thrust, -room, room)
    return np.stack([common - difference, common + difference], axis=1)
