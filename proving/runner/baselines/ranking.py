"""Every effect of the catalogue fitted alone by least squares on the open-loop error; the lowest RMSE is blamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from proving.runner.baselines.track import STEP, VEHICLE, Track, prepare_track
from vpptwin.effects import Effect
from vpptwin.logs.flight import Flight
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.sensors import age_of_pose, measure_coordinate
from vpptwin.twin.spec import TwinSpec

LENGTH, EVERY = 0.5, 1.0
"""Of a window, and from one to the next [s]."""
WARM = 150
"""Past commands that the servos are run through before a window [ms]."""
ITERATIONS = 3
MATTERS = 0.05
"""Share of the RMSE that must go, or nothing is blamed."""


@dataclass(frozen=True)
class Stretches:
    """Windows: start time [s] (K,), warm and own commands (K, ., 2) rad, speed, start, and what was measured."""

    start: np.ndarray
    warm: np.ndarray
    command: np.ndarray
    speed: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray
    measured: np.ndarray  # x, z and θ times half the arm at 100 Hz after the start, (K, samples, 3) m


def name_by_ranking(flights: Sequence[Flight]) -> str:
    """The effect with the lowest error over all flights."""
    spec, stretches = load_twin(), cut_stretches([prepare_track(flight) for flight in flights])
    plain = float(np.sqrt(np.mean(Alone(spec, stretches, None).miss(np.zeros((1, 0))) ** 2)))
    errors = {effect.id: fit_alone(spec, stretches, effect) for effect in spec.catalogue}
    best = min(errors, key=lambda effect: errors[effect])
    return best if errors[best] < (1.0 - MATTERS) * plain else ""


def cut_stretches(tracks: Sequence[Track]) -> Stretches:
    """Windows of all flights, stacked."""
    parts = []
    steps, samples = round(LENGTH / STEP), round(LENGTH * 100)
    for track in tracks:
        ticks = np.arange(30, len(track.time) - samples - 1, round(EVERY * 100))
        first = np.searchsorted(track.fast, track.time[ticks] - 1e-9)
        warm = track.command[first[:, None] + np.arange(-WARM, 0)]
        run = first[:, None] + np.arange(steps)
        after = ticks[:, None] + np.arange(1, samples + 1)
        measured = track.pose[after] * np.array([1.0, 1.0, VEHICLE.airframe.half_length])
        now = track.smooth[ticks], track.velocity[ticks]
        parts.append((track.time[ticks], warm, track.command[run], track.speed[run], *now, measured))
    return Stretches(*(np.concatenate(columns) for columns in zip(*parts)))


class Alone:
    """A twin with one effect (or none) and its miss of the windows."""

    def __init__(self, spec: TwinSpec, stretches: Stretches, effect: Effect | None) -> None:
        self.spec, self.stretches, self.effect = spec, stretches, effect
        self.twins: dict[int, Twin] = {}

    def miss(self, values: np.ndarray) -> np.ndarray:
        """Predicted less measured, (V, K samples 3) m, for parameters (V, P)."""
        variations, s = len(values), self.stretches
        rows = variations * len(s.start)
        if variations not in self.twins:
            active = () if self.effect is None else (self.effect.id,)
            self.twins[variations] = Twin(self.spec, rows, active)
        twin = self.twins[variations]
        if self.effect is not None:
            keys = [(self.effect.id, p.name) for p in self.effect.parameters]
            twin.set_parameters(keys, np.repeat(values, len(s.start), axis=0))
        pose, velocity, start = (np.tile(a, (variations, 1)) for a in (s.pose, s.velocity, s.start[:, None]))
        begin = twin.initial_state(qpos=twin.pose_for_engine(pose, velocity), qvel=velocity, time=start[:, 0])
        layer = begin.actuators
        warm, command, speed = (np.tile(a, (variations, 1, 1)) for a in (s.warm, s.command, s.speed))
        layer["horn"] = layer["blade"] = warm[:, 0]
        layer["history"] = warm[:, :1]
        begin.actuators[:] = twin.warm_up(layer, warm)
        flown = twin.replay_commands(begin, command, speed)
        seen = self.show(twin, twin.pose_at_time(flown.qpos, flown.qvel), start)
        return (seen - np.tile(s.measured, (variations, 1, 1))).reshape(variations, -1)

    def show(self, twin: Twin, pose: np.ndarray, start: np.ndarray) -> np.ndarray:
        """What motion capture would have made of simulated poses (rows, steps, 3), every 10 ms, (rows, samples, 3)."""
        constants = twin.constants
        stamp = 0.01 * (np.arange(self.stretches.measured.shape[1]) + 1)
        late = np.stack([age_of_pose(constants, start[:, 0] + t) for t in stamp], axis=1)
        index = np.clip((stamp - late) / STEP - 1.0, 0.0, pose.shape[1] - 1.001)
        whole = index.astype(int)
        part = (index - whole)[..., None]
        rows = np.arange(len(pose))[:, None]
        then = (1.0 - part) * pose[rows, whole] + part * pose[rows, whole + 1]
        shown = [measure_coordinate(constants[:, None], axis, then[..., axis]) for axis in range(3)]
        return np.stack([*shown[:2], shown[2] * VEHICLE.airframe.half_length], axis=-1)


def fit_alone(spec: TwinSpec, stretches: Stretches, effect: Effect) -> float:
    """RMSE [m] with one effect's parameters fitted by Gauss-Newton from a small strength."""
    twin, parameters = Alone(spec, stretches, effect), effect.parameters
    low, high, size = (np.array([getattr(p, name) for p in parameters]) for name in ("low", "high", "size"))
    here = np.array([p.off for p in parameters])
    here[0] += 0.1 * size[0] if here[0] + size[0] <= high[0] else -0.1 * size[0]
    here = np.clip(here, low, high)
    best = np.inf
    for _ in range(ITERATIONS):
        step = np.where(here + 0.3 * size <= high, 0.3, -0.3) * size
        tried = np.clip(np.vstack([here, here + np.diag(step)]), low, high)
        missed = twin.miss(tried)
        best = min(best, float(np.sqrt(np.mean(missed[0] ** 2))))
        moved = np.diag(tried[1:] - here)
        columns = (missed[1:] - missed[0]) / np.where(moved == 0.0, 1.0, moved)[:, None] * size[:, None]
        ridge = 1e-9 * max(float((columns**2).sum()), 1e-30) * np.eye(len(here))
        here = np.clip(here - size * np.linalg.solve(columns @ columns.T + ridge, columns @ missed[0]), low, high)
    return min(best, float(np.sqrt(np.mean(twin.miss(here[None]) ** 2))))
