"""Writing logs that `ros2 bag`, Foxglove and PlotJuggler open."""

from __future__ import annotations

import contextlib
import math
import os
import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, Writer
from mcap_ros2._dynamic import serialize_dynamic

from vpptwin.logs.channels import CHANNELS, JOINT_COLUMNS, JOINT_STATE, MessageChannel
from vpptwin.logs.flight import Stream
from vpptwin.logs.formats.decode import find_leaf
from vpptwin.logs.formats.layout import MessageLayout, compose_message, parse_definition
from vpptwin.logs.formats.raw import RawChannel
from vpptwin.logs.messages import compose_definition
from vpptwin.logs.streams.convert import Value, split_column
from vpptwin.system.errors import InputError
from vpptwin.system.files import replace_files

# Time zero of logs that have no clock of their own: November 2023, and the same in every run.
START_NS = 1_700_000_000 * 10**9
STRUCT_CODES = {
    "u1": "B", "i1": "b", "u2": "H", "i2": "h", "u4": "I", "i4": "i", "u8": "Q", "i8": "q", "f4": "f", "f8": "d",
}  # fmt: skip


@dataclass(frozen=True)
class Message:
    """One message of a type that holds no samples of ours.

    Attributes:
        topic: any.
        message_type: one of those in `vpptwin.logs.messages`, e.g. `tf2_msgs/msg/TFMessage`.
        time: when it was recorded [s since time zero].
        fields: by name, headers included; what is left out is zero or empty.
    """

    topic: str
    message_type: str
    time: float
    fields: Mapping[str, object]


@dataclass(frozen=True)
class _Template:
    """A message with everything filled in that does not change, and where the rest goes."""

    message: bytearray
    layout: MessageLayout

    def fill(self, path: str, value: Value) -> None:
        """Put a number, or all elements of an array, into the little-endian message."""
        leaf = find_leaf(self.layout, path)
        elements = (value,) if leaf.count is None else value
        form = f"<{1 if leaf.count is None else leaf.count}{STRUCT_CODES[leaf.code]}"
        struct.pack_into(form, self.message, leaf.offset, *elements)  # type: ignore[misc]


