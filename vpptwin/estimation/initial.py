"""States at chosen instants, from the measurements around or before them: the starting points of replays."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from vpptwin.estimation.series import Displacement, Measurements, Series
from vpptwin.twin.robot.manifold import (
    conjugate,
    difference_attitudes,
    find_place,
    list_attitudes,
    multiply_attitudes,
    rotate,
)

SAMPLES = 8.0
"""Samples of somebody's smooth estimate used on either side where the log has not told how many."""
SPANS = (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0, 45.0, 60.0)
"""Samples from which the log tells; farther away than `HORIZON` none is used."""
AHEAD, TRIED, TOLERANCE = 2, 1000, 1.15
"""Samples ahead that a parabola foretells, instants at which it does, and what its error may be of the least."""
HORIZON = 0.15
"""Measurements used on either side of an instant [s]."""
SMOOTH = 0.3
"""The same along a track, ever less of them [s]: what rings magnifies every jolt."""
MIN_WEIGHT = 0.01
"""Of the weight there of the farthest, where there are hardly any."""
DRIFT_STD = 0.1
"""Prior on a leftover angular acceleration [rad/s²] once a gyro has been integrated."""
RATE_SPAN = 0.01
"""A rate is the end of a line through so much of the gyro [s]."""
FREE = 1e6
"""Prior wide enough to leave a coefficient to the data."""


