"""How far back samples best tell the state of a rig whose sensors nobody described."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vpptwin.estimation.gaps import find_gaps, touch
from vpptwin.estimation.initial import FREE, SAMPLES, select_samples, solve_local, weigh_samples
from vpptwin.estimation.noise import is_white
from vpptwin.estimation.series import Measurements, Series

REACHES = 5.0 * 1.5 ** np.arange(12)
"""How many samples back are tried."""
FARTHEST = 0.3
"""But none farther back than this [s]."""
TRIALS, FEWEST = 300, 50
"""Instants at which that is tried, and how many of them tell at least."""


def reach_back(measurements: Measurements) -> Measurements:
    """The measurements with the reach of positions beside which no velocities were logged."""
    positions, attitudes = measurements.positions, measurements.attitudes
    start, end = measurements.start + FARTHEST, measurements.end - FARTHEST
    times = np.linspace(start, end, TRIALS if end - start > 2.0 * FARTHEST else 0)
    for spans in (measurements.strikes, measurements.blows):  # across which no start is read
        times = times[~touch(spans, times - FARTHEST, times + FARTHEST)]
    turning = {first: range(first, first + 3) for first in attitudes}
    turned = [dof for axes in turning.values() for dof in axes]
    reaches: dict[int, float | None] = {}
    for axes in (*turning.values(), *([dof] for dof in positions if dof not in turned)):
        if not any(dof in measurements.velocities for dof in axes):
            reaches |= dict.fromkeys(axes, find_reach([positions[dof] for dof in axes], times))
    return replace(
        measurements,
        positions={dof: replace(series, reach=reaches.get(dof)) for dof, series in positions.items()},
        attitudes={first: replace(series, reach=reaches.get(first)) for first, series in attitudes.items()},
    )


def find_reach(several: Sequence[Series], times: np.ndarray) -> float | None:
    """How far back samples of series of the same times best tell speeds at `times` (K,) [s].

    Close by there are few to average their noise, and farther back the motion is no parabola. What is best comes
    closest to the speed of a cubic through the samples on either side, which knows of neither if noise is white.

    Returns:
        None if noise is not white, or too few samples tell.
    """
    time = several[0].time
    white = [s for s in several if not s.white and len(time) >= FEWEST and is_white(s.value)]
    times = times[~touch(find_gaps(time, 0.0), times - FARTHEST, times + FARTHEST)]
    period = float(np.median(np.diff(time)))
    reaches = [float(reach) for reach in period * REACHES if reach <= FARTHEST]
    if not white or len(reaches) < 2 or len(times) < FEWEST:
        return None
    missed = np.zeros((len(reaches), len(times)))
    for series in white:
        around = fit_speed(series, times, SAMPLES * period, np.full(len(times), np.inf), 3)
        missed += [(fit_speed(series, times, reach, times, 2) - around) ** 2 for reach in reaches]
    return reaches[int(np.argmin(missed.mean(axis=1)))]


def fit_speed(series: Series, times: np.ndarray, span: float, until: np.ndarray, degree: int) -> np.ndarray:
    """Slope at `times` (K,) of polynomials through the samples within `span` [s], none later than `until`, (K,)."""
    index, near = select_samples(series.time, times, span, until)
    t = series.time[index] - times[:, None]
    columns = [t**power / math.factorial(power) for power in range(degree + 1)]
    return solve_local([weigh_samples(t, near, series.std, columns, series.value[index])], FREE)[1]
