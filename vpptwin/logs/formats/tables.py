"""Named columns over time, as logs of other kinds held them: kept as they are, and packed as ROS 2 messages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding

from vpptwin.logs.channels import CHANNELS, JOINT_TOPICS
from vpptwin.logs.formats.layout import CODES, LayoutError, compose_message, parse_definition
from vpptwin.logs.formats.raw import Block, HeldBytes, Query, RawChannel, RawFile, TableRows, extend_all, show_reading
from vpptwin.logs.messages import compose_definition, shorten_type
from vpptwin.system.errors import InputError, escape_text

_TYPES = {code: name for name, code in reversed(CODES.items()) if name not in ("byte", "char", "bool")}
_MAX_S = 2**31
_PACKAGE = "vpptwin_msgs/msg/"
NAMES = re.compile(r"(.*?)(?:joint_?)?names?[_.\[]?(\d+)\]?", re.IGNORECASE)
"""Columns of text that say what the signals of that number are called."""
_OURS = {channel.message_type for channel in CHANNELS.values()}


@dataclass(frozen=True)
class Table:
    """Some rows of one source of a log."""

    topic: str  # of the source, with a slash in front
    time: np.ndarray  # (n,) ns, int64
    columns: Mapping[str, np.ndarray]  # name as in the log -> numbers, bool or text, (n,) or (n, k)
    units: Mapping[str, str] = field(default_factory=dict)  # of columns that have one
    fields: Mapping[str, str] | None = None  # column wanted -> its name in messages; None where nobody has chosen yet


def choose_fields(query: Query, topic: str, columns: Iterable[str]) -> dict[str, str]:
    """Which of all columns of a topic are wanted -> what messages call them."""
    columns, paths = list(columns), query.fields.get(topic)
    names = dict(zip(columns, make_unique(list_names(column)[2] for column in columns)))
    if paths is None:
        return names
    named = find_named(query, topic, names)
    return {n: names[n] for n in named} if len(named) >= len({path.split("[")[0] for path in paths}) - 1 else names


def note_dropped(query: Query, topic: str, columns: Iterable[str], clock: str) -> None:
    """Note which columns of a table, besides its time, are none of those that somebody names."""
    if topic in query.fields:
        names = dict(zip(columns := list(columns), make_unique(list_names(column)[2] for column in columns)))
        query.dropped[topic] = [column for column in columns if column not in {clock, *find_named(query, topic, names)}]


def find_named(query: Query, topic: str, names: Mapping[str, str]) -> list[str]:
    """The columns that somebody names, of those that messages call so."""
    paths = query.fields.get(topic, ())
    wanted = {name for path in paths for given in (path, path.split("[")[0]) for name in list_names(given)}
    return [column for column, name in names.items() if column in wanted or name in wanted]


def list_some(what: str, names: Sequence[str]) -> str:
    """What is so of some columns, "" if none is."""
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return f"{what} {', '.join(names[:8])}{more}, left out" if names else ""


def name_topic(path: Path) -> str:
    """What the only table of a file is called."""
    return keep_apart("/" + (re.sub(r"[^A-Za-z0-9_]+", "_", path.name.split(".")[0]).strip("_") or "table"))


def keep_apart(topic: str) -> str:
    """What a table is called that would be called so: as none of our topics, nor its messages as a type of ours."""
    ours = topic in (*CHANNELS, *JOINT_TOPICS) or _PACKAGE + _name_type(topic) in _OURS
    return f"{topic}_table" if ours else topic


def is_packed(message_type: str) -> bool:
    """Whether messages of a type are rows of a table, which no topic of ours has."""
    return message_type.startswith(_PACKAGE) and message_type not in _OURS


def name_field(column: str) -> str:
    """A column's name as ROS 2 allows it: small letters, digits, single underscores, an index left as it is."""
    name, index = re.fullmatch(r"(.*?)((?:\[\d+\])?)", column, flags=re.DOTALL).groups()  # type: ignore[union-attr]
    name = re.sub(r"_+", "_", re.sub(r"[^a-z0-9]", "_", name.lower())).strip("_")
    return (name if name[:1].isalpha() else f"c_{name}".rstrip("_")) + index


