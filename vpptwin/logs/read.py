"""Reading a flight log: from MCAP files to a Flight, checked and in order of the header stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vpptwin.errors import InputError
from vpptwin.logs.channels import CHANNELS, JOINT_TOPICS, Column, is_joint_state
from vpptwin.logs.check import check_finite, check_gyro, check_limits, check_rotation
from vpptwin.logs.container import RawChannel
from vpptwin.logs.convert import convert_column, list_fields
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.joints import JointSamples, read_joints
from vpptwin.logs.recording import PathLike, Recording, open_recording
from vpptwin.logs.timeline import check_clocks, describe_gaps, order_stamps
from vpptwin.logs.topic_map import LOG_TIME, NANOSECONDS, Route, Stamp, TopicMap, load_topic_map


@dataclass
class _Samples:
    """Samples of a topic in order: stamp (n,) ns; fields path -> (n,) or (n, k)."""

    stamp: np.ndarray
    fields: dict[str, np.ndarray]
    columns: tuple[Column, ...] = ()
    warnings: list[str] = field(default_factory=list)


def read_flight(path: PathLike | Sequence[PathLike], topic_map: PathLike | None = None) -> Flight:
    """Read a flight log.

    Args:
        path: an .mcap file, a rosbag2 folder, or a list of the split files of one recording.
        topic_map: YAML file for logs with other topics, types or units (docs/logs.md).

    Returns:
        All topics of SPEC 3 that have messages, and all joints of all JointState topics.

    Raises:
        InputError: if the log is damaged, is no ROS 2 log, or holds values that cannot be right.
    """
    topics = load_topic_map(topic_map)
    routes = {route.topic: route for route in topics.routes.values()}

    def is_wanted(channel: RawChannel) -> bool:
        return channel.topic in routes or channel.topic in topics.joints or is_joint_state(channel.message_type)

    recording = open_recording(path, is_wanted)
    present = recording.list_topics()
    samples = {
        canonical: _read_samples(recording, route, present[route.topic])
        for canonical, route in topics.routes.items()
        if route.topic in present
    }
    joints = _read_all_joints(recording, topics, present)
    return _assemble_flight(recording, topics, samples, joints)


def _read_samples(recording: Recording, route: Route, message_type: str) -> _Samples:
    try:
        columns = route.choose_columns(message_type)
    except InputError as error:
        raise InputError(f"{recording.path}: {error.found}", error.expected, error.action) from None
    paths = [path for column in columns for path in list_fields(column.source)]
    stamp_paths = _list_stamp_fields(route.stamp)
    batches = recording.decode(route.topic, [*stamp_paths, *paths])
    if not batches:
        return _Samples(np.zeros(0, np.int64), {}, (), [f"{route.topic} has no messages"])
    order = np.argsort(np.concatenate([batch.number for batch in batches]), kind="stable")
    fields = {path: np.concatenate([batch.values[path] for batch in batches])[order] for path in (*stamp_paths, *paths)}
    log_time = np.concatenate([batch.log_time for batch in batches])[order]
    return _Samples(_read_stamps(route.stamp, fields, log_time), fields, columns)


def _list_stamp_fields(stamp: Stamp) -> list[str]:
    if stamp.path == LOG_TIME:
        return []
    return [stamp.path] if stamp.unit else [f"{stamp.path}.sec", f"{stamp.path}.nanosec"]


def _read_stamps(stamp: Stamp, fields: dict[str, np.ndarray], log_time: np.ndarray) -> np.ndarray:
    if stamp.path == LOG_TIME:
        return log_time.astype(np.int64)
    parts = [fields[path] for path in _list_stamp_fields(stamp)]
    if stamp.unit is None:
        return parts[0].astype(np.int64) * 10**9 + parts[1].astype(np.int64)
    factor = NANOSECONDS[stamp.unit]
    whole = np.floor(parts[0])  # apart from the fraction, so that no precision of large counts is lost
    return whole.astype(np.int64) * factor + np.rint((parts[0] - whole) * factor).astype(np.int64)


def _read_all_joints(
    recording: Recording, topics: TopicMap, present: dict[str, str]
) -> dict[str, dict[str, JointSamples]]:
    taken = {route.topic for route in topics.routes.values()}
    joints = {}
    for topic, message_type in present.items():
        canonical = topics.joints.get(topic, topic)
        if is_joint_state(message_type) and topic not in taken:
            joints[canonical] = read_joints(recording, topic)
        elif canonical in JOINT_TOPICS:
            raise InputError(
                f"{recording.path}: {topic} is of type {message_type}", "sensor_msgs/msg/JointState", "record that type"
            )
    return joints


def _assemble_flight(
    recording: Recording, topics: TopicMap, samples: dict[str, _Samples], joints: dict[str, dict[str, JointSamples]]
) -> Flight:
    path = recording.path
    warnings = [
        f"{route.origin}: {canonical} is mapped to {route.topic}, which the log lacks"
        for canonical, route in topics.routes.items()
        if route.origin and canonical not in samples
    ]
    warnings += [warning for item in samples.values() for warning in item.warnings]
    ordered: dict[str, _Samples] = {}
    for topic, item in samples.items():
        if len(item.stamp):
            ordered[topic] = _order_samples(item, path.name, topic, warnings)
    joint_samples: dict[tuple[str, str], _Samples] = {}
    for topic, names in joints.items():
        for name, joint in names.items():
            warnings += joint.warnings
            if len(joint.stamp):
                item = _Samples(joint.stamp, joint.values)
                joint_samples[topic, name] = _order_samples(item, path.name, f"{topic} {name}", warnings)
    spans = {topic: (int(item.stamp[0]), int(item.stamp[-1])) for topic, item in ordered.items()}
    spans |= {" ".join(key): (int(item.stamp[0]), int(item.stamp[-1])) for key, item in joint_samples.items()}
    if not spans:
        raise _refuse_empty(recording)
    check_clocks(spans, str(path))
    start = min(first for first, _ in spans.values())
    streams = {topic: _build_stream(item, start, f"{path}: {topic}", warnings) for topic, item in ordered.items()}
    built: dict[str, dict[str, Stream]] = {}
    for (topic, name), item in joint_samples.items():
        time = (item.stamp - start) / 1e9
        for column, values in item.fields.items():
            check_finite(f"{path}: {topic} {name}", time, column, values)
        built.setdefault(topic, {})[name] = Stream(time, item.fields)
    _compare_streams(str(path), streams)
    for topic, stream in streams.items():
        if CHANNELS[topic].steady:
            warnings += describe_gaps(stream.time, topic)
    for topic, names_built in built.items():
        for name, stream in names_built.items():
            warnings += describe_gaps(stream.time, f"{topic} {name}")
    sources = {canonical: route.topic for canonical, route in topics.routes.items() if route.topic != canonical}
    return Flight(path, start, streams, built, tuple(warnings), sources)


def _order_samples(item: _Samples, file: str, topic: str, warnings: list[str]) -> _Samples:
    order, found = order_stamps(item.stamp, f"{file}: {topic}")
    warnings += found
    return replace(item, stamp=item.stamp[order], fields={path: values[order] for path, values in item.fields.items()})


def _build_stream(item: _Samples, start: int, label: str, warnings: list[str]) -> Stream:
    time = (item.stamp - start) / 1e9  # correctly rounded: a stamp of 1 ms is exactly 0.001
    values: dict[str, np.ndarray] = {}
    for column in item.columns:
        paths = list_fields(column.source)
        if column.optional and all(np.isnan(item.fields[path]).all() for path in paths):
            warnings.append(f"{label}: {column.name} is NaN throughout, left out")
            continue
        for path in paths:
            check_finite(label, time, path, item.fields[path])
        if column.source.axis is not None:
            check_rotation(label, time, column.source, item.fields)
        data = convert_column(column.source, item.fields)
        expected = (len(time),) if column.width == 1 else (len(time), column.width)
        if data.shape != expected:
            raise InputError(
                f"{label}: {', '.join(column.source.paths)} has {data.shape[1:] or 'one'} values per message",
                f"{column.width} for {column.name}",
                "name single fields or array elements in the topic map",
            )
        check_limits(label, time, column, data)
        turns = column.source.axis is not None or column.name == "theta"
        values[column.name] = np.unwrap(data) if turns else data
    return Stream(time, values)


def _compare_streams(path: str, streams: dict[str, Stream]) -> None:
    pose, imu = streams.get("/mocap/pose"), streams.get("/imu/data")
    if pose is not None and imu is not None:
        check_gyro(f"{path}: /imu/data", (pose.time, pose["theta"]), (imu.time, imu["rate"]))


def _refuse_empty(recording: Recording) -> InputError:
    counts: dict[str, str] = {}
    for file in recording.files:
        for channel in file.channels:
            counts[channel.topic] = f"{channel.topic} ({channel.message_type})"
    names = list(counts.values())
    listed = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    ours = any(channel.topic in CHANNELS for file in recording.files for channel in file.channels)
    found = (
        f"{recording.path} has no messages on {listed}"
        if ours
        else f"{recording.path} has only the topics {listed or 'none'}"
    )
    return InputError(
        found,
        f"messages on some of {', '.join(CHANNELS)}, or JointState topics",
        "name the topics in a topic map if they are recorded under other names",
    )
