"""MCAP files taken apart: channels and the raw payloads of the topics wanted, in record order."""

from __future__ import annotations

import io
import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, Header, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy.lib.stride_tricks import sliding_window_view
from tqdm import tqdm
from zstandard import ZstdError

from vpptwin.logs.formats.raw import Block, HeldBytes, Query, RawChannel, RawFile, show_reading
from vpptwin.logs.formats.tables import is_packed, keep_apart
from vpptwin.logs.formats.unpack import Unpacker
from vpptwin.system.errors import InputError, escape_text

_PREFIX = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_MAX_NOTED = 1 << 17  # messages noted before they are stored, which takes 200 bytes each
_MAX_MAPPED = 1 << 25  # bytes of a file held in memory at once
# What mcap and the decompressors raise on records whose content makes no sense.
_BROKEN = (McapError, ValueError, RuntimeError, MemoryError, OverflowError, struct.error, ZstdError)


class _DamageError(Exception):
    """The file ends or stops making sense at a byte offset."""

    def __init__(self, offset: int, reason: str) -> None:
        self.offset, self.reason = offset, reason
        super().__init__(reason)


@contextmanager
def _blame(offset: int, what: str) -> Iterator[None]:
    """Say which record makes no sense where reading it fails."""
    try:
        yield
    except InputError:
        raise
    except _BROKEN:
        raise _DamageError(offset, f"holds a broken {what}") from None


