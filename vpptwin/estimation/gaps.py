"""Which stretches of a flight were recorded well enough to be compared with a twin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from vpptwin.estimation.series import Measurements

LOOK_BACK = 0.15
"""Before a window its commands run through the actuators and its state is estimated [s]."""
MAX_HOLD = 0.05
"""A command is believed to have been held for so long without a new one, at most [s]."""
MAX_POSE_GAP, MAX_INERTIAL_GAP, MAX_SPEED_GAP = 0.12, 0.02, 0.1
"""Gaps that estimates of pose, of inertial displacement and of rotor speed bridge [s]."""
PERIODS = 4.0
"""No gap is shorter than this many median periods of its stream."""
UNSTEADY = 5.0
"""Ratio of a stream's long to its short periods (90th to 10th percentile) beyond which it speaks on change only."""
MAX_CUT = 0.1
"""Share of the flight that may fall outside the common span unmentioned."""
PROBE = 0.3
"""Length of the windows by which the share of a flight that gaps spoil is told [s]."""


def usable_starts(measurements: Measurements, starts: np.ndarray, length: float) -> np.ndarray:
    """Whether windows of a length [s] from `starts` (K,) [s] touch no gap or strike that spoils them, (K,) bool."""
    spoilt = touch(measurements.strikes, starts - LOOK_BACK, starts + length)
    for _, rows in spoil_starts(measurements, starts, length):
        spoilt |= rows
    return ~spoilt


def spoil_starts(measurements: Measurements, starts: np.ndarray, length: float) -> Iterator[tuple[str, np.ndarray]]:
    """Name of each quantity that has gaps, and which windows these spoil, (K,) bool."""
    before, ends = starts - LOOK_BACK, starts + length
    command = measurements.command
    yield command.name, touch(find_gaps(command.time, MAX_HOLD) + np.array([MAX_HOLD, 0.0]), before, ends)
    for series in measurements.positions.values():
        gaps = find_gaps(series.time, MAX_POSE_GAP)
        lost = touch(gaps, before, starts + MAX_HOLD) | (overlap(gaps, starts, ends) > 0.5 * length)
        yield "poses" if measurements.delayed else series.name, lost
    for inertial in (*measurements.velocities.values(), measurements.specific_force):
        if inertial is not None and measurements.specific_force is not None:
            gaps = find_gaps(inertial.time, MAX_INERTIAL_GAP)
            yield inertial.name, touch(gaps, before, starts + LOOK_BACK)
    for held in (measurements.rotor_speed, *measurements.driven.values()):
        if held is not None:
            yield held.name, touch(find_gaps(held.time, MAX_SPEED_GAP), starts, ends)


def tell_gaps(measurements: Measurements) -> list[str]:
    """How much of the flight gaps make useless, in at most one line."""
    starts = np.arange(measurements.start + LOOK_BACK, measurements.end - PROBE, 0.1)
    spoilt = {name: rows for name, rows in spoil_starts(measurements, starts, PROBE) if rows.any()}
    if not spoilt:
        return []
    share = float(np.mean(np.any(list(spoilt.values()), axis=0)))
    return [f"gaps in {', '.join(dict.fromkeys(spoilt))} leave out {max(share, 0.01):.0%} of the flight"]


def tell_cut(spans: Mapping[str, tuple[float, float]]) -> list[str]:
    """Which topics start late or end early, if that costs a notable share of the flight, in at most one line.

    The spans are topic → first and last sample [s].
    """
    begin, end = min(first for first, _ in spans.values()), max(last for _, last in spans.values())
    start, stop = max(first for first, _ in spans.values()), min(last for _, last in spans.values())
    allowed = 0.5 * MAX_CUT * (end - begin)
    if stop - start >= (1.0 - MAX_CUT) * (end - begin):
        return []
    late = [f"{name} starts {a - begin:.1f} s late" for name, (a, _) in spans.items() if a - begin > allowed]
    early = [f"{name} ends {end - b:.1f} s early" for name, (_, b) in spans.items() if end - b > allowed]
    used = max(stop - start, 0.0)
    return [f"only {used:.1f} of {end - begin:.1f} s are common to all topics: {', '.join(late + early)}"]


def find_gaps(time: np.ndarray, longest: float) -> np.ndarray:
    """Gaps longer than `longest` [s] and than a few median periods, as (begin, end) rows; none in irregular streams."""
    steps = np.diff(time)
    if len(steps) < 3:
        return np.zeros((0, 2))
    short, period, long = np.percentile(steps, [10.0, 50.0, 90.0])
    if long > UNSTEADY * short:
        return np.zeros((0, 2))
    rows = np.flatnonzero(steps > max(longest, PERIODS * period))
    return np.stack([time[rows], time[rows + 1]], axis=1)


def touch(gaps: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Which of the intervals begins..ends (K,) overlap any of the gaps (G, 2), (K,) bool."""
    return np.asarray(np.searchsorted(gaps[:, 1], begins, side="right") < np.searchsorted(gaps[:, 0], ends))


def overlap(gaps: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """How much of the intervals begins..ends (K,) the gaps (G, 2) cover, (K,) s."""
    if not len(gaps):
        return np.zeros(len(begins))
    edges, covered = gaps.ravel(), np.append(0.0, np.cumsum(gaps[:, 1] - gaps[:, 0]))
    known = np.repeat(covered, 2)[1:-1]
    return np.asarray(np.interp(ends, edges, known) - np.interp(begins, edges, known))
