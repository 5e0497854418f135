"""How much of one signal is in another: slopes, lags, roughness."""

from __future__ import annotations

import numpy as np

from vpptwin.mapping.survey import Signal

STILL = 1e-9
"""Spread below which a signal stands still."""
SLOPE_SPAN, MAX_LAG = 0.1, 0.5
"""Over which time slopes are compared, and how much later one signal may be than another [s]."""
MIN_SAMPLES = 20


def measure_roughness(signal: Signal) -> float:
    """How far a signal strays from a line between neighbours, in the median."""
    return float(np.median(np.abs(np.diff(signal.finite, 2)))) if len(signal.finite) > 2 else 0.0


def resample(first: Signal, second: Signal) -> tuple[float, np.ndarray, np.ndarray]:
    """Period [s] and both signals (n,) over the time that they share, finite and at a constant rate."""
    good = [(s.time[np.isfinite(s.values)], s.values[np.isfinite(s.values)]) for s in (first, second)]
    if not all(len(time) for time, _ in good):
        return 1.0, np.zeros(0), np.zeros(0)
    start, end = max(time[0] for time, _ in good), min(time[-1] for time, _ in good)
    period = max(1.0 / min(s.rate for s in (first, second)), (end - start) / 50_000.0)
    grid = np.arange(start, end, period)
    if len(grid) < MIN_SAMPLES:
        return period, np.zeros(0), np.zeros(0)
    return period, *(np.interp(grid, time, values) for time, values in good)


def compare_slope(position: Signal, velocity: Signal) -> tuple[float, float]:
    """Correlation of a velocity with the slope of a position, and its share of that; NaN if it is still."""
    period, place, rate = resample(position, velocity)
    width = max(round(SLOPE_SPAN / period), 1)
    if len(place) < 4 * width:
        return np.nan, np.nan
    moved = place[width:] - place[:-width]
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * period)])
    turned = summed[width:] - summed[:-width]
    if moved.std() < STILL or turned.std() < STILL:
        return np.nan, np.nan
    return float(np.corrcoef(moved, turned)[0, 1]), float(turned @ moved / (moved @ moved))


def compare_lag(target: Signal, position: Signal) -> tuple[float, float]:
    """Correlation of a position with its target at the lag at which it is greatest, and that lag [s]; NaN if still."""
    period, asked, seen = resample(target, position)
    if len(asked) < MIN_SAMPLES or asked.std() < STILL or seen.std() < STILL:
        return np.nan, np.nan
    most = min(round(MAX_LAG / period), len(asked) // 4)
    lags = list(range(-most, most + 1))
    values = [np.corrcoef(asked[max(-k, 0) : len(asked) - max(k, 0)], seen[max(k, 0) : len(seen) - max(-k, 0)])[0, 1]
              for k in lags]  # fmt: skip
    best = int(np.argmax(values))
    return float(values[best]), lags[best] * period
