"""MCAP files taken apart: channels and the raw payloads of the topics wanted, in record order."""

from __future__ import annotations

import io
import mmap
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, Header, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from vpptwin.errors import InputError

_PREFIX = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


@dataclass(frozen=True)
class Block:
    """Payloads of one length: record number in the file (n,), log time [ns] (n,), bytes (n, length)."""

    number: np.ndarray
    log_time: np.ndarray
    payload: np.ndarray


@dataclass
class RawChannel:
    """One channel of a file with its payloads. type and definition are those of its schema; count: messages seen."""

    topic: str
    message_type: str
    encoding: str
    schema_encoding: str
    definition: str
    count: int = 0
    blocks: list[Block] = field(default_factory=list)


@dataclass(frozen=True)
class RawFile:
    """A file taken apart. profile: of its header; log_time: of its first and last message [ns]."""

    path: Path
    profile: str
    channels: list[RawChannel]
    log_time: tuple[int, int]


class _Damage(Exception):
    """The file ends or stops making sense at a byte offset."""

    def __init__(self, offset: int, reason: str) -> None:
        self.offset, self.reason = offset, reason
        super().__init__(reason)


class _Scan:
    """What has been read of a file so far."""

    def __init__(self, wanted: Callable[[RawChannel], bool]) -> None:
        self.wanted = wanted
        self.profile = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, RawChannel] = {}
        self.keep: set[int] = set()
        self.count = 0
        self.first, self.last = 2**63, -1

    def take_channel(self, record: ChannelRecord) -> None:
        if record.id in self.channels:
            return
        schema = self.schemas.get(record.schema_id)
        text = schema.data.decode("utf-8", "replace") if schema else ""
        channel = RawChannel(
            record.topic,
            schema.name if schema else "",
            record.message_encoding,
            schema.encoding if schema else "",
            text,
        )
        self.channels[record.id] = channel
        if self.wanted(channel):
            self.keep.add(record.id)

    def take_records(self, data: bytes | memoryview, base: int) -> Iterator[tuple[int, int, int]]:
        """Walk over records. Yields (opcode, start, end) of those that are neither schema, channel nor message."""
        found: list[tuple[int, int, int, int, int]] = []
        position, total = 0, len(data)
        unpack_prefix, unpack_message = _PREFIX.unpack_from, _MESSAGE.unpack_from
        message, schema, channel = int(Opcode.MESSAGE), int(Opcode.SCHEMA), int(Opcode.CHANNEL)
        keep, channels, number, first, last = self.keep, self.channels, self.count, self.first, self.last
        try:
            while position < total:
                if position + 9 > total:
                    raise _Damage(base + position, "ends inside a record")
                opcode, length = unpack_prefix(data, position)
                start = position + 9
                position = start + length
                if position > total:
                    raise _Damage(base + start - 9, "ends inside a record")
                if opcode == message:
                    channel_id, _, log_time, _ = unpack_message(data, start)
                    if channel_id in keep:
                        found.append((channel_id, length - 22, start + 22, log_time, number))
                    elif channel_id in channels:
                        channels[channel_id].count += 1
                    number += 1
                    first = log_time if log_time < first else first
                    last = log_time if log_time > last else last
                elif opcode == schema:
                    record = Schema.read(_open_stream(data, start, position))
                    self.schemas[record.id] = record
                elif opcode == channel:
                    self.take_channel(ChannelRecord.read(_open_stream(data, start, position)))
                else:
                    yield opcode, start, position
                    if opcode == Opcode.DATA_END:
                        return
        finally:
            self.count, self.first, self.last = number, first, last
            self.store(np.frombuffer(data, np.uint8), found)

    def store(self, data: np.ndarray, found: list[tuple[int, int, int, int, int]]) -> None:
        """Copy the messages found, grouped by channel and length."""
        if not found:
            return
        table = np.array(found, dtype=np.uint64)
        kinds, group = np.unique(table[:, :2], axis=0, return_inverse=True)
        for index, (channel_id, length) in enumerate(kinds):
            rows = table[group.reshape(-1) == index]
            starts = rows[:, 2].astype(np.intp)
            windows = np.lib.stride_tricks.sliding_window_view(data, int(length)) if length else data[:0].reshape(0, 0)
            payload = windows[starts] if length else np.zeros((len(rows), 0), np.uint8)
            channel = self.channels[int(channel_id)]
            channel.count += len(rows)
            channel.blocks.append(Block(rows[:, 4].astype(np.int64), rows[:, 3], payload))


def read_container(path: Path, wanted: Callable[[RawChannel], bool]) -> RawFile:
    """Take an MCAP file apart.

    Args:
        path: the file.
        wanted: tells whether a channel's payloads are to be kept.

    Returns:
        All channels; those wanted with their payloads.

    Raises:
        InputError: if the file is not MCAP, is damaged or ends early.
    """
    size = path.stat().st_size
    scan = _Scan(wanted)
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        view = memoryview(mapped)
        try:
            _read_records(view, scan)
        except _Damage as damage:
            raise _refuse_damaged(path, size, scan, damage) from None
        finally:
            view.release()
    return RawFile(path, scan.profile, list(scan.channels.values()), (scan.first, scan.last))


def _read_records(view: memoryview, scan: _Scan) -> None:
    start = len(MCAP0_MAGIC)
    body = view[start:]
    ended = False
    try:
        for opcode, first, last in scan.take_records(body, start):
            ended = opcode == Opcode.DATA_END
            try:
                if opcode == Opcode.HEADER:
                    scan.profile = Header.read(_open_stream(body, first, last)).profile
                elif opcode == Opcode.CHUNK:
                    stream, length = get_chunk_data_stream(
                        Chunk.read(_open_stream(body, first, last)), validate_crc=True
                    )
                    for _ in scan.take_records(stream.read(length), start + first):
                        pass
            except (McapError, CRCValidationError, ValueError, RuntimeError) as error:
                raise _Damage(start + first, f"holds a broken chunk ({error})") from None
    finally:
        body.release()
    if not ended or view[-len(MCAP0_MAGIC) :] != MCAP0_MAGIC:
        raise _Damage(len(view), "ends without the closing part of an MCAP file")


def _open_stream(data: bytes | memoryview, start: int, end: int) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(data[start:end]))


def _refuse_damaged(path: Path, size: int, scan: _Scan, damage: _Damage) -> InputError:
    readable = f"{scan.count} messages"
    if scan.last >= scan.first:
        readable += f" over {(scan.last - scan.first) * 1e-9:.1f} s"
    return InputError(
        f"{path} {damage.reason} at byte {damage.offset} of {size}, {readable} before it are readable",
        "a complete MCAP file",
        f"copy or record it again, or save the readable part with `mcap recover {path.name} -o recovered.mcap`",
    )
