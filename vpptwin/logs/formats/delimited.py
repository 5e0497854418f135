"""CSV as scripts and data loggers write it: any delimiter, decimal commas, lists in cells, units, gzip, any clock."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vpptwin.logs.formats.csv_form import (
    DATE,
    NULLS,
    NUMBER,
    UNPACKING_ERRORS,
    CsvForm,
    open_bytes,
    sniff,
    split_list,
    split_rows,
)
from vpptwin.logs.formats.headings import find_times
from vpptwin.logs.formats.raw import Query, refuse_damaged
from vpptwin.logs.formats.tables import NAMES, Table, choose_fields, find_named, list_some, note_dropped
from vpptwin.logs.streams.cells import read_pieces
from vpptwin.system.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

_BLOCK = 1 << 22  # bytes of text converted at once, of which Arrow reads up to thirty ahead
_TRIES = 3  # times that a file is read again for one column more; then for all
_FORMS = {
    "double": ("a number", NUMBER),
    "int64": ("a whole number", re.compile(r"[-+]?\d+")),
    "timestamp": ("a date", DATE),
}
"""Arrow's type of a column → what its cells should be."""


def read_csv(path: Path, topic: str, query: Query, notes: list[str]) -> Iterator[Table]:
    """Rows of a CSV file, which may be gzipped, in pieces."""
    form = sniff(path, notes)
    times = find_times(path, topic, form.names, query.stamps.get(topic), form.units)
    clock = times.name
    fields = choose_fields(query, topic, form.names)
    note_dropped(query, topic, form.names, clock)
    needed = {clock, *find_named(query, topic, fields)}
    readable = {name for name, kind in zip(form.names, form.kinds)
            if query.texts or kind != "text" or name in needed or NAMES.fullmatch(name)}  # fmt: skip
    wanted = [name for name in form.names if name in readable and (name in fields or name == clock)]
    times.unit = "ns" if is_date(form, clock) else None
    cells, number = CsvCells(path, form, clock, needed, load_arrow()), 0
    for columns in convert_columns(cells, wanted):
        rows = len(columns[clock])
        columns = drop_blank(cells, columns, number)
        number += rows
        yield Table(topic, times.count(columns[clock], notes), columns, form.units, fields)
    if not number:
        raise InputError(f"{path} has no rows", "a row of names, then rows of numbers", "check what wrote it")
    unread = [name for name in form.names if name in fields and name not in readable]
    lost = [f"{name} ({count}, the first {cell[:40]!r})" for name, (count, cell) in cells.lost.items()]
    lost_notes = list_some("no numbers in", unread), list_some("cells that are not as the others in", lost)
    notes += [f"{topic}: {note}" for note in lost_notes if note]


def load_arrow() -> Any:  # noqa: ANN401
    """Arrow, or None where it is not installed."""
    try:
        return import_module("pyarrow")
    except ModuleNotFoundError:
        return None


