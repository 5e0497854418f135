"""The clocks that stamped a recording, each read against the recorder's: what they are off by, and how they drift."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vpptwin.logs.streams.samples import Samples
from vpptwin.system.errors import InputError

MAX_OFFSET = 0.5
"""Messages of two topics that were recorded together may be stamped so far apart [s]: no transport takes longer."""
BLOCKS = 20
"""The drift is a line through the quickest message of each of so many blocks: transport only ever adds."""
STEP, STEADY = 0.05, 20
"""A clock steps where stamps leap by so much [s] and log times do not, from the messages before to so many after."""
ALIKE = 0.1
"""Log times tell of a clock if they span what its stamps span, within this share: some tools write whatever."""


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
        "cut the log there, set clocks before flights only, or give the topic `stamp: log_time` in a topic map",
    )
