"""Parquet files: columns of numbers, dates and lists over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vpptwin.errors import InputError, load_extra
from vpptwin.fields import UNSAID, Stamp
from vpptwin.logs.headings import check_times, count_ns, find_clock, guess_unit, part_units
from vpptwin.logs.raw import Wish
from vpptwin.logs.tables import NAMES, Table, choose_fields

_ROWS = 1 << 16  # rows converted at once
_BUFFER = 1 << 16  # bytes of a column read at once
ROWS_OF_SETS = ("index", "frame_index", "episode_index", "task_index")  # bookkeeping of LeRobot


def read_parquet(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Rows of a Parquet file, in pieces.

    Raises:
        InputError: if it is damaged, or has no column with the time.
    """
    yield from read_rows(path, path, topic, wish.stamps.get(topic), wish, notes, None, {})


def read_rows(
    path: Path, file: Path, topic: str, stamp: Stamp | None, wish: Wish, notes: list[str], episode: int | None,
    names: Mapping[str, list[str]],
) -> Iterator[Table]:  # fmt: skip
    """Rows of a Parquet file, those of one episode if it has several; `names` are those of elements of lists."""
    pa = load_extra("pyarrow", path)
    parquet, compute = load_extra("pyarrow.parquet", path), load_extra("pyarrow.compute", path)
    try:
        content = parquet.ParquetFile(file, pre_buffer=False, buffer_size=_BUFFER)  # else all of it is held
        unit: str | None = None
        units: dict[str, str] = {}
        given = dict(zip(part_units(content.schema_arrow.names, units), content.schema_arrow.names))
        clock = find_clock(path, list(given), stamp, units)
        fields: dict[str, str] | None = None
        for first in content.iter_batches(batch_size=_ROWS):  # only rows tell whether lists have one length
            held = {n: read_arrow(pa, n, first.column(k), units, names) for k, n in enumerate(given)}
            held = {n: columns for n, columns in held.items() if episode is None or n not in ROWS_OF_SETS}
            if {"episode_index", "frame_index"} <= given.keys():  # of LeRobot, with its folder or without
                measured = [c for found in held.values() for c in found if c not in (clock, *ROWS_OF_SETS)]
                units = dict.fromkeys(measured, UNSAID) | units
            times = held[clock].get(clock, np.empty(0, bool))
            if times.dtype.kind not in "iuf" or times.ndim > 1:
                raise InputError(f"{path}: {clock} holds no numbers", "a column of times", "name another as its stamp")
            fields = choose_fields(wish, topic, [column for columns in held.values() for column in columns])
            given = {n: given[n] for n, columns in held.items() if n == clock or not fields.keys().isdisjoint(columns)}
            break
        wanted = [*given.values(), *(["episode_index"] if episode is not None else [])]
        for batch in content.iter_batches(batch_size=_ROWS, columns=wanted):
            if episode is not None:
                batch = batch.filter(compute.equal(batch.column("episode_index"), episode))
            if not batch.num_rows:
                continue
            columns: dict[str, np.ndarray] = {}
            for name, source in given.items():
                columns |= read_arrow(pa, name, batch.column(source), units, names)
            if lost := (fields or {}).keys() - columns.keys():
                found = f"{path}: {min(lost)} holds lists of several lengths"
                raise InputError(found, "one length", "leave the column out")
            time = columns[clock]
            check_times(path, clock, time)
            unit = unit or (stamp.unit if stamp is not None else None) or units.get(clock) or guess_unit(time)
            yield Table(topic, count_ns(time, unit), columns, units, fields)
        if unit is None:
            raise InputError(f"{path} has no rows", "a table with rows", "check what wrote it")
        if unit not in ("s", units.get(clock)) and stamp is None:
            notes.append(f"{topic}: {clock} is taken to count {unit}")
    except (pa.ArrowException, OSError, KeyError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{file} is damaged ({reason})", "a whole Parquet file", "copy it again") from None


def read_arrow(
    pa: Any,  # noqa: ANN401
    name: str,
    column: Any,  # noqa: ANN401
    units: dict[str, str],
    names: Mapping[str, list[str]],
) -> dict[str, np.ndarray]:
    """A column as arrays: dates in ns, lists (n, k) or one column per named element, what is neither left out."""
    kind = column.type
    if pa.types.is_timestamp(kind):
        units[name] = "ns"
        return {name: np.asarray(column.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64()))}
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        inner = column.flatten()
        width, rest = divmod(len(inner), len(column))
        if width and not rest and NAMES.fullmatch(f"{name}[0]") and pa.types.is_string(inner.type):
            texts = np.asarray(inner.fill_null("").to_numpy(zero_copy_only=False)).reshape(-1, width)
            return {f"{name}[{k}]": texts[:, k] for k in range(width)}
        if rest or not width or not (pa.types.is_floating(inner.type) or pa.types.is_integer(inner.type)):
            return {}  # pictures, ragged lists
        values = np.asarray(inner.to_numpy(zero_copy_only=False)).reshape(-1, width)
        labels = names.get(name, [])
        if len(labels) == width and len(set(labels)) == width:
            return {f"{name}.{label}": values[:, k] for k, label in enumerate(labels)}
        return {name: values}
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
