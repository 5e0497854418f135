"""Rate loop and allocation: from a thrust and rate command to the thrusts of two rotors (SPEC 2)."""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.blade import max_thrust
from vpptwin.actuators.numbers import Number, VehicleNumbers
from vpptwin.engine.compile import compilable


@compilable()
def filter_gyro(vehicle: VehicleNumbers, filtered: Number, rate: Number) -> Number:
    """One inner step of the gyro low-pass [rad/s]."""
    return filtered + vehicle.control.gyro_filter * (rate - filtered)


@compilable()
def compute_torque(
    vehicle: VehicleNumbers, rate_command: Number, filtered: Number, previous: Number, dt: float
) -> Number:
    """PD on angular rate: torque command [N m], positive for positive q̇, from filtered rates [rad/s] one step apart."""
    slope = (filtered - previous) / dt
    return vehicle.control.rate_kp * (rate_command - filtered) - vehicle.control.rate_kd * slope


@compilable()
def allocate(vehicle: VehicleNumbers, thrust: Number, torque: Number) -> tuple[Number, Number]:
    """Rotor thrusts f_1,2 = f/2 ∓ τ/(2 l) within what a rotor can give [N]; rate control wins over thrust.

    Args:
        vehicle: nominal numbers.
        thrust: total thrust f [N].
        torque: torque τ, positive for positive q̇ [N m].
    """
    limit = max_thrust(vehicle.rotor)
    difference = np.minimum(np.maximum(torque / (2.0 * vehicle.airframe.half_length), -limit), limit)
    room = limit - np.abs(difference)
    common = np.minimum(np.maximum(0.5 * thrust, -room), room)
    return common - difference, common + difference
