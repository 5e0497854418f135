"""Parquet files: columns of numbers, dates and lists over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.logs.formats.arrays import refuse_tests
from vpptwin.logs.formats.headings import find_times, split_units
from vpptwin.logs.formats.raw import Query, refuse_damaged
from vpptwin.logs.formats.tables import NAMES, Table, choose_fields, find_named, list_some, note_dropped
from vpptwin.logs.parts import split_test
from vpptwin.system.errors import InputError, load_extra
from vpptwin.system.fields import UNSAID, Stamp

_MAX_ROWS = 1 << 16  # rows converted at once
_BUFFER = 1 << 16  # bytes of a column read at once
ROWS_OF_SETS = ("index", "frame_index", "episode_index", "task_index")  # bookkeeping of LeRobot


def read_parquet(path: Path, topic: str, query: Query, notes: list[str]) -> Iterator[Table]:
    """Rows of a Parquet file, in pieces."""
    file, number = split_test(path)
    held = list_file_episodes(file)
    if number is None and len(held) > 1:
        raise refuse_tests(path, [f"episode_index {episode}" for episode in held])
    if number is not None and number not in held:
        found, expected = f"{path}: no episode {number}", ", ".join(f"#{n}" for n in held[:12]) or f"{file}"
        raise InputError(found, expected, "correct the number")
    yield from read_rows(path, file, topic, query.stamps.get(topic), query, notes, number, {})


def list_file_episodes(file: Path) -> list[int]:
    """The episodes of a Parquet file out of a LeRobot data set, [] for any other file."""
    pa, parquet = load_extra("pyarrow", file), load_extra("pyarrow.parquet", file)
    try:
        with parquet.ParquetFile(file, pre_buffer=False, buffer_size=_BUFFER) as content:
            if "episode_index" not in content.schema_arrow.names:
                return []
            batches = content.iter_batches(batch_size=_MAX_ROWS, columns=["episode_index"])
            return sorted({int(n) for batch in batches for n in batch.column(0).unique().to_pylist() if n is not None})
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:
        raise refuse_damaged(file, "Parquet file", error) from None


def read_rows(
    path: Path, file: Path, topic: str, stamp: Stamp | None, query: Query, notes: list[str], episode: int | None,
    names: Mapping[str, list[str]],
) -> Iterator[Table]:  # fmt: skip
    """Rows of a Parquet file, those of one episode if it has several; `names` are those of elements of lists."""
    pa = load_extra("pyarrow", path)
    parquet, compute = load_extra("pyarrow.parquet", path), load_extra("pyarrow.compute", path)
    try:
        content = parquet.ParquetFile(file, pre_buffer=False, buffer_size=_BUFFER)  # else all of it is held
        units: dict[str, str] = {}
        widths: dict[str, int] = {}
        given = dict(zip(split_units(content.schema_arrow.names, units), content.schema_arrow.names))
        times = find_times(path, topic, list(given), stamp, units)
        clock = times.name
        fields: dict[str, str] | None = None
        for first in content.iter_batches(batch_size=_MAX_ROWS):  # only rows tell whether lists have one length
            held = {n: read_arrow(pa, n, first.column(k), units, names, widths) for k, n in enumerate(given)}
            held = {n: columns for n, columns in held.items() if episode is None or n not in ROWS_OF_SETS}
            if {"episode_index", "frame_index"} <= given.keys():  # of LeRobot, with its folder or without
                measured = [c for found in held.values() for c in found if c not in (clock, *ROWS_OF_SETS)]
                units = dict.fromkeys(measured, UNSAID) | units
            stamps = held[clock].get(clock, np.empty(0, bool))
            if stamps.dtype.kind not in "iuf" or stamps.ndim > 1:
                raise InputError(f"{path}: {clock} holds no numbers", "a column of times", "name another as its stamp")
            fields = choose_fields(query, topic, [column for columns in held.values() for column in columns])
            note_dropped(query, topic, [column for columns in held.values() for column in columns], clock)
            if topic not in query.fields and (unread := [name for name, columns in held.items() if not columns]):
                notes.append(f"{topic}: {list_some('no numbers in', unread)}")
            given = {n: given[n] for n, columns in held.items() if n == clock or not fields.keys().isdisjoint(columns)}
            break
        is_empty = True
        wanted = [*given.values(), *(["episode_index"] if episode is not None else [])]
        for batch in content.iter_batches(batch_size=_MAX_ROWS, columns=wanted):
            if episode is not None:
                batch = batch.filter(compute.equal(batch.column("episode_index"), episode))
            if not batch.num_rows:
                continue
            columns: dict[str, np.ndarray] = {}
            for name, source in given.items():
                columns |= read_arrow(pa, name, batch.column(source), units, names, widths)
            for lost in (fields or {}).keys() - columns.keys():
                if lost in find_named(query, topic, fields or {}):
                    raise InputError(f"{path}: {lost} holds lists of several lengths", "one length", "save it so")
                columns[lost] = np.full((batch.num_rows, *([widths[lost]] if lost in widths else [])), np.nan)
            is_empty = False
            counted = times.count(columns[clock], notes if stamp is None else [])
            yield Table(topic, counted, columns, units, fields)
        if is_empty:
            raise InputError(f"{path} has no rows", "a table with rows", "check what wrote it")
    except (pa.ArrowException, OSError, KeyError) as error:
        raise refuse_damaged(file, "Parquet file", error) from None


def read_arrow(
    pa: Any, name: str, column: Any, units: dict[str, str], names: Mapping[str, list[str]], widths: dict[str, int],  # noqa: ANN401
) -> dict[str, np.ndarray]:  # fmt: skip
    """A column as arrays: dates in ns, lists (n, k) or one column per named element, what is neither left out."""
    kind = column.type
    if pa.types.is_timestamp(kind):
        units[name] = "ns"
        return {name: np.asarray(column.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64()))}
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        inner = column.flatten()
        is_named = NAMES.fullmatch(f"{name}[0]") and pa.types.is_string(inner.type)
        if is_named and len(inner) and not len(inner) % len(column):
            texts = np.asarray(inner.fill_null("").to_numpy(zero_copy_only=False)).reshape(len(column), -1)
            return {f"{name}[{k}]": texts[:, k] for k in range(texts.shape[1])}
        values = read_lists(column, widths, name)
        labels = names.get(name, [])
        if values is not None and len(labels) == values.shape[1] and len(set(labels)) == len(labels):
            return {f"{name}.{label}": values[:, k] for k, label in enumerate(labels)}
        return {} if values is None else {name: values}
    if pa.types.is_boolean(kind):
        return {name: np.asarray(column.fill_null(False).to_numpy(zero_copy_only=False)).astype(bool)}
    if pa.types.is_integer(kind) and not column.null_count:
        return {name: np.asarray(column.to_numpy(zero_copy_only=False))}
    if pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind) or pa.types.is_null(kind):
        code = pa.float32() if pa.types.is_float32(kind) else pa.float64()
        return {name: np.asarray(column.cast(code, safe=False).to_numpy(zero_copy_only=False))}
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return {name: np.asarray(column.fill_null("").to_numpy(zero_copy_only=False))}
    return {}


def read_lists(column: Any, widths: dict[str, int], name: str) -> np.ndarray | None:  # noqa: ANN401
    """Lists as (n, k), NaN where a row holds another number of values than most of the first rows, or none.

    None for pictures, and for lists of which most have other lengths or that cannot hold NaN; `widths` knows k.
    """
    from pyarrow import compute, types

    kind = column.type.value_type
    if not (types.is_floating(kind) or types.is_integer(kind)):
        return None
    lengths = np.asarray(compute.list_value_length(column).fill_null(0).to_numpy(zero_copy_only=False))
    if name not in widths:
        values, counts = np.unique(lengths[lengths > 0], return_counts=True)
        widths[name] = int(values[np.argmax(counts)]) if len(values) and 4 * counts.max() > 3 * counts.sum() else 0
    width, good = widths[name], np.flatnonzero(lengths == widths[name])
    if not width or (len(good) < len(lengths) and not types.is_floating(kind)):
        return None
    whole = len(good) == len(lengths) and not column.null_count
    inner = (column if whole else column.take(good)).flatten()
    found = np.asarray(inner.to_numpy(zero_copy_only=False)).reshape(-1, width)
    if whole:
        return found
    values = np.full((len(lengths), width), np.nan, found.dtype)
    values[good] = found
    return values
