"""Samples that no motion explains: spikes, frames of another body, a tracker that has frozen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vpptwin.estimation.series import Series
from vpptwin.logs.flight import Stream

PAIRS = ((-1, 1), (-2, -1), (1, 2), (-2, 1), (-1, 2), (-2, 2), (-3, -1), (1, 3))
"""Neighbours, by distance in samples, whose lines predict a sample."""
SPREADS = 10.0
"""Standard deviations by which a wild sample misses every such prediction. Flips at 15 rad/s stay below three."""
AROUND, COMPANY = 8, 3
"""Where nothing is known of the motion, a wild sample must lie outside what so many samples on either side span, but
for the most extreme few, ..."""
OUTSIDE = 0.5
"""... by this share of that span."""
ROUNDS = 4
"""Wild samples side by side hide each other: those found are taken out and the rest looked at again."""
MAX_RUN = 0.3
"""Longest stretch of samples that count as outliers together [s]: what stays away longer has moved."""


def find_spikes(time: np.ndarray, value: np.ndarray, std: float, curvature: float | None) -> np.ndarray:
    """Samples that miss the lines through all pairs of neighbours, by the one they miss least.

    Where a motion has a kink (a bounce, a rail that lets go) the line from one side still holds, so that only what
    both sides contradict is wild.

    Args:
        time: (n,) s, increasing.
        value: (n,) or (n, k).
        std: noise of a sample, in the unit of the value.
        curvature: largest second derivative of any true motion, unit/s²; None if nothing is known of it.

    Returns:
        (n,) bool.
    """
    value = value[:, None] if value.ndim == 1 else value
    wild = np.zeros(len(time), dtype=bool)
    for _ in range(ROUNDS):
        remaining = np.flatnonzero(~wild)
        if len(remaining) < 7:
            break
        spikes = np.zeros(len(remaining), dtype=bool)
        for column in value[remaining].T:
            spikes |= miss_all(time[remaining], column, std, curvature or 0.0)
        if curvature is None:
            spikes &= find_outside(value[remaining])
        if not spikes.any():
            break
        wild[remaining[spikes]] = True
    return wild


def find_outside(value: np.ndarray) -> np.ndarray:
    """Samples (n, k) that lie well outside the span of those around them, (n,) bool; ends are left alone."""
    outside = np.zeros(len(value), dtype=bool)
    if len(value) <= 2 * AROUND:
        return outside
    for column in value.T:
        around = np.sort(sliding_window_view(column, 2 * AROUND + 1), axis=1)
        low, high = around[:, COMPANY], around[:, -1 - COMPANY]
        middle = column[AROUND:-AROUND]
        outside[AROUND:-AROUND] |= np.maximum(middle - high, low - middle) > OUTSIDE * (high - low)
    return outside


def miss_all(time: np.ndarray, value: np.ndarray, std: float, curvature: float) -> np.ndarray:
    """Samples (n,) that miss each of their predictions by more than noise and curvature allow, (n,) bool.

    Vibration that is faster than the samples counts as noise.
    """
    count = len(time)
    noise, missing = std, np.arange(count)
    for first, second in PAIRS:
        inside = (missing >= -first) & (missing < count - second)
        rows = missing[inside]
        a, b = rows + first, rows + second
        part = (time[rows] - time[a]) / (time[b] - time[a])
        miss = np.abs(value[rows] - value[a] - part * (value[b] - value[a]))
        spread = np.sqrt(1.0 + part**2 + (1.0 - part) ** 2)
        if (first, second) == PAIRS[0]:
            noise = max(std, float(np.median(miss / spread)) / 0.6745)  # σ = MAD / 0.6745
        bend = 0.5 * curvature * np.abs((time[rows] - time[a]) * (time[b] - time[rows]))
        inside[inside] = miss <= SPREADS * noise * spread + bend
        missing = missing[~inside]
    wild = np.zeros(count, dtype=bool)
    wild[missing] = True
    return wild


def find_strays(time: np.ndarray, value: np.ndarray, std: np.ndarray, speed: np.ndarray, turn: int = -1) -> np.ndarray:
    """Stretches of at most MAX_RUN that nothing could have reached and come back from: frames of another body.

    Args:
        time: (n,) s, increasing.
        value: (n, k).
        std: noise of a sample, (k,).
        speed: highest speed of any true motion, (k,) unit/s.
        turn: column that is an angle, of which whole turns do not count; -1 for none.

    Returns:
        (n,) bool.
    """

    def is_reached(a: np.ndarray | int, b: np.ndarray | int) -> np.ndarray:
        step = value[b] - value[a]
        if turn >= 0:
            step[..., turn] = wrap_angle(step[..., turn])
        return np.asarray((np.abs(step) <= SPREADS * std + speed * np.abs(time[b] - time[a])[..., None]).all(axis=-1))

    count = len(time)
    breaks = np.flatnonzero(~is_reached(np.arange(count - 1), np.arange(1, count)))
    stray = np.zeros(count, dtype=bool)
    if not len(breaks):
        return stray
    begins, ends = np.append(0, breaks + 1), np.append(breaks, count - 1)
    anchor = int(np.argmax(time[ends] - time[begins]))
    for order, entry, leave in (
        (range(anchor + 1, len(begins)), begins, ends),
        (range(anchor - 1, -1, -1), ends, begins),
    ):
        last = leave[anchor]
        for segment in order:
            lasting = time[ends[segment]] - time[begins[segment]] > MAX_RUN
            if lasting or is_reached(last, entry[segment]):
                last = leave[segment]
            else:
                stray[begins[segment] : ends[segment] + 1] = True
    return stray


def find_frozen(value: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Samples (n, k) that repeat the one before in every digit, although what follows shows that there was motion."""
    same = np.append(False, (np.diff(value, axis=0) == 0.0).all(axis=1))
    begins = np.flatnonzero(~same)
    after = np.append(begins[1:], len(value))
    moved = np.zeros(len(begins), dtype=bool)
    moved[:-1] = (np.abs(value[begins[1:]] - value[begins[:-1]]) > SPREADS * std).any(axis=1)
    moved[-1] = moved[:-1][np.diff(begins) > 1].any()  # nothing follows the last: trust it unless others were frozen
    return same & np.repeat(moved, after - begins)


def wrap_angle(angle: np.ndarray) -> np.ndarray:
    """The same angle within [-π, π) [rad]."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def clean_series(series: Series, label: str) -> tuple[Series, list[str]]:
    """A joint's track without spikes, and a warning that counts them; of its motion nothing is known."""
    wild = find_spikes(series.time, series.value, series.std, None)
    if not wild.any():
        return series, []
    kept = replace(series, time=series.time[~wild], value=series.value[~wild])
    return kept, tell_left_out(label, wild, "are outliers")


def drop_rows(stream: Stream, rows: np.ndarray) -> Stream:
    """A stream without some of its samples, (n,) bool."""
    if not rows.any():
        return stream
    return Stream(stream.time[~rows], {name: values[~rows] for name, values in stream.values.items()})


def tell_left_out(label: str, rows: np.ndarray, what: str) -> list[str]:
    """One line if there are any rows, (n,) bool."""
    count = int(np.count_nonzero(rows))
    return [f"{label}: {count} of {len(rows)} samples {what}, left out"] if count else []
