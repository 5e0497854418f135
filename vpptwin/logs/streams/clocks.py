"""Header stamps: put in order, held against log times and each other; clocks that run backwards or leap are refused.

Each clock is read against the recorder's: what it is off by, and how it drifts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vpptwin.system.errors import InputError

if TYPE_CHECKING:
    from vpptwin.logs.streams.samples import Samples

MAX_OFFSET = 0.5
"""Messages of two topics that were recorded together may be stamped so far apart [s]: no transport takes longer."""
BLOCKS = 20
"""The drift is a line through the quickest message of each of so many blocks: transport only ever adds."""
STEP, STEADY = 0.05, 20
"""A clock steps where stamps leap by so much [s] and log times do not, from the messages before to so many after."""
ALIKE = 0.1
"""Log times tell of a clock if they span what its stamps span, within this share: some tools write whatever."""
MAX_LATE = 0.5  # s, how late a message may come and still be sorted in
MAX_CLOCK_DISTANCE = 3600.0  # s between two topics of one recording
MAX_PERIOD = 3.0  # s from message to message, without a gap, from which the unit is doubted
FASTEST_RATE, FAST_COUNT = 100_000.0, 1000
"""Messages a second of one topic that no rig logs, and how many of them tell that its clock is misread."""
MIN_RATE = 10.0  # messages per s, all topics together, that a log of more than that has; else someone set a clock
GAP_PERIODS = 5.0  # a gap is longer than this many median periods
_STAMP_ADVICE = "stamp each message with the time at which it was measured or commanded"


@dataclass(frozen=True)
class Clock:
    """What one topic's stamps are against the time of recording."""

    latency: float  # median time from stamp to record [s]
    jitter: float  # spread of that time, 1 sigma [s]
    drift: float  # by which the stamps' clock runs fast against the recorder's [s/s]


def read_clock(samples: Samples) -> Clock | None:
    """The clock of one topic, from samples in order of stamps; None where log times tell nothing of it."""
    if len(samples.stamp) < 2 * BLOCKS:
        return None
    if samples.log_time is samples.stamp:
        return Clock(0.0, 0.0, 0.0)
    since, logged = ((times - times[0]) * 1e-9 for times in (samples.stamp, samples.log_time))
    if abs(logged[-1] - since[-1]) > ALIKE * since[-1] + MAX_OFFSET:
        return None
    late = (samples.log_time - samples.stamp) * 1e-9
    latency = float(np.median(late))
    blocks = np.array_split(np.arange(len(late)), BLOCKS)
    quickest = [rows[np.argmin(late[rows])] for rows in blocks]
    # late = offset - drift t through the least delays, to which queues add nothing (Moon, Skelly & Towsley 1999)
    drift = -float(np.polyfit(since[quickest], late[quickest], 1)[0])
    # sigma = MAD / 0.6745 of a normal distribution (Rousseeuw & Croux 1993)
    return Clock(latency, float(np.median(np.abs(late - latency)) / 0.6745), drift)


def check_offsets(clocks: Mapping[str, Clock], path: str) -> None:
    """Refuse topics that were recorded together but stamped by clocks set to different times."""
    if len(clocks) < 2:
        return
    quick, slow = (chosen(clocks, key=lambda topic: clocks[topic].latency) for chosen in (min, max))
    offset = clocks[slow].latency - clocks[quick].latency
    if offset > MAX_OFFSET:
        raise InputError(
            f"{path}: {slow} is stamped {offset:.2f} s earlier than messages on {quick} that were recorded with it",
            "all topics stamped by one clock",
            f"set the clocks by NTP or PTP, or give {slow} `stamp: log_time` in a topic map",
        )


def check_steps(samples: Samples, path: str) -> None:
    """Refuse a topic, in record order, whose clock steps within the flight: stamps leap where log times do not."""
    if len(samples.stamp) < 2 * STEADY or samples.log_time is samples.stamp:
        return
    stamp, logged = ((times - times[:1]) * 1e-9 for times in (samples.stamp, samples.log_time))
    between, apart = np.diff(stamp), np.diff(logged)
    period = float(np.median(between))
    ratio = float(np.median(apart)) / max(period, 1e-9)
    if abs(logged[-1] - stamp[-1]) > ALIKE * stamp[-1] + MAX_OFFSET or not 0.5 < ratio < 2.0:
        return  # log times tell nothing
    leaps = np.flatnonzero((np.abs(between - apart) > STEP) & (apart < 3.0 * period + 0.5 * STEP))
    late = logged - stamp
    for at in leaps:
        before, after = late[max(at + 1 - STEADY, 0) : at + 1], late[at + 1 : at + 1 + STEADY]
        change = float(np.median(before) - np.median(after))
        steady = max(float(np.ptp(part)) for part in (before, after)) < 0.5 * abs(change)
        if min(len(before), len(after)) == STEADY and abs(change) > STEP and steady:
            raise refuse_step(path, samples.label, float(logged[at + 1]), change)