def estimate_states(
    measurements: Measurements, times: np.ndarray, model: mujoco.MjModel, causal: bool, until: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate poses and velocities at `times`.

    Where gyro and accelerometer carry the state between samples (`Measurements.dead_reckon`), a few of those pin it
    down; elsewhere a local polynomial is fitted to positions and, where logged, velocities.

    Args:
        measurements: one flight.
        times: (K,) s.
        model: whose state it is.
        causal: use nothing later than each instant.
        until: along a track, (K,) s: nothing later than this is used, in the place of `causal`, and what was measured
            farther away counts less, so that none comes in or goes out with a jolt.

    Returns:
        Pose (K, nq) and velocity (K, nv); zero for degrees of freedom that are not measured.
    """
    track = until is not None
    until = limit_times(times, causal) if until is None else until
    pose, velocity = follow_log(measurements, times, model)
    displacement = {} if measurements.dead_reckon is None else measurements.dead_reckon(measurements, model)
    turning = [first + axis for first in measurements.attitudes for axis in range(3)]
    for dof, series in measurements.positions.items():
        if dof in turning:
            continue
        moved = displacement.get(dof)
        rate = None if moved is not None else measurements.velocities.get(dof)
        horizon = find_horizon(series) if moved is None else SMOOTH if track else HORIZON
        pose[:, find_place(model, dof)], velocity[:, dof], _ = fit_parabola(
            series, rate, moved, times, until, horizon, track
        ).T
    for first, attitude in measurements.attitudes.items():
        place, axes = find_place(model, first), range(first, first + 3)
        gyro = [measurements.velocities[axis] for axis in axes if axis in measurements.velocities]
        pose[:, place : place + 4], velocity[:, first : first + 3] = fit_attitude(
            attitude, gyro if len(gyro) == 3 else [], times, until
        )
    for dof in displacement.keys() & measurements.velocities.keys():  # a rate that is measured itself
        velocity[:, dof] = fit_end(measurements.velocities[dof], times, RATE_SPAN, until)
    return pose, velocity


def follow_log(measurements: Measurements, times: np.ndarray, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Poses (..., nq) and velocities (..., nv) of what is driven at `times` (...) s, by a spline; the rest at zero."""
    pose, velocity = np.zeros((*times.shape, model.nq)), np.zeros((*times.shape, model.nv))
    pose[..., [place for place, _ in list_attitudes(model)]] = 1.0
    if not measurements.driven:
        return pose, velocity
    from scipy.interpolate import make_interp_spline  # only rigs that are driven wait for it

    for dof, series in measurements.driven.items():
        spline, place = make_interp_spline(series.time, series.value, k=3), find_place(model, dof)
        at, slope = spline(times), spline.derivative()(times)
        if series.value.ndim == 1:
            pose[..., place], velocity[..., dof] = at, slope
            continue
        size = np.linalg.norm(at, axis=-1, keepdims=True)
        pose[..., place : place + 4] = at / size
        velocity[..., dof : dof + 3] = 2.0 * multiply_attitudes(conjugate(at), slope)[..., 1:] / size**2
    return pose, velocity


def limit_times(times: np.ndarray, causal: bool) -> np.ndarray:
    """Until when measurements may be used for estimates at `times` (K,) [s]."""
    return times if causal else np.full(len(times), np.inf)


def select_samples(
    time: np.ndarray, times: np.ndarray, span: float, until: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Samples within `span` [s] of each instant, or the three nearest if there are fewer.

    Args:
        time: of the samples, (n,) s.
        times: the instants, (K,) s.
        span: s.
        until: none after this, (K,) s.

    Returns:
        Indices of samples and which of them count, (K, S) each.
    """
    first = np.searchsorted(time, times - span, side="right")
    stop = np.searchsorted(time, np.minimum(times + span, until), side="right")
    few = stop - first < 3
    last = np.maximum(np.searchsorted(time, until, side="right"), 1)
    nearest = np.minimum(np.clip(np.searchsorted(time, times), 2, len(time) - 1) + 1, last)
    return list_samples(np.where(few, nearest - 3, first), np.where(few, nearest, stop), len(time))


def list_samples(first: np.ndarray, stop: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The samples from `first` to before `stop` (K,) of `count`, as `select_samples` returns them."""
    first = np.maximum(first, 0)
    index = first[:, None] + np.arange((stop - first).max(initial=0))
    return np.minimum(index, count - 1), index < stop[:, None]


def fit_parabola(
    series: Series, rate: Series | None, moved: Displacement | None, times: np.ndarray, until: np.ndarray,
    horizon: float, track: bool = False,
) -> np.ndarray:  # fmt: skip
    """Position, velocity and extra acceleration at `times`, (K, 3), by regularised least squares.

    The model is x(t) = x + v t + a t²/2 on top of the known displacement `moved`, over samples within `horizon` [s];
    with no displacement known the extra term is a free acceleration (Savitzky and Golay 1964, with a prior on a).
    """
    index, near = select_samples(series.time, times, horizon, until)
    t = series.time[index] - times[:, None]
    value = np.array(series.value[index], dtype=float)
    if moved is not None:
        at, speed = moved.read(times)
        value -= moved.read(series.time)[0][index] - at[:, None] - speed[:, None] * t
    weight = near * taper(t, horizon) if track else near
    parts = [weigh_samples(t, weight, series.std, (np.ones_like(t), t, 0.5 * t * t), value)]
    if rate is not None:
        first, stop = (
            np.searchsorted(rate.time, ends, side="right")
            for ends in (times - horizon, np.minimum(times + horizon, until))
        )
        index, near = list_samples(first, stop, len(rate.time))
        t = rate.time[index] - times[:, None]
        weight = near * taper(t, horizon) if track else near
        parts.append(weigh_samples(t, weight, rate.std, (np.zeros_like(t), np.ones_like(t), t), rate.value[index]))
    return solve_local(parts, FREE if moved is None else moved.prior)


def find_horizon(series: Series) -> float:
    """How far around an instant samples are used where nothing carries from one to the next [s]."""
    if series.white or len(series.time) < 2:
        return HORIZON
    return series.span or min(HORIZON, SAMPLES * float(np.median(np.diff(series.time))))


def choose_span(series: Series, rate: Series | None) -> float:
    """The span [s] of which the samples up to an instant foretell the log best, or a longer one that does as well.

    Of a joint that a motor jerks about, eight samples tell a velocity that is off by more than all noise; of a slow one
    more of them tell it better. 0 for a log too short to tell.
    """
    period = float(np.median(np.diff(series.time))) if len(series.time) > 1 else 0.0
    spans = [samples * period for samples in SPANS if samples == SPANS[0] or samples * period <= HORIZON]
    first = int(np.searchsorted(series.time, series.time[0] + spans[-1]))
    if len(series.time) - first < TRIED // 10:
        return 0.0
    at = np.unique(np.linspace(first, len(series.time) - 1 - AHEAD, TRIED).astype(int))
    times, later = series.time[at], series.time[at + AHEAD] - series.time[at]
    missed = []
    for span in spans:
        place, speed, turn = fit_parabola(series, rate, None, times, times, span).T
        foretold = place + later * (speed + 0.5 * later * turn)
        missed.append(float(((foretold - series.value[at + AHEAD]) ** 2).mean()))
    best = int(np.argmin(missed))
    while best + 1 < len(spans) and missed[best + 1] <= TOLERANCE**2 * min(missed):
        best += 1
    return spans[best]


def taper(t: np.ndarray, horizon: float) -> np.ndarray:
    """Weight of samples at times `t` from an instant, falling to nothing at the horizon [s]; same shape."""
    return np.maximum(1.0 - (t / horizon) ** 2, MIN_WEIGHT)


def weigh_samples(
    t: np.ndarray, weight: np.ndarray, std: float, columns: Sequence[np.ndarray], value: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (K, S, 3) and right sides (K, S) of samples in units of their noise, times their weights (K, S)."""
    scaled = weight / std
    return scaled[..., None] * np.stack(columns, axis=2), scaled * value


def solve_local(parts: Sequence[tuple[np.ndarray, np.ndarray]], curvature: float) -> np.ndarray:
    """Value, slope and curvature at t = 0 of parabolas by least squares, (K, 3); `curvature`: the last's prior."""
    count = len(parts[0][0])
    prior = np.broadcast_to(np.diag([1.0 / FREE, 1.0 / FREE, 1.0 / curvature]), (count, 3, 3))
    q, r = np.linalg.qr(np.concatenate([*(rows for rows, _ in parts), prior], axis=1))
    target = np.concatenate([*(value for _, value in parts), np.zeros((count, 3))], axis=1)
    solution: np.ndarray = np.linalg.solve(r, np.swapaxes(q, 1, 2) @ target[..., None])[..., 0]  # R x = Qᵀ y
    return solution


def fit_attitude(
    attitude: Series, gyro: Sequence[Series], times: np.ndarray, until: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Attitude and rate about body axes at instants `times` (K,), from the samples around each.

    A gyro of three axes, where there is one, carries the attitude from sample to sample. What is left to turn from the
    nearest one is fitted as a rotation vector, a local parabola as in `fit_parabola`.

    Returns:
        Unit quaternions (K, 4) and rates (K, 3) rad/s.
    """
    index, near = select_samples(attitude.time, times, find_horizon(attitude), until)
    t = attitude.time[index] - times[:, None]
    base = index[np.arange(len(times)), np.argmin(np.where(near, np.abs(t), np.inf), axis=1)]
    turned, at = attitude.value, np.array([1.0, 0.0, 0.0, 0.0])
    if gyro:
        carried = carry_attitude(gyro, np.concatenate([attitude.time, times]))
        turned = multiply_attitudes(conjugate(carried[: len(attitude.time)]), attitude.value)
        at = carried[len(attitude.time) :]
    residual = difference_attitudes(turned[base][:, None], turned[index])
    place, speed = np.zeros((len(times), 3)), np.zeros((len(times), 3))
    for axis in range(3):
        rows = weigh_samples(t, near, attitude.std, (np.ones_like(t), t, 0.5 * t * t), residual[..., axis])
        place[:, axis], speed[:, axis] = solve_local([rows], DRIFT_STD if gyro else FREE)[:, :2].T
    pose = rotate(multiply_attitudes(at, turned[base]), place)
    if gyro:
        return pose, np.stack([fit_end(series, times, RATE_SPAN, until) for series in gyro], axis=1)
    return pose, speed - 0.5 * np.cross(place, speed)


def carry_attitude(gyro: Sequence[Series], times: np.ndarray) -> np.ndarray:
    """Attitudes at any times (K,) as a gyro alone has them, from its first sample on; no look ahead, (K, 4)."""
    time, rate = gyro[0].time, np.stack([np.interp(gyro[0].time, s.time, s.value) for s in gyro], axis=1)
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)[:, None]
    still = np.array([[1.0, 0.0, 0.0, 0.0]])
    track, span = np.concatenate([still, rotate(still, steps)]), 1
    while span < len(track):  # each turn with those before it, twice as many every time
        track[span:] = multiply_attitudes(track[:-span], track[span:])
        span *= 2
    last = np.maximum(np.searchsorted(time, times, side="right") - 1, 0)
    return rotate(track[last], rate[last] * (times - time[last])[:, None])


def fit_end(series: Series, times: np.ndarray, span: float, until: np.ndarray) -> np.ndarray:
    """Values of a series at `times` (K,), from lines through the samples within `span` [s], at least three; (K,)."""
    index, near = select_samples(series.time, times, span, until)
    weight = near / near.sum(axis=1, keepdims=True)
    t, value = series.time[index] - times[:, None], series.value[index]
    middle, mean = (weight * t).sum(axis=1), (weight * value).sum(axis=1)
    apart = t - middle[:, None]
    spread = (weight * apart**2).sum(axis=1)
    slope = (weight * apart * (value - mean[:, None])).sum(axis=1) / np.where(spread > 0.0, spread, 1.0)
    return mean - slope * middle
