"""Propeller with variable pitch: thrust, drag torque and the pitch that gives a wanted thrust."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from vpptwin.actuators.numbers import Number, RotorNumbers


@register_jitable
def compute_thrust(rotor: RotorNumbers, speed: Number, pitch: Number) -> Number:
    """Thrust T = k_T ω α [N] (paper Eq. 4) at speed [rad/s] and blade pitch [rad]; negative below zero pitch."""
    return rotor.k_t * speed * pitch


@register_jitable
def compute_drag_torque(rotor: RotorNumbers, speed: Number, pitch: Number) -> Number:
    """Drag torque D = k_D1 ω² + k_D2 ω² α² + k_D3 ω |α| [N m] (paper Eq. 5).

    With |α| where the paper has α: drag also grows at negative pitch.
    """
    return speed * (rotor.k_d1 * speed + rotor.k_d2 * speed * pitch * pitch + rotor.k_d3 * np.abs(pitch))


@register_jitable
def pitch_for_thrust(rotor: RotorNumbers, thrust: Number) -> Number:
    """Blade pitch [rad] that gives `thrust` [N] at the governed speed, within the pitch stops."""
    return np.minimum(np.maximum(thrust / (rotor.k_t * rotor.speed), -rotor.pitch_max), rotor.pitch_max)


@register_jitable
def max_thrust(rotor: RotorNumbers) -> float:
    """Thrust of one rotor at the pitch stop and governed speed [N]."""
    return rotor.k_t * rotor.speed * rotor.pitch_max
