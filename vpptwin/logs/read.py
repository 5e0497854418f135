"""Reading a log: from files to a Flight, checked and in order of the header stamps."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from vpptwin.logs.channels import CHANNELS, JOINT_STATE, JOINT_TOPICS, SPATIAL_COLUMNS, is_joint_state, is_spatial
from vpptwin.logs.check import check_gyro
from vpptwin.logs.flight import Flight
from vpptwin.logs.formats.raw import Query, RawChannel
from vpptwin.logs.formats.tables import is_packed
from vpptwin.logs.recording import Recording, open_recording
from vpptwin.logs.spelling import PathLike, list_flights, spell
from vpptwin.logs.streams.clocks import (
    check_clocks,
    check_leaps,
    check_offsets,
    check_steps,
    describe_gaps,
    order_stamps,
    read_clock,
)
from vpptwin.logs.streams.condense import Condenser
from vpptwin.logs.streams.samples import Samples, read_joints, read_named, read_samples, read_spatial
from vpptwin.logs.streams.streams import build_joint_stream, build_stream, measure_time
from vpptwin.logs.topic_map import SignalEntries, TopicMap, load_topic_map, slash
from vpptwin.system.errors import InputError, escape_text

JointSamples = dict[str, dict[str, Samples]]


def read_flight(
    path: PathLike | Sequence[PathLike], topic_map: PathLike | None = None, signals: SignalEntries | None = None
) -> Flight:
    """Read a log.

    Args:
        path: a log in any format of docs/logs.md, a rosbag2 folder, or a list of the files of one recording.
        topic_map: YAML file for logs with other topics, types or units (docs/logs.md).
        signals: where a twin says that joints and actuators lie, `Signals.entries`.

    Returns:
        All topics of the channel table that have messages, and all joints of all JointState topics.

    Raises:
        InputError: if the log is damaged, is no ROS 2 log, or holds values that cannot be right.
    """
    topics = load_topic_map(topic_map, signals)
    sources = {slash(route.topic) for route in topics.list_routes()}

    def is_wanted(channel: RawChannel) -> bool:
        named = slash(channel.topic) in sources or channel.topic in topics.joints
        return named or is_joint_state(channel.message_type) or is_spatial(channel.message_type)

    take = Condenser(str(spell(path)), topics)
    query = Query(is_wanted, topics.list_fields(), topics.list_stamps(), take)
    recording = open_recording(path, query)
    warnings: list[str] = [note for file in recording.files for note in file.notes]

    def put_in_order(samples: Samples) -> Samples:
        check_steps(samples, str(recording.path))
        order, found = order_stamps(samples.stamp, str(recording.path), samples.label)
        warnings.extend([warning for warning in found if warning not in warnings])
        return samples.take(order)

    read = {topic: put_in_order(samples) for topic, samples in _read_channels(recording, topics, warnings)}
    joints: JointSamples = {}
    spatial: dict[str, Samples] = {}
    taken = {route.topic for route in topics.routes.values()}
    for topic, message_type in recording.list_topics().items():
        canonical = topics.joints.get(topic, topic)
        if topic not in taken and is_joint_state(message_type):
            recording.check_type(topic)
            found, lost = read_joints(recording, topic, canonical)
            warnings += lost
            if found:
                joints[canonical] = {name: put_in_order(item) for name, item in found.items()}
        elif canonical in JOINT_TOPICS and not is_packed(message_type):
            raise InputError(f"{recording.path}: {topic} is of type {message_type}", JOINT_STATE, "record that type")
    for topic, message_type in recording.list_topics().items():
        if topic not in taken and is_spatial(message_type):
            placed = read_spatial(recording, topic)
            if len(placed.stamp) and placed.fields:
                spatial[topic] = put_in_order(placed)
    for route in topics.named:
        signal = read_named(recording, route, warnings)
        if len(signal.stamp) and route.canonical.startswith(tuple(SPATIAL_COLUMNS)):
            spatial[route.canonical] = put_in_order(signal)
        elif len(signal.stamp):
            joints.setdefault(route.canonical, {})[route.name] = put_in_order(signal)
    flight = _assemble_flight(recording, topics, read, joints, spatial, warnings)
    return replace(flight, dropped=tuple(escape_text(name) for names in query.dropped.values() for name in names))


def expand_logs(paths: Iterable[PathLike]) -> list[Path]:
    """The recordings that logs stand for; a line on standard error says how many a folder, a set or a pattern has."""
    found: list[Path] = []
    for path in paths:
        within = list_flights(path)
        if len(within) > 1:
            kind = "is a folder of" if os.path.isdir(path) else "stands for"
            print(f"{path} {kind} {len(within)} recordings", file=sys.stderr)
        found += within
    return found


def _read_channels(recording: Recording, topics: TopicMap, warnings: list[str]) -> Iterator[tuple[str, Samples]]:
    """Canonical topic and samples in record order, of those of the channel table that have messages."""
    for canonical, route in topics.routes.items():
        present = recording.find_topic(route.topic)
        if present is not None and not route.origin and is_packed(recording.list_topics()[present]):
            continue  # a table that is called as a topic of ours
        if present is not None:
            samples = read_samples(recording, route)
            if len(samples.stamp):
                yield canonical, samples
            else:
                warnings.append(f"{route.topic} has no messages")
        elif route.origin:
            warnings.append(f"{route.origin}: {canonical} is mapped to {route.topic}, which the log lacks")


def _assemble_flight(
    recording: Recording, topics: TopicMap, samples: dict[str, Samples], joints: JointSamples,
    spatial: dict[str, Samples], warnings: list[str],
) -> Flight:  # fmt: skip
    path = str(recording.path)
    every = [*samples.values(), *(item for names in joints.values() for item in names.values()), *spatial.values()]
    if not every:
        raise _refuse_foreign(recording)
    check_clocks({item.label: (int(item.stamp[0]), int(item.stamp[-1])) for item in every}, path)
    check_leaps({item.label: item.stamp for item in every}, path)
    clocks = {item.label: clock for item in every if (clock := read_clock(item)) is not None}
    check_offsets(clocks, path)
    start, recorded = (min(int(time.min()) for time in times) for times in zip(*((i.stamp, i.log_time) for i in every)))
    for file in recording.files:
        for channel in file.channels:
            channel.forget()  # logs of gigabytes leave no room for what is not needed any more
    stamps = {id(item.stamp): item.stamp for item in every}  # which all that was read of a topic may share
    times = {key: measure_time(stamp, start) for key, stamp in stamps.items()}
    streams = {topic: build_stream(item, times[id(item.stamp)], path, warnings) for topic, item in samples.items()}
    streams = {topic: stream for topic, stream in streams.items() if stream.values}
    built = {
        topic: {name: build_joint_stream(item, times[id(item.stamp)], path, warnings) for name, item in names.items()}
        for topic, names in joints.items()
    }
    pose, imu = streams.get("/mocap/pose"), streams.get("/imu/data")
    if pose is not None and imu is not None:
        check_gyro(f"{path}: /imu/data", (pose.time, pose["theta"]), (imu.time, imu["rate"]))
    steady = [(topic, stream) for topic, stream in streams.items() if CHANNELS[topic].steady]
    for topic, names in built.items():
        together: dict[bytes, list[str]] = {}  # joints that come in the same messages have the same gaps
        for name, stream in names.items():
            together.setdefault(sha256(stream.time.data).digest(), []).append(name)
        steady += [(escape_text(f"{topic} {', '.join(group)}"), names[group[0]]) for group in together.values()]
    gaps = [warning for label, stream in steady for warning in describe_gaps(stream.time, label)]
    warnings += [warning for warning in gaps if warning not in warnings]
    sources = {canonical: route.topic for canonical, route in topics.routes.items() if route.topic != canonical}
    placed = {topic: build_joint_stream(item, times[id(item.stamp)], path, warnings) for topic, item in spatial.items()}
    return Flight(recording.path, start, streams, built, tuple(warnings), sources, clocks, placed, recorded)


def _refuse_foreign(recording: Recording) -> InputError:
    topics = [f"{topic} ({message_type})" for topic, message_type in recording.list_topics().items()]
    listed = ", ".join(topics[:8]) + (f" and {len(topics) - 8} more" if len(topics) > 8 else "")
    found = f"{recording.path} holds no messages"
    if any(channel.count for file in recording.files for channel in file.channels):
        found = f"{recording.path} has none of our topics with messages, only {listed}"
    action = "name the topics in a topic map if they are recorded under other names"
    if any(map(is_packed, recording.list_topics().values())):
        action = f"have `vpptwin inspect {recording.path} --model MODEL` write a twin that says what its columns are"
    return InputError(found, f"messages on some of {', '.join(CHANNELS)}, or JointState topics", action)
