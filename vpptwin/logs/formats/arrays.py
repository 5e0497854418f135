"""Files of named arrays, read within bounds: MATLAB's .mat, NumPy's .npz. Those with their time are tables.

Arrays of structures are tests, FILE#n the nth of them.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from vpptwin.logs.formats.headings import find_times, split_time, split_units
from vpptwin.logs.formats.raw import Query, refuse_damaged
from vpptwin.logs.formats.tables import Table, choose_fields, find_named, name_field, name_topic
from vpptwin.logs.parts import split_test
from vpptwin.system.errors import InputError

MAX_ARRAYS = 10**9
"""Bytes that arrays may take."""
_HEAD, _COMPRESSED = 128, 15  # bytes of the head of a .mat, and the kind of an element that is compressed
_PIECE = 1 << 20  # bytes that are unpacked at once
_MAX_CACHED = 1 << 26  # bytes of a file whose content is kept for the next question
_TRY = "import sys; from scipy.io import loadmat; loadmat(sys.argv[1], simplify_cells=True)"
"""What a process of its own tries where no checksum vouches for a file: scipy crashes on some that are damaged."""
_BROKEN = (ValueError, TypeError, KeyError, IndexError, EOFError, OSError, struct.error, zlib.error, MemoryError,
           OverflowError, zipfile.BadZipFile, AttributeError, NotImplementedError, RuntimeError,
           SyntaxError, TokenError)  # fmt: skip
# What readers raise on content that makes no sense.
_VALUES = ("data", "values", "value")
"""What a structure of one signal calls what is neither its name nor its time."""
_LABELS = ("name", "label", "title")
_SHORT = 16  # values of what is no signal, but a parameter


def load_file(path: Path, notes: list[str]) -> dict[str, Any]:
    """The variables of a file, structures of arrays as mappings, arrays of structures and cells as lists."""
    about = path.stat()
    load = _load if about.st_size < _MAX_CACHED else _load.__wrapped__
    content, noted = load(path, (about.st_mtime_ns, about.st_size))
    notes += noted
    return content


@lru_cache(1)
def _load(path: Path, about: tuple[int, int]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Variables and notes of a file as it was then: what tests it holds is asked before one is read."""
    notes: list[str] = []
    is_numpy = path.suffix.lower() == ".npz"
    try:
        content = _load_npz(path, notes) if is_numpy else _load_mat(path)
    except InputError:
        raise
    except _BROKEN as error:
        raise refuse_damaged(path, "NumPy file" if is_numpy else "MATLAB file", error) from None
    return {name: simplify(value) for name, value in content.items() if not name.startswith("__")}, tuple(notes)


def _load_mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat  # which few logs wait for
    from scipy.io.matlab import MatReadError

    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head.startswith(b"MATLAB 7.3"):
        found = f"{path} is a MATLAB file of version 7.3, which is HDF5"
        raise InputError(found, "version 7 or older", "save it so: save(file, '-v7')")
    sealed = False
    if head.startswith(b"MATLAB"):
        size, sealed = measure_mat(path, "<" if head[126:128] == b"IM" else ">")
        check_size(path, size)
    if not sealed and subprocess.run([sys.executable, "-c", _TRY, str(path)], capture_output=True).returncode < 0:
        raise ValueError("what reads it crashes")
    try:
        return loadmat(path, simplify_cells=True)
    except MatReadError as error:
        raise ValueError(*error.args) from None


