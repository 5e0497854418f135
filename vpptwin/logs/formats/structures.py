"""Structures of named arrays: those with their time are tables, arrays of them are tests, FILE#n the nth of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.logs.formats.headings import find_times, part_units, split_time
from vpptwin.logs.formats.raw import Wish
from vpptwin.logs.formats.tables import Table, choose_fields, find_named, name_field, name_topic
from vpptwin.logs.parts import split_test
from vpptwin.system.errors import InputError

_VALUES = ("data", "values", "value")
"""What a structure of one signal calls what is neither its name nor its time."""
_LABELS = ("name", "label", "title")
_SHORT = 16  # values of what is no signal, but a parameter


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


def part_tables(path: Path, topic: str, content: Mapping[str, Any], wish: Wish, notes: list[str]) -> Iterator[Table]:
    """The tables of a file or of one test of it: of arrays with their time, of structures, of matrices.

    The only one is called as the file, others as their variables.
    """
    beside = list_tests(content) if split_test(path)[1] is None and holds_table(content) else []
    notes += [f"{path.name}: {name} is a test beside: {path}#{k}" for k, (name, _) in enumerate(beside[:3])]
    content = choose_test(path, content)
    groups = list(list_tables("", content, wish))
    if not groups:
        held = ", ".join(f"{k} {describe(v)}" for k, v in content.items()) or "nothing"
        found = f"{path} holds {held[:300]}"
        raise InputError(found, "a vector `t` or `time`, or one in a structure or a first column",
                         "save the time too; of Simulink, `Structure With Time` or arrays")  # fmt: skip
    for group in groups:
        called = topic if len(groups) == 1 or not group.name else name_topic(Path(group.name.replace(".", "_")))
        units: dict[str, str] = {}
        given = dict(zip(part_units(list(group.columns), units), group.columns.values()))
        times = find_times(path, called, list(given), wish.stamps.get(called), units)
        time = given[times.name]
        said = {name: f"{name} has {count} values for {len(time)} times" for name, count in group.odd.items()}
        if named := find_named(wish, called, {name: name_field(name) for name in group.odd}):
            found = f"{path}: {called}: {said[named[0]]}"
            raise InputError(found, "one at each time", "save it with a time of its own, or resample it")
        long = [said[name] for name, count in group.odd.items() if count > _SHORT]
        if long and called not in wish.fields:
            notes.append(f"{called}: {', '.join(long[:8])}: left out")
        counted = times.count(time, notes if times.stamp is None else [])
        yield Table(called, counted, given, units, choose_fields(wish, called, given))


def choose_test(path: Path, content: Mapping[str, Any]) -> Mapping[str, Any]:
    """The test that FILE#NUMBER names of a file, or the only one of a file that is an array of them."""
    tests, number = list_tests(content), split_test(path)[1]
    if number is None and (not tests or holds_table(content)):
        return content
    full = [place for place, (_, part) in enumerate(tests) if holds_table(part)]
    if number is None and len(full) != 1:
        raise refuse_tests(path, [name for name, _ in tests])
    number = full[0] if number is None else number
    if number >= len(tests):
        found = f"{path}: {len(tests)} tests" if tests else f"{path}: a file of one test"
        expected = f"#0 to #{len(tests) - 1}" if tests else f"{split_test(path)[0]}"
        raise InputError(found, expected, "correct the number")
    return tests[number][1]


def refuse_tests(path: Path, names: list[str]) -> InputError:
    """What to say of a file of several tests where one is wanted."""
    listed = ", ".join(f"#{k} {name}" for k, name in enumerate(names[:12]))
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    found = f"{path} holds {len(names)} tests: {listed}{more}"
    return InputError(found, "one flight here", f"give one, such as {path}#0")


def holds_table(content: Mapping[str, Any]) -> bool:
    """Whether arrays with their time are in a file, or in a structure."""
    return next(list_tables("", content, Wish(lambda _: True)), None) is not None


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
            group = next(list_tables("", part, Wish(lambda _: True)), None)
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


def list_tables(name: str, content: Mapping[str, Any], wish: Wish) -> Iterator[Group]:
    """Every group of arrays with its time, depth first."""
    content = unpack_signals(content)
    arrays = {k: v for k, v in content.items() if isinstance(v, np.ndarray) and v.dtype.kind in "iufb" and v.size > 1}
    named = {stamp.path for stamp in wish.stamps.values()}
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
            yield from list_tables(f"{name}.{key}".strip("."), value, wish)
        elif isinstance(value, list) and is_signals(value):
            for part in value:
                yield from list_tables(f"{name}.{find_label(part)}".strip("."), part, wish)


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
