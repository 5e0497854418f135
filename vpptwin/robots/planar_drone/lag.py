"""How far one stream runs behind another: the motion capture's angle against the integral of the gyro."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from vpptwin.estimation.series import Lag, Series, integrate

SPAN = 0.05
"""Turning is compared over steps of this length [s]: long against the noise of the angle, short against a flip."""
GRID = 0.01
"""Resolution of the first search, over every lag [s]."""
SEARCHES = ((0.3, 0.005), (0.005, 0.0005))
"""Half width and resolution of the searches that follow, each about the last one's result [s]."""
MIN_CORRELATION = 0.7
"""Correlation from which on two streams are taken to show one motion."""
BLOCK = 8.0
"""The drift is read off blocks at least this long [s]."""
MAX_BLOCKS = 8
MAX_STEPS = 2000
"""Steps compared in a block."""
STRETCH = 3.0
"""Steps of a clock are looked for between stretches of this length [s]."""
STEP, ALIKE = 0.1, 0.03
"""A clock steps where its lag changes by so much between two parts of a flight, and no more than that in them [s]."""
CLEAR = 5.0
"""Turning must exceed its noise by this factor, or there is nothing to compare."""


def estimate_lag(angle: Series, rate: Series) -> Lag | None:
    """Lag of an angle (n,), rad, unwrapped, behind the integral of its rate (m,), rad/s.

    Returns:
        None if there was too little turning, or the two show different motions.
    """
    turned = Series("turned", "rad", rate.time, integrate(rate.value, rate.time), rate.std)
    coarse = search_all(angle, turned)
    if coarse is None:
        return None
    begin = max(angle.time[0], rate.time[0] + coarse)
    end = min(angle.time[-1], rate.time[-1] + coarse)
    blocks = int(np.clip((end - begin) / BLOCK, 1, MAX_BLOCKS))
    edges = np.linspace(begin, end, blocks + 1)
    lags_of = [(0.5 * (a + b), refine(angle, turned, coarse, a, b)) for a, b in pairwise(edges)]
    known = [(middle, lag) for middle, lag in lags_of if lag is not None]
    if not known:
        return None
    middle, lags = np.array(known).T
    if len(known) < 2:
        return Lag(float(lags[0]), 0.0)
    drift, start = np.polyfit(middle - angle.time[0], lags, 1)
    return Lag(float(start), float(drift))


def search_all(angle: Series, turned: Series) -> float | None:
    """The lag at which turning is most alike, out of all at which half of the flight overlaps [s]."""
    begin, end = min(angle.time[0], turned.time[0]), max(angle.time[-1], turned.time[-1])
    grid = np.arange(begin, end, GRID)
    if len(grid) < 2 * SPAN / GRID:
        return None
    late, early = (step_over(series, grid) for series in (angle, turned))
    if np.std(late) < CLEAR * angle.std or not np.any(early):
        return None
    early = early - np.median(early)
    padded, half = 2 * len(grid), len(grid) // 2
    product = np.fft.irfft(np.fft.rfft(late, padded) * np.conj(np.fft.rfft(early, padded)), padded)
    correlation = np.roll(product, half)[: 2 * half + 1] / np.sqrt((late @ late) * (early @ early))
    best = int(np.argmax(correlation))
    return float((best - half) * GRID) if correlation[best] > MIN_CORRELATION else None


def refine(angle: Series, turned: Series, coarse: float, begin: float, end: float) -> float | None:
    """The lag near a coarse one at which the turning from `begin` to `end` [s] differs least [s]."""
    stamps = angle.time[(angle.time >= begin) & (angle.time <= end - SPAN)]
    stamps = stamps[:: -(-len(stamps) // MAX_STEPS)] if len(stamps) else stamps
    seen = step_over(angle, stamps + 0.5 * SPAN)
    if len(stamps) < 50 or np.std(seen) < CLEAR * angle.std:
        return None
    lag = coarse
    for width, resolution in SEARCHES:
        lags = lag + np.arange(-width, width + 0.5 * resolution, resolution)
        misses = [float(np.var(seen - step_over(turned, stamps + 0.5 * SPAN - late))) for late in lags]
        lag = float(lags[np.argmin(misses)])
    return lag


def find_step(angle: Series, rate: Series) -> tuple[float, float] | None:
    """When the angle's clock steps against the rate's, and by how much [s]; None if it does not, or nothing tells.

    Between stretches that all have one lag and those that all have another; one of them may lie astride the step.
    """
    turned = Series("turned", "rad", rate.time, integrate(rate.value, rate.time), rate.std)
    lags = np.arange(-SEARCHES[0][0] - STEP, SEARCHES[0][0] + STEP, GRID)
    known: list[tuple[float, float]] = []
    for begin in np.arange(max(angle.time[0], rate.time[0]) + STEP, min(angle.time[-1], rate.time[-1]), STRETCH):
        stamps = angle.time[(angle.time >= begin) & (angle.time < begin + STRETCH)]
        seen = step_over(angle, stamps)
        if len(stamps) < 50 or np.std(seen) < CLEAR * angle.std:
            continue
        misses = [float(np.var(seen - step_over(turned, stamps - late))) for late in lags]
        if min(misses) < (1.0 - MIN_CORRELATION) * np.var(seen):
            known.append((float(begin), float(lags[np.argmin(misses)])))
    for split in range(2, len(known) - 1):
        for astride in (0, 1):
            before, after = (np.array([lag for _, lag in part]) for part in (known[:split], known[split + astride :]))
            change = float(np.median(after) - np.median(before)) if len(after) > 1 else 0.0
            if abs(change) > STEP and max(np.ptp(before), np.ptp(after)) < ALIKE:
                return known[split][0], change
    return None


def step_over(series: Series, time: np.ndarray) -> np.ndarray:
    """Change of a series over SPAN about each time, (k,)."""
    ahead, behind = (np.interp(time + side * 0.5 * SPAN, series.time, series.value) for side in (1.0, -1.0))
    return np.asarray(ahead - behind)
