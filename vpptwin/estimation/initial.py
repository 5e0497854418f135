"""States at chosen instants, from the measurements around or before them: the starting points of replays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.estimation.series import integrate

SAMPLES = 8.0
"""Samples of somebody's smooth estimate used on either side: beyond, the motion is no parabola."""
HORIZON = 0.15
"""Measurements used on either side of an instant [s]."""
SLOPE_STD = 0.3
"""Prior on a leftover acceleration [m/s²] once the accelerometer has been integrated."""
DRIFT_STD = 0.1
"""Prior on a leftover angular acceleration [rad/s²] once the gyro has been integrated."""
FREE = 1e6
"""Prior wide enough to leave a coefficient to the data."""


def estimate_states(
    measurements: Measurements, times: np.ndarray, num_dofs: int, gravity: float, causal: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate poses and velocities at `times`.

    On the drone gyro and accelerometer carry the state between motion-capture samples, so that a few of those pin it
    down; elsewhere a local polynomial is fitted to positions and, where logged, velocities.

    Args:
        measurements: one flight.
        times: (K,) s.
        num_dofs: degrees of freedom of the model.
        gravity: m/s², to turn specific force into acceleration.
        causal: use nothing later than each instant.

    Returns:
        Pose (K, num_dofs) and velocity (K, num_dofs); zero for degrees of freedom that are not measured.
    """
    pose, velocity = np.zeros((len(times), num_dofs)), np.zeros((len(times), num_dofs))
    displacement = integrate_inertial(measurements, gravity)
    for dof, series in measurements.positions.items():
        moved = displacement.get(dof)
        rate = None if moved is not None else measurements.velocities.get(dof)
        pose[:, dof], velocity[:, dof] = fit_local(series, rate, moved, times, causal)
    if 2 in displacement:
        velocity[:, 2] = fit_end(measurements.velocities[2], times, 0.01, causal)
    return pose, velocity


@dataclass(frozen=True)
class Displacement:
    """How far gyro and accelerometer say that a degree of freedom has moved.

    Attributes:
        time: of the samples, (n,) s.
        value, slope, curvature: displacement and its derivatives, (n,).
        prior: standard deviation of the acceleration that is left over.
    """

    time: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray
    prior: float

    def read(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and slope at any times, continued from the last sample before each: no look ahead."""
        last = np.maximum(np.searchsorted(self.time, times, side="right") - 1, 0)
        late = times - self.time[last]
        slope = self.slope[last] + self.curvature[last] * late
        return self.value[last] + 0.5 * (self.slope[last] + slope) * late, slope


def integrate_inertial(measurements: Measurements, gravity: float) -> dict[int, Displacement]:
    """Displacement of each degree of freedom that gyro and accelerometer see."""
    force = measurements.specific_force
    if force is None or 2 not in measurements.velocities:
        return {}
    gyro, angle = measurements.velocities[2], measurements.positions[2]
    time = force.time
    rate = np.interp(time, gyro.time, gyro.value)
    turned = Displacement(time, integrate(rate, time), rate, np.zeros_like(time), DRIFT_STD)
    offset = angle.value - turned.read(angle.time)[0]
    summed = np.cumsum(np.concatenate([np.full(20, offset[0]), offset]))
    smooth = (summed[20:] - summed[:-20]) / 20.0
    theta = turned.value + smooth[np.maximum(np.searchsorted(angle.time, time, side="right") - 1, 0)]
    body_x, body_z = force.value[:, 0], force.value[:, 1]
    result = {2: turned}
    for dof, acceleration in (
        (0, body_x * np.cos(theta) - body_z * np.sin(theta)),
        (1, body_x * np.sin(theta) + body_z * np.cos(theta) - gravity),
    ):
        speed = integrate(acceleration, time)
        moved = integrate(speed, time)
        result[dof] = Displacement(time, moved, speed, acceleration, SLOPE_STD)
    return result


def select_samples(time: np.ndarray, times: np.ndarray, span: float, causal: bool) -> tuple[np.ndarray, np.ndarray]:
    """Samples within `span` [s] of each instant, or the three nearest if there are fewer.

    Args:
        time: of the samples, (n,) s.
        times: the instants, (K,) s.
        span: s.
        causal: none after the instant.

    Returns:
        Indices of samples and which of them count, (K, S) each.
    """
    first = np.searchsorted(time, times - span, side="right")
    stop = np.searchsorted(time, times if causal else times + span, side="right")
    few = stop - first < 3
    if causal:
        nearest = stop - 3, np.maximum(stop, 1)
    else:
        middle = np.clip(np.searchsorted(time, times), 2, len(time) - 1)
        nearest = middle - 2, middle + 1
    return list_samples(np.where(few, nearest[0], first), np.where(few, nearest[1], stop), len(time))


def list_samples(first: np.ndarray, stop: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The samples from `first` to before `stop` (K,) of `count`, as `select_samples` returns them."""
    first = np.maximum(first, 0)
    index = first[:, None] + np.arange((stop - first).max(initial=0))
    return np.minimum(index, count - 1), index < stop[:, None]


def fit_local(
    series: Series, rate: Series | None, moved: Displacement | None, times: np.ndarray, causal: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity at instants `times` (K,) by regularised least squares over the samples around each.

    The model is position + velocity t + extra t²/2 on top of the known displacement `moved`; with no displacement
    known the extra term is a free acceleration.

    Returns:
        Positions (K,) and velocities (K,).
    """
    horizon = HORIZON
    if moved is None and not series.white:
        horizon = min(HORIZON, SAMPLES * float(np.median(np.diff(series.time)))) if len(series.time) > 1 else HORIZON
    index, near = select_samples(series.time, times, horizon, causal)
    t = series.time[index] - times[:, None]
    value = np.array(series.value[index], dtype=float)
    if moved is not None:
        at, speed = moved.read(times)
        value -= moved.read(series.time)[0][index] - at[:, None] - speed[:, None] * t
    columns = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=2)
    rows, target = [np.where(near[..., None], columns, 0.0) / series.std], [np.where(near, value, 0.0) / series.std]
    if rate is not None:
        first, stop = (
            np.searchsorted(rate.time, times + reach, side="right") for reach in (-horizon, 0.0 if causal else horizon)
        )
        index, near = list_samples(first, stop, len(rate.time))
        t = rate.time[index] - times[:, None]
        columns = np.stack([np.zeros_like(t), np.ones_like(t), t], axis=2)
        rows.append(np.where(near[..., None], columns, 0.0) / rate.std)
        target.append(np.where(near, rate.value[index], 0.0) / rate.std)
    prior = np.diag([1.0 / FREE, 1.0 / FREE, 1.0 / (FREE if moved is None else moved.prior)])
    rows.append(np.broadcast_to(prior, (len(times), 3, 3)))
    target.append(np.zeros((len(times), 3)))
    q, r = np.linalg.qr(np.concatenate(rows, axis=1))
    solution = np.linalg.solve(r, np.swapaxes(q, 1, 2) @ np.concatenate(target, axis=1)[..., None])
    return solution[:, 0, 0], solution[:, 1, 0]


def fit_end(series: Series, times: np.ndarray, span: float, causal: bool) -> np.ndarray:
    """Values of a series at `times` (K,), from lines through the samples within `span` [s], at least three; (K,)."""
    index, near = select_samples(series.time, times, span, causal)
    weight = near / near.sum(axis=1, keepdims=True)
    t, value = series.time[index] - times[:, None], series.value[index]
    middle, mean = (weight * t).sum(axis=1), (weight * value).sum(axis=1)
    apart = t - middle[:, None]
    spread = (weight * apart**2).sum(axis=1)
    slope = (weight * apart * (value - mean[:, None])).sum(axis=1) / np.where(spread > 0.0, spread, 1.0)
    return mean - slope * middle
