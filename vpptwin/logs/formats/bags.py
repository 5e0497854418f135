"""ROS 1 bags and SQLite files of rosbag2, whose messages come as CDR."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding

from vpptwin.logs.formats.raw import Block, HeldBytes, Query, RawChannel, RawFile, refuse_damaged, show_reading
from vpptwin.logs.formats.unpack import unpack_message
from vpptwin.system.errors import InputError, escape_text, load_extra

_MAX_GATHERED = 1 << 14  # messages of a channel that are kept apart at most
_LENGTH = struct.Struct("<I")
_MESSAGE = b"\x02"


def read_bag(path: Path, query: Query) -> RawFile:
    """Read a ROS 1 bag, or one SQLite file of a rosbag2."""
    with path.open("rb") as file:
        is_first = file.read(7) == b"#ROSBAG"
    load_extra("rosbags.typesys", path)
    try:
        return _read_bag1(path, query) if is_first else _read_sqlite(path, query)
    except InputError:
        raise
    except Exception as error:  # the library raises of its own and whatever its unpacking does
        advice = "run `rosbag reindex`, or copy it again" if is_first else "run `ros2 bag reindex`, or copy it again"
        raise refuse_damaged(path, "bag", error, advice) from None


def _read_bag1(path: Path, query: Query) -> RawFile:
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    class Chunks(Reader):
        """A bag without the library's index of messages, which takes 150 bytes each."""

        def read_index_data(self, pos: int, indexes: object) -> None:
            """Pass over the index of a connection in a chunk: a head and its content."""
            assert self.bio is not None
            for _ in range(2):
                (size,) = _LENGTH.unpack(self.bio.read(_LENGTH.size))
                self.bio.seek(size, 1)

    with Chunks(path) as reader:
        store = get_typestore(Stores.EMPTY)
        for connection in reader.connections:
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            if header := types.get("std_msgs/msg/Header"):
                fields = [field for field in header[1] if field[0] != "seq"]  # which ROS 2 has no longer
                types["std_msgs/msg/Header"] = (header[0], fields)
            store.register(types)
        texts = {
            c.id: (c.topic, c.msgtype, store.generate_msgdef(c.msgtype, ros_version=2)[0]) for c in reader.connections
        }
        gather = _Gather(path, query, texts)
        for key, stamp, raw in show_reading(path, iterable=list_messages(reader), unit=" messages"):
            if gather.note(key, stamp):
                gather.add(key, stamp, bytes(store.ros1_to_cdr(raw, texts[key][1])))
    return gather.finish()


def list_messages(reader: Any) -> Iterator[tuple[int, int, bytes]]:  # noqa: ANN401
    """Connection, time [ns] and content of the messages of a ROS 1 bag, chunk by chunk, as they were recorded."""

    def take(data: bytes, place: int) -> tuple[bytes, int]:
        """A piece that its length stands before, and the place behind it."""
        start = place + _LENGTH.size
        end = start + _LENGTH.unpack_from(data, place)[0]
        if end > len(data):
            raise ValueError(f"a record of {end - start} bytes where {len(data) - start} are left")
        return data[start:end], end

    for info in sorted(reader.chunk_infos, key=lambda info: info.start_time):
        chunk, place = reader.chunks[info.pos], 0
        reader.bio.seek(chunk.datapos)
        data = chunk.decompressor(reader.bio.read(chunk.datasize))
        while place < len(data):
            head, place = take(data, place)
            content, place = take(data, place)
            fields, at = {}, 0
            while at < len(head):
                entry, at = take(head, at)
                name, _, value = entry.partition(b"=")
                fields[name] = value
            if fields[b"op"] == _MESSAGE:
                seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
                yield _LENGTH.unpack(fields[b"conn"])[0], seconds * 10**9 + nanoseconds, content


def _read_sqlite(path: Path, query: Query) -> RawFile:
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
    from rosbags.typesys import Stores, get_typestore

    known = get_typestore(Stores.LATEST)
    reader = Sqlite3Reader(path)
    reader.open()
    try:
        texts = {}
        for connection in reader.connections:
            if connection.msgdef.format == MessageDefinitionFormat.MSG:
                text = connection.msgdef.data
            elif connection.msgtype in known.fielddefs:
                text = known.generate_msgdef(connection.msgtype, ros_version=2)[0]
            else:
                text = ""  # which a topic that is wanted is refused for
            texts[connection.id] = connection.topic, connection.msgtype, text
        gather, messages = _Gather(path, query, texts), reader.messages(reader.connections)
        for connection, stamp, raw in show_reading(path, iterable=messages, unit=" messages"):
            if gather.note(connection.id, stamp):
                gather.add(connection.id, stamp, unpack_message(bytes(raw)))
    finally:
        reader.close()
    return gather.finish()


class _Gather:
    """Messages one by one, into channels."""

    def __init__(self, path: Path, query: Query, texts: dict[Any, tuple[str, str, str]]) -> None:
        self.path, self.number, self.times, self.span = path, 0, (2**63, -1), query.span
        self.held_bytes = HeldBytes(query.take)
        self.channels = {
            key: RawChannel(escape_text(topic), escape_text(kind), MessageEncoding.CDR, SchemaEncoding.ROS2, text)
            for key, (topic, kind, text) in texts.items()
        }
        self.wanted = {key for key, channel in self.channels.items() if query.channel(channel)}
        self.held: dict[tuple[Any, int], list[tuple[int, int, bytes]]] = {}

    def note(self, key: Any, stamp: int) -> bool:  # noqa: ANN401
        """Count a message; whether it is wanted."""
        if self.span is not None and not self.span.choose(np.array([stamp]))[0]:
            return False
        self.channels[key].count += 1
        self.number += 1
        self.times = min(self.times[0], stamp), max(self.times[1], stamp)
        return key in self.wanted

    def add(self, key: Any, stamp: int, content: bytes) -> None:  # noqa: ANN401
        """Keep a message."""
        held = self.held.setdefault((key, len(content)), [])
        held.append((self.number, stamp, content))
        if len(held) == _MAX_GATHERED:
            self.store((key, len(content)))

    def store(self, place: tuple[Any, int]) -> None:
        """Messages of one channel and length, as a block."""
        number, stamp, content = zip(*self.held.pop(place))
        payload = np.frombuffer(b"".join(content), np.uint8).reshape(len(number), place[1])
        self.channels[place[0]].blocks.append(Block(np.array(number, np.uint64), np.array(stamp, np.uint64), payload))
        self.held_bytes.add(payload.nbytes, self.channels.values())

    def finish(self) -> RawFile:
        """All that was kept."""
        for place in list(self.held):
            self.store(place)
        return RawFile(self.path, "ros2", list(self.channels.values()), self.times)
