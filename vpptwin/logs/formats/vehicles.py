"""Logs that autopilots write: ULog of PX4, DataFlash of ArduPilot, the Crazyflie's SD card."""

from __future__ import annotations

import contextlib
import io
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.logs.formats.raw import Query
from vpptwin.logs.formats.tables import Table
from vpptwin.system.errors import InputError, load_extra

_CODES = {"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8", "f": "f4",
          "d": "f8", "e": "f2"}  # fmt: skip
"""Numbers as Python's struct writes them → as NumPy does."""
_MAX_PIECE = 1 << 26  # bytes of a large log that are taken apart at once
_ULOG_HEAD = 16  # bytes before the first message
_HEAD = b"\xa3\x95"  # of a message of DataFlash
_FMT = 128  # the message that describes others
_PAGE = 528  # bytes


def read_ulog(path: Path, topic: str, query: Query, notes: list[str]) -> Iterator[Table]:
    """Topics of a PX4 ULog, of large ones stretch by stretch; a topic's second instance is called TOPIC_1."""
    pyulog = load_extra("pyulog", path)
    corrupt, lost, empty = False, [], True
    for stretch in split_ulog(path, notes):
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                log = pyulog.ULog(stretch, disable_str_exceptions=True)
        except Exception as error:  # the library raises whatever its unpacking does
            raise InputError(f"{path} is a damaged ULog ({error})", "a whole one", "copy it again") from None
        corrupt |= log.file_corruption
        lost += [drop.duration for drop in log.dropouts]
        for data in log.data_list:
            empty = False
            name = f"{data.name}_{data.multi_id}" if data.multi_id else data.name
            parts: dict[str, list[np.ndarray]] = {}  # of NAME[0], NAME[1], which are one column (n, k)
            for key, values in data.data.items():
                if not key.startswith("_padding"):
                    parts.setdefault(re.sub(r"\[\d+\]$", "", key), []).append(values)
            joined = {key: np.stack(held, axis=1) if len(held) > 1 else held[0] for key, held in parts.items()}
            columns = {key: v if v.dtype.kind in "iufb" else v.astype(str) for key, v in joined.items()}
            yield Table(f"/{name}", data.data["timestamp"].astype(np.int64) * 1000, columns, {"timestamp": "us"})
    if empty:
        raise InputError(f"{path}: a ULog without samples", "one that was logged in flight", "check the log")
    if corrupt:
        notes.append(f"{path.name} is damaged, or ends early: what is readable is used")
    if lost:
        notes.append(f"{path.name}: the logger lost {len(lost)} times, {sum(lost) / 1e3:.2f} s in all")


def split_ulog(path: Path, notes: list[str]) -> Iterator[io.BytesIO]:
    """A ULog as several: each has the formats and the subscriptions before it, and a stretch of whole messages.

    The last has what is left, of which a warning is added to the notes if it is no whole message.
    """
    total = path.stat().st_size
    with path.open("rb") as file:
        formats, subscribed, data = file.read(_ULOG_HEAD), b"", b""
        while piece := file.read(_MAX_PIECE):
            head, data, place = formats + subscribed, data + piece, 0
            while place + 3 <= len(data):
                end = place + 3 + data[place] + 256 * data[place + 1]
                if end > len(data):
                    break
                if data[place + 2] == ord("A"):
                    subscribed += data[place:end]
                elif data[place + 2] == ord("F"):
                    formats += data[place:end]
                place = end
            is_last = file.tell() == total
            yield io.BytesIO(head + (data if is_last else data[:place]))
            data = data[place:]
    if data:
        notes.append(f"{path.name} ends within a message: what is before it is used")


def read_dataflash(path: Path, topic: str, query: Query, notes: list[str]) -> Iterator[Table]:
    """Messages of an ArduPilot DataFlash log by their names; those of an instance I of several are called NAME_I."""
    make = load_extra("pymavlink.DFReader", path).DFFormat
    forms = {_FMT: make(_FMT, "FMT", 89, "BBnNZ", "Type,Length,Name,Format,Columns")}
    rest, empty, torn = b"", True, False
    with path.open("rb") as file:
        while piece := file.read(_MAX_PIECE):
            data = rest + piece
            try:
                starts, end, lost = find_messages(data, forms, make)
            except Exception as error:  # the library raises whatever its unpacking does
                found = f"{path} is a damaged DataFlash log ({error})"
                raise InputError(found, "a whole one", "copy it again") from None
            torn |= lost
            content = np.frombuffer(data, np.uint8)
            for number, places in starts.items():
                raw = content[np.array(places)[:, None] + np.arange(3, forms[number].len)]
                for table in read_messages(forms[number], raw):
                    empty = False
                    yield table
            rest = data[end:]
    if empty:
        raise InputError(f"{path}: a DataFlash log without samples", "messages with TimeUS", "check the log")
    if torn:
        notes.append(f"{path.name} is damaged in places, which are left out")
    if rest:
        notes.append(f"{path.name} ends within a message: what is before it is used")


