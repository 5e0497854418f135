"""Blade-pitch commands that nobody logged, from the policy's commands and the gyro through the believed rate loop."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from vpptwin.actuators.blade import pitch_for_thrust
from vpptwin.actuators.cascade import allocate, compute_torque, filter_gyro
from vpptwin.robots.planar_drone.vehicle import Vehicle

STALE = 0.05
"""A policy command older than this was followed by others that the log lacks, unless they come slower [s]."""
MAX_GYRO_GAP = 0.02
"""Longest gap in the gyro that is bridged by a line [s]: in a longer one the rate loop saw what the log lacks."""


def reconstruct_commands(
    vehicle: Vehicle, policy: tuple[np.ndarray, np.ndarray, np.ndarray], gyro: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Run the inner loop of the flight controller over logged policy commands and gyro samples.

    Args:
        vehicle: the believed numbers, which are those the craft flies on.
        policy: time [s], thrust [N] and rate [rad/s] of the policy's commands, (n,) each.
        gyro: time [s] and rate [rad/s] as measured, (m,) each.

    Returns:
        Time (k,) s and blade pitch (k, 2) rad, one inner step apart. Steps at which policy or gyro are unknown are
        left out, so that they show as gaps.
    """
    dt = 1.0 / vehicle.control.inner_rate
    time = lay_grid(gyro[0], dt)
    rate = np.interp(time, *gyro)
    filtered = np.fromiter(accumulate(rate.tolist(), lambda last, now: filter_gyro(vehicle, last, now)), float)
    before = np.concatenate([filtered[:1], filtered[:-1]])
    held = np.searchsorted(policy[0], time, side="right") - 1
    torque = compute_torque(vehicle, policy[2][held], filtered, before, dt)
    thrusts = allocate(vehicle, policy[1][held], torque)
    pitch = np.stack([pitch_for_thrust(vehicle.rotor, thrust) for thrust in thrusts], axis=1)
    known = (held >= 0) & (time - policy[0][held] <= max(STALE, 3.0 * float(np.median(np.diff(policy[0])))))
    following = np.clip(np.searchsorted(gyro[0], time), 1, len(gyro[0]) - 1)
    known &= gyro[0][following] - gyro[0][following - 1] <= MAX_GYRO_GAP
    return time[known], pitch[known]


def lay_grid(time: np.ndarray, dt: float) -> np.ndarray:
    """Instants about `dt` [s] apart that include the samples' own, (n,) s, or even ones if those are much closer."""
    steps = np.diff(time)
    if np.median(steps) < 0.75 * dt:
        return np.arange(time[0], time[-1], dt)
    index = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / dt), 1.0))])
    return np.interp(np.arange(index[-1] + 1.0), index, time)
