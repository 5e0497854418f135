"""Logs that autopilots write: ULog of PX4, DataFlash of ArduPilot, the Crazyflie's SD card."""

from __future__ import annotations

import contextlib
import io
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vpptwin.errors import InputError, load_extra
from vpptwin.logs.tables import Table, Wish

_USD_CODES = {"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8", "f": "f4",
              "d": "f8", "e": "f2"}  # fmt: skip
_ROWS = 1 << 16  # messages gathered before they are packed


def read_ulog(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Topics of a PX4 ULog; a topic's second instance is called TOPIC_1.

    Raises:
        InputError: if it is damaged from its beginning.
    """
    pyulog = load_extra("pyulog", path)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            log = pyulog.ULog(str(path), disable_str_exceptions=True)
    except Exception as error:  # the library raises whatever its unpacking does
        raise InputError(f"{path} is a damaged ULog ({error})", "a whole one", "copy it again") from None
    if log.file_corruption or not log.data_list:
        if not log.data_list:
            raise InputError(f"{path}: a ULog without samples", "one that was logged in flight", "check the log")
        notes.append(f"{path.name} is damaged, or ends early: what is readable is used")
    if log.dropouts:
        lost = sum(drop.duration for drop in log.dropouts)
        notes.append(f"{path.name}: the logger lost {len(log.dropouts)} times, {lost / 1e3:.2f} s in all")
    repeated = {data.name for data in log.data_list if data.multi_id}
    for data in log.data_list:
        name = f"{data.name}_{data.multi_id}" if data.name in repeated and data.multi_id else data.name
        columns = join_arrays({key: values for key, values in data.data.items() if not key.startswith("_padding")})
        yield Table(f"/{name}", data.data["timestamp"].astype(np.int64) * 1000, columns, {"timestamp": "us"})


def join_arrays(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns NAME[0], NAME[1] as one of (n, k)."""
    joined: dict[str, list[np.ndarray]] = {}
    for name, values in columns.items():
        joined.setdefault(re.sub(r"\[\d+\]$", "", name), []).append(values)
    arrays = {name: np.stack(parts, axis=1) if len(parts) > 1 else parts[0] for name, parts in joined.items()}
    return {name: v if v.dtype.kind in "iufb" else v.astype(str) for name, v in arrays.items()}


def read_dataflash(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Messages of an ArduPilot DataFlash log by their names; those of an instance I of several are called NAME_I.

    Raises:
        InputError: if nothing in it can be read.
    """
    reader = load_extra("pymavlink.DFReader", path)
    rows: dict[str, list[list[object]]] = {}
    times: dict[str, list[int]] = {}
    heads: dict[str, list[str]] = {}
    try:
        with contextlib.redirect_stdout(io.StringIO()) as told, contextlib.redirect_stderr(io.StringIO()):
            log = reader.DFReader_binary(str(path), zero_time_base=True)
            while (message := log.recv_msg()) is not None:
                names = list(message._fieldnames)
                if "TimeUS" not in names:  # formats, units and other descriptions of the log itself
                    continue
                topic = message.get_type()
                instance = message.fmt.instance_field
                values = [getattr(message, name) for name in names]
                if instance is not None and int(values[names.index(instance)]):
                    topic = f"{topic}_{int(values[names.index(instance)])}"
                heads.setdefault(topic, names)
                rows.setdefault(topic, []).append(values)
                times.setdefault(topic, []).append(int(message.TimeUS) * 1000)
                if len(rows[topic]) == _ROWS:
                    yield gather(topic, times.pop(topic), rows.pop(topic), heads[topic])
    except InputError:
        raise
    except Exception as error:  # the library raises whatever its unpacking does
        if not rows:
            raise InputError(f"{path} is a damaged DataFlash log ({error})", "a whole one", "copy it again") from None
        notes.append(f"{path.name} is damaged: what is readable is used")
    if not heads:
        raise InputError(f"{path}: a DataFlash log without samples", "messages with TimeUS", "check the log")
    if told.getvalue().strip():
        notes.append(f"{path.name} is damaged in places, which are left out")
    for topic, values in rows.items():
        yield gather(topic, times[topic], values, heads[topic])


def gather(topic: str, times: list[int], rows: list[list[object]], names: list[str]) -> Table:
    """Messages of one kind as a table."""
    columns = {}
    for name, values in zip(names, zip(*rows)):
        if isinstance(values[0], str | bytes):
            texts = [v.decode("latin-1") if isinstance(v, bytes) else str(v) for v in values]
            columns[name] = np.array(texts, dtype=object)
        elif isinstance(values[0], int | float):
            kind = float if any(isinstance(v, float) for v in values) or name != "TimeUS" else np.int64
            columns[name] = np.array(values, dtype=kind)
        else:
            columns[name] = np.array([list(v) for v in values], dtype=float)
    return Table(f"/{topic}", np.array(times, dtype=np.int64), columns, {"TimeUS": "us"})


def read_usd(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Events of a Crazyflie's SD-card log, versions 1 and 2 of Bitcraze's documentation.

    Raises:
        InputError: if it ends early, its checksum is wrong, or its version unknown.
    """
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
                codes.append(f"<{_USD_CODES[text[-2]]}")
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
            columns = {
                n: rows[f"f{i}"].astype("f4" if kind[f"f{i}"] == "<f2" else kind[f"f{i}"]) for i, n in enumerate(names)
            }
            yield Table(f"/{event}", rows["time"].astype(np.int64) * (10**6 if version == 1 else 1000), columns)


def read_text(data: bytes, place: int) -> tuple[str, int]:
    """A text that ends with a zero, and the place behind it."""
    end = data.index(b"\0", place)
    return data[place:end].decode("latin-1"), end + 1
