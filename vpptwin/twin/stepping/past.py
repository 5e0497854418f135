"""The poses of the last policy steps, as an explicit state: what a late motion capture still has to show."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

import numpy as np
from numba import njit

from vpptwin.actuators.numbers import Number
from vpptwin.effects import Effect
from vpptwin.engine.arrays import Array, beside, library
from vpptwin.engine.compile import can_keep, compilable


@dataclass(frozen=True)
class SensorState:
    """Poses and velocities of the last policy steps, of N simulations."""

    pose: np.ndarray  # ring of x, z, θ, (N, depth, 3) m, m, rad; no entries when no pose comes late
    velocity: np.ndarray  # ring of v_x, v_z, q, (N, depth, 3) m/s, m/s, rad/s
    newest: np.ndarray  # index of the last one, (N,)

    @property
    def depth(self) -> int:
        """Entries of the ring."""
        return int(self.pose.shape[1])

    def arrays(self) -> dict[str, np.ndarray]:
        """Every array by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> SensorState:
        """The state of which `arrays()` gave these arrays; copies."""
        return cls(**{f.name: arrays[f.name].copy() for f in fields(cls)})

    def take(self, ids: np.ndarray | slice) -> SensorState:
        """The rows `ids` as a state of their own (a copy), or those of a slice (a view)."""
        return SensorState(self.pose[ids], self.velocity[ids], self.newest[ids])

    def write_rows(self, ids: np.ndarray, rows: SensorState) -> None:
        """Put `rows`, which has len(ids) rows, in place of the rows `ids` of this very state."""
        for f in fields(self):
            getattr(self, f.name)[ids] = getattr(rows, f.name)


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


def record_poses(state: SensorState, pose: np.ndarray, velocity: np.ndarray) -> None:
    """Take down the present pose and velocity, (N, 3) each, in place of the oldest."""
    if library(pose) is not np:
        state.newest[:] = (state.newest + 1) % max(state.depth, 1)
        rows = library(pose).arange(len(pose), device=pose.device)
        if state.depth:
            state.pose[rows, state.newest], state.velocity[rows, state.newest] = pose, velocity
    elif state.depth:
        _record_poses(state.pose, state.velocity, state.newest, pose, velocity)


@njit(cache=can_keep())
def _record_poses(
    poses: np.ndarray, velocities: np.ndarray, newest: np.ndarray, pose: np.ndarray, velocity: np.ndarray
) -> None:
    for i in range(len(newest)):
        newest[i] = (newest[i] + 1) % poses.shape[1]
        for j in range(3):
            poses[i, newest[i], j] = pose[i, j]
            velocities[i, newest[i], j] = velocity[i, j]


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
    if library(age) is not np:
        return _look_back_at_once(state, age, period)
    pose, velocity = np.empty((len(age), 3)), np.empty((len(age), 3))
    _look_back(state.pose, state.velocity, state.newest, age, period, pose, velocity)
    return pose, velocity


@njit(cache=can_keep())
def _look_back(
    poses: np.ndarray, velocities: np.ndarray, newest: np.ndarray, age: np.ndarray, period: float,
    pose: np.ndarray, velocity: np.ndarray,
) -> None:  # fmt: skip
    depth = poses.shape[1]
    for i in range(len(newest)):
        steps = min(max(age[i] / period, 0.0), depth - 1.0)
        whole = min(int(steps), max(depth - 2, 0))
        newer, older = (newest[i] - whole) % depth, (newest[i] - min(whole + 1, depth - 1)) % depth
        u = steps - whole
        for j in range(3):
            p_0, p_1, v_0, v_1 = (
                poses[i, newer, j],
                poses[i, older, j],
                velocities[i, newer, j],
                velocities[i, older, j],
            )
            pose[i, j], velocity[i, j] = _interpolate(p_0, p_1, v_0, v_1, u, period)


@compilable()
def _interpolate(p_0: Number, p_1: Number, v_0: Number, v_1: Number, u: Number, period: float) -> tuple[Number, Number]:
    """The cubic through a newer and an older pose with their velocities, a share `u` of the way back."""
    rest = 1.0 - u
    pose = (1.0 + 2.0 * u) * rest * rest * p_0 + u * u * (3.0 - 2.0 * u) * p_1
    velocity = rest * (1.0 - 3.0 * u) * v_0 + u * (3.0 * u - 2.0) * v_1
    return pose + period * u * rest * (u * v_1 - rest * v_0), velocity + 6.0 * u * rest * (p_0 - p_1) / period


def _look_back_at_once(state: SensorState, age: Number, period: float) -> tuple[Number, Number]:
    """`look_back` in tensors."""
    depth, rows = state.depth, library(age).arange(len(age), device=age.device)
    steps = (age / period).clip(0.0, depth - 1.0)
    whole = steps.long().clip(max=max(depth - 2, 0))
    newer, older = (state.newest - whole) % depth, (state.newest - (whole + 1).clip(max=depth - 1)) % depth
    (p_0, v_0), (p_1, v_1) = ((state.pose[rows, at], state.velocity[rows, at]) for at in (newer, older))
    return _interpolate(p_0, p_1, v_0, v_1, (steps - whole)[:, None], period)