class _Scan:
    """What has been read of a file so far."""

    def __init__(self, query: Query, unpacker: Unpacker, mapped: mmap.mmap, bar: tqdm) -> None:
        self.query, self.unpacker, self.mapped, self.bar = query, unpacker, mapped, bar
        self.held, self.forgotten = HeldBytes(query.take), 0
        self.profile = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, RawChannel] = {}
        self.keep: set[int] = set()
        self.count = 0
        self.log_time = (2**63, -1)

    def take_records(self, data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
        """Walk over records. Yields (opcode, start, end) of those that are neither schema, channel nor message."""
        found: list[tuple[int, int, int, int]] = []
        position, total = 0, len(data)
        unpack_prefix, unpack_message = _PREFIX.unpack_from, _MESSAGE.unpack_from
        message = int(Opcode.MESSAGE)
        try:
            while position < total:
                begin, start = position, position + _PREFIX.size
                opcode, length = unpack_prefix(data, begin) if start <= total else (0, total)
                position = start + length
                if position > total:
                    raise _DamageError(begin, "ends inside a record")
                if opcode == message:
                    if length < _MESSAGE.size:
                        raise _DamageError(begin, "holds a broken message")
                    channel_id, _, log_time, _ = unpack_message(data, start)
                    found.append((channel_id, length - _MESSAGE.size, start + _MESSAGE.size, log_time))
                    if len(found) == _MAX_NOTED:
                        self.store(data, found)
                        self.forget(data, position)
                        found = []
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self.take_declaration(opcode, _open_stream(data, start, position), begin)
                else:
                    self.store(data, found)
                    self.forget(data, begin)
                    found = []
                    yield opcode, start, position
        finally:
            self.store(data, found)

    def forget(self, data: bytes | memoryview, position: int) -> None:
        """Give back the memory that the file takes up to a position, if it is the file that is walked over."""
        if isinstance(data, memoryview):
            self.bar.update(position - self.bar.n)
        if isinstance(data, memoryview) and position > self.forgotten + _MAX_MAPPED:
            self.mapped.madvise(mmap.MADV_DONTNEED, 0, position // mmap.PAGESIZE * mmap.PAGESIZE)
            self.forgotten = position

    def take_declaration(self, opcode: int, stream: ReadDataStream, offset: int) -> None:
        """Note a schema or a channel."""
        with _blame(offset, "schema or channel"):
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.schemas[schema.id] = schema
                return
            record = ChannelRecord.read(stream)
        if record.id in self.channels:
            return
        known = self.schemas.get(record.schema_id, Schema(id=0, data=b"", encoding="", name=""))
        text = known.data.decode("utf-8", "replace")
        topic, kind = name_channel(record, known)
        topic = self.query.names.get(topic, topic) if is_packed(kind) else topic
        channel = RawChannel(topic, kind, record.message_encoding, known.encoding, text)
        self.channels[record.id] = channel
        if self.query.channel(channel):
            self.keep.add(record.id)

    def store(self, data: bytes | memoryview, found: list[tuple[int, int, int, int]]) -> None:
        """Count messages, given as (channel, length, start, log time), and copy those wanted, grouped by length."""
        if not found:
            return
        channel, length, start, log_time = np.array(found, dtype=np.uint64).T
        number = self.count + np.arange(len(found))
        self.count += len(found)
        self.log_time = (min(self.log_time[0], int(log_time.min())), max(self.log_time[1], int(log_time.max())))
        content, size = np.frombuffer(data, np.uint8), 0
        inside = self.query.span.choose(log_time.astype(np.int64)) if self.query.span else np.ones(len(found), bool)
        for identifier in np.unique(channel[inside]).tolist():
            members = (channel == identifier) & inside
            if identifier in self.channels:
                self.channels[identifier].count += int(np.count_nonzero(members))
            for width in np.unique(length[members]).tolist() if identifier in self.keep else ():
                rows = np.flatnonzero(members & (length == width))
                # An empty message at the very end has no window of its own, so it borrows the one before.
                windows = sliding_window_view(content, max(width, 1))
                payload = windows[start[rows].astype(np.intp) - (width == 0), :width]
                self.channels[identifier].blocks.append(Block(number[rows], log_time[rows], payload))
                size += payload.nbytes
        self.held.add(size, self.channels.values())


def name_channel(record: ChannelRecord, schema: Schema | None) -> tuple[str, str]:
    """Topic and message type of a channel; tables are called as none of our topics."""
    topic, kind = escape_text(record.topic), escape_text(schema.name if schema else "")
    return keep_apart(topic) if is_packed(kind) else topic, kind


def list_channels(path: Path) -> dict[str, str] | None:
    """Topic → message type, as the summary at the end of an MCAP file says; None for a file without one."""
    with path.open("rb") as file:
        try:
            summary = SeekingReader(file).get_summary()
        except _BROKEN:
            return None
    known = summary.schemas if summary else {}
    return dict(name_channel(c, known.get(c.schema_id)) for c in summary.channels.values()) if summary else None


def read_container(path: Path, query: Query) -> RawFile:
    """Take an MCAP file apart: all of its channels, those wanted with their payloads."""
    bar = show_reading(path, unit="B", total=path.stat().st_size)
    with path.open("rb") as file, bar, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        scan = _Scan(query, Unpacker(path, path.stat().st_size), mapped, bar)
        view = memoryview(mapped)
        body = view[len(MCAP0_MAGIC) :]
        try:
            _read_records(body, scan)
        except _DamageError as damage:
            readable = f"{scan.count} messages"
            if scan.count:
                readable += f" over {(scan.log_time[1] - scan.log_time[0]) * 1e-9:.1f} s"
            offset = damage.offset + len(MCAP0_MAGIC)
            raise InputError(
                f"{path} {damage.reason} at byte {offset} of {len(view)}, {readable} before it are readable",
                "a complete MCAP file",
                f"copy or record it again, or save the readable part with `mcap recover {path.name} -o recovered.mcap`",
            ) from None
        finally:
            body.release()
            view.release()
    if scan.profile not in ("ros2", ""):
        found = f"{path} has the MCAP profile '{scan.profile}'"
        raise InputError(found, "'ros2'", "record with ROS 2, or convert the log")
    return RawFile(path, scan.profile, list(scan.channels.values()), scan.log_time)


def _read_records(body: memoryview, scan: _Scan) -> None:
    expected = None
    for opcode, start, end in scan.take_records(body):
        if opcode == Opcode.HEADER:
            with _blame(start, "header"):
                scan.profile = Header.read(_open_stream(body, start, end)).profile
        elif opcode == Opcode.CHUNK:
            with _blame(start, "chunk"):
                chunk = Chunk.read(_open_stream(body, start, end))
                if chunk.compression not in ("", "zstd", "lz4"):
                    raise _DamageError(start, f"holds a chunk compressed by '{chunk.compression}'")
                records = scan.unpacker.unpack(chunk)
            try:
                for _ in scan.take_records(records):
                    pass
            except _DamageError:
                raise _DamageError(start, "holds a broken chunk") from None
        elif opcode == Opcode.STATISTICS:
            with _blame(start, "summary"):
                expected = Statistics.read(_open_stream(body, start, end)).message_count
        elif opcode == Opcode.FOOTER:
            break
    else:
        raise _DamageError(len(body), "ends without a footer")
    if body[end:] != MCAP0_MAGIC:
        raise _DamageError(end, "does not end as MCAP files do")
    if expected not in (None, scan.count):
        raise _DamageError(end, f"holds {scan.count} messages, not {expected} as its summary says,")


def _open_stream(data: bytes | memoryview, start: int, end: int) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(data[start:end]))
