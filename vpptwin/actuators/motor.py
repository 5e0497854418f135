"""Motor and speed governor of a rotor (paper Eq. 6 and section "Adaptive Actuator Controller")."""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.blade import compute_drag_torque
from vpptwin.vehicle import Motor, Rotor

GOVERNOR_KP = 0.08
"""Speed feedback [V s/rad]; the paper gives none, this holds 4500 rpm within 2 % through full pitch steps."""
GOVERNOR_KI = 0.5
"""Integral speed feedback [V/rad]."""


def compute_current(motor: Motor, voltage: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Motor current i = (V - ω/k_V)/R [A] (paper Eq. 7)."""
    return (voltage - speed / motor.k_v) / motor.resistance


def step_speed(
    motor: Motor, rotor: Rotor, speed: np.ndarray, pitch: np.ndarray, voltage: np.ndarray, dt: float
) -> np.ndarray:
    """Rotor speed [rad/s] after dt [s]: I ω̇ = (i - i_0)/k_Q - D (paper Eq. 6), voltage [V] held."""
    torque = (compute_current(motor, voltage, speed) - motor.no_load_current) / motor.k_q
    return np.maximum(speed + dt * (torque - compute_drag_torque(rotor, speed, pitch)) / rotor.inertia, 0.0)


def hold_speed(
    motor: Motor, rotor: Rotor, speed: np.ndarray, pitch_command: np.ndarray, integral: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Governor: feed-forward from the drag map at the commanded pitch plus PI feedback on measured speed.

    Args:
        motor: motor constants.
        rotor: propeller constants.
        speed: measured rotor speed, (N, 2) rad/s.
        pitch_command: commanded blade pitch, (N, 2) rad.
        integral: integral of the speed error, (N, 2) rad.
        dt: inner step, s.

    Returns:
        Throttle (N, 2) in 0..1 of the nominal battery voltage, and the new integral (held while saturated).
    """
    target = np.full_like(speed, rotor.speed)
    drag = compute_drag_torque(rotor, target, pitch_command)
    feed_forward = target / motor.k_v + motor.resistance * (motor.no_load_current + motor.k_q * drag)
    error = target - speed
    grown = integral + dt * error
    throttle = (feed_forward + GOVERNOR_KP * error + GOVERNOR_KI * grown) / motor.battery
    saturated = (throttle < 0.0) | (throttle > 1.0)
    return np.clip(throttle, 0.0, 1.0), np.where(saturated, integral, grown)
