"""The files of one recording, and what their channels hold before any topic is interpreted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding

from vpptwin.logs.formats.container import list_channels
from vpptwin.logs.formats.decode import Batch, DecodeError, decode_channel
from vpptwin.logs.formats.raw import LARGE, Query, RawChannel, RawFile
from vpptwin.logs.formats.readers import MCAP, find_format, name_table, read_file, read_start
from vpptwin.logs.formats.tables import find_elsewhere, find_field, is_packed
from vpptwin.logs.formats.unpack import ZSTD
from vpptwin.logs.messages import shorten_type
from vpptwin.logs.parts import split_span
from vpptwin.logs.spelling import PathLike, find_files, spell
from vpptwin.system.errors import InputError
from vpptwin.system.fields import Stamp


@dataclass(frozen=True)
class Recording:
    """The files of one recording in the order of their log time, all with ROS 2 messages or tables.

    times: topic and clock -> log times and stamps (n,) ns in record order, which whatever is read of the topic shares.
    """

    path: Path
    files: tuple[RawFile, ...]
    times: dict[tuple[str, Stamp], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def find_topic(self, topic: str) -> str | None:
        """A topic's name in the log, of which people leave out the slash; None if it lacks it."""
        names = topic, f"/{topic}", topic.removeprefix("/")
        return next((name for name in names if name in self._channels), None)

    def list_topics(self) -> dict[str, str]:
        """Topic -> message type, of all channels."""
        return {topic: found[-1][1].message_type for topic, found in self._channels.items()}

    @cached_property
    def _channels(self) -> dict[str, list[tuple[int, RawChannel]]]:
        """Topic -> its channels, each with the position of its file: a bag may have ten thousands."""
        found: dict[str, list[tuple[int, RawChannel]]] = {}
        for index, file in enumerate(self.files):
            for channel in file.channels:
                found.setdefault(channel.topic, []).append((index, channel))
        return found

    def is_table(self, topic: str) -> bool:
        """Whether a topic has rows, in place of messages."""
        return any(channel.rows for _, channel in self._find_channels(topic))

    def check_type(self, topic: str) -> str:
        """Message type of a topic."""
        types = {shorten_type(c.message_type): c.message_type for _, c in self._find_channels(topic)}
        if len(types) > 1:
            raise InputError(
                f"{self.path}: {topic} is recorded as {' and as '.join(types.values())}",
                "one type per topic",
                "record again without the program that publishes the other type",
            )
        return next(iter(types.values()))

    def _find_channels(self, topic: str) -> list[tuple[int, RawChannel]]:
        """Channels of a topic, each with the position of its file."""
        name = self.find_topic(topic)
        return self._channels[name] if name is not None else []

    def decode(self, topic: str, paths: Sequence[str], texts: Sequence[str] = ()) -> Iterator[Batch]:
        """Decode fields of all messages of a topic, or of all rows of a table.

        Args:
            topic: name in the log.
            paths: fields wanted.
            texts: string sequences wanted.

        Yields:
            Batches whose record numbers count across all files.
        """
        for index, channel in self._find_channels(topic):
            refuse_encoding(self.path, [channel])
            names = {path: find_field(channel, path) for path in paths}
            try:
                for batch in decode_channel(channel, list(names.values()), texts):
                    values = {path: batch.values[name] for path, name in names.items()}
                    yield Batch(batch.number + (index << 40), batch.log_time, values, batch.texts)
            except DecodeError as error:
                found = find_elsewhere([c for file in self.files for c in file.channels], channel, paths)
                raise refuse_messages(self.path, channel, paths, error, found) from None


def open_recording(path: PathLike | Sequence[PathLike], query: Query) -> Recording:
    """Read the raw messages of a recording, however it is spelled, or of a list of files, as far as wanted.

    Raises:
        InputError: if there is no such file, it is no log of a kind that is read, or damaged.
    """
    paths = find_files(path)
    files, origin = list[RawFile](), list[int]()
    query = replace(query, names=name_tables([split_span(given)[0] for given in paths], query))
    for given in paths:
        plain, span = split_span(given, origin)
        files.append(read_file(plain, replace(query, span=span)))
        channels = [channel for file in files for channel in file.channels]
        held = sum(block.payload.nbytes for channel in channels for block in channel.blocks)
        if query.take is not None and (held > LARGE or any(channel.batches for channel in channels)):
            query.take(channels)
    if origin and not any(channel.count for file in files for channel in file.channels):
        advice = "look with `vpptwin inspect` how long the log is"
        raise InputError(f"{spell(path)} holds no messages", "a stretch in which there are some", advice)
    files.sort(key=lambda file: file.log_time[0])
    for file in files:
        if file.channels and not any(channel.encoding == MessageEncoding.CDR for channel in file.channels):
            refuse_encoding(file.path, file.channels)
    return Recording(spell(path), tuple(files))


def name_tables(paths: Sequence[Path], query: Query) -> dict[str, str]:
    """What the only table of a recording is called → as the twin calls it, so that it takes its next run.

    A twin that names fields of several topics, or of one that is there beside the table, means what it says.
    """
    if len(query.fields) != 1:
        return {}
    (wanted,), topics = query.fields, dict[str, str | None]()
    for path in paths:
        start = read_start(path)
        form = find_format(path, start) if not start.startswith(ZSTD) else find_format(path.with_suffix(""), b"")
        if form is not None and form.is_single:
            topics[name_table(path, form)] = None
        elif form is MCAP and (channels := list_channels(path)) is not None:
            topics |= channels
        else:  # of several topics, which only reading tells
            return {}
    tables = [topic for topic, message_type in topics.items() if message_type is None or is_packed(message_type)]
    return {tables[0]: wanted} if len(tables) == 1 and wanted not in topics else {}


def refuse_encoding(path: Path, channels: Sequence[RawChannel]) -> None:
    """Refuse messages that are not CDR with a ros2msg definition."""
    for name, given, expected in (
        ("message encoding", [c.encoding for c in channels], MessageEncoding.CDR),
        ("definition", [c.schema_encoding for c in channels], SchemaEncoding.ROS2),
    ):
        if expected not in given:
            topics = ", ".join(channel.topic for channel in channels[:5])
            raise InputError(
                f"{path}: {name} '{given[0]}' on {topics}",
                f"'{expected}', as ROS 2 records it",
                "record with `ros2 bag record -s mcap`, or convert the log",
            )


def refuse_messages(
    path: PathLike, channel: RawChannel, paths: Sequence[str], error: DecodeError, elsewhere: str = ""
) -> InputError:
    """What to say of messages that do not decode; `elsewhere` says in which other topics there is what they lack."""
    headless, named = "field header.stamp" in str(error), [name for name in paths if name != "header.stamp"]
    if channel.rows and not headless:  # a table
        found = str(error).replace("numeric field", "numeric column").replace("only header.stamp, ", "only ")
        what = f"columns {', '.join(named)}, as the twin's `signals` or the topic map name them"
        found = f"{path}: {channel.topic} has {f'{elsewhere}; ' * bool(elsewhere)}{found}"
        return InputError(found, what, "correct their names there, or in the log")
    return InputError(
        f"{path}: {channel.topic} ({channel.message_type}) has {error}",
        f"messages with {', '.join(paths)} as the definition in the file says",
        "say `stamp: log_time` of it" if headless else "check the field names and the program that wrote it",
    )
