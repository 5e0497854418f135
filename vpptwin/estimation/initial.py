"""States at chosen instants, from the measurements around or before them: the starting points of replays."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from vpptwin.estimation.measurements import Measurements, Series

HORIZON = 0.15
"""Measurements used on either side of an instant [s]."""
SLOPE_STD = 0.3
"""Prior on a leftover acceleration [m/s²] once the accelerometer has been integrated."""
DRIFT_STD = 0.1
"""Prior on a leftover rate [rad/s] once the gyro has been integrated."""
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
        moved, prior = displacement.get(dof, (None, FREE))
        rate = None if dof in displacement else measurements.velocities.get(dof)
        for k, instant in enumerate(times):
            pose[k, dof], velocity[k, dof] = fit_local(series, rate, moved, instant, prior, causal)
    if 2 in displacement:
        gyro = measurements.velocities[2]
        velocity[:, 2] = [fit_end(gyro, instant, 0.01, causal) for instant in times]
    return pose, velocity


def integrate_inertial(measurements: Measurements, gravity: float) -> dict[int, tuple[tuple[np.ndarray, ...], float]]:
    """Displacement by gyro and accelerometer: dof → ((time, displacement, its slope), prior of what is left over)."""
    force = measurements.specific_force
    if force is None or 2 not in measurements.velocities:
        return {}
    gyro, angle = measurements.velocities[2], measurements.positions[2]
    time = force.time
    rate = np.interp(time, gyro.time, gyro.value)
    turned = cumulative_trapezoid(rate, time, initial=0.0)
    offset = angle.value - np.interp(angle.time, time, turned)
    smooth = np.cumsum(np.concatenate([np.full(20, offset[0]), offset]))
    theta = turned + np.interp(time, angle.time, (smooth[20:] - smooth[:-20]) / 20.0)
    body_x, body_z = force.value[:, 0], force.value[:, 1]
    result: dict[int, tuple[tuple[np.ndarray, ...], float]] = {2: ((time, turned, np.zeros_like(time)), DRIFT_STD)}
    for dof, acceleration in (
        (0, body_x * np.cos(theta) - body_z * np.sin(theta)),
        (1, body_x * np.sin(theta) + body_z * np.cos(theta) - gravity),
    ):
        speed = cumulative_trapezoid(acceleration, time, initial=0.0)
        result[dof] = ((time, cumulative_trapezoid(speed, time, initial=0.0), speed), SLOPE_STD)
    return result


def fit_local(
    series: Series,
    rate: Series | None,
    moved: tuple[np.ndarray, ...] | None,
    instant: float,
    prior: float,
    causal: bool,
) -> tuple[float, float]:
    """Position and velocity at an instant by regularised least squares over the samples around it.

    The model is position + velocity t + extra t²/2 on top of the known displacement `moved`; the angle's displacement
    by gyro leaves only a constant and a drift. With no displacement known the extra term is a free acceleration.
    """
    low, high = instant - HORIZON, instant + (0.0 if causal else HORIZON)
    near = slice(*np.searchsorted(series.time, [low, high], side="right"))
    if near.stop - near.start < 3:
        middle = int(np.clip(np.searchsorted(series.time, instant), 2, len(series.time) - 1))
        near = slice(middle - 2, middle + 1)
    t = series.time[near] - instant
    value = np.array(series.value[near], dtype=float)
    columns = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=1) / series.std
    if moved is not None:
        time, displacement, slope = moved
        at, speed = np.interp(instant, time, displacement), np.interp(instant, time, slope)
        value -= np.interp(series.time[near], time, displacement) - at - speed * t
    rows, target = [columns], [value / series.std]
    if rate is not None:
        near_rate = slice(*np.searchsorted(rate.time, [low, high], side="right"))
        t_rate = rate.time[near_rate] - instant
        rows.append(np.stack([np.zeros_like(t_rate), np.ones_like(t_rate), t_rate], axis=1) / rate.std)
        target.append(rate.value[near_rate] / rate.std)
    rows.append(np.diag([1.0 / FREE, 1.0 / FREE, 1.0 / prior]))
    target.append(np.zeros(3))
    solution = np.linalg.lstsq(np.concatenate(rows), np.concatenate(target), rcond=None)[0]
    return float(solution[0]), float(solution[1])


def fit_end(series: Series, instant: float, span: float, causal: bool) -> float:
    """Value of a series at an instant from a line through the samples within `span` [s]."""
    near = slice(*np.searchsorted(series.time, [instant - span, instant + (0.0 if causal else span)], side="right"))
    if near.stop - near.start < 3:
        return float(np.interp(instant, series.time, series.value))
    return float(np.polyval(np.polyfit(series.time[near] - instant, series.value[near], 1), 0.0))