def list_names(path: str) -> tuple[str, str, str]:
    """What a field may be called that somebody names: so, or as ROS 2 allows it, an index apart or within."""
    return path, name_field(path), name_field(re.sub(r"\[(\d+)\]", r"_\1", path))


def find_field(channel: RawChannel, path: str) -> str:
    """A field's path in messages of a channel, which may be called as it is in the log that they were packed from."""
    if channel.message_type.startswith("vpptwin_msgs/"):
        known = _list_known(channel.message_type, channel.definition)
        return next((name for name in list_names(path) if name.split("[")[0] in known), path)
    return path


@lru_cache(64)
def _list_known(message_type: str, definition: str) -> frozenset[str]:
    return frozenset(field.name for field in parse_definition(message_type, definition)[shorten_type(message_type)])


def list_field_names(channel: RawChannel) -> frozenset[str]:
    """What the fields of a channel's messages, or the columns of its table, are called."""
    try:
        return _list_known(channel.message_type, channel.definition)
    except (LayoutError, KeyError):
        return frozenset()


def find_elsewhere(channels: Iterable[RawChannel], channel: RawChannel, paths: Iterable[str]) -> str:
    """Which of these fields another topic has and this one lacks: `no Roll, which is in /ATT`; "" for none."""
    missing: dict[str, list[str]] = {}
    known = list_field_names(channel)
    for path in paths:
        names = {re.split(r"[.\[]", name)[0] for name in list_names(path)}
        for other in channels if not names & known else ():
            if names & list_field_names(other):
                missing.setdefault(other.topic, []).append(path)
    verbs = {topic: "is" if len(names) == 1 else "are" for topic, names in missing.items()}
    return "; ".join(f"no {', '.join(names)}, which {verbs[topic]} in {topic}" for topic, names in missing.items())


def make_unique(names: Iterable[str]) -> list[str]:
    """Names as they are, each once: those that come again get a number."""
    counts: dict[str, int] = {}
    apart: dict[str, None] = {}
    for first in names:
        name = first
        while name in apart:
            counts[first] = counts.get(first, 1) + 1
            name = f"{first}_{counts[first]}"
        apart[name] = None
    return list(apart)


def keep_tables(path: Path, tables: Iterable[Table], query: Query, notes: list[str]) -> RawFile:
    """The tables of a log as channels, each with a definition of messages that would hold its rows.

    Args:
        path: of the log.
        tables: of any number of topics, each in the order of its rows.
        query: what is kept of them.
        notes: warnings, which may still grow while tables are read.
    """
    channels: dict[str, RawChannel] = {}
    fields: dict[str, Mapping[str, str]] = {}
    first, last, number, held = 2**63, -1, 0, HeldBytes(query.take)
    bar = show_reading(path, unit=" rows")
    for table in tables:
        bar.update(len(table.time))
        if query.span is not None:
            rows = query.span.choose(table.time)
            table = replace(table, time=table.time[rows], columns={n: c[rows] for n, c in table.columns.items()})
        count = len(table.time)
        if table.topic not in channels:
            names = table.fields if table.fields is not None else choose_fields(query, table.topic, table.columns)
            fields[table.topic] = {column: name for column, name in names.items() if column in table.columns}
            kind = _PACKAGE + _name_type(keep_apart(table.topic))
            text = define_message(table.columns, fields[table.topic], table.units)
            channels[table.topic] = RawChannel(table.topic, kind, MessageEncoding.CDR, SchemaEncoding.ROS2, text)
        channel = channels[table.topic]
        channel.count += count
        if not count:
            continue
        if not (table.time.min() >= -_MAX_S * 10**9 and table.time.max() < _MAX_S * 10**9):
            found = f"{path}: {table.topic} has times {table.time.min() / 1e9:.4g} to {table.time.max() / 1e9:.4g} s"
            raise InputError(found, "times within 68 years of 1970", "say which unit the time has")
        first, last = min(first, max(int(table.time.min()), 0)), max(last, int(table.time.max()), 0)
        if query.channel(channel):
            kept = {name: table.columns[column] for column, name in fields[table.topic].items()
                    if query.texts or not is_text(table.columns[column]) or NAMES.fullmatch(column)}  # fmt: skip
            piece = channel.rows[-1] if channel.rows else None
            pairs = [(piece.time, table.time), *((piece.columns[n], data) for n, data in kept.items())] if piece else []
            if piece is None or piece.number + len(piece.time) != number or not extend_all(pairs):
                columns = {name: np.array(data) for name, data in kept.items()}
                channel.rows.append(TableRows(number, np.array(table.time), columns))
            held.add(table.time.nbytes + sum(data.nbytes for data in kept.values()), channels.values())
        number += count
    bar.close()
    return RawFile(path, "ros2", list(channels.values()), (first, last), notes)


