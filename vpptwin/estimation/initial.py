"""States at chosen instants, from the measurements around or before them: the starting points of replays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from vpptwin.estimation.measurements import Measurements, Series

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
        for k, instant in enumerate(times):
            pose[k, dof], velocity[k, dof] = fit_local(series, rate, moved, instant, causal)
    if 2 in displacement:
        gyro = measurements.velocities[2]
        velocity[:, 2] = [fit_end(gyro, instant, 0.01, causal) for instant in times]
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
    turned = Displacement(time, cumulative_trapezoid(rate, time, initial=0.0), rate, np.zeros_like(time), DRIFT_STD)
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
        speed = cumulative_trapezoid(acceleration, time, initial=0.0)
        moved = cumulative_trapezoid(speed, time, initial=0.0)
        result[dof] = Displacement(time, moved, speed, acceleration, SLOPE_STD)
    return result


def select_samples(time: np.ndarray, instant: float, span: float, causal: bool) -> slice:
    """Samples within `span` [s] of an instant, or the three nearest if there are fewer; `causal`: none after it."""
    first, stop = np.searchsorted(time, [instant - span, instant + (0.0 if causal else span)], side="right")
    if stop - first >= 3:
        return slice(first, stop)
    if causal:
        return slice(max(stop - 3, 0), max(stop, 1))
    middle = int(np.clip(np.searchsorted(time, instant), 2, len(time) - 1))
    return slice(middle - 2, middle + 1)


def fit_local(
    series: Series, rate: Series | None, moved: Displacement | None, instant: float, causal: bool
) -> tuple[float, float]:
    """Position and velocity at an instant by regularised least squares over the samples around it.

    The model is position + velocity t + extra t²/2 on top of the known displacement `moved`; with no displacement
    known the extra term is a free acceleration.
    """
    near = select_samples(series.time, instant, HORIZON, causal)
    t = series.time[near] - instant
    value = np.array(series.value[near], dtype=float)
    columns = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=1) / series.std
    if moved is not None:
        (at,), (speed,) = moved.read(np.array([instant]))
        value -= moved.read(series.time[near])[0] - at - speed * t
    rows, target = [columns], [value / series.std]
    if rate is not None:
        low, high = instant - HORIZON, instant + (0.0 if causal else HORIZON)
        near_rate = slice(*np.searchsorted(rate.time, [low, high], side="right"))
        t_rate = rate.time[near_rate] - instant
        rows.append(np.stack([np.zeros_like(t_rate), np.ones_like(t_rate), t_rate], axis=1) / rate.std)
        target.append(rate.value[near_rate] / rate.std)
    rows.append(np.diag([1.0 / FREE, 1.0 / FREE, 1.0 / (FREE if moved is None else moved.prior)]))
    target.append(np.zeros(3))
    solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(target), rcond=None)[0]
    return float(solution[0]), float(solution[1])


def fit_end(series: Series, instant: float, span: float, causal: bool) -> float:
    """Value of a series at an instant from a line through the samples within `span` [s], at least three."""
    near = select_samples(series.time, instant, span, causal)
    line = np.polyfit(series.time[near] - instant, series.value[near], min(1, near.stop - near.start - 1))
    return float(line[-1])
