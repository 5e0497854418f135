"""Flights cut into windows, split into those that are fitted and those that only judge."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.channels import LEAD, join_channels, observe_windows
from vpptwin.diagnosis.evidence.motor import observe_motor
from vpptwin.errors import InputError
from vpptwin.estimation.gaps import usable_starts
from vpptwin.estimation.measurements import Measurements
from vpptwin.estimation.windows import cut_windows, join_windows
from vpptwin.twin.spec import TwinSpec

HORIZONS_S = (0.05, 0.1, 0.25, 0.5, 1.0)
"""How far ahead predictions are judged [s]."""
SEGMENT = 0.1
"""Length of a gust pulse [s]."""
SETTLE = 0.2
"""Start of a log left to the estimate of the first state [s]."""
BLOCK = 3.0
"""A single flight is split into blocks of at most this length [s], every third of them held out."""
MIN_DURATION = 5.0
"""Shortest flight that can be diagnosed [s]."""
MIN_JUDGES = 3
"""Fewest held-out windows: with fewer a gain has no standard error, and anything may be named."""
MIN_RATE = 20.0
"""Lowest mean rate of poses [Hz]: a window needs a few of them."""
MAX_WINDOWS = 400
"""More windows than this are thinned out evenly: they would refine figures that model error limits anyway."""


@dataclass(frozen=True)
class Split:
    """Start times per flight, fitted and held out; `whole` tells whether whole flights are held out."""

    fitted: list[np.ndarray]
    held_out: list[np.ndarray]
    whole: bool


def list_starts(measurements: Sequence[Measurements], window: float) -> list[np.ndarray]:
    """Start times of adjacent windows over every flight.

    Raises:
        InputError: if a flight is too short.
    """
    starts = []
    for flight in measurements:
        if flight.duration < MIN_DURATION:
            raise InputError(
                f"{flight.name}: {max(flight.duration, 0.0):.1f} s in which all needed topics were recorded",
                f"at least {MIN_DURATION:g} s",
                "log a longer flight",
            )
        for series in flight.positions.values():
            rate = (len(series.time) - 1) / max(float(np.ptp(series.time)), 1e-9)
            if rate < MIN_RATE:
                raise InputError(
                    f"{flight.name}: {series.name} was measured {rate:.2g} times a second on average",
                    f"at least {MIN_RATE:g} Hz",
                    "look for what interrupts the tracker or the recorder",
                )
        found = np.arange(flight.start + SETTLE, flight.end - window, window)
        kept = found[usable_starts(flight, found, window)]
        if len(kept) < MIN_JUDGES:
            raise InputError(
                f"{flight.name}: gaps leave {len(kept)} usable windows of {window:g} s",
                f"at least {MIN_JUDGES}",
                "look for what interrupts the tracker or the recorder",
            )
        starts.append(kept)
    return starts


def split_flights(measurements: Sequence[Measurements], window: float, judges: Collection[int] = ()) -> Split:
    """Hold out the flights `judges` where there are several, else every third block of the only one."""
    starts = list_starts(measurements, window)
    count = len(measurements)
    if count > 1:
        empty = np.empty(0)
        fitted = [empty if i in judges else s for i, s in enumerate(starts)]
        return Split(fitted, [s if i in judges else empty for i, s in enumerate(starts)], True)
    since = starts[0] - starts[0][0]
    block = (since / min(BLOCK, (since[-1] + window) / 3.0) + 1e-9).astype(int)
    judging, flight = block % 3 == 2, measurements[0]
    if judging.sum() < MIN_JUDGES:
        raise InputError(
            f"{flight.name}: {flight.duration:.1f} s, of which {judging.sum()} windows can be held out",
            f"at least {3 * MIN_JUDGES * window + 2 * SETTLE + window:.0f} s, or several flights",
            "log a longer flight",
        )
    return Split([starts[0][~judging]], [starts[0][judging]], False)


def thin_out(starts: list[np.ndarray], limit: int) -> list[np.ndarray]:
    """At most `limit` start times, evenly spread over all flights."""
    total = sum(len(s) for s in starts)
    return [s[:: max(-(-total // limit), 1)] for s in starts] if total > limit else starts


def build_bench(
    spec: TwinSpec, measurements: Sequence[Measurements], starts: Sequence[np.ndarray], length: float, causal: bool,
    progress: Callable[[int], None] | None = None, criteria: Criteria = CRITERIA,
) -> Bench:  # fmt: skip
    """Windows and channels of several flights on one bench."""
    windows, channels = [], []
    motors = all(None not in (flight.throttle, flight.rotor_speed, flight.current) for flight in measurements)
    for i, (flight, times) in enumerate(zip(measurements, starts)):
        times = times[times <= flight.end - length]
        times = times[usable_starts(flight, times, length)]
        if len(times):
            cut = cut_windows(spec, flight, times, length, causal, i)
            windows.append(cut)
            lead = 0.0 if causal and length > spec.robot.window else LEAD
            seen = observe_windows(cut, flight, lead, criteria)
            if motors:
                seen += observe_motor(cut, flight, spec.vehicle.motor, criteria)
            channels.append(seen)
    names = [[c.name for c in part] for part in channels]
    if any(n != names[0] for n in names):
        raise InputError(
            f"logs with different channels ({', '.join(names[0])} and others)",
            "the same topics in every log",
            "diagnose logs of one kind together",
        )
    segments = max(round(length / SEGMENT), 1)
    joined = join_windows(windows), join_channels(channels)
    return Bench(spec, *joined, segments, measurements, causal, progress, criteria)


def long_starts(starts: Sequence[np.ndarray], window: float) -> list[np.ndarray]:
    """Start times of windows as long as the last horizon, at most half overlapping, out of those of short ones."""
    every = max(round(0.5 * HORIZONS_S[-1] / window), 1)
    return [s[::every] for s in starts]
