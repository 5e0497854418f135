"""Measurements with the errors of sensors taken back: the inverse of the laws in `vpptwin.twin.sensors`."""

from __future__ import annotations

from dataclasses import replace

from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.twin.sensors import PERFECT, PITCH, Constants, age_of_pose


def correct_measurements(measurements: Measurements, sensors: Constants) -> Measurements:
    """What sensors without errors would have said on a drone's flight, noise apart; their constants are (1,)."""
    errors = {name: float(sensors[name][0]) for name in PERFECT}
    if errors == PERFECT:
        return measurements
    positions = {}
    for dof, series in measurements.positions.items():
        value = series.value - errors["mocap.angle"] if dof == PITCH else series.value / errors["mocap.scale"]
        time = series.time - age_of_pose(sensors, series.time) if dof in measurements.delayed else series.time
        positions[dof] = replace(series, time=time, value=value)
    velocities: dict[int, Series] = {}
    for dof, series in measurements.velocities.items():
        velocities[dof] = replace(series, value=(series.value - errors["gyro.bias"]) / errors["gyro.scale"])
    return replace(measurements, positions=positions, velocities=velocities)
