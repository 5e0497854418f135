"""The motion that is likeliest with a twin: windows are linearised about it."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench, Key, Track
from vpptwin.diagnosis.search.likelihood import (
    gust_std,
    likeness_of_gusts,
    measure_response,
    middles_of_segments,
    tune_gust,
)

FOLLOWED, SETTLED = 5, 0.1
"""Times at most that windows are followed, and drop in a window's cost below which they have been."""


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
    bench, nv = copy(bench), bench.spec.model.nv
    count, pulses = len(bench.windows), bench.segments * nv
    if bench.track is None:
        zero = np.zeros((count, nv))
        bench.track = Track(zero, zero, np.zeros((count, bench.segments, nv)))
    response, missed = measure_response(bench, values), bench.residual(values)
    gust = tune_gust(bench, response, response.restore(missed)) if gust is None else gust
    alike = likeness_of_gusts(bench, middles_of_segments(bench))
    root = np.linalg.cholesky(alike + 1e-9 * np.eye(bench.segments))
    spread = np.einsum("kij,ab->kiajb", root, np.diag(gust)).reshape(count, pulses, -1)
    started = np.concatenate([bench.track.pose, bench.track.velocity], axis=1) / response.state_std
    pushed = np.linalg.solve(spread, (bench.track.push / gust_std(bench)).reshape(count, -1, 1))[..., 0]
    at, one = np.concatenate([started, pushed], axis=1), np.eye(2 * nv + pulses)

    def place(found: np.ndarray) -> Track:
        state, push = found[:, : 2 * nv] * response.state_std, np.einsum("kpq,kq->kp", spread, found[:, 2 * nv :])
        return Track(state[:, :nv], state[:, nv:], push.reshape(count, -1, nv) * gust_std(bench))

    best, damping = ((missed / bench.std) ** 2).sum(axis=1) + (at**2).sum(axis=1), np.zeros(count)
    for turn in range(FOLLOWED):
        if turn:
            response, missed = measure_response(bench, values), bench.residual(values)
        columns = np.concatenate([response.state * response.state_std, response.push @ spread], axis=2)
        columns /= bench.std[..., None]
        turned = np.swapaxes(columns, 1, 2)
        gram = turned @ columns + (1.0 + damping)[:, None, None] * one
        target = turned @ (response.restore(missed) / bench.std)[..., None]
        found = np.linalg.solve(gram, target + damping[:, None, None] * at[..., None])[..., 0]
        bench.track = place(found)
        cost = ((bench.residual(values) / bench.std) ** 2).sum(axis=1) + (found**2).sum(axis=1)
        better, gained = cost < best, float(np.maximum(best - cost, 0.0).sum())
        damping = np.where(better, damping / 10.0, np.maximum(4.0 * damping, 1.0))
        best, at = np.where(better, cost, best), np.where(better[:, None], found, at)
        bench.track = place(at)
        if gained < len(at) * SETTLED:
            break
    return bench.track