class FlightWriter:
    """Writes a log. The file appears when the context closes without an exception, otherwise not at all."""

    def __init__(
        self, path: str | os.PathLike[str], start_ns: int = START_NS, metadata: Mapping[str, str] | None = None
    ) -> None:
        """Open a log for writing.

        Args:
            path: file to write; one that exists is replaced at the end.
            start_ns: stamp of time zero [ns].
            metadata: stored in the file as metadata record `vpptwin`, for instance seed and commit.

        Raises:
            InputError: if the folder cannot be written to.
        """
        self.path = Path(path)
        self.start_ns = start_ns
        self._channels: dict[str | int, int] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._templates: dict[tuple[str, tuple[str, ...], tuple[str, ...]], _Template] = {}
        self._sequence: dict[str, int] = {}
        self._encoders: dict[str, Callable[[Mapping[str, object]], bytes]] = {}
        try:
            self.path.parent.stat()  # a log goes where somebody keeps logs
            with contextlib.ExitStack() as opening:
                drafts = opening.enter_context(replace_files(self.path.parent, [self.path.name]))
                file = opening.enter_context((drafts / self.path.name).open("wb"))
                self._open = opening.pop_all()
        except OSError as error:
            raise self._refuse(error) from None
        self._writer = Writer(file)
        self._writer.start(profile="ros2", library=f"vpptwin {LIBRARY_IDENTIFIER}")
        if metadata:
            self.add_metadata(metadata)

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the file, or remove what was written if there was an exception."""
        try:
            with self._open:
                if error is not None:
                    raise error
                self._writer.finish()
        except OSError as failure:
            raise self._refuse(failure) from failure

    def _refuse(self, error: OSError) -> InputError:
        found = f"{self.path} cannot be written ({error.strerror or error})"
        return InputError(found, "a path to write a log to", "choose another")

    def write(self, topic: str, time: float, values: Mapping[str, Value], log_time: float | None = None) -> None:
        """Write one message.

        Args:
            topic: of the channel table, or one of them below a namespace, such as `/twin/after/mocap/pose`.
            time: of the header stamp [s since time zero].
            values: column -> number or (k,), SI; optional columns left out are written as NaN.
            log_time: when it was recorded [s since time zero]; None for `time`.
        """
        channel = find_channel(topic)
        given = {column.name: values.get(column.name) for column in channel.columns}
        missing = [column.name for column in channel.columns if given[column.name] is None and not column.optional]
        if missing or set(values) - set(given):
            raise ValueError(f"{topic} takes {', '.join(given)}, got {', '.join(values)}")
        template = self._find_template(topic, channel.message_type, channel)
        for column in channel.columns:
            value = given[column.name]
            unknown = math.nan if column.width == 1 else [math.nan] * column.width
            for path, part in split_column(column, unknown if value is None else value).items():
                template.fill(path, part)
        self._add(topic, channel.message_type, template, time, log_time)

    def write_joints(
        self, topic: str, time: float, joints: Mapping[str, Mapping[str, float]], log_time: float | None = None
    ) -> None:
        """Write one JointState message.

        Args:
            topic: e.g. `/joint_states`.
            time: of the header stamp [s since time zero].
            joints: joint or actuator name -> position, velocity, effort; all names with the same of the three.
            log_time: when it was recorded [s since time zero]; None for `time`.
        """
        names = tuple(joints)
        present = tuple(column for column in JOINT_COLUMNS if names and column in joints[names[0]])
        if any(set(values) != set(present) for values in joints.values()):
            raise ValueError(f"{topic}: all names need the same of {', '.join(JOINT_COLUMNS)}")
        template = self._find_template(topic, JOINT_STATE, None, names, present)
        for column in present:
            template.fill(column, [joints[name][column] for name in names])
        self._add(topic, JOINT_STATE, template, time, log_time)

    def write_message(self, message: Message) -> None:
        """Write a message of any type that we have a definition of, encoded by mcap-ros2-support."""
        kind, topic = message.message_type, message.topic
        if kind not in self._encoders:
            self._encoders[kind] = serialize_dynamic(kind, compose_definition(kind))[kind]
        stamp = self.start_ns + round(message.time * 1e9)
        self._sequence[topic] = self._sequence.get(topic, 0) + 1
        content = self._encoders[kind](message.fields)
        self._writer.add_message(self._find_channel(topic, kind, {}), stamp, content, stamp, self._sequence[topic])

    def add_channel(self, channel: RawChannel) -> int:
        """Declare a channel as it was recorded, and its number; once, however often it is called."""
        key = id(channel)  # of several with one topic
        if key not in self._channels:
            schema = self._find_schema(channel.message_type, channel.definition, channel.schema_encoding)
            metadata = {"offered_qos_profiles": ""}
            self._channels[key] = self._writer.register_channel(channel.topic, channel.encoding, schema, metadata)
        return self._channels[key]

    def write_raw(self, channel: int, time: int, content: bytes) -> None:
        """Write a message of a channel by its number, recorded at a log time [ns]."""
        self._writer.add_message(channel, time, content, time)

    def _find_schema(self, message_type: str, definition: str, encoding: str = SchemaEncoding.ROS2) -> int:
        key = message_type, definition
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(message_type, encoding, definition.encode())
        return self._schemas[key]

    def add_metadata(self, metadata: Mapping[str, str]) -> None:
        """Store in the file as metadata record `vpptwin`."""
        self._writer.add_metadata("vpptwin", dict(metadata))

    def _find_template(
        self, topic: str, message_type: str, channel: MessageChannel | None, names: tuple[str, ...] = (),
        present: tuple[str, ...] = (),
    ) -> _Template:  # fmt: skip
        key = (topic, names, present)
        if key not in self._templates:
            definitions = parse_definition(message_type, compose_definition(message_type))
            frame = {"header.frame_id": channel.frame_id if channel else ""}
            strings = frame | {f"name[{index}]": name for index, name in enumerate(names)}
            lengths = {"name": len(names)} | {column: len(names) for column in present}
            template = _Template(*compose_message(definitions, message_type, strings, lengths))
            for path, value in channel.constants.items() if channel else ():
                template.fill(path, value)
            self._templates[key] = template
        return self._templates[key]

    def _add(self, topic: str, message_type: str, template: _Template, time: float, log_time: float | None) -> None:
        stamp = self.start_ns + round(float(time) * 1e9)
        template.fill("header.stamp.sec", stamp // 10**9)
        template.fill("header.stamp.nanosec", stamp % 10**9)
        logged = stamp if log_time is None else self.start_ns + round(float(log_time) * 1e9)
        self._sequence[topic] = self._sequence.get(topic, 0) + 1
        channel, content = self._find_channel(topic, message_type), bytes(template.message)
        self._writer.add_message(channel, logged, content, stamp, self._sequence[topic])

    def _find_channel(self, topic: str, message_type: str, units: Mapping[str, str] | None = None) -> int:
        if topic not in self._channels:
            if units is None and message_type == JOINT_STATE:
                units = JOINT_COLUMNS
            elif units is None:
                units = {column.name: column.unit for column in find_channel(topic).columns}
            listed = ", ".join(f"{name} {unit}" for name, unit in units.items())
            metadata = {"offered_qos_profiles": "", "units": listed}
            schema = self._find_schema(message_type, compose_definition(message_type))
            self._channels[topic] = self._writer.register_channel(topic, MessageEncoding.CDR, schema, metadata)
        return self._channels[topic]


def find_channel(topic: str) -> MessageChannel:
    """The channel whose form messages on a topic take: its own, or that of the canonical topic that it ends with.

    Raises:
        KeyError: if there is none.
    """
    for canonical, channel in CHANNELS.items():
        if topic.endswith(canonical):
            return channel
    raise KeyError(topic)


def write_flight(
    path: str | os.PathLike[str],
    streams: Mapping[str, Stream],
    joints: Mapping[str, Mapping[str, Stream]] | None = None,
    start_ns: int = START_NS,
    metadata: Mapping[str, str] | None = None,
    messages: Iterable[Message] = (),
) -> None:
    """Write whole streams, in order of time.

    Args:
        path: file to write.
        streams: canonical topic -> samples.
        joints: JointState topic -> name -> samples; one message per name and sample.
        start_ns: stamp of time zero [ns].
        metadata: stored in the file.
        messages: more of them, of other types, in order of time.
    """
    waiting = deque(messages)
    entries = [(stream.time, topic, "", stream) for topic, stream in streams.items()]
    entries += [(s.time, topic, name, s) for topic, names in (joints or {}).items() for name, s in names.items()]
    with FlightWriter(path, start_ns, metadata) as writer:
        for index, row in merge_times([entry[0] for entry in entries]):
            time, topic, name, stream = entries[index]
            while waiting and waiting[0].time <= time[row]:
                writer.write_message(waiting.popleft())
            sample = {column: values[row] for column, values in stream.values.items()}
            if name:
                writer.write_joints(topic, float(time[row]), {name: sample})
            else:
                writer.write(topic, float(time[row]), sample)
        for message in waiting:
            writer.write_message(message)


def merge_times(times: Sequence[np.ndarray]) -> Iterator[tuple[int, int]]:
    """Place among `times` and row of every sample, in order of time [s], or of whatever counts them."""
    if not times:
        return
    which = np.concatenate([np.full(len(time), index) for index, time in enumerate(times)])
    row = np.concatenate([np.arange(len(time)) for time in times])
    for place in np.argsort(np.concatenate(times), kind="stable"):
        yield int(which[place]), int(row[place])