def refuse_step(path: str, topic: str, time: float, change: float) -> InputError:
    """What is said of a clock that steps by `change` [s], about so long [s] after the topic's first message."""
    return InputError(
        f"{path}: the clock of {topic} steps by {change:+.2f} s against the others, about {time:.1f} s into the log",
        "clocks that run through",
        "cut the log there, set clocks before recording only, or give the topic `stamp: log_time` in a topic map",
    )


def order_stamps(stamps: np.ndarray, path: str, topic: str) -> tuple[slice | np.ndarray, tuple[str, ...]]:
    """Indices that sort stamps, (n,) ns in record order, and drop repeated ones (the first stays), and warnings."""
    unset = int(np.count_nonzero(stamps == 0))
    # Among small stamps a zero is the start of a simulated clock, not a stamp left unset.
    if unset and (2 * unset > len(stamps) or stamps[stamps != 0].min() > MAX_CLOCK_DISTANCE * 1e9):
        found = f"{path}: {topic}: {unset} of {len(stamps)} messages have no header stamp (zero)"
        raise InputError(found, "header.stamp set", _STAMP_ADVICE)
    if (stamps[1:] > stamps[:-1]).all():
        return slice(None), ()
    check_order(stamps, path, topic)
    lateness = np.maximum.accumulate(stamps) - stamps
    late = int(np.count_nonzero(lateness))
    order = np.argsort(stamps, kind="stable")
    repeats = np.flatnonzero(np.diff(stamps[order]) == 0) + 1
    warnings = []
    if late:
        worst = lateness.max() * 1e-9
        warnings.append(f"{late} of {len(stamps)} messages on {topic} out of order by up to {worst:.3g} s, sorted")
    if len(repeats):
        warnings.append(f"{len(repeats)} of {len(stamps)} messages on {topic} repeat a stamp, dropped")
    return np.delete(order, repeats), tuple(warnings)


def check_order(stamps: np.ndarray, path: str, topic: str) -> None:
    """Refuse stamps, (n,) ns in record order, that run backwards, or are those of a clock that is rounded.

    Raises:
        InputError: saying where they fall, or how to give the rate.
    """
    lateness = np.maximum.accumulate(stamps) - stamps
    falling = int(np.count_nonzero(np.diff(stamps) < 0))
    if lateness.max() > MAX_LATE * 1e9 or (len(stamps) > 2 and falling > len(stamps) // 2):
        index = int(np.argmax(lateness))
        raise InputError(
            f"{path}: time runs backwards on {topic}, message {index + 1} of {len(stamps)} is stamped "
            f"{lateness[index] * 1e-9:.3f} s before an earlier one",
            f"header stamps that increase, up to {MAX_LATE} s of disorder",
            "look for a clock that was set, a recording that looped, or several recordings in one file",
        )
    some = np.unique(stamps)
    if 2 * len(some) < len(stamps):
        found = f"{path}: {topic}: {len(stamps) - len(some)} of {len(stamps)} messages repeat a stamp"
        advice = _STAMP_ADVICE
        if len(some) > 2:
            rate = count_rate(stamps)
            found += f", {len(stamps) / len(some):.3g} have each"
            advice += f", or give the rate at which they come: `stamp: {{rate: {rate:.4g}}}` beside the topic's fields"
        raise InputError(found, "one stamp per message", advice)


def count_rate(stamps: np.ndarray) -> float:
    """Messages a second of a clock that is rounded, by the stamps (n,) ns between the first and the last of them."""
    inner = stamps[(stamps > stamps[0]) & (stamps < stamps[-1])]
    first = int(inner.min()) if len(inner) else int(stamps[0])
    return len(inner) / max((int(stamps[-1]) - first) * 1e-9, 1e-9)


def space_stamps(label: str, stamps: np.ndarray, rate: float) -> np.ndarray:
    """Stamps (n,) ns of messages that come at a rate [Hz], from the first on; those given are rounded."""
    made = stamps[0] + np.rint(np.arange(len(stamps)) * (1e9 / rate)).astype(np.int64)
    steps = np.diff(stamps)
    coarse = float(steps[steps > 0].max(initial=0)) if len(steps) else 0.0
    if np.ptp(made - stamps) > 2.0 * coarse + 0.02 * float(np.ptp(stamps)):
        spans = (
            f"{np.ptp(made) * 1e-9:.4g} s of {len(stamps)} messages that are stamped over {np.ptp(stamps) * 1e-9:.4g} s"
        )
        advice = f"give {count_rate(stamps):.3g}, or correct the stamps"
        raise InputError(f"{label}: a rate of {rate:g} Hz makes {spans}", "the rate of the log", advice)
    return made


def describe_gaps(time: np.ndarray, label: str) -> tuple[str, ...]:
    """Warn of gaps in a stream that should come at a constant rate; time (n,) s, increasing."""
    if len(time) < 3:
        return ()
    threshold = GAP_PERIODS * float(np.median(np.diff(time), overwrite_input=True))
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > threshold)
    if not len(gaps):
        return ()
    worst = gaps[np.argmax(steps[gaps])]
    return (
        f"{len(gaps)} {'gap' if len(gaps) == 1 else 'gaps'} over {threshold:.3g} s on {label}, "
        f"the longest {steps[worst]:.3g} s at {time[worst]:.3f} s",
    )


