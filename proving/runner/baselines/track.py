"""A flight as an engineer would prepare it for a fit: smoothed motion and the thrust that the nominal rotors make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter, medfilt, savgol_filter

from vpptwin.logs.flight import Flight
from vpptwin.robots.planar_drone.vehicle import load_vehicle

RATE, STEP = 100.0, 0.001
"""Of the smoothed motion [Hz] and of the commands [s]."""
SMOOTHED = 11
"""Samples that a cubic is fitted to: 0.1 s."""
VEHICLE = load_vehicle()


@dataclass(frozen=True)
class Track:
    """One flight on even grids.

    Attributes:
        time: (n,) s, 100 Hz.
        pose: x, z, θ measured, (n, 3) m, m, rad, gaps filled and single outliers removed.
        smooth: the same smoothed, (n, 3).
        velocity, accel: its derivatives, (n, 3).
        fast: (m,) s, 1 kHz.
        command: blade pitch commanded, (m, 2) rad.
        speed: rotor speed measured, (m, 2) rad/s.
        thrust: of each rotor by the nominal twin, (m, 2) N.
    """

    time: np.ndarray
    pose: np.ndarray
    smooth: np.ndarray
    velocity: np.ndarray
    accel: np.ndarray
    fast: np.ndarray
    command: np.ndarray
    speed: np.ndarray
    thrust: np.ndarray

    def at(self, time: np.ndarray, series: np.ndarray) -> np.ndarray:
        """A fast series at other times, (len(time), k)."""
        return np.stack([np.interp(time, self.fast, column) for column in series.T], axis=1)

    def motion_at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smoothed pose and velocity at other times, (len(time), 3) each."""
        spline = make_interp_spline(self.time, self.smooth, k=3)
        return spline(time), spline.derivative()(time)


def prepare_track(flight: Flight) -> Track:
    """Smooth a flight and work out its nominal thrust."""
    pose, command, rotor = (flight.streams[t] for t in ("/mocap/pose", "/rotor/command", "/rotor/state"))
    start, end = max(s.time[0] for s in (pose, command, rotor)), min(s.time[-1] for s in (pose, command, rotor))
    time, fast = np.arange(start, end, 1.0 / RATE), np.arange(start, end, STEP)
    measured = np.stack([pose["x"], pose["z"], np.unwrap(pose["theta"])], axis=1)
    even = np.stack([np.interp(time, pose.time, mend(column)) for column in measured.T], axis=1)
    smooth, velocity, accel = (
        savgol_filter(even, SMOOTHED, 3, deriv=order, delta=1.0 / RATE, axis=0) for order in range(3)
    )
    blade = np.stack([np.interp(fast, command.time, column) for column in command["blade_pitch"].T], axis=1)
    speed = np.stack([np.interp(fast, rotor.time, column) for column in rotor["speed"].T], axis=1)
    keep = np.exp(-STEP / VEHICLE.servo.time_constant)
    lagged = lfilter([0.0, 1.0 - keep], [1.0, -keep], blade, axis=0, zi=blade[:1] * keep)[0]
    return Track(time, even, smooth, velocity, accel, fast, blade, speed, VEHICLE.rotor.k_t * speed * lagged)


def mend(column: np.ndarray) -> np.ndarray:
    """Samples far from their neighbours' median replaced by it."""
    usual = medfilt(column, 5)
    usual[:2], usual[-2:] = column[:2], column[-2:]
    off = np.abs(column - usual)
    return np.where(off > 10.0 * max(float(np.median(off)), 1e-4), usual, column)
