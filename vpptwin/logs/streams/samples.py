"""Samples of one topic in record order, before they are sorted, checked and converted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from vpptwin.logs.channels import EULER, JOINT_COLUMNS, SPATIAL, Column, is_joint_state
from vpptwin.logs.formats.headings import count_ns
from vpptwin.logs.formats.layout import STAMP
from vpptwin.logs.messages import shorten_type
from vpptwin.logs.recording import Recording
from vpptwin.logs.streams.clocks import space_stamps
from vpptwin.logs.streams.convert import convert_column, list_fields
from vpptwin.logs.topic_map import LOG_TIME, JointRoute, Route
from vpptwin.system.errors import InputError, escape_text
from vpptwin.system.fields import NANOSECONDS, Stamp

MAX_STAMP_NS = 2.0**62


@dataclass(frozen=True)
class Samples:
    """Samples of one topic, or of one joint."""

    label: str  # canonical topic, and name of the joint
    stamp: np.ndarray  # (n,) ns
    # when each was recorded, (n,) ns; the array of stamps itself where they are equal, as in tables
    log_time: np.ndarray
    fields: dict[str, np.ndarray]  # message field -> (n,) or (n, k)
    columns: tuple[Column, ...] = ()  # what to make of the fields, for topics of the channel table

    def take(self, rows: slice | np.ndarray) -> Samples:
        """Samples of these rows, in this order; as they are for `slice(None)`."""
        if isinstance(rows, slice):
            return self
        fields = {path: values[rows] for path, values in self.fields.items()}
        stamp = self.stamp[rows]
        log_time = stamp if self.log_time is self.stamp else self.log_time[rows]
        return Samples(self.label, stamp, log_time, fields, self.columns)


def read_samples(recording: Recording, route: Route) -> Samples:
    """Read a topic of the channel table."""
    try:
        columns = route.choose_columns(recording.check_type(route.topic))
    except InputError as error:
        raise InputError(f"{recording.path}: {error.found}", error.expected, error.action) from None
    paths = [path for column in columns for path in list_fields(column.source)]
    return replace(read_fields(recording, route.topic, route.stamp, paths, route.channel.topic), columns=columns)


def read_fields(recording: Recording, topic: str, clock: Stamp, paths: list[str], label: str) -> Samples:
    """These fields of all messages of a topic, in record order.

    Raises:
        InputError: if messages do not decode, or stamps are no times.
    """
    is_stamped = recording.is_table(topic) and clock.unit is None and clock.path != LOG_TIME
    stamp_paths = [STAMP] if is_stamped else list_stamp_fields(clock)
    parts: dict[str, list[np.ndarray]] = {path: [] for path in paths}
    numbers, stamps, log_times = [], [], []
    for batch in recording.decode(topic, [*stamp_paths, *paths]):
        numbers.append(batch.number)
        log_times.append(batch.log_time.view(np.int64))
        label_of = f"{recording.path}: {topic}"
        stamps.append(batch.values[STAMP] if is_stamped else _read_stamps(label_of, clock, batch.values, log_times[-1]))
        for path, held in parts.items():
            held.append(batch.values[path])
    if not numbers:
        return Samples(label, np.zeros(0, np.int64), np.zeros(0, np.int64), {})
    order = find_order(numbers)
    del numbers  # logs of gigabytes leave no room for what is not needed any more
    log_time, stamp = _join(log_times, order), _join(stamps, order)
    if clock.rate is not None:
        log_time = stamp = space_stamps(f"{recording.path}: {topic}", stamp, clock.rate)
    log_time = stamp if np.array_equal(log_time, stamp) else log_time
    log_time, stamp = recording.times.setdefault((topic, clock), (log_time, stamp))
    return Samples(label, stamp, log_time, {path: _join(parts[path], order) for path in parts})


def find_order(numbers: Sequence[np.ndarray]) -> slice | np.ndarray:
    """What puts messages into record order that come in these parts."""
    rising = all((n[1:] > n[:-1]).all() for n in numbers) and all(a[-1] < b[0] for a, b in pairwise(numbers))
    return slice(None) if rising else np.argsort(np.concatenate(numbers), kind="stable")


def _join(parts: list[np.ndarray], order: slice | np.ndarray) -> np.ndarray:
    """Parts as one array in this order; the list is emptied."""
    joined = parts[0] if len(parts) == 1 else np.concatenate(parts)
    parts.clear()
    return joined[order]


def read_named(recording: Recording, route: JointRoute, warnings: list[str]) -> Samples:
    """Read a joint, actuator, body or IMU out of fields; rows in which one of them is no number are left out."""
    topic = recording.find_topic(route.topic)
    if topic is None:
        lacking = f"{recording.path} lacks topic {route.topic}, which {route.name} is mapped to"
        listed = ", ".join(recording.list_topics())
        raise InputError(lacking, f"one of {listed}", "correct the map, or add the file that has it: FILE+FILE")
    label = f"{route.canonical} {escape_text(route.name)}"
    paths = [path for source in route.sources.values() for path in list_fields(source)]
    may_be_joint = not recording.is_table(topic) and set(paths) <= set(JOINT_COLUMNS)
    found = None
    if may_be_joint and is_joint_state(recording.check_type(topic)):
        found = read_joints(recording, topic, topic)[0].get(route.name)
    found = replace(found or read_fields(recording, topic, route.stamp, paths, label), label=label)
    if not len(found.stamp):
        return found
    for path in (path for path in paths if path not in found.fields):
        raise InputError(f"{recording.path}: {topic} has no {path} of {route.name!r}", "it", "name another field")
    values = {column: convert_column(source, found.fields) for column, source in route.sources.items()}
    if "attitude" in values and len(route.sources["attitude"].paths) == len(EULER):
        values["attitude"] = euler_to_quaternion(values["attitude"])
    for column, data in values.items():
        if data.ndim != 1 and len(route.sources[column].paths) == 1:
            path = route.sources[column].paths[0]
            raise InputError(f"{recording.path}: {route.topic} {path} is a list", "a number", f"name {path}[0], say")
        if route.sources[column].axis is not None:
            values[column] = np.unwrap(data)
    empty = np.any([np.isnan(data).reshape(len(data), -1).any(axis=1) for data in values.values()], axis=0)
    if empty.all():
        lacking = f"{recording.path}: {route.topic} has no row with a number as {' and '.join(paths)}"
        raise InputError(lacking, "one in most rows", "name another column")
    if empty.any():
        warnings.append(f"{np.count_nonzero(empty)} of {len(empty)} rows of {route.topic} lack {label}, left out")
    return replace(found, fields=values).take(~empty if empty.any() else slice(None))


def euler_to_quaternion(angles: np.ndarray) -> np.ndarray:
    """Unit quaternions w, x, y, z, (n, 4), of roll, pitch and yaw, (n, 3) rad."""
    # q = q_z(yaw) q_y(pitch) q_x(roll), each (cos a/2, axis sin a/2) (Diebel 2006, eq. 290).
    half = 0.5 * angles.T
    (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    return np.column_stack([w, x, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy])


def list_stamp_fields(stamp: Stamp) -> list[str]:
    """Fields that a time is made of."""
    if stamp.path == LOG_TIME:
        return []
    return [stamp.path] if stamp.unit else [f"{stamp.path}.sec", f"{stamp.path}.nanosec"]


def _read_stamps(label: str, stamp: Stamp, fields: dict[str, np.ndarray], log_time: np.ndarray) -> np.ndarray:
    """Stamps in ns, (n,)."""
    if stamp.path == LOG_TIME:
        return _count_ns(label, log_time, 1)
    parts = [fields[path] for path in list_stamp_fields(stamp)]
    if stamp.unit is None:
        return _count_ns(label, parts[0], 10**9) + _count_ns(label, parts[1], 1)
    return _count_ns(label, parts[0], NANOSECONDS[stamp.unit])


def _count_ns(label: str, values: np.ndarray, factor: int) -> np.ndarray:
    """Values (n,) in units of `factor` ns as whole ns."""
    if values.dtype.kind != "f" and max(abs(int(values.min())), abs(int(values.max()))) < MAX_STAMP_NS / factor:
        return count_ns(values, factor)
    wrong = ~(np.abs(values.astype(float)) < MAX_STAMP_NS / factor)
    if wrong.any():
        found = (
            f"{label}: {np.count_nonzero(wrong)} of {len(values)} stamps are no time, such as {values[wrong][0]:.4g}"
        )
        raise InputError(found, "stamps within 146 years of zero", "correct the program that stamps them")
    return count_ns(values, factor)


def read_spatial(recording: Recording, topic: str) -> Samples:
    """Read a topic of poses, odometry or an IMU: vectors (n, 3), attitudes w, x, y, z (n, 4), as `SPATIAL` has them."""
    parts = list_vectors(recording.check_type(topic))
    found = read_fields(recording, topic, Stamp(), [path for paths in parts.values() for path in paths], topic)
    if not found.fields:
        return found
    fields = {n: np.stack([found.fields[path] for path in paths], axis=1).astype(float) for n, paths in parts.items()}
    # ROS marks what an IMU or an odometry does not tell by NaN, or by zeros throughout.
    known = {name: values for name, values in fields.items() if values.any() and not np.isnan(values).all()}
    return replace(found, fields=known)


def list_vectors(message_type: str) -> dict[str, list[str]]:
    """Column -> the fields of its components, of messages that `SPATIAL` has."""
    columns = {shorten_type(kind): columns for kind, columns in SPATIAL.items()}[shorten_type(message_type)]
    return {name: [f"{path}.{c}" for c in ("wxyz" if name == "attitude" else "xyz")] for name, path in columns.items()}


def read_joints(recording: Recording, topic: str, canonical: str) -> tuple[dict[str, Samples], list[str]]:
    """Read all joints of one JointState topic, which labels call by its canonical name.

    Returns:
        Joint or actuator name -> samples of position, velocity, effort; warnings. Columns that are absent from most
        messages, or NaN throughout, are left out.
    """
    seconds, nanoseconds = list_stamp_fields(Stamp())
    parts: dict[str, list[tuple[np.ndarray, Samples]]] = {}
    for batch in recording.decode(topic, (seconds, nanoseconds, *JOINT_COLUMNS), texts=("name",)):
        names = batch.texts["name"]
        stamp = _read_stamps(f"{recording.path}: {topic}", Stamp(), batch.values, batch.log_time)
        widths = {column: batch.values[column].shape[1] for column in JOINT_COLUMNS}
        for column, width in widths.items():
            if width not in (0, len(names)):
                raise InputError(
                    f"{recording.path}: {topic} has {width} values of {column} for {len(names)} names, {names[:4]}",
                    "one value per name, or none",
                    "correct the program that publishes it",
                )
        for index, name in enumerate(names):
            values = {
                column: batch.values[column][:, index].astype(float, copy=False)
                for column, width in widths.items()
                if width
            }
            part = Samples(name, stamp, batch.log_time.view(np.int64), values)
            parts.setdefault(name, []).append((batch.number, part))
    warnings: list[str] = []
    times: _Times = {}
    labels = {name: f"{canonical} {escape_text(name)}" for name in parts}
    joined = {name: _join_parts(labels[name], items, warnings, times) for name, items in parts.items()}
    return {name: samples for name, samples in joined.items() if len(samples.stamp)}, warnings


_Times = dict[tuple[int, ...], tuple[slice | np.ndarray, np.ndarray, np.ndarray]]


def _join_parts(label: str, parts: list[tuple[np.ndarray, Samples]], warnings: list[str], times: _Times) -> Samples:
    """Samples of one joint, of parts with their record numbers; joints of the same messages share `times`."""
    total = sum(len(part.stamp) for _, part in parts)
    counts = {column: sum(len(p.stamp) for _, p in parts if column in p.fields) for column in JOINT_COLUMNS}
    kept = [column for column, count in counts.items() if count > total / 2]
    usable = [(number, p) for number, p in parts if kept and all(column in p.fields for column in kept)]
    lost = total - sum(len(part.stamp) for _, part in usable)
    if lost:
        warnings.append(f"{lost} of {total} messages on {label} lack {' or '.join(kept) or 'values'}, left out")
    if not usable:
        return Samples(label, np.zeros(0, np.int64), np.zeros(0, np.int64), {})
    key = tuple(id(number) for number, _ in usable)
    if key not in times:
        order = find_order([number for number, _ in usable])
        times[key] = order, _join([p.stamp for _, p in usable], order), _join([p.log_time for _, p in usable], order)
    order, stamp, log_time = times[key]
    values = {column: _join([part.fields[column] for _, part in usable], order) for column in kept}
    values = {column: data for column, data in values.items() if not np.isnan(data).all()}
    count = len(stamp) if values else 0
    return Samples(label, stamp[:count], log_time[:count], values)
