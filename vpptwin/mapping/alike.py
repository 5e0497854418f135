"""How much of one signal is in another: slopes, lags, roughness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vpptwin.estimation.checks.turns import unwrap_turns
from vpptwin.logs.flight import Stream
from vpptwin.mapping.survey import Signal

STILL = 1e-9
"""Spread below which a signal stands still."""


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
    if len(grid) < 20:
        return period, np.zeros(0), np.zeros(0)
    return period, *(np.interp(grid, time, values) for time, values in good)


def straighten(position: Signal, scale: float, limits: np.ndarray | None, rotary: bool) -> tuple[Signal, list[str]]:
    """A position logged in units of `scale`, in SI units, that goes on where it was logged within one turn."""
    known = np.isfinite(position.values)
    stream = Stream(position.time[known], {"position": scale * position.values[known]})
    stream, told = unwrap_turns(stream, position.label, limits, rotary)
    return replace(position, time=stream.time, values=stream["position"]), told


def compare_slope(position: Signal, velocity: Signal) -> tuple[float, float]:
    """Correlation of a velocity with the slope of a position over 0.1 s, and its share of that; NaN if it is still."""
    period, place, rate = resample(position, velocity)
    width = max(round(0.1 / period), 1)
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
    period, asked, found = resample(target, position)
    if len(asked) < 20 or asked.std() < STILL or found.std() < STILL:
        return np.nan, np.nan
    most = min(round(0.5 / period), len(asked) // 4)
    lags = list(range(-most, most + 1))
    values = [np.corrcoef(asked[max(-k, 0) : len(asked) - max(k, 0)], found[max(k, 0) : len(found) - max(-k, 0)])[0, 1]
              for k in lags]  # fmt: skip
    best = int(np.argmax(values))
    return float(values[best]), lags[best] * period