def find_messages(
    data: bytes, forms: dict[int, Any], make: Callable[..., Any]
) -> tuple[dict[int, list[int]], int, bool]:
    """Number of a format → places of its whole messages; where they end; whether anything between them is none.

    Formats that the stretch describes are added to `forms`, made by the library.
    """
    starts: dict[int, list[int]] = {}
    place, lost = 0, False
    while place + 3 <= len(data):
        number = data[place + 2]
        if data[place] != _HEAD[0] or data[place + 1] != _HEAD[1] or number not in forms:
            after = data.find(_HEAD, place + 1)
            lost |= len(data) - place > _PAGE  # a page of flash is filled up at the end
            place = after if after >= 0 else len(data)
            continue
        form = forms[number]
        if place + form.len > len(data):
            break
        starts.setdefault(number, []).append(place)
        place += form.len
        if form.name in ("FMT", "FMTU"):
            values = struct.unpack(form.msg_struct, data[place - form.len + 3 : place])
            fields: list[Any] = [v.partition(b"\0")[0].decode("latin-1") if isinstance(v, bytes) else v for v in values]
            if form.name == "FMT":
                kind, size, name, codes, columns = fields
                if size > len(_HEAD):  # else nothing would come behind it
                    forms[kind] = make(kind, name, size, codes, columns, oldfmt=forms.get(kind))
            elif (about := forms.get(fields[1])) is not None:
                about.set_unit_ids(fields[2], {})  # which tell what counts instances
    return starts, place, lost


def read_messages(form: Any, raw: np.ndarray) -> Iterator[Table]:  # noqa: ANN401
    """Messages of one format, (n, bytes) without their heads, as a table for each instance; none without times."""
    codes = re.findall(r"\d*[a-zA-Z]", form.msg_struct)
    kinds = ["(32,)<i2" if c == "a" else f"S{s[:-1]}" if s.endswith("s") else f"<{_CODES[s]}"
             for c, s in zip(form.msg_fmts, codes)]  # fmt: skip
    kind = np.dtype([(f"f{i}", kind) for i, kind in enumerate(kinds)])
    if "TimeUS" not in form.columns or kind.itemsize != raw.shape[1] or len(kinds) != len(form.columns):
        return  # formats, units and other descriptions of the log itself
    records = np.ascontiguousarray(raw).view(kind)[:, 0]
    columns = {}
    for i, (name, factor) in enumerate(zip(form.columns, form.msg_mults)):
        values = records[f"f{i}"]
        if values.dtype.kind == "S":
            texts = [text.partition(b"\0")[0].decode("latin-1") for text in values.tolist()]
            columns[name] = np.array(texts, dtype=object)
        else:
            columns[name] = values / (1.0 / factor) if factor else widen(values)
    which = columns.get(form.instance_field, np.zeros(len(records), int))
    for instance in np.unique(which.astype(str) if which.dtype == object else which):
        rows = which == instance
        name = f"{form.name}_{instance}" if instance else form.name
        time = columns["TimeUS"][rows].astype(np.int64) * 1000
        yield Table(f"/{name}", time, {n: values[rows] for n, values in columns.items()}, {"TimeUS": "us"})


def widen(values: np.ndarray) -> np.ndarray:
    """Halves as floats, which ROS has no name for; other numbers as they are."""
    return values.astype("f4") if values.dtype == np.float16 else values


def read_usd(path: Path, topic: str, query: Query, notes: list[str]) -> Iterator[Table]:
    """Events of a Crazyflie's SD-card log, versions 1 and 2 of Bitcraze's documentation."""
    data = path.read_bytes()
    if len(data) < 9 or data[0] != 0xBC:
        raise InputError(f"{path} is no log of a Crazyflie's SD card", "one that begins with 0xBC", "check the file")
    version, kinds = struct.unpack_from("<HH", data, 1)
    if version not in (1, 2):
        found = f"{path}: version {version} of the Crazyflie's SD-card log"
        raise InputError(found, "1 or 2", "log with firmware from 2020 on")
    if zlib.crc32(data[:-4]) != struct.unpack_from("<I", data, len(data) - 4)[0]:
        raise InputError(
            f"{path}: wrong checksum of {len(data)} bytes", "a whole log", "stop logging before the card is taken out"
        )
    try:
        place, events = 5, {}
        for _ in range(kinds):
            (number,) = struct.unpack_from("<H", data, place)
            name, place = read_text(data, place + 2)
            (count,) = struct.unpack_from("<H", data, place)
            place += 2
            names, codes = [], []
            for _ in range(count):
                text, place = read_text(data, place)
                names.append(text[:-3])
                codes.append(f"<{_CODES[text[-2]]}")
            head = [("event", "<u2"), ("time", "<u4" if version == 1 else "<u8")]
            events[number] = name, np.dtype([*head, *((f"f{i}", code) for i, code in enumerate(codes))]), names
        starts: dict[int, list[int]] = {number: [] for number in events}
        while place < len(data) - 4:
            (number,) = struct.unpack_from("<H", data, place)
            starts[number].append(place)
            place += events[number][1].itemsize
        if place != len(data) - 4:
            raise KeyError(place)
    except (struct.error, KeyError, ValueError, IndexError):
        raise InputError(
            f"{path} makes no sense at byte {place}", "events that are declared", "copy it again"
        ) from None
    content = np.frombuffer(data, np.uint8)
    for number, (event, kind, names) in events.items():
        if starts[number]:
            raw = content[np.array(starts[number])[:, None] + np.arange(kind.itemsize)]
            rows = np.ascontiguousarray(raw).view(kind)[:, 0]
            columns = {n: widen(rows[f"f{i}"]) for i, n in enumerate(names)}
            yield Table(f"/{event}", rows["time"].astype(np.int64) * (10**6 if version == 1 else 1000), columns)


def read_text(data: bytes, place: int) -> tuple[str, int]:
    """A text that ends with a zero, and the place behind it."""
    end = data.index(b"\0", place)
    return data[place:end].decode("latin-1"), end + 1