def _name_type(topic: str) -> str:
    words = [word for word in re.split(r"[^A-Za-z0-9]+", topic) if word]
    name = "".join(word[0].upper() + word[1:] for word in words) or "Table"
    return name if name[0].isalpha() else f"T{name}"


def define_message(columns: Mapping[str, np.ndarray], names: Mapping[str, str], units: Mapping[str, str]) -> str:
    """ros2msg text of rows with the columns of `names`, texts last; comments have their names in the log and units."""
    lines = ["std_msgs/Header header"]
    for column in sorted(names, key=lambda column: is_text(columns[column])):
        data = columns[column]
        base = "string" if is_text(data) else "bool" if data.dtype == bool else _TYPES[data.dtype.str[1:]]
        array = f"[{data.shape[1]}]" if data.ndim > 1 else ""
        unit = f" [{units[column]}]" if column in units else ""
        comment = escape_text(f"{column}{unit}".replace("=", ":"))
        lines.append(f"{base}{array} {names[column]}" + (f"  # {comment}" if comment != names[column] else ""))
    _, _, rest = compose_definition("geometry_msgs/msg/PoseStamped").partition("=" * 80)
    sections = [part for part in rest.split("=" * 80) if "MSG: std_msgs" in part or "MSG: builtin" in part]
    return "\n".join(lines) + "\n" + "".join("=" * 80 + section.rstrip("\n") + "\n" for section in sections)


def is_text(data: np.ndarray) -> bool:
    """Whether a column is of text."""
    return bool(data.dtype.kind in "OUS")


def pack_rows(channel: RawChannel, rows: TableRows) -> Iterator[Block]:
    """Rows of a channel as little-endian CDR, those of one length together."""
    definitions = parse_definition(channel.message_type, channel.definition)
    texts = {n: [str(t).encode() + b"\0" for t in data] for n, data in rows.columns.items() if is_text(data)}
    lengths = np.array([[len(text) for text in column] for column in texts.values()], dtype=int).T
    lengths = lengths.reshape(len(rows.time), len(texts))
    one = lengths[:1], np.zeros(len(rows.time), int)
    shapes, which = np.unique(lengths, axis=0, return_inverse=True) if texts else one
    for index, shape in enumerate(shapes):
        members = np.flatnonzero(which.reshape(-1) == index)
        blanks = {path: " " * (size - 1) for path, size in zip(texts, shape.tolist())}
        message, layout = compose_message(definitions, channel.message_type, blanks, {})
        payload = np.tile(np.frombuffer(message, np.uint8), (len(members), 1))
        for path, (offset, length) in layout.strings.items():
            if path in texts:
                data = b"".join(texts[path][row] for row in members)
                payload[:, offset : offset + length] = np.frombuffer(data, np.uint8).reshape(len(members), length)
        parts = {"header.stamp.sec": rows.time // 10**9, "header.stamp.nanosec": rows.time % 10**9}
        for path, values in (parts | {n: data for n, data in rows.columns.items() if n not in texts}).items():
            leaf = layout.leaves[path]
            raw = np.ascontiguousarray(values[members].astype(f"<{leaf.code}").reshape(len(members), -1)).view(np.uint8)
            payload[:, leaf.offset : leaf.offset + raw.shape[1]] = raw
        yield Block(
            (rows.number + members).astype(np.uint64), np.maximum(rows.time[members], 0).astype(np.uint64), payload
        )
