"""Files of named arrays, as laboratories save them: MATLAB's .mat, NumPy's .npz."""

from __future__ import annotations

import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.errors import InputError
from vpptwin.logs.headings import check_times, count_ns, find_clock, guess_unit, part_units, split_time
from vpptwin.logs.raw import Wish
from vpptwin.logs.tables import Table, choose_fields, name_topic

MOST = 10**9
"""Bytes that arrays may take."""
_FIRST, _COMPRESSED = 128, 15  # bytes of the head of a .mat, and the kind of an element that is compressed
_PIECE = 1 << 20
_TRY = "import sys; from scipy.io import loadmat; loadmat(sys.argv[1], simplify_cells=True)"
"""What a process of its own tries where no checksum vouches for a file: scipy crashes on some that are damaged."""
_BROKEN = (ValueError, TypeError, KeyError, IndexError, EOFError, OSError, struct.error, zlib.error, MemoryError,
           OverflowError, zipfile.BadZipFile, AttributeError, NotImplementedError)  # fmt: skip
# What readers raise on content that makes no sense.


def read_mat(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Tables of a MATLAB file up to version 7: one of each structure, or group of arrays, that holds its time.

    Raises:
        InputError: if it is damaged, of version 7.3, or no time is found in it.
    """
    from scipy.io import loadmat  # which few logs wait for
    from scipy.io.matlab import MatReadError

    with path.open("rb") as file:
        head = file.read(_FIRST)
    if head.startswith(b"MATLAB 7.3"):
        found = f"{path} is a MATLAB file of version 7.3, which is HDF5"
        raise InputError(found, "version 7 or older", "save it so: save(file, '-v7')")
    try:
        sealed = False
        if head.startswith(b"MATLAB"):
            size, sealed = measure_mat(path, "<" if head[126:128] == b"IM" else ">")
            weigh(path, size)
        if not sealed and subprocess.run([sys.executable, "-c", _TRY, str(path)], capture_output=True).returncode < 0:
            raise ValueError("what reads it crashes")
        content = loadmat(path, simplify_cells=True)
    except InputError:
        raise
    except (MatReadError, *_BROKEN) as error:
        raise damaged(path, "MATLAB", error) from None
    yield from part_tables(path, topic, content, wish, notes)


def read_npz(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """The table of a NumPy archive.

    Raises:
        InputError: if it is damaged, holds pickles alone, or no time is found in it.
    """
    content: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            weigh(path, sum(item.file_size for item in archive.infolist()))
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                try:
                    content[name] = archive[name]
                except ValueError as error:
                    if "pickle" not in str(error).lower():
                        raise
                    notes.append(f"{path.name}: {name} holds Python objects, left out")
    except InputError:
        raise
    except _BROKEN as error:
        raise damaged(path, "NumPy", error) from None
    yield from part_tables(path, topic, content, wish, notes)


def damaged(path: Path, kind: str, error: Exception) -> InputError:
    """What to say of a file that cannot be read."""
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return InputError(f"{path} is damaged ({reason})", f"a whole {kind} file", "copy it again")


def weigh(path: Path, size: int) -> None:
    """Refuse arrays that take more than `MOST` bytes."""
    if size > MOST:
        found = f"{path} holds arrays of more than {MOST / 1e9:g} GB"
        raise InputError(found, "less", "save a part of it, or write CSV or MCAP")


def measure_mat(path: Path, order: str) -> tuple[int, bool]:
    """Bytes that a MATLAB file's elements take, those unpacked that are compressed, and whether all are, as sealed.

    It is counted as far as `MOST`.
    """
    total, sealed = 0, True
    with path.open("rb") as file:
        file.seek(_FIRST)
        while len(tag := file.read(8)) == 8 and total <= MOST:
            kind, size = struct.unpack(f"{order}II", tag)
            end = file.tell() + size
            if kind != _COMPRESSED:
                total, sealed = total + size, False
            unpacker = zlib.decompressobj()
            while kind == _COMPRESSED and (left := end - file.tell()) > 0 and total <= MOST:
                packed = file.read(min(left, _PIECE))
                while packed and total <= MOST:
                    total += len(unpacker.decompress(packed, _PIECE))
                    packed = unpacker.unconsumed_tail
                if not packed and file.tell() >= path.stat().st_size:
                    break
            sealed = sealed and unpacker.eof
            file.seek(end)
    return total, sealed


def part_tables(path: Path, topic: str, content: Mapping[str, Any], wish: Wish, notes: list[str]) -> Iterator[Table]:
    """The tables of a file: of arrays with their time, of structures, of matrices whose first column is the time.

    The only one is called as the file, others as their variables.

    Raises:
        InputError: if there is none.
    """
    tables = list(list_tables("", {k: v for k, v in content.items() if not k.startswith("__")}, wish))
    if not tables:
        held = ", ".join(f"{k} {describe(v)}" for k, v in content.items() if not k.startswith("__")) or "nothing"
        found = f"{path} holds {held[:300]}"
        raise InputError(found, "a vector `t` or `time`, or one in a structure or a first column",
                         "save the time too; of Simulink, `Structure With Time` or arrays")  # fmt: skip
    for name, columns in tables:
        called = topic if len(tables) == 1 or not name else name_topic(Path(name.replace(".", "_")))
        units: dict[str, str] = {}
        given = dict(zip(part_units(list(columns), units), columns.values()))
        stamp = wish.stamps.get(called)
        clock = find_clock(path, list(given), stamp, units)
        time = given[clock]
        check_times(path, clock, time)
        unit = (stamp.unit if stamp is not None else None) or units.get(clock) or guess_unit(time)
        if unit not in ("s", units.get(clock)) and stamp is None:
            notes.append(f"{called}: {clock} is taken to count {unit}")
        yield Table(called, count_ns(time, unit), given, units, choose_fields(wish, called, given))


def describe(value: object) -> str:
    """A variable's kind, for a message."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "iufb":
        return " x ".join(map(str, value.shape)) or "a number"
    return "a structure" if isinstance(value, dict) else f"of {type(value).__name__}"


def list_tables(name: str, content: Mapping[str, Any], wish: Wish) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Name and columns, (n,) or (n, k), of every group of arrays with its time, depth first."""
    content = unpack_signals(content)
    arrays = {k: v for k, v in content.items() if isinstance(v, np.ndarray) and v.dtype.kind in "iufb" and v.size > 1}
    named = {stamp.path for stamp in wish.stamps.values()}
    clocks = [k for k, v in arrays.items() if v.ndim == 1 and (split_time(k)[0] or k in named)]
    if clocks:
        length = len(arrays[clocks[0]])
        fitting = {k: v for k, v in arrays.items() if 1 <= v.ndim <= 2 and length in v.shape}
        yield name, {k: v if v.shape[0] == length else v.T for k, v in fitting.items()}
    else:
        for key, value in arrays.items():
            rows = value.T if value.ndim == 2 and value.shape[0] < value.shape[1] else value
            if rows.ndim == 2 and rows.shape[1] > 1 and (np.diff(rows[:, 0]) > 0.0).all():
                yield f"{name}.{key}".strip("."), {"time": rows[:, 0], key: rows[:, 1:]}
    for key, value in content.items():
        if isinstance(value, dict):
            yield from list_tables(f"{name}.{key}".strip("."), value, wish)


def unpack_signals(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Simulink's structure with time as a structure of its signals, called by their labels."""
    signals = content.get("signals")
    listed = [signals] if isinstance(signals, dict) else signals
    if "time" not in content or not isinstance(listed, list | np.ndarray):
        return content
    columns: dict[str, Any] = {"time": content["time"]}
    for i, signal in enumerate(listed):
        if isinstance(signal, dict) and "values" in signal:
            label = signal.get("label")
            label = label if isinstance(label, str) and label else f"signal_{i + 1}"  # an empty one is an empty array
            columns[label if label not in columns else f"{label}_{i + 1}"] = signal["values"]
    return columns
