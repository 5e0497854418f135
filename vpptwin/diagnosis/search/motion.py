"""The motion that is likeliest with a twin: windows are linearised about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Track
from vpptwin.diagnosis.search.likelihood import (
    Response,
    likeness_of_gusts,
    measure_response,
    middles_of_segments,
    tune_gust,
)
from vpptwin.inference.covariance import factor, solve

FOLLOWED, SETTLED = 5, 0.1
"""Times at most that windows are followed, and drop in a window's cost below which they have been."""
BRIEFLY, STRIDES, ENOUGH = 3, 3, 0.01
"""Where disturbances are assumed: times that responses are measured, steps that one serves for, and share of the cost
whose drop is enough to go on."""


def spread_gusts(bench: Bench, gust: np.ndarray) -> np.ndarray:
    """Factors of the prior of every window's pulses in units of what is assumed, (K, segments nv, segments nv).

    Args:
        bench: K windows.
        gust: strength of the pulses as a multiple of what is assumed, (nv,).
    """
    alike = likeness_of_gusts(bench, middles_of_segments(bench))
    root = factor(alike + 1e-9 * np.eye(bench.segments))
    size = bench.segments * bench.spec.model.nv
    return np.einsum("kij,ab->kiajb", root, np.diag(gust)).reshape(len(alike), size, size)


@dataclass(frozen=True)
class Path:
    """Starting states and pulses of K windows in units of their prior, (K, 2 nv + segments nv), and as a track.

    Attributes:
        bench: the windows.
        response: of the twin to them.
        spread: of pulses, see `spread_gusts`.
    """

    bench: Bench
    response: Response
    spread: np.ndarray

    def measure(self, track: Track) -> np.ndarray:
        """A track in those units."""
        started = np.concatenate([track.pose, track.velocity], axis=1) / self.response.state_std
        pushed = (track.push / self.response.assumed).reshape(len(started), -1, 1)
        return np.concatenate([started, np.linalg.solve(self.spread, pushed)[..., 0]], axis=1)

    def place(self, found: np.ndarray) -> Track:
        """The track of such values."""
        nv = self.bench.spec.model.nv
        state = found[:, : 2 * nv] * self.response.state_std
        push = np.einsum("kpq,kq->kp", self.spread, found[:, 2 * nv :]).reshape(len(found), -1, nv)
        return Track(state[:, :nv], state[:, nv:], push * self.response.assumed)

    def step(self, missed: np.ndarray, at: np.ndarray | float = 0.0, damping: np.ndarray | float = 0.0) -> np.ndarray:
        """The likeliest path by the response, of a twin that without a track misses so much, (K, M)."""
        response, held = self.response, np.broadcast_to(damping, len(missed))[:, None]
        columns = np.concatenate([response.state * response.state_std, response.push @ self.spread], axis=2)
        columns /= self.bench.std[..., None]
        turned = np.swapaxes(columns, 1, 2)
        gram = turned @ columns + (1.0 + held[..., None]) * np.eye(columns.shape[2])
        target = turned @ (missed / self.bench.std)[..., None]
        goal = target + (held * at)[..., None]
        return solve(gram, goal)[..., 0]  # of a twin that runs away rounding leaves nothing of the prior

    def cost(self, missed: np.ndarray, found: np.ndarray) -> np.ndarray:
        """Square of what is missed about a path, (K, M), and of the path, both in units of their prior, (K,)."""
        return ((missed / self.bench.std) ** 2).sum(axis=1) + (found**2).sum(axis=1)


def find_track(bench: Bench, values: Mapping[Key, float]) -> Track | None:
    """The likeliest motion of a twin in angles, about which windows are linear; None where it stays near without."""
    robot = bench.spec.robot
    strays = robot.disturbance.known or any(dof + 3 not in robot.driven for dof in robot.afloat)
    return follow_motion(bench, values).of(robot.rotary, robot.rotary) if strays else None


def follow_motion(bench: Bench, values: Mapping[Key, float], gust: np.ndarray | None = None) -> Track:
    """The likeliest starting states and force pulses of every window of a twin with `values`, by Gauss-Newton.

    Whether a slider sticks depends on the forces upon it, and those on angles that in a third of a second stray by
    degrees from what was measured: linearised about what happened, dry friction is told from noise. To first order a
    track changes no likelihood, whatever it is (an iterated Kalman smoother's step).

    Args:
        bench: the windows, and where to begin.
        values: of the twin.
        gust: strength of the pulses as a multiple of what is assumed, (nv,); None for the likeliest.
    """
    nv, count = bench.spec.model.nv, len(bench.windows)
    none = Track(np.zeros((count, nv)), np.zeros((count, nv)), np.zeros((count, bench.segments, nv)))
    track = bench.track or none
    bench = bench.about(track)
    response, missed = measure_response(bench, values), bench.residual(values)
    gust = tune_gust(bench, response, response.restore(missed, track)) if gust is None else gust
    path = Path(bench, response, spread_gusts(bench, gust))
    at = path.measure(track)
    best, damping = path.cost(missed, at), np.zeros(count)
    turns, strides = (BRIEFLY, STRIDES) if bench.guessed else (FOLLOWED, 1)

    def settled(before: float) -> bool:
        """Whether the cost has hardly fallen since."""
        now = float(best.sum())
        return before - now < max(count * SETTLED, ENOUGH * now * bench.guessed)

    for turn in range(turns):
        begun = float(best.sum())
        if turn:
            path = replace(path, response=measure_response(bench, values))
        for _ in range(strides):
            before = float(best.sum())
            found = path.step(path.response.restore(missed, track), at, damping)
            there = bench.about(path.place(found)).residual(values)
            cost = path.cost(there, found)
            better = cost < best
            damping = np.where(better, damping / 10.0, np.maximum(4.0 * damping, 1.0))
            best, kept = np.where(better, cost, best), better[:, None]
            missed, at = np.where(kept, there, missed), np.where(kept, found, at)
            bench.track = track = path.place(at)
            if settled(before):
                break
        if settled(begun):
            break
    return track
