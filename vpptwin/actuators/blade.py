"""Propeller with variable pitch: thrust, drag torque and the pitch that gives a wanted thrust."""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.numbers import Number, RotorNumbers
from vpptwin.engine.compile import compilable

NEWTON = 4
"""Steps from the straight line to the pitch that a bent map asks for."""


@compilable()
def is_straight(rotor: RotorNumbers) -> bool:
    """Whether the map is the paper's T = k_T ω α."""
    return rotor.k_t2 == 0.0 and rotor.k_t3 == 0.0 and rotor.inflow == 0.0 and rotor.thrust_power == 1.0


@compilable()
def shape_thrust(k_t: Number, k_t2: Number, k_t3: Number, inflow: Number, pitch: Number) -> Number:
    """Thrust per speed at blade pitch α [rad], N s/rad.

    A polynomial in |α| that is odd in α, or, with inflow q, blade elements with momentum theory: √s solves
    x² + q x = k_T |α|, as C_T = σa/2 (θ/3 - √(C_T/2)/2) has it.
    """
    size = np.abs(pitch)
    if inflow > 0.0:
        x = 0.5 * (np.sqrt(inflow * inflow + 4.0 * k_t * size) - inflow)
        return np.sign(pitch) * x * x
    return pitch * (k_t + size * (k_t2 + size * k_t3))


@compilable()
def compute_thrust(rotor: RotorNumbers, speed: Number, pitch: Number) -> Number:
    """Thrust [N] at speed [rad/s] and blade pitch [rad]; negative below zero pitch.

    T = k_T ω α (paper Eq. 4), or one of the other maps of `vpptwin.robots.planar_drone.vehicle.Propeller`.
    """
    if is_straight(rotor):
        return rotor.k_t * speed * pitch
    scale = speed * (speed / rotor.speed) ** (rotor.thrust_power - 1.0)
    return scale * shape_thrust(rotor.k_t, rotor.k_t2, rotor.k_t3, rotor.inflow, pitch)


@compilable()
def compute_drag_torque(rotor: RotorNumbers, speed: Number, pitch: Number) -> Number:
    """Drag torque D = k_D1 ω² + k_D2 ω² α² + k_D3 ω |α| [N m] (paper Eq. 5).

    With |α| where the paper has α: drag also grows at negative pitch.
    """
    return speed * (rotor.k_d1 * speed + rotor.k_d2 * speed * pitch * pitch + rotor.k_d3 * np.abs(pitch))


@compilable()
def pitch_for_thrust(rotor: RotorNumbers, thrust: Number) -> Number:
    """Blade pitch [rad] that gives `thrust` [N] at the governed speed, within the pitch stops."""
    wanted = thrust / rotor.speed
    if rotor.inflow > 0.0:
        x = np.sqrt(np.abs(wanted))
        pitch = np.sign(wanted) * (x * x + rotor.inflow * x) / rotor.k_t
    elif is_straight(rotor):
        pitch = thrust / (rotor.k_t * rotor.speed)
    else:
        pitch = wanted / rotor.k_t
        for _ in range(NEWTON):
            size = np.minimum(np.abs(pitch), rotor.pitch_max)
            bent = pitch * (rotor.k_t + size * (rotor.k_t2 + size * rotor.k_t3))
            pitch = pitch - (bent - wanted) / (rotor.k_t + size * (2.0 * rotor.k_t2 + 3.0 * size * rotor.k_t3))
    return np.minimum(np.maximum(pitch, -rotor.pitch_max), rotor.pitch_max)


@compilable()
def max_thrust(rotor: RotorNumbers) -> float:
    """Thrust of one rotor at the pitch stop and governed speed [N]."""
    return compute_thrust(rotor, rotor.speed, rotor.pitch_max)
