"""The flight controller below the policy, as firmware runs it: rate loop, allocation, actuators; sensors go in.

One implementation, whoever runs it: training, `fly`, and what is exported.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vpptwin.actuators.adaptive import BLADE, DRAG, FAULT, NO_SPEED, SOUND, TRIM, correct_pitch, learn
from vpptwin.actuators.blade import max_thrust, pitch_for_thrust
from vpptwin.actuators.motor import hold_speed
from vpptwin.actuators.numbers import Number, VehicleNumbers
from vpptwin.engine.compile import compilable

Memory = Any
"""A record with `gyro`, `governor`, `throttle` and `adaptive` (see `vpptwin.actuators.layer.layer_dtype`)."""


@compilable()
def filter_gyro(vehicle: VehicleNumbers, filtered: Number, rate: Number) -> Number:
    """One inner step of the gyro low-pass [rad/s]."""
    return filtered + vehicle.control.gyro_filter * (rate - filtered)


@compilable()
def compute_torque(
    vehicle: VehicleNumbers, rate_command: Number, filtered: Number, previous: Number, dt: float
) -> Number:
    """PD on angular rate: torque command [N m], positive for positive q̇, from filtered rates [rad/s] one step apart."""
    # τ = kp (q_cmd - q) - kd q̇, the derivative of the measurement alone (Åström and Murray, Feedback Systems).
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


@compilable()
def run_cascade(
    vehicle: VehicleNumbers, memory: Memory, thrust: float, rate: float, turn: float, speed: tuple[float, float],
    current: tuple[float, float], dt: float,
) -> tuple[float, float]:  # fmt: skip
    """One inner step.

    Args:
        vehicle: the believed vehicle.
        memory: advances; the throttles of the rotors are left in `memory.throttle`.
        thrust: commanded by the policy [N].
        rate: likewise [rad/s].
        turn: what the gyro says [rad/s].
        speed: measured, of rotors 1 and 2 [rad/s].
        current: measured, likewise [A]; only the adaptive controller looks at it.
        dt: inner step [s].

    Returns:
        Blade-pitch commands of rotors 1 and 2 [rad].
    """
    before = memory.gyro
    memory.gyro = filter_gyro(vehicle, before, turn)
    torque = compute_torque(vehicle, rate, memory.gyro, before, dt)
    thrust_1, thrust_2 = allocate(vehicle, thrust, torque)
    pitch_1 = drive_rotor(vehicle, memory, 0, thrust_1, speed[0], current[0], dt)
    pitch_2 = drive_rotor(vehicle, memory, 1, thrust_2, speed[1], current[1], dt)
    return pitch_1, pitch_2


@compilable()
def drive_rotor(
    vehicle: VehicleNumbers, memory: Memory, i: int, thrust: float, speed: float, current: float, dt: float
) -> float:
    """Throttle, into `memory.throttle`, and blade-pitch command [rad] of rotor i for a thrust [N]."""
    pitch = pitch_for_thrust(vehicle.rotor, thrust)
    command, drag, blade = pitch, 1.0, pitch
    if memory.adaptive.shape[1] > 0:
        learned = memory.adaptive[i]
        learn(vehicle, learned, speed, current, memory.throttle[i], dt)
        command = correct_pitch(vehicle, learned, pitch)
        if learned[FAULT] == SOUND:
            drag, blade = learned[DRAG], learned[BLADE] + learned[TRIM]  # where it is, not where it is to be
        elif learned[FAULT] == NO_SPEED:
            speed = vehicle.rotor.speed  # no feedback
    throttle, integral = hold_speed(vehicle.motor, vehicle.rotor, speed, blade, memory.governor[i], dt, drag)
    memory.throttle[i] = throttle
    memory.governor[i] = integral
    return command
