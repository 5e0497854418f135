"""Cells of CSV by Python alone, where Arrow, which is five times as quick, is not installed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from vpptwin.logs.formats.csv_form import DATE, NULLS, NUMBER, UNPACKING_ERRORS, split_list
from vpptwin.logs.formats.raw import refuse_damaged
from vpptwin.system.errors import InputError

if TYPE_CHECKING:
    from vpptwin.logs.formats.delimited import CsvCells

_ROWS = 1 << 14  # converted at once
_NULLS = frozenset(NULLS)
_ZONE = re.compile(r"(Z|([+-])(\d\d):?(\d\d)?)$")
_PARTS = re.compile(r"[,;\s]+")


def read_pieces(cells: CsvCells, wanted: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
    """The columns wanted, some rows at a time, as `vpptwin.logs.formats.delimited.read_column` gives them.

    Raises:
        InputError: if a line has another number of cells, or a cell that is needed does not convert.
    """
    names, lines, number = cells.form.names, cells.list_lines(), 0
    try:
        while piece := list(islice(lines, _ROWS)):
            for line, row in piece:
                if len(row) != len(names):
                    expected = f"{len(names)} cells a line, each with a number where the first has one"
                    found = f"{cells.path}, line {line}: {len(row)} cells"
                    raise InputError(found, expected, "complete or remove the line")
            columns = list(zip(*(row for _, row in piece)))
            yield {name: convert_column(cells, columns[cells.places[name]], name, number) for name in wanted}
            number += len(piece)
    except UNPACKING_ERRORS as error:
        raise refuse_damaged(cells.path, "gzip file", error) from None


def convert_column(cells: CsvCells, column: Sequence[str], name: str, number: int) -> np.ndarray:
    """Cells of a column: numbers (n,), lists (n, k) or text; `number` rows came before."""
    place = cells.places[name]
    first, kind = cells.form.first[place], cells.form.kinds[place]
    trimmed = [cell.strip() for cell in column]
    if name == cells.clock and DATE.fullmatch(first):
        return convert_dates(cells, trimmed, number)
    if kind == "text":
        return np.array(column, dtype=object)
    if kind == "list":
        return convert_lists(cells, trimmed, name, number)
    if name == cells.clock and re.fullmatch(r"\d{16,}", first) and all(cell.isdigit() for cell in trimmed):
        return np.array([int(cell) for cell in trimmed])  # for whose digits a double has no room
    values, wrong = convert_numbers(trimmed, cells.form.decimal, name in cells.form.grouped)
    cells.drop(name, wrong, column, number, "a number, as in the lines before")
    return values


def convert_numbers(column: Sequence[str], decimal: str, grouped: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of trimmed cells, (n,), whose thousands may be parted, and which hold something else, (n,) bool."""
    known = ["nan" if cell in _NULLS else cell for cell in column]
    if not grouped and (decimal == "." or not any("." in cell for cell in known)):
        with suppress(ValueError):
            return np.array([cell.replace(decimal, ".") for cell in known], dtype=float), np.zeros(len(known), bool)
    parts = r"['’ \u00a0\u202f" + {".": ",]", ",": ".]"}[decimal]
    parted = re.compile(rf"[-+]?[1-9]\d{{0,2}}({parts}\d{{3}})+({re.escape(decimal)}\d+)?")
    values, wrong = np.full(len(column), np.nan), np.zeros(len(column), bool)
    for i, cell in enumerate(column):
        if cell in _NULLS:
            continue
        text = re.sub(parts, "", cell) if parted.fullmatch(cell) else cell
        text = text.replace(decimal, ".")
        if NUMBER.fullmatch(text):
            values[i] = float(text)
        else:
            wrong[i] = True
    return values, wrong


def convert_dates(cells: CsvCells, column: Sequence[str], number: int) -> np.ndarray:
    """Dates in ns, (n,); floats with NaN where there is none."""
    found = np.full(len(column), np.datetime64("NaT"), "datetime64[ns]")
    for i, cell in enumerate(column):
        if cell in _NULLS:
            continue
        if not DATE.fullmatch(cell):
            line = cells.find_line(number + i)
            told = f"{cells.path}, line {line}: {cell!r} as {cells.clock}"
            raise InputError(told, "a date, as in the lines before", "correct the line")
        zone = _ZONE.search(cell[11:])
        local = np.datetime64(cell[: len(cell) - len(zone[0]) if zone else None].replace(" ", "T"), "ns")
        ahead = int(zone[3]) * 60 + int(zone[4] or 0) if zone and zone[2] else 0
        found[i] = local - np.timedelta64(-ahead if zone and zone[2] == "-" else ahead, "m")
    blank = np.isnat(found)
    return np.where(blank, np.nan, found.astype(np.int64)) if blank.any() else found.astype(np.int64)


def convert_lists(cells: CsvCells, column: Sequence[str], name: str, number: int) -> np.ndarray:
    """Lists of numbers in cells, (n, k), NaN where a cell holds another number of them, or none."""
    width = len(split_list(cells.form.first[cells.places[name]]))
    parts = [_PARTS.split(cell.strip("[]() \t\r\n")) for cell in column]
    widths, empty = np.array([len(each) for each in parts]), np.array([cell in _NULLS for cell in column])
    wrong = (widths != width) & ~empty
    if wrong.any() and name in cells.needed:
        line = cells.find_line(number + int(np.argmax(wrong)))
        found = f"{cells.path}, line {line}: {widths[wrong][0]} values in the list of {name}"
        raise InputError(found, f"{width}, as in the first", "correct the line")
    values, good = np.full((len(parts), width), np.nan), np.flatnonzero(widths == width)
    flat, odd = convert_numbers([part for i in good for part in parts[i]], cells.form.decimal)
    values[good] = flat.reshape(-1, width)
    wrong[good] |= odd.reshape(-1, width).any(axis=1) & ~empty[good]
    cells.drop(name, wrong, column, number, f"a list of {width} numbers")
    return values
