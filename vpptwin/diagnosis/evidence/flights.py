"""Flights cut into windows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.channels import BIN, LEAD, choose_bin, join_channels, observe_windows
from vpptwin.diagnosis.evidence.forces import measure_growth, measure_turning
from vpptwin.diagnosis.evidence.motor import observe_motor
from vpptwin.diagnosis.evidence.runs import MakeTwin
from vpptwin.estimation.gaps import usable_starts
from vpptwin.estimation.measurements import Measurements
from vpptwin.estimation.strikes import mark_strikes
from vpptwin.estimation.windows import cut_windows, join_windows
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

HORIZONS_S = (0.05, 0.1, 0.25, 0.5, 1.0)
"""How far ahead predictions are judged [s]."""
SHOWN = 3
"""Place of the horizon at which a twin matters, half a second: beyond noise, and near what a controller plans."""
SEGMENT = 0.1
"""Length of a gust pulse [s]."""
MANY_PULSES = 3
"""Degrees of freedom beyond which pulses are twice as long."""
FEWEST_PULSES = 5
"""Of them in a window then: a gust that stays the same throughout is no noise, but one more law."""
SETTLE = 0.2
"""Start of a log left to the estimate of the first state [s]."""
MIN_JUDGES = 3
"""Fewest held-out windows: with fewer a gain has no standard error, and anything may be named."""
MIN_RATE = 20.0
"""Lowest mean rate of poses [Hz]: a window needs a few of them."""
MAX_WINDOWS = 240
"""More windows than this are thinned out evenly: they would refine figures that model error limits anyway."""
MAX_LONG_WINDOWS = 90
"""The same of windows of a rig that nobody knows, which are longer."""
GROWN, LEAST_WINDOW = 2.5, 0.2
"""Errors of a window's start may grow by this much on a logarithmic scale; windows no shorter than that [s]."""
MANY_JOINTS = 1.5
"""Degrees of freedom from which fewer windows do: each shows more, and costs more."""


def choose_window(spec: TwinSpec, measurements: Sequence[Measurements]) -> tuple[TwinSpec, list[Measurements]]:
    """The twin with windows short enough for these logs, and the logs, which warn if that is shorter than usual.

    They know where the rig strikes something, too, and warn of that: windows there are left out.
    Where motion is unstable errors grow past all linear thought within a second: windows end before.

    Raises:
        InputError: if a log is too short for any.
    """
    robot = spec.robot
    for flight in measurements:
        if flight.duration < robot.shortest_log:
            raise InputError(
                f"{flight.name}: {max(flight.duration, 0.0):.1f} s in which all needed topics were recorded",
                f"at least {robot.shortest_log:g} s",
                "log for longer",
            )
    measurements = [mark_strikes(spec.model, flight, robot.window) for flight in measurements]
    usual = robot.window if robot.disturbance.known else find_steady(spec, measurements)
    shorter = range(max(round((usual - robot.shortest_window) / SEGMENT), 0) + 1)
    lengths = [round(usual - SEGMENT * i, 6) for i in shorter]
    judges = (count_judges(measurements, length) for length in lengths)
    chosen = next((length for length, n in zip(lengths, judges) if n >= MIN_JUDGES), lengths[-1])
    if chosen == usual:
        return spec.with_robot(window=usual), measurements
    told = (
        f"so short that windows have {chosen:g} s instead of {usual:g} s: strong effects that act all the time are "
        "identifiable; weak, slow or rare ones are not, the share of the error is rough, and errors beyond a window "
        "are not wholly on held-out data; log for longer, or log again"
    )
    spec = spec.with_robot(window=chosen, is_short=True)
    return spec, [replace(m, warnings=(*m.warnings, told)) for m in measurements]


def find_steady(spec: TwinSpec, measurements: Sequence[Measurements]) -> float:
    """Length of windows [s], in steps of 0.1 s, in which errors of the start grow by exp(`GROWN`) at most.

    And in which a free body does not lose its way altogether.
    """
    rate = measure_growth(spec, measurements)
    longest = min(GROWN / rate if rate > 0.0 else np.inf, measure_turning(spec, measurements))
    steady = np.floor(longest / SEGMENT + 1e-6) * SEGMENT
    return float(round(np.clip(steady, LEAST_WINDOW, spec.robot.window), 6))