def convert_columns(cells: CsvCells, wanted: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
    """The columns wanted, some rows at a time."""
    if cells.pa is None:
        yield from read_pieces(cells, wanted)
        return
    number = 0
    for batch in convert_batches(cells, wanted):
        yield {name: read_column(cells, batch.column(name), name, number) for name in wanted}
        number += batch.num_rows


class CellError(Exception):
    """A cell that is not of its column's kind."""

    def __init__(self, name: str, problem: InputError) -> None:
        self.name, self.problem = name, problem
        super().__init__(name)


@dataclass
class CsvCells:
    """How the cells of a CSV file are converted.

    Attributes:
        path, form: of the file.
        clock: column of the time.
        needed: columns in which every cell must be what the first ones are.
        pa: Arrow; None where it is not installed.
        loose: columns that are read as text and converted here, as some cells are no plain number.
        lost: column → how many of its cells are left out, and the first of them.
    """

    path: Path
    form: CsvForm
    clock: str
    needed: set[str]
    pa: Any
    loose: set[str] = field(default_factory=set)
    lost: dict[str, tuple[int, str]] = field(default_factory=dict)

    @cached_property
    def places(self) -> dict[str, int]:
        """Column → its place."""
        return {name: place for place, name in enumerate(self.form.names)}

    def list_lines(self) -> Iterator[tuple[int, list[str]]]:
        """Number of the line in which each row of values ends, and its cells."""
        with open_bytes(self.path) as file:
            text = io.TextIOWrapper(file, self.form.encoding, "replace", newline=None)
            for line, row in split_rows(self.path, text, self.form.delimiter):
                if line > self.form.skip and row:
                    yield line, row

    def find_line(self, row: int) -> int:
        """Number of the line in which a row of values lies."""
        return [line for line, _ in islice(self.list_lines(), row + 1)][-1]

    def drop(self, name: str, wrong: np.ndarray, column: Any, number: int, expected: str) -> None:  # noqa: ANN401
        """Note cells that are `wrong`, (n,) bool, in rows behind `number` others."""
        if not wrong.any():
            return
        cell = column[int(np.argmax(wrong))]
        cell = cell if isinstance(cell, str) else str(cell.as_py())
        if name in self.needed:
            line = self.find_line(number + int(np.argmax(wrong)))
            raise InputError(f"{self.path}, line {line}: {cell!r} as {name}", expected, "correct the line")
        count, first = self.lost.get(name, (0, cell))
        self.lost[name] = count + int(np.count_nonzero(wrong)), first


def drop_blank(cells: CsvCells, columns: dict[str, np.ndarray], number: int) -> dict[str, np.ndarray]:
    """Columns without the rows that are empty; `number` rows came before."""
    path, clock, time = cells.path, cells.clock, columns[cells.clock]
    if time.dtype.kind not in "iuf" or time.ndim > 1:
        line, cell = cells.find_line(number), time.reshape(len(time), -1)[0, 0]
        expected = "a number, or a date like 2026-01-31 12:00:00.5"
        found = f"{path}, line {line}: {cell!r} as {clock}"
        raise InputError(found, expected, "convert it, or name another column")
    blank = ~np.isfinite(time)
    if not blank.any():
        return columns
    filled = [c for n, c in columns.items() if n != clock and c.dtype.kind == "f"]
    torn = blank & np.any([np.isfinite(c).reshape(len(c), -1).any(axis=1) for c in filled], axis=0)
    if torn.any():
        line = cells.find_line(number + int(np.argmax(torn)))
        raise InputError(f"{path}, line {line}: no number as {clock}", "a time in every row", "remove the row")
    return {name: column[~blank] for name, column in columns.items()}


def is_date(form: CsvForm, clock: str) -> bool:
    """Whether the time is told as a date."""
    place = form.names.index(clock)
    return place < len(form.first) and bool(DATE.fullmatch(form.first[place]))


def convert_batches(cells: CsvCells, wanted: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """The columns wanted as Arrow has them; from the start again where one turns out to be no plain number."""
    done, tries = 0, 0
    cells.loose |= cells.form.grouped
    while True:
        seen = 0
        try:
            for batch in open_batches(cells, wanted):
                seen += batch.num_rows
                if seen > done:
                    yield batch.slice(max(done - (seen - batch.num_rows), 0))
                    done = seen
            return
        except CellError as error:
            tries += 1
            if error.name in cells.loose:
                raise error.problem from None
            cells.loose |= {error.name} if tries < _TRIES else set(wanted) - {cells.clock}


def open_batches(cells: CsvCells, wanted: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """The columns wanted, from the start.

    Raises:
        CellError: at a cell that does not convert.
        InputError: if a line has another number of cells.
    """
    from pyarrow import csv as arrow_csv

    path, form, pa = cells.path, cells.form, cells.pa
    types = {}
    for name in wanted:
        cell, kind = form.first[cells.places[name]], form.kinds[cells.places[name]]
        if name == cells.clock and is_date(form, name):
            types[name] = pa.timestamp("ns", "UTC" if re.search(r"(Z|[+-]\d\d(:?\d\d)?)$", cell[11:]) else None)
        elif kind != "number" or name in cells.loose:
            types[name] = pa.string()
        else:  # an int64 for a clock for whose digits a double has no room
            is_whole = name == cells.clock and re.fullmatch(r"\d{16,}", cell)
            types[name] = pa.int64() if is_whole else pa.float64()
    with open_bytes(path) as file:
        try:
            reader = arrow_csv.open_csv(
                file,
                arrow_csv.ReadOptions(
                    encoding=form.encoding, column_names=form.names, skip_rows=form.skip, block_size=_BLOCK,
                    use_threads=False,
                ),
                arrow_csv.ParseOptions(delimiter=form.delimiter, newlines_in_values=form.is_folded),
                arrow_csv.ConvertOptions(
                    column_types=types, decimal_point=form.decimal, include_columns=wanted, null_values=NULLS,
                ),
            )  # fmt: skip
            yield from reader
        except UNPACKING_ERRORS as error:
            raise refuse_damaged(path, "gzip file", error) from None
        except (pa.ArrowInvalid, UnicodeError) as error:
            raise blame_line(cells, {n: str(kind).partition("[")[0] for n, kind in types.items()}, error) from None


def blame_line(cells: CsvCells, types: dict[str, str], error: Exception) -> Exception:
    """Which line it was that did not convert, of the columns with these types."""
    path, form = cells.path, cells.form
    kinds = [(place, name, types[name]) for place, name in enumerate(form.names) if types.get(name) in _FORMS]
    for line, row in cells.list_lines():
        if len(row) != len(form.names):
            expected = f"{len(form.names)} cells a line, each with a number where the first has one"
            return InputError(f"{path}, line {line}: {len(row)} cells", expected, "complete or remove the line")
        for place, name, kind in kinds:
            plain = row[place].strip().replace(form.decimal, ".")
            good = NUMBER.fullmatch(plain) or plain in NULLS
            if good if kind == "double" else _FORMS[kind][1].fullmatch(plain):
                continue
            found, expected = f"{path}, line {line}: {row[place]!r} as {name}", _FORMS[kind][0]
            return CellError(name, InputError(found, f"{expected}, as in the lines before", "correct the line"))
    return InputError(f"{path}: {error}", "a CSV file", "correct it")


def read_column(cells: CsvCells, column: Any, name: str, number: int) -> np.ndarray:  # noqa: ANN401
    """A column of some rows: numbers (n,), lists (n, k) or text; `number` rows came before."""
    pa, place = cells.pa, cells.places[name]
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.int64())
    if not pa.types.is_string(column.type):
        if pa.types.is_float64(column.type) or (pa.types.is_int64(column.type) and column.null_count == 0):
            return np.asarray(column.to_numpy(zero_copy_only=False))
        return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=float)
    kind = cells.form.kinds[place]
    if kind == "text":
        return np.asarray(column.fill_null("").to_numpy(zero_copy_only=False))
    if kind == "number":
        values, wrong = read_numbers(cells, column)
        cells.drop(name, wrong, column, number, "a number, as in the lines before")
        return values
    return read_lists(cells, column, name, number)


def read_numbers(cells: CsvCells, column: Any) -> tuple[np.ndarray, np.ndarray]:  # noqa: ANN401
    """Numbers of cells, whose thousands may be parted, (n,), and which cells hold something else, (n,) bool."""
    from pyarrow import compute

    text = compute.utf8_trim_whitespace(column)
    point, parts = re.escape(cells.form.decimal), r"['’ \x{00a0}\x{202f}" + {".": ",]", ",": ".]"}[cells.form.decimal]
    grouped = compute.match_substring_regex(text, rf"^[-+]?[1-9]\d{{0,2}}({parts}\d{{3}})+({point}\d+)?$")
    text = compute.if_else(grouped, compute.replace_substring_regex(text, parts, ""), text)
    text = compute.replace_substring(text, cells.form.decimal, ".")
    good = compute.match_substring_regex(text, rf"(?i)^(?:{NUMBER.pattern})$")
    numbers = compute.if_else(compute.and_(good, compute.not_equal(text, "")), text, None)
    values = np.asarray(numbers.cast(cells.pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    wrong = compute.and_(compute.is_valid(column), compute.invert(good.fill_null(True)))
    return values, np.asarray(wrong.to_numpy(zero_copy_only=False))


def read_lists(cells: CsvCells, column: Any, name: str, number: int) -> np.ndarray:  # noqa: ANN401
    """Lists of numbers in cells, (n, k), NaN where a cell holds another number of them, or none."""
    from pyarrow import compute

    first = cells.form.first[cells.places[name]]
    width = len(split_list(first))
    parts = compute.split_pattern_regex(compute.utf8_trim(column.fill_null(""), "[]() \t\r\n"), r"[,;\s]+")
    widths = compute.list_value_length(parts).to_numpy(zero_copy_only=False)
    empty = ~np.asarray(column.is_valid().to_numpy(zero_copy_only=False))
    wrong = (widths != width) & ~empty
    if wrong.any() and name in cells.needed:
        line = cells.find_line(number + int(np.argmax(wrong)))
        found = f"{cells.path}, line {line}: {widths[wrong][0]} values in the list of {name}"
        raise InputError(found, f"{width}, as in the first", "correct the line")
    values = np.full((len(widths), width), np.nan)
    good = np.flatnonzero(widths == width)
    numbers, odd = read_numbers(cells, parts.take(cells.pa.array(good)).flatten())
    values[good] = numbers.reshape(-1, width)
    wrong[good] |= odd.reshape(-1, width).any(axis=1) & ~empty[good]
    cells.drop(name, wrong, column, number, f"a list of {width} numbers")
    return values