def _load_npz(path: Path, notes: list[str]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        check_size(path, sum(item.file_size for item in archive.infolist()))
    with np.load(path, allow_pickle=False) as arrays:
        for name in arrays.files:
            try:
                content[name] = arrays[name]
            except ValueError as error:
                if "pickle" not in str(error).lower():
                    raise
                notes.append(f"{path.name}: {name} holds Python objects, left out")
    return content


def check_size(path: Path, size: int) -> None:
    """Refuse arrays that take more than `MAX_ARRAYS` bytes."""
    if size > MAX_ARRAYS:
        found = f"{path} holds arrays of more than {MAX_ARRAYS / 1e9:g} GB"
        raise InputError(found, "less", "save a part of it, or write CSV or MCAP")


def measure_mat(path: Path, order: str) -> tuple[int, bool]:
    """Bytes that a MATLAB file's elements take, those unpacked that are compressed, and whether all are, as sealed.

    It is counted as far as `MAX_ARRAYS`.
    """
    total, sealed = 0, True
    with path.open("rb") as file:
        file.seek(_HEAD)
        while len(tag := file.read(8)) == 8 and total <= MAX_ARRAYS:
            kind, size = struct.unpack(f"{order}II", tag)
            end = file.tell() + size
            if kind != _COMPRESSED:
                total, sealed = total + size, False
            unpacker = zlib.decompressobj()
            while kind == _COMPRESSED and (rest := end - file.tell()) > 0 and total <= MAX_ARRAYS:
                packed = file.read(min(rest, _PIECE))
                while packed and total <= MAX_ARRAYS:
                    total += len(unpacker.decompress(packed, _PIECE))
                    packed = unpacker.unconsumed_tail
                if not packed and file.tell() >= path.stat().st_size:
                    break
            sealed = sealed and unpacker.eof
            file.seek(end)
    return total, sealed


def list_array_tests(path: Path) -> list[int]:
    """The numbers of the tests of a file that is an array of them, those without time left out, [] for other files."""
    content = load_file(path, [])
    tests = [] if holds_table(content) else list_tests(content)
    return [number for number, (_, part) in enumerate(tests) if holds_table(part)]


@dataclass
class Group:
    """Arrays with their time: columns (n,) or (n, k); odd: those of another length, and how long they are."""

    name: str
    columns: dict[str, np.ndarray]
    odd: dict[str, int] = field(default_factory=dict)


def simplify(value: Any) -> Any:  # noqa: ANN401
    """A variable with structures as mappings, arrays of them and cells as lists in MATLAB's order."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        return {name: simplify(value[name]) for name in value.dtype.names}
    if hasattr(value, "_fieldnames"):  # scipy's structure
        return {name: simplify(getattr(value, name)) for name in value._fieldnames}
    if isinstance(value, dict):
        return {name: simplify(part) for name, part in value.items()}
    if isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        return [simplify(part) for part in (value if isinstance(value, list) else value.flatten("F"))]
    return value


def read_arrays(path: Path, topic: str, query: Query, notes: list[str]) -> Iterator[Table]:
    """Tables of a MATLAB file up to version 7, of a NumPy archive, or of one test of it: of arrays with their time.

    The only one is called as the file, others as their variables.
    """
    file, number = split_test(path)
    content: Mapping[str, Any] = load_file(file, notes)
    tests, is_table = list_tests(content), holds_table(content)
    if number is None and is_table:
        notes += [f"{path.name}: {name} is a test beside: {path}#{k}" for k, (name, _) in enumerate(tests[:3])]
    elif number is not None or tests:
        full = [place for place, (_, part) in enumerate(tests) if holds_table(part)]
        if number is None and len(full) != 1:
            raise refuse_tests(path, [name for name, _ in tests])
        number = full[0] if number is None else number
        if number >= len(tests):
            found = f"{path}: {len(tests)} tests" if tests else f"{path}: a file of one test"
            expected = f"#0 to #{len(tests) - 1}" if tests else f"{file}"
            raise InputError(found, expected, "correct the number")
        content = tests[number][1]
    groups = list(list_tables("", content, query))
    if not groups:
        held = ", ".join(f"{k} {describe(v)}" for k, v in content.items()) or "nothing"
        found = f"{path} holds {held[:300]}"
        raise InputError(found, "a vector `t` or `time`, or one in a structure or a first column",
                         "save the time too; of Simulink, `Structure With Time` or arrays")  # fmt: skip
    for group in groups:
        called = topic if len(groups) == 1 or not group.name else name_topic(Path(group.name.replace(".", "_")))
        units: dict[str, str] = {}
        given = dict(zip(split_units(list(group.columns), units), group.columns.values()))
        times = find_times(path, called, list(given), query.stamps.get(called), units)
        time = given[times.name]
        mismatch = {name: f"{name} has {count} values for {len(time)} times" for name, count in group.odd.items()}
        if named := find_named(query, called, {name: name_field(name) for name in group.odd}):
            found = f"{path}: {called}: {mismatch[named[0]]}"
            raise InputError(found, "one at each time", "save it with a time of its own, or resample it")
        long = [mismatch[name] for name, count in group.odd.items() if count > _SHORT]
        if long and called not in query.fields:
            notes.append(f"{called}: {', '.join(long[:8])}: left out")
        counted = times.count(time, notes if times.stamp is None else [])
        yield Table(called, counted, given, units, choose_fields(query, called, given))


def refuse_tests(path: Path, names: list[str]) -> InputError:
    """What to say of a file of several tests where one is wanted."""
    listed = ", ".join(f"#{k} {name}" for k, name in enumerate(names[:12]))
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    found = f"{path} holds {len(names)} tests: {listed}{more}"
    return InputError(found, "one recording here", f"give one, such as {path}#0")


def holds_table(content: Mapping[str, Any]) -> bool:
    """Whether arrays with their time are in a file, or in a structure."""
    return next(list_tables("", content, Query(lambda _: True)), None) is not None


def list_tests(content: Mapping[str, Any], above: str = "") -> list[tuple[str, Mapping[str, Any]]]:
    """Tests of a file, the structures of all arrays of them, and what each is called; [] without such an array."""
    found: list[tuple[str, Mapping[str, Any]]] = []
    for key, value in content.items():
        name = f"{above}.{key}".strip(".")
        if isinstance(value, Mapping) and unpack_signals(value) is value:
            found += list_tests(value, name)
        parts = value if isinstance(value, list) and not is_signals(value) else []
        structures = [(number, part) for number, part in enumerate(parts, 1) if isinstance(part, Mapping)]
        if not any(holds_table(part) for _, part in structures):
            continue
        for number, part in structures:
            group = next(list_tables("", part, Query(lambda _: True)), None)
            held = f"{len(next(iter(group.columns.values())))} times" if group else "no time"
            label = find_label(part)
            found.append((f"{name}({number}) ({label + ', ' if label else ''}{held})", part))
    return found


def is_signals(parts: list[Any]) -> bool:
    """Whether a list is one of signals of one test: each has a name of its own, its time and its values."""
    named = [find_label(part) for part in parts if isinstance(part, Mapping)]
    plain = all(any(key.lower() in _VALUES for key in part) for part in parts if isinstance(part, Mapping))
    return bool(named) and plain and all(named) and len(set(named)) == len(parts)


def find_label(part: Mapping[str, Any]) -> str:
    """What a structure says that it is called, "" if nothing."""
    labels = (value for key, value in part.items() if key.lower() in _LABELS and isinstance(value, str))
    return next((label for label in labels if label), "")


def describe(value: object) -> str:
    """A variable's kind, for a message."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "iufb":
        return " x ".join(map(str, value.shape)) or "a number"
    if isinstance(value, list):
        kinds = sorted({describe(part) for part in value[:100]})
        return f"a list of {len(value)} ({', '.join(kinds[:3])})"
    return (
        "a structure" if isinstance(value, dict) else "text" if isinstance(value, str) else f"of {type(value).__name__}"
    )


def list_tables(name: str, content: Mapping[str, Any], query: Query) -> Iterator[Group]:
    """Every group of arrays with its time, depth first."""
    content = unpack_signals(content)
    arrays = {k: v for k, v in content.items() if isinstance(v, np.ndarray) and v.dtype.kind in "iufb" and v.size > 1}
    named = {stamp.path for stamp in query.stamps.values()}
    clocks = [k for k, v in arrays.items() if v.ndim == 1 and (split_time(k)[0] or k in named)]
    if clocks:
        length = len(arrays[clocks[0]])
        fitting = {k: v for k, v in arrays.items() if 1 <= v.ndim <= 2 and length in v.shape}
        odd = {k: max(v.shape) for k, v in arrays.items() if k not in fitting}
        yield Group(name, {k: v if v.shape[0] == length else v.T for k, v in fitting.items()}, odd)
    else:
        for key, value in arrays.items():
            rows = value.T if value.ndim == 2 and value.shape[0] < value.shape[1] else value
            if rows.ndim == 2 and rows.shape[1] > 1 and (np.diff(rows[:, 0]) > 0.0).all():
                yield Group(f"{name}.{key}".strip("."), {"time": rows[:, 0], key: rows[:, 1:]})
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from list_tables(f"{name}.{key}".strip("."), value, query)
        elif isinstance(value, list) and is_signals(value):
            for part in value:
                yield from list_tables(f"{name}.{find_label(part)}".strip("."), part, query)


def unpack_signals(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Simulink's structure with time as a structure of its signals, called by their labels."""
    signals = content.get("signals")
    listed = [signals] if isinstance(signals, Mapping) else signals
    if "time" not in content or not isinstance(listed, list):
        return content
    columns: dict[str, Any] = {"time": content["time"]}
    for i, signal in enumerate(listed):
        if isinstance(signal, Mapping) and "values" in signal:
            label = signal.get("label")
            label = label if isinstance(label, str) and label else f"signal_{i + 1}"  # an empty one is an empty array
            columns[label if label not in columns else f"{label}_{i + 1}"] = signal["values"]
    return columns
