"""Motor and speed governor of a rotor (paper Eq. 6 and section "Adaptive Actuator Controller")."""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.blade import compute_drag_torque
from vpptwin.actuators.numbers import MotorNumbers, Number, RotorNumbers, choose
from vpptwin.engine.compile import compilable

GOVERNOR_KP = 0.08
"""Speed feedback [V s/rad]; the paper gives none, this holds 4500 rpm within 2 % through full pitch steps."""
GOVERNOR_KI = 0.5
"""Integral speed feedback [V/rad]."""


@compilable()
def compute_current(motor: MotorNumbers, voltage: Number, speed: Number) -> Number:
    """Motor current i = (V - ω/k_V)/R [A] (paper Eq. 7)."""
    return (voltage - speed / motor.k_v) / motor.resistance


@compilable()
def step_speed(
    motor: MotorNumbers, rotor: RotorNumbers, speed: Number, pitch: Number, voltage: Number, drag_gain: Number,
    dt: float,
) -> Number:  # fmt: skip
    """Rotor speed [rad/s] after dt [s] by the midpoint rule, voltage [V] held, at the mean blade pitch of the step.

    `drag_gain` multiplies the drag torque.
    """
    middle = speed + 0.5 * dt * accelerate_rotor(motor, rotor, speed, pitch, voltage, drag_gain)
    return np.maximum(speed + dt * accelerate_rotor(motor, rotor, middle, pitch, voltage, drag_gain), 0.0)


@compilable()
def accelerate_rotor(
    motor: MotorNumbers, rotor: RotorNumbers, speed: Number, pitch: Number, voltage: Number, drag_gain: Number
) -> Number:
    """Acceleration of a rotor [rad/s²]: I ω̇ = (i - i_0)/k_Q - D (paper Eq. 6)."""
    torque = (compute_current(motor, voltage, speed) - motor.no_load_current) / motor.k_q
    return (torque - drag_gain * compute_drag_torque(rotor, speed, pitch)) / rotor.inertia


@compilable()
def hold_speed(
    motor: MotorNumbers, rotor: RotorNumbers, speed: Number, pitch_command: Number, integral: Number, dt: float,
    drag_gain: Number = 1.0,
) -> tuple[Number, Number]:  # fmt: skip
    """Governor: feed-forward from the drag map at the commanded pitch plus PI feedback on measured speed.

    Args:
        motor: motor constants.
        rotor: propeller constants.
        speed: measured rotor speed [rad/s].
        pitch_command: commanded blade pitch, or where the blade is believed to be [rad].
        integral: integral of the speed error [rad].
        dt: inner step [s].
        drag_gain: drag torque over that of the map.

    Returns:
        Throttle in 0..1 of the nominal battery voltage, and the new integral (held while saturated).
    """
    # U = ω/k_V + R (i_0 + k_Q D), which holds ω̇ = 0 (paper Eq. 6 and 7), + k_p e + k_i ∫e.
    drag = drag_gain * compute_drag_torque(rotor, rotor.speed, pitch_command)
    feed_forward = rotor.speed / motor.k_v + motor.resistance * (motor.no_load_current + motor.k_q * drag)
    error = rotor.speed - speed
    grown = integral + dt * error
    throttle = (feed_forward + GOVERNOR_KP * error + GOVERNOR_KI * grown) / motor.battery
    clipped = np.minimum(np.maximum(throttle, 0.0), 1.0)
    return clipped, choose(throttle == clipped, grown, integral)
