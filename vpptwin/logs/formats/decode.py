"""Fields of many messages at once, as arrays; one by one by mcap-ros2-support where that does not work."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from vpptwin.logs.formats.layout import (
    LITTLE_ENDIAN,
    STAMP,
    Definitions,
    LayoutError,
    Leaf,
    MessageLayout,
    describe_columns,
    locate_fields,
    parse_definition,
)
from vpptwin.logs.formats.raw import Batch, Block, RawChannel

MAX_MERGED = 1 << 25  # bytes of messages decoded at once, so that memory does not double on long logs
MAX_SHAPES = 256  # message shapes (lengths of strings and sequences) of one channel worth a vectorised pass each


class DecodeError(ValueError):
    """Messages of a channel cannot be decoded, or lack a field."""


def decode_channel(channel: RawChannel, paths: Sequence[str], texts: Sequence[str] = ()) -> Iterator[Batch]:
    """Decode fields of all messages of a channel.

    Args:
        channel: with its payloads.
        paths: fields wanted, e.g. `pose.position.x`, `blade_pitch`, `blade_pitch[0]`.
        texts: string sequences wanted; batches are split so that each is constant in a batch.

    Yields:
        Batches that together cover every message once.

    Raises:
        DecodeError: if a message does not fit its definition, or has no such field.
    """
    for rows in channel.rows:  # of a table, as messages with these fields would be
        layout, known, values = describe_columns(rows.columns), {STAMP: rows.time, **rows.columns}, {}
        for path in paths:
            leaf = find_leaf(layout, path)
            data = known[path] if path in known else known[path.rpartition("[")[0]][:, leaf.offset // int(leaf.code[1])]
            values[path] = data.view(np.uint8) if data.dtype == bool else data
        number = np.arange(rows.number, rows.number + len(rows.time), dtype=np.uint64)
        log_time = rows.time if rows.time.min() >= 0 else np.maximum(rows.time, 0)
        yield Batch(number, log_time.view(np.uint64), values, {})
    for held in channel.batches:
        strings = {path: held.texts[path] for path in texts}
        yield Batch(held.number, held.log_time, {path: held.values[path] for path in paths}, strings)
    reference = _ReferenceDecoder(channel)
    try:
        definitions = parse_definition(channel.message_type, channel.definition)
    except LayoutError:
        definitions = None
    # blocks of chunks are joined by length of message, so that they are few but none is much beyond MAX_MERGED
    for length in sorted({block.payload.shape[1] for block in channel.blocks}):
        same = [block for block in channel.blocks if block.payload.shape[1] == length]
        sizes = np.cumsum([block.payload.nbytes for block in same]) // MAX_MERGED
        for group in np.unique(sizes):
            members = [block for block, size in zip(same, sizes) if size == group]
            columns = zip(*((block.number, block.log_time, block.payload) for block in members))
            merged = Block(*(np.concatenate(parts) for parts in columns))
            yield from _decode_block(channel.message_type, definitions, merged, paths, texts, reference)


def _decode_block(
    name: str, definitions: Definitions | None, block: Block, paths: Sequence[str], texts: Sequence[str],
    reference: _ReferenceDecoder,
) -> Iterator[Batch]:  # fmt: skip
    remaining = np.arange(len(block.number))
    shapes = 0
    while len(remaining):
        first = block.payload[remaining[0]].tobytes()
        try:
            if definitions is None or shapes >= MAX_SHAPES:
                raise LayoutError("too many shapes")
            layout = locate_fields(definitions, name, first)
        except LayoutError:
            yield from reference.decode(_take(block, remaining), paths, texts)
            return
        shapes += 1
        fixed = [(0, 4), *((offset, 4) for offset in layout.counters)]  # encapsulation, lengths and wanted strings
        fixed += [span for path, span in layout.strings.items() if path.rsplit("[", 1)[0] in texts]
        columns = np.concatenate([np.arange(start, start + length) for start, length in fixed])
        payload = block.payload[remaining]
        same = np.asarray((payload[:, columns] == payload[0, columns]).all(axis=1))
        members, remaining = _take(block, remaining[same]), remaining[~same]
        batch = _decode_same(members, layout, paths, texts)
        ends = np.unique([0, len(members.number) - 1])
        agree = all(  # bit by bit, and NaN equals NaN
            batch.texts == check.texts
            and all(np.array_equal(data[row], check.values[p][0], equal_nan=True) for p, data in batch.values.items())
            for row, check in zip(ends, list(reference.decode(_take(members, ends), paths, texts)), strict=True)
        )
        yield from [batch] if agree else reference.decode(members, paths, texts)


def _take(block: Block, rows: np.ndarray) -> Block:
    return Block(block.number[rows], block.log_time[rows], block.payload[rows])


def _decode_same(block: Block, layout: MessageLayout, paths: Sequence[str], texts: Sequence[str]) -> Batch:
    order = "<" if block.payload[0, 1] == LITTLE_ENDIAN else ">"
    payload = block.payload
    values = {}
    for path in paths:
        leaf = find_leaf(layout, path)
        if leaf.count == 0:
            values[path] = np.zeros((len(payload), 0))
            continue
        end = leaf.offset + int(leaf.code[1]) * (leaf.count or 1)
        data = np.ascontiguousarray(payload[:, leaf.offset : end]).view(order + leaf.code)
        values[path] = (data[:, 0] if leaf.count is None else data).astype(leaf.code)
    strings: dict[str, tuple[str, ...]] = dict.fromkeys(texts, ())
    for name, (start, length) in layout.strings.items():
        if (path := name.rsplit("[", 1)[0]) in strings:
            text = payload[0, start : start + max(length - 1, 0)].tobytes().decode("utf-8", "replace")
            strings[path] = (*strings[path], text)
    return Batch(block.number, block.log_time, values, strings)


def find_leaf(layout: MessageLayout, path: str) -> Leaf:
    """Leaf of a path, which may index into an array.

    Raises:
        DecodeError: if the message has no such field.
    """
    if path in layout.leaves:
        return layout.leaves[path]
    match = re.fullmatch(r"(.*)\[(\d+)\]", path)
    leaf = layout.leaves.get(match.group(1)) if match else None
    if match and leaf and leaf.count is not None and int(match.group(2)) < leaf.count:
        return Leaf(leaf.offset + int(match.group(2)) * int(leaf.code[1]), leaf.code, None)
    raise DecodeError(f"no numeric field {path}, only {', '.join(list(layout.leaves)[:12])}")


class _ReferenceDecoder:
    """mcap-ros2-support's decoder: slow, and the reference for the fast one."""

    def __init__(self, channel: RawChannel) -> None:
        self.channel = channel
        self.function: Callable[[bytes], object] | None = None

    def decode(self, block: Block, paths: Sequence[str], texts: Sequence[str]) -> Iterator[Batch]:
        """Yield one batch per message."""
        for row in range(len(block.number)):
            message = self._decode_message(block.payload[row].tobytes())
            values = {path: np.asarray([_follow_path(message, path)]) for path in paths}
            strings = {}
            for path in texts:
                names = _follow_path(message, path)
                if not isinstance(names, list):
                    raise DecodeError("a single value where a list of names was expected")
                strings[path] = tuple(map(str, names))
            yield Batch(block.number[row : row + 1], block.log_time[row : row + 1], values, strings)

    def _decode_message(self, payload: bytes) -> object:
        channel = self.channel
        try:
            if self.function is None:
                about = channel.encoding, channel.schema_encoding, channel.message_type, channel.definition
                self.function = _make_decoder(*about)
            return self.function(payload)
        except Exception as error:  # the decoder raises whatever its struct calls raise
            raise DecodeError(f"{len(payload)} bytes that do not decode ({error})") from None


@lru_cache(64)
def _make_decoder(encoding: str, schema_encoding: str, message_type: str, definition: str) -> Callable[[bytes], object]:
    """What decodes messages of a type, which a bag may have on ten thousands of topics."""
    schema = Schema(1, definition.encode(), schema_encoding, message_type)
    with contextlib.redirect_stderr(io.StringIO()):  # the definition parser prints what it then raises
        function = DecoderFactory().decoder_for(encoding, schema)
    if function is None:
        raise ValueError(f"no decoder for {encoding} with {schema_encoding} definitions")
    return function


def _follow_path(message: object, path: str) -> object:
    for name, index in re.findall(r"(\w+)((?:\[\d+\])*)", path):
        try:
            message = getattr(message, name)
            for digits in re.findall(r"\d+", index):
                message = message[int(digits)]  # type: ignore[index]
        except (AttributeError, IndexError, TypeError):
            raise DecodeError(f"no field {path}") from None
    return list(message) if isinstance(message, bytes) else message
