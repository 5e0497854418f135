"""The poses of the last policy steps, as an explicit state: what a late motion capture still has to show."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vpptwin.effects import Effect
from vpptwin.engine.arrays import Array, beside, library
from vpptwin.twin.state import RowArrays


@dataclass(frozen=True)
class SensorState(RowArrays):
    """Poses and velocities of the last policy steps, of N simulations."""

    pose: np.ndarray  # ring of x, z, θ, (N, depth, 3) m, m, rad; no entries when no pose comes late
    velocity: np.ndarray  # ring of v_x, v_z, q, (N, depth, 3) m/s, m/s, rad/s
    newest: np.ndarray  # index of the last one, (N,)

    @property
    def depth(self) -> int:
        """Entries of the ring."""
        return int(self.pose.shape[1])


def history_depth(effects: Iterable[Effect], period: float, horizon: float) -> int:
    """Entries that a ring needs for any parameters within their bounds; 0 when no effect makes poses late.

    Args:
        effects: that are switched on.
        period: between entries [s].
        horizon: longest time since the start of the log [s].
    """
    longest = 0.0
    for effect in effects:
        if "pose.delay" in effect.writes:
            longest += max(p.high for p in effect.parameters)
        if "pose.drift" in effect.writes:
            longest += max(p.high for p in effect.parameters) * horizon
    return math.ceil(longest / period - 1e-9) + 1 if longest > 0.0 else 0


def start_sensors(pose: Array, velocity: Array, depth: int, period: float) -> SensorState:
    """A state as if the craft had come here in a straight line at constant speed.

    Args:
        pose: x, z, θ now, (N, 3) m, m, rad.
        velocity: v_x, v_z, q, (N, 3) m/s, m/s, rad/s.
        depth: entries of the ring.
        period: between them [s].
    """
    xp, back = library(pose), beside(pose, period * np.arange(depth)[::-1])
    track = pose[:, None] - back[:, None] * velocity[:, None]
    newest = xp.zeros_like(pose[:, 0], dtype=xp.int64) + max(depth - 1, 0)
    return SensorState(track, xp.zeros_like(track) + velocity[:, None], newest)


def record_poses(state: SensorState, pose: Array, velocity: Array) -> None:
    """Take down the present pose and velocity, (N, 3) each, in place of the oldest."""
    if state.depth:
        state.newest[:] = (state.newest + 1) % state.depth
        rows = library(pose).arange(len(pose), device=pose.device)
        state.pose[rows, state.newest], state.velocity[rows, state.newest] = pose, velocity


def look_back(state: SensorState, age: Array, period: float) -> tuple[Array, Array]:
    """Pose and velocity as they were some time ago: the cubic through neighbouring entries and their velocities.

    In smooth flight poses are off by at most h⁴/384, velocities by h³/125 of the pose's fourth time derivative, with h
    the period. For the nominal craft at full throttle (20 m/s², 300 rad/s², servos of 20 ms) that is 1.3 µm, 0.02 mrad
    and 0.4 mm/s at 100 Hz, a hundredth of the sensors' noise. At whole periods it is exact.

    Args:
        state: whose newest entry is the present; with at least one entry.
        age: s, (N,); less than 0 counts as 0, more than the ring holds as its oldest entry.
        period: between entries [s].

    Returns:
        Pose (N, 3) m, m, rad and velocity (N, 3) m/s, m/s, rad/s.
    """
    xp, depth = library(age), state.depth
    rows, steps = xp.arange(len(age), device=age.device), (age / period).clip(0.0, depth - 1.0)
    whole = xp.asarray(steps, dtype=xp.int64).clip(max=max(depth - 2, 0))
    newer, older = (state.newest - whole) % depth, (state.newest - (whole + 1).clip(max=depth - 1)) % depth
    (p_0, v_0), (p_1, v_1) = ((state.pose[rows, at], state.velocity[rows, at]) for at in (newer, older))
    u = (steps - whole)[:, None]
    rest = 1.0 - u
    # Cubic Hermite interpolation, x(u) = h_00 p_0 + h_01 p_1 + h (h_10 v_0 + h_11 v_1), a share u of the way back.
    pose = (1.0 + 2.0 * u) * rest * rest * p_0 + u * u * (3.0 - 2.0 * u) * p_1
    velocity = rest * (1.0 - 3.0 * u) * v_0 + u * (3.0 * u - 2.0) * v_1
    return pose + period * u * rest * (u * v_1 - rest * v_0), velocity + 6.0 * u * rest * (p_0 - p_1) / period
