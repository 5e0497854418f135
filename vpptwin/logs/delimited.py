"""CSV as scripts and data loggers write it: any delimiter, decimal commas, lists in cells, units, gzip, any clock."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vpptwin.errors import InputError, load_extra
from vpptwin.fields import NANOSECONDS
from vpptwin.logs.csv_form import DATE, NUMBER, Format, is_number, open_bytes, refuse_damaged, sniff
from vpptwin.logs.headings import count_ns, find_clock, guess_unit
from vpptwin.logs.raw import Wish
from vpptwin.logs.tables import Table, choose_fields

if TYPE_CHECKING:
    import pyarrow as pa

_BLOCK = 1 << 22  # bytes of text converted at once, of which Arrow reads up to thirty ahead
_FORMS = {
    "double": ("a number", NUMBER),
    "int64": ("a whole number", re.compile(r"[-+]?\d+")),
    "timestamp": ("a date", DATE),
}
"""Arrow's type of a column → what its cells should be."""


def read_csv(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Rows of a CSV file, in pieces.

    Args:
        path: of the file, which may be gzipped.
        topic: what it is called.
        wish: says which columns are wanted, and may say which one is the time; otherwise it is found by its name.
        notes: warnings are added to it.

    Raises:
        InputError: naming the line, if one is not like the others.
    """
    pa = load_extra("pyarrow", path)
    form = sniff(path, notes)
    stamp = wish.stamps.get(topic)
    clock = find_clock(path, form.names, stamp)
    fields = choose_fields(wish, topic, form.names)
    wanted = [name for name in form.names if name in fields or name == clock]
    unit = stamp.unit if stamp is not None else form.units.get(clock) if form.units.get(clock) in NANOSECONDS else None
    unit = "ns" if is_date(form, clock) else unit
    number = 0
    for batch in convert_batches(path, form, clock, wanted, pa):
        columns = {name: read_column(path, form, batch.column(name), name, number, pa) for name in wanted}
        time = columns[clock]
        if time.dtype.kind not in "iuf":
            line, said = find_line(path, form, number), time.reshape(len(time), -1)[0, 0]
            found = f"{path}, line {line}: {said!r} as {clock}"
            raise InputError(
                found, "a number, or a date like 2026-01-31 12:00:00.5", "convert it, or name another column"
            )
        blank = np.isnan(time) if time.dtype.kind == "f" else np.zeros(len(time), dtype=bool)
        if blank.any():
            filled = [c for n, c in columns.items() if n != clock and c.dtype.kind == "f"]
            torn = blank & np.any([np.isfinite(c).reshape(len(c), -1).any(axis=1) for c in filled], axis=0)
            if torn.any():
                line = find_line(path, form, number + int(np.argmax(torn)))
                raise InputError(f"{path}, line {line}: no number as {clock}", "a time in every row", "remove the row")
            columns = {name: column[~blank] for name, column in columns.items()}
            time = columns[clock]
        if unit is None and len(time):
            unit = guess_unit(time)
            if unit != "s":
                notes.append(f"{topic}: {clock} is taken to count {unit}")
        number += batch.num_rows
        yield Table(topic, count_ns(time, unit or "s"), columns, form.units, fields)
    if not number:
        raise InputError(f"{path} has no rows", "a row of names, then rows of numbers", "check what wrote it")


def is_date(form: Format, clock: str) -> bool:
    """Whether the time is told as a date."""
    place = form.names.index(clock)
    return place < len(form.first) and bool(DATE.fullmatch(form.first[place]))


def convert_batches(
    path: Path,
    form: Format,
    clock: str,
    wanted: Sequence[str],
    pa: Any,  # noqa: ANN401
) -> Iterator[pa.RecordBatch]:
    """The columns wanted as Arrow has them: numbers, except for those whose first row holds none."""
    from pyarrow import csv as arrow_csv

    types = {}
    for place, name in enumerate(form.names):
        cell = form.first[place] if place < len(form.first) else ""
        number = is_number(cell, form.delimiter) and not cell.startswith(("[", "("))
        whole = name == clock and re.fullmatch(r"\d{16,}", cell)  # which a double has no room for
        zone = re.search(r"(Z|[+-]\d\d(:?\d\d)?)$", cell[11:])
        dates = pa.timestamp("ns", "UTC" if zone else None)
        is_dates = name == clock and is_date(form, clock)
        types[name] = dates if is_dates else pa.int64() if whole else pa.float64() if number else pa.string()
    with open_bytes(path) as file:
        try:
            reader = arrow_csv.open_csv(
                file,
                arrow_csv.ReadOptions(
                    encoding=form.encoding, column_names=form.names, skip_rows=form.skip, block_size=_BLOCK,
                    use_threads=False,
                ),
                arrow_csv.ParseOptions(delimiter=form.delimiter),
                arrow_csv.ConvertOptions(
                    column_types=types, decimal_point=form.decimal, include_columns=wanted,
                    null_values=["", "nan", "NaN", "NAN", "null", "NULL", "None", "N/A", "NA", "-", "-nan"],
                ),
            )  # fmt: skip
            yield from reader
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise refuse_damaged(path, error) from None
        except (pa.ArrowInvalid, UnicodeError) as error:
            raise blame_line(path, form, {name: str(types[name]).partition("[")[0] for name in wanted}, error) from None


def blame_line(path: Path, form: Format, types: dict[str, str], error: Exception) -> InputError:
    """Which line it was that did not convert, of the columns with these types."""
    expected = f"{len(form.names)} cells a line, each with a number where the first has one"
    kinds = [types.get(name) for name in form.names]
    with open_bytes(path) as file:
        reader = csv.reader(io.TextIOWrapper(file, form.encoding, "replace", newline=None), delimiter=form.delimiter)
        for line, row in enumerate(reader, 1):
            if line <= form.skip or not row:
                continue
            if len(row) != len(form.names):
                found = f"{path}, line {reader.line_num}: {len(row)} cells"
                return InputError(found, expected, "complete or remove the line")
            for kind, name, cell in zip(kinds, form.names, row):
                text = cell.strip().replace(form.decimal, ".")
                good = NUMBER.fullmatch(text) or text.lower() in ("null", "none", "n/a", "na", "-", "-nan")
                if kind not in _FORMS or (good if kind == "double" else _FORMS[kind][1].fullmatch(text)):
                    continue
                found = f"{path}, line {reader.line_num}: {cell!r} as {name}"
                return InputError(found, f"{_FORMS[kind][0]}, as in the lines before", "correct the line")
    return InputError(f"{path}: {error}", "a CSV file", "correct it")


def read_column(path: Path, form: Format, column: Any, name: str, number: int, pa: Any) -> np.ndarray:  # noqa: ANN401
    """A column of some rows: numbers (n,), lists (n, k) or text; `number` rows came before."""
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.int64())
    if not pa.types.is_string(column.type):
        if pa.types.is_int64(column.type) and column.null_count == 0:
            return np.asarray(column.to_numpy(zero_copy_only=False))
        return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=float)
    place = form.names.index(name)
    if not (place < len(form.first) and form.first[place].startswith(("[", "("))):
        return np.asarray(column.fill_null("").to_numpy(zero_copy_only=False))
    from pyarrow import compute

    inner = compute.utf8_trim(column.fill_null(""), "[]() \t")
    parts = compute.split_pattern_regex(inner, r"[,;\s]+")
    widths = compute.list_value_length(parts).to_numpy(zero_copy_only=False)
    width = len(re.split(r"[,;\s]+", form.first[place].strip("[]() \t")))
    wrong = np.flatnonzero(widths != width)
    if len(wrong):
        line = find_line(path, form, number + int(wrong[0]))
        found = f"{path}, line {line}: {widths[wrong[0]]} values in the list of {name}"
        raise InputError(found, f"{width}, as in the first", "correct the line")
    try:
        values = compute.cast(parts.flatten(), pa.float64())
    except pa.ArrowInvalid as error:
        raise InputError(f"{path}: {name}: {error}", "lists of numbers", "correct the cell") from None
    return np.asarray(values.to_numpy(zero_copy_only=False)).reshape(-1, width)


def find_line(path: Path, form: Format, row: int) -> int:
    """Number of the line in which a row of values lies."""
    with open_bytes(path) as file:
        reader = csv.reader(io.TextIOWrapper(file, form.encoding, "replace", newline=None), delimiter=form.delimiter)
        filled = -form.skip
        for cells in reader:
            filled += bool(cells) or filled < 0
            if filled > row:
                break
        return reader.line_num
