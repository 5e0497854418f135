"""Propeller with variable pitch: thrust, drag torque and the pitch that gives a wanted thrust."""

from __future__ import annotations

import numpy as np

from vpptwin.vehicle import Rotor


def compute_thrust(rotor: Rotor, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Thrust T = k_T ω α [N] (paper Eq. 4) at speed [rad/s] and blade pitch [rad]; negative below zero pitch."""
    return rotor.k_t * speed * pitch


def compute_drag_torque(rotor: Rotor, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """Drag torque D = k_D1 ω² + k_D2 ω² α² + k_D3 ω |α| [N m] (paper Eq. 5).

    With |α| where the paper has α: drag also grows at negative pitch.
    """
    return speed * (rotor.k_d1 * speed + rotor.k_d2 * speed * pitch * pitch + rotor.k_d3 * np.abs(pitch))


def pitch_for_thrust(rotor: Rotor, thrust: np.ndarray) -> np.ndarray:
    """Blade pitch [rad] that gives `thrust` [N] at the governed speed, within the pitch stops."""
    return np.clip(thrust / (rotor.k_t * rotor.speed), -rotor.pitch_max, rotor.pitch_max)


def max_thrust(rotor: Rotor) -> float:
    """Thrust of one rotor at the pitch stop and governed speed [N]."""
    return rotor.k_t * rotor.speed * rotor.pitch_max