def check_clocks(spans: dict[str, tuple[int, int]], path: str) -> None:
    """Refuse topics stamped by clocks that have nothing to do with each other; spans: first and last stamp [ns]."""
    early = min(spans, key=lambda topic: spans[topic][1], default="")
    late = max(spans, key=lambda topic: spans[topic][0], default="")
    distance = (spans[late][0] - spans[early][1]) * 1e-9 if spans else 0.0
    if distance > MAX_CLOCK_DISTANCE:
        raise InputError(
            f"{path}: {late} is stamped {distance:.0f} s after {early} ends",
            "one clock for all topics",
            "stamp all topics by the same clock (all simulated time, or all wall time)",
        )


def check_leaps(stamps: Mapping[str, np.ndarray], path: str) -> None:
    """Refuse clocks that leap or race, before anything is laid out over the time they leap; topic -> stamps (n,) ns."""
    for topic, part in stamps.items():
        taken = float(part.max() - part.min()) * 1e-9
        if len(part) >= FAST_COUNT and 0.0 < taken < len(part) / FASTEST_RATE:
            raise InputError(
                f"{path}: {len(part)} messages of {topic} in {taken:.4g} s",
                f"at most {FASTEST_RATE:,.0f} messages a second",
                "if its clock counts seconds, name the column so (`time_s`) or say `stamp: {path: NAME, unit: s}`",
            )
    span = float(max(part.max() for part in stamps.values()) - min(part.min() for part in stamps.values())) * 1e-9
    if span <= MAX_CLOCK_DISTANCE:
        return
    count = sum(map(len, stamps.values()))
    apart = list({id(part): part for part in stamps.values()}.values())  # topics share theirs
    every = apart[0] if len(apart) == 1 else np.sort(np.concatenate(apart))
    steps = np.diff(every)
    if steps.max() <= MAX_CLOCK_DISTANCE * 1e9 and count >= MIN_RATE * span:
        return
    after = every[np.argmax(steps) + 1]
    topic = next(name for name, part in stamps.items() if after in part)
    index = int(np.searchsorted(stamps[topic], after))
    usual = float(np.median(steps)) * 1e-9
    if usual > MAX_PERIOD and steps.max() <= GAP_PERIODS * usual * 1e9:
        raise InputError(
            f"{path}: {count} messages over {span:.4g} s, one of {topic} every {usual:.4g} s",
            f"at least {MIN_RATE:g} messages a second",
            "if those are milliseconds, name the column so (`time_ms`) or say `stamp: {path: NAME, unit: ms}`",
        )
    raise InputError(
        f"{path}: {count} messages over {span:.4g} s, and the clock of {topic} leaps forward by "
        f"{steps.max() * 1e-9:.4g} s before message {index + 1} of {len(stamps[topic])}",
        f"at most {MAX_CLOCK_DISTANCE:g} s without any message",
        "look for a clock that was set, cut the log there, or give `stamp: log_time` in a topic map",
    )
