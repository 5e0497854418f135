"""Measurements with the errors of sensors taken back: the inverse of the laws in `vpptwin.twin.sensors`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vpptwin.estimation.series import Measurements, Series
from vpptwin.twin.robot.manifold import rotate
from vpptwin.twin.sensors import PERFECT, Constants, find_age, turn_rates


def is_perfect(sensors: Constants) -> bool:
    """Whether sensors show the truth."""
    return all(bool((sensors[name] == value).all()) for name, value in PERFECT.items())


def correct_measurements(measurements: Measurements, sensors: Constants) -> Measurements:
    """What sensors without errors would have said, noise apart; their constants are (1, nv)."""
    if is_perfect(sensors):
        return measurements
    errors = {name: sensors[name][0] for name in PERFECT}
    turning = [first + axis for first in measurements.attitudes for axis in range(3)]

    def correct(series: Series, signal: str, dof: int, added: float) -> Series:
        time = series.time - find_age(sensors, signal, dof, series.time)
        return replace(series, time=time, value=(series.value - added) / errors[f"{signal}.scale"][dof])

    positions = {  # what an attitude has turned by is as the attitude says
        dof: correct(series, "pose", dof, 0.0 if dof in turning else errors["pose.offset"][dof])
        for dof, series in measurements.positions.items()
    }
    velocities = {
        dof: correct(series, "rate", dof, errors["rate.bias"][dof]) for dof, series in measurements.velocities.items()
    }
    for first in (first for first in measurements.attitudes if sensors["rate.turn"][0, first : first + 3].any()):
        rates = np.stack([velocities[first + axis].value for axis in range(3)], axis=-1)
        for axis, value in enumerate(turn_rates(sensors, rates, first, True).T):
            velocities[first + axis] = replace(velocities[first + axis], value=value)
    attitudes = {}
    for first, series in measurements.attitudes.items():
        back = np.broadcast_to(-errors["pose.offset"][first : first + 3], (len(series.time), 3))
        time = series.time - find_age(sensors, "pose", first, series.time)
        attitudes[first] = replace(series, time=time, value=rotate(series.value, back))
    return replace(measurements, positions=positions, velocities=velocities, attitudes=attitudes)
