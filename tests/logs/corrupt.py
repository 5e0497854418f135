"""Recordings spoilt as real ones are: each function takes one and returns another, the rest untouched.

Stamps, records and values are spoilt apart: where a clock is wrong the stamp moves and the time of record stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from proving.drone.recording import Recording, Topic

POSE, IMU, POLICY, COMMAND, STATE = "/mocap/pose", "/imu/data", "/cmd/rate_thrust", "/rotor/command", "/rotor/state"


def change(recording: Recording, name: str, topic: Topic) -> Recording:
    """The recording with one topic replaced."""
    return replace(recording, topics={**recording.topics, name: topic})


def edit(recording: Recording, name: str, **columns: np.ndarray) -> Recording:
    """The recording with other columns of one topic."""
    topic = recording.topics[name]
    return change(recording, name, replace(topic, columns={**topic.columns, **columns}))


def copy_columns(topic: Topic) -> dict[str, np.ndarray]:
    """A topic's columns, to be written into."""
    return {column: np.array(data, dtype=float) for column, data in topic.columns.items()}


def take(topic: Topic, rows: np.ndarray) -> Topic:
    """Some of a topic's messages, by index or mask."""
    columns = {name: np.asarray(values)[rows] for name, values in topic.columns.items()}
    return replace(topic, time=topic.time[rows], latency=topic.latency[rows], columns=columns)


def move(topic: Topic, late: np.ndarray | float) -> Topic:
    """The messages with other stamps [s], recorded when they were."""
    return replace(topic, time=topic.time + late, latency=topic.latency - late)


def remove(recording: Recording, *names: str) -> Recording:
    """Without some topics."""
    return replace(recording, topics={k: v for k, v in recording.topics.items() if k not in names})


def drop(recording: Recording, name: str, share: float, rng: np.random.Generator) -> Recording:
    """Without a share of a topic's messages, here and there."""
    topic = recording.topics[name]
    return change(recording, name, take(topic, rng.random(len(topic.time)) >= share))


def cut(recording: Recording, name: str, begin: float, end: float) -> Recording:
    """Without a topic's messages from begin to end [s]."""
    topic = recording.topics[name]
    return change(recording, name, take(topic, (topic.time < begin) | (topic.time >= end)))


def jitter(recording: Recording, name: str, std: float, rng: np.random.Generator) -> Recording:
    """A topic's stamps off by some noise [s]."""
    topic = recording.topics[name]
    return change(recording, name, move(topic, std * rng.standard_normal(len(topic.time))))


def offset(recording: Recording, name: str, seconds: float, drift: float = 0.0) -> Recording:
    """A topic stamped by a clock that is ahead by `seconds` and gains `drift` [s/s]."""
    topic = recording.topics[name]
    return change(recording, name, move(topic, seconds + drift * topic.time))


def shuffle(recording: Recording, name: str, late: float, rng: np.random.Generator) -> Recording:
    """A topic recorded up to `late` [s] late, so that its messages lie out of order."""
    topic = recording.topics[name]
    return change(recording, name, replace(topic, latency=topic.latency + late * rng.random(len(topic.time))))


def repeat(recording: Recording, name: str, share: float, rng: np.random.Generator) -> Recording:
    """A share of a topic's messages recorded twice."""
    topic = recording.topics[name]
    twice = np.where(rng.random(len(topic.time)) < share, 2, 1)
    return change(recording, name, take(topic, np.repeat(np.arange(len(twice)), twice)))


def spike(
    recording: Recording, name: str, columns: Mapping[str, float], share: float, rng: np.random.Generator
) -> tuple[Recording, np.ndarray]:
    """A share of a topic's samples off, each in one column by half of its size to all of it, and which, (n,) bool."""
    topic = recording.topics[name]
    bad = rng.random(len(topic.time)) < share
    which = rng.choice(list(columns), len(bad))
    values = copy_columns(topic)
    for column, size in columns.items():
        rows = np.flatnonzero(bad & (which == column))
        values[column][rows] += size * rng.uniform(0.5, 1.0, len(rows)) * rng.choice([-1.0, 1.0], len(rows))
    return edit(recording, name, **values), bad


def swap(recording: Recording, begin: float, end: float, x: float, z: float, angle: float) -> Recording:
    """The tracker follows another body from begin to end [s], beside and turned against the right one [m, rad]."""
    topic = recording.topics[POSE]
    rows = (topic.time >= begin) & (topic.time < end)
    values = copy_columns(topic)
    half = np.arctan2(-values["qy"][rows], values["qw"][rows]) + 0.5 * angle
    values["x"][rows] += x
    values["z"][rows] += z
    values["qy"][rows], values["qw"][rows] = -np.sin(half), np.cos(half)
    return edit(recording, POSE, **values)


def freeze(recording: Recording, begin: float, end: float) -> Recording:
    """The tracker repeats one pose from begin to end [s]."""
    topic = recording.topics[POSE]
    rows = np.flatnonzero((topic.time >= begin) & (topic.time < end))
    values = copy_columns(topic)
    for data in values.values():
        data[rows] = data[rows[0]]
    return edit(recording, POSE, **values)


def scale(recording: Recording, name: str, factor: float, *columns: str) -> Recording:
    """Columns in another unit."""
    topic = recording.topics[name]
    return edit(recording, name, **{column: factor * np.asarray(topic.columns[column]) for column in columns})


def hold(recording: Recording, name: str, *columns: str, begin: int = 0, end: int | None = None) -> Recording:
    """Columns of a topic that repeat one value from one message to another."""
    held = {column: np.array(recording.topics[name].columns[column]) for column in columns}
    for values in held.values():
        values[begin:end] = values[begin + 10]
    return edit(recording, name, **held)


def copy_column(recording: Recording, name: str, source: str, target: str) -> Recording:
    """One column in the place of another."""
    return edit(recording, name, **{target: recording.topics[name].columns[source]})


def set_clock(recording: Recording, name: str, at: float, by: float) -> Recording:
    """The clock that stamps a topic is set ahead at a time [s] by some [s]."""
    topic = recording.topics[name]
    return change(recording, name, move(topic, np.where(topic.time > at, by, 0.0)))


def put(recording: Recording, name: str, row: int, **values: float) -> Recording:
    """Other values in one message of a topic."""
    columns = copy_columns(recording.topics[name])
    for column, value in values.items():
        columns[column][row] = value
    return edit(recording, name, **columns)