def count_judges(measurements: Sequence[Measurements], window: float) -> int:
    """Windows of a length [s] that may be a fold: a third of a lone flight's, else all of the poorest flight."""
    counts = [len(cut_flight(flight, window)) for flight in measurements]
    return min(counts) if len(counts) > 1 else counts[0] // 3


def cut_flight(flight: Measurements, window: float) -> np.ndarray:
    """Start times of adjacent windows of a length [s] that no gap spoils, (K,) s."""
    found = np.arange(flight.start + SETTLE, flight.end - window, window)
    return found[usable_starts(flight, found, window)]


def list_starts(measurements: Sequence[Measurements], window: float) -> list[np.ndarray]:
    """Start times of adjacent windows over every flight.

    Raises:
        InputError: if a flight was recorded too rarely or with too many gaps.
    """
    starts = []
    for flight in measurements:
        for series in flight.positions.values():
            rate = (len(series.time) - 1) / max(float(np.ptp(series.time)), 1e-9)
            if rate < MIN_RATE:
                raise InputError(
                    f"{flight.name}: {series.name} was measured {rate:.2g} times a second on average",
                    f"at least {MIN_RATE:g} Hz",
                    "look for what interrupts the tracker or the recorder",
                )
        kept = cut_flight(flight, window)
        if len(kept) < MIN_JUDGES:
            raise InputError(
                f"{flight.name}: gaps leave {len(kept)} usable windows of {window:g} s",
                f"at least {MIN_JUDGES}",
                "look for what interrupts the tracker or the recorder",
            )
        starts.append(kept)
    return starts


def thin_out(spec: TwinSpec, starts: list[np.ndarray], judging: bool = False) -> list[np.ndarray]:
    """As many start times as are looked at, evenly spread over all flights; half of them where they are `judging`."""
    long = round(MAX_LONG_WINDOWS / spec.robot.window / max(spec.model.nv / MANY_JOINTS, 1.0))
    limit = (MAX_WINDOWS if spec.robot.disturbance.known else long) // (1 + judging)
    total = sum(len(s) for s in starts)
    return [s[:: max(-(-total // limit), 1)] for s in starts] if total > limit else starts


def build_bench(
    spec: TwinSpec, measurements: Sequence[Measurements], starts: Sequence[np.ndarray], length: float, causal: bool,
    progress: Callable[[int], None] | None = None, criteria: Criteria = CRITERIA, fine: bool = False,
    make_twin: MakeTwin = Twin,
) -> Bench:  # fmt: skip
    """Windows and channels of several flights on one bench, in bins of `BIN` where they are `fine` or sensors known."""
    fine = fine or spec.robot.disturbance.known
    windows, channels = [], []
    motors = all(None not in (flight.throttle, flight.rotor_speed, flight.current) for flight in measurements)
    for i, (flight, times) in enumerate(zip(measurements, starts)):
        times = times[times <= flight.end - length]
        times = times[usable_starts(flight, times, length)]
        if len(times):
            cut = cut_windows(spec, flight, times, length, causal, i)
            windows.append(cut)
            lead = 0.0 if causal and length > spec.robot.window else LEAD
            seen = observe_windows(cut, flight, lead, criteria, BIN if fine else choose_bin(flight, length))
            if motors:
                seen += observe_motor(cut, flight, spec.vehicle.motor, criteria)
            channels.append(seen)
    if not windows:
        found = f"{' and '.join(flight.name for flight in measurements)}: no {length:g} s in one piece to predict"
        raise InputError(found, "such a stretch without gaps, on what is held out too", "log for longer")
    names = [[c.name for c in part] for part in channels]
    if any(n != names[0] for n in names):
        raise InputError(
            f"logs with different channels ({', '.join(names[0])} and others)",
            "the same topics in every log",
            "diagnose logs of one kind together",
        )
    many = spec.model.nv > MANY_PULSES
    segments = max(round(length / (2.0 * SEGMENT if many else SEGMENT)), FEWEST_PULSES if many else 1)
    joined = join_windows(windows), join_channels(channels)
    return Bench(spec, *joined, segments, measurements, causal, progress, criteria, make_twin)


def long_starts(starts: Sequence[np.ndarray], window: float) -> list[np.ndarray]:
    """Start times of windows as long as the last horizon, at most half overlapping, out of those of short ones."""
    every = max(round(0.5 * HORIZONS_S[-1] / window), 1)
    return [s[::every] for s in starts]
