"""What kind of CSV a file is, told from its beginning: encoding, delimiter, decimals, names, units."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, cast

from vpptwin.logs.formats.headings import clean_unit, split_time, split_units
from vpptwin.logs.formats.raw import refuse_damaged
from vpptwin.system.errors import InputError
from vpptwin.system.fields import UNITS

_SAMPLE, _MAX_SAMPLE = 1 << 18, 1 << 24  # bytes that are looked at to see what kind of CSV it is; of very long lines
_LINES, _MIN_LINES = 50, 8  # lines looked at
_DECIMALS = 1 << 16  # characters that tell decimals
_MAX_UNIT = 12  # characters
_MAX_CELL = 1 << 26  # characters: more is a quote that was left open
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf(inity)?)|", re.IGNORECASE)
COMMA_NUMBER = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}((\.\d{3})+(,\d+)?|(,\d{3})+(\.\d+)?|(['’ \u00a0\u202f]\d{3})+([.,]\d+)?)")
"""Numbers whose thousands are parted."""
DATE = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d(:?\d\d)?)?")
NULLS = ("", "nan", "NaN", "NAN", "null", "NULL", "None", "N/A", "NA", "-", "-nan",
         "#N/A", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#NV", "#WERT!", "#BEZUG!", "#ZAHL!")  # fmt: skip
"""Cells without a value."""
UNPACKING_ERRORS = (EOFError, zlib.error, gzip.BadGzipFile)
LISTS = ("[", "(")
"""What cells with lists begin with."""
csv.field_size_limit(_MAX_CELL)


@dataclass
class CsvForm:
    """What kind of CSV a file is.

    Attributes:
        encoding: of its text.
        delimiter, decimal: of cells and fractions.
        skip: lines before the first row of values.
        names: of the columns, each once.
        units: of columns that have one.
        kinds: of the columns: "number", "list" or "text".
        first: a cell of each column that is of its kind.
        is_folded: whether cells hold line ends.
        grouped: columns with numbers whose thousands are parted.
    """

    encoding: str
    delimiter: str
    decimal: str
    skip: int
    names: list[str]
    units: dict[str, str] = field(default_factory=dict)
    kinds: list[str] = field(default_factory=list)
    first: list[str] = field(default_factory=list)
    is_folded: bool = False
    grouped: set[str] = field(default_factory=set)


def sniff(path: Path, notes: list[str]) -> CsvForm:
    """Find out what kind of CSV a file is, from its beginning."""
    try:
        with open_bytes(path) as file:
            head = file.read(_SAMPLE)
            while head.count(b"\n") < _MIN_LINES and len(head) < _MAX_SAMPLE and (more := file.read(len(head))):
                head += more
    except UNPACKING_ERRORS as error:
        raise refuse_damaged(path, "gzip file", error) from None
    encoding = find_encoding(head)
    if encoding in ("cp1252", "latin-1"):
        notes.append(f"{path.name} is not in UTF-8, read as Windows-1252 (Latin-1)")
    text = head.decode(encoding, "ignore").lstrip("\ufeff")
    lines = re.split(r"\r\n|\n|\r", text)
    lines = lines[:-1] if len(head) >= _SAMPLE and len(lines) > 1 else lines
    start = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))
    marked = re.fullmatch(r'"?sep=(.)"?[;,\t]*', lines[start]) if start < len(lines) else None  # which Excel obeys
    start += marked is not None
    sample = [line for line in lines[start:] if line.strip()][:_LINES]
    if not sample:
        raise InputError(f"{path} has no rows", "a row of names, then rows of numbers", "check what wrote it")
    delimiter = marked.group(1) if marked else find_delimiter(sample)
    places, rows, place, size = list[int](), list[list[str]](), 0, 0  # the line each row begins in, and its cells
    for line, row in split_rows(path, (f"{line}\n" for line in lines[start:]), delimiter):
        if any(row) or len(row) > 1:
            places.append(place)
            rows.append([cell.strip() for cell in row])
        place, size = line, size + sum(map(len, row))
        if len(rows) >= _LINES and size > _DECIMALS:
            break
    kinds = find_kinds(rows[:_LINES], rows)
    begin, named, united = find_heads(rows[:_LINES], kinds)
    if begin == len(rows):
        raise InputError(f"{path} has no rows", "a row of names, then rows of numbers", "check what wrote it")
    width, body = len(kinds), [row for row in rows[begin:] if len(row) == len(kinds)]
    if named is not None:
        names = rows[named]  # a delimiter may end rows, or the names
        cells = len(body[0]) if body else len(names)
        if any(names[cells:]) or any(any(row[len(names) :]) for row in body):
            found = f"{path}, line {start + places[named] + 1}: {len(names)} cells"
            expected = f"{cells} cells a line, as in the lines after it"
            raise InputError(found, expected, "complete the names, or remove the line")
        names = [*names, *[""] * cells][:cells]
    else:
        comment = lines[start - 1] if start else ""
        names = [cell.strip() for cell in next(csv.reader([comment.lstrip("# ")], delimiter=delimiter), [])]
        if len(names) != width or not comment.startswith("#"):
            names = [f"c{i}" for i in range(width)]
    units: dict[str, str] = {}
    names = split_units(names, units)
    if united is not None:
        units |= {name: clean_unit(cell) for name, cell in zip(names, rows[united]) if cell}
    columns = list(zip(*body)) or [()] * width
    decimal = find_decimal(columns)
    first = [next((cell for cell in column if find_kind(cell) == kind), "") for column, kind in zip(columns, kinds)]
    plain = NUMBER if decimal == "." else COMMA_NUMBER
    grouped = {name for name, column in zip(names, columns)
               if any(GROUPED.fullmatch(cell) and not plain.fullmatch(cell) for cell in column)}  # fmt: skip
    is_folded = any("\n" in cell for row in rows for cell in row)
    return CsvForm(encoding, delimiter, decimal, start + places[begin], names, units, kinds, first, is_folded, grouped)


def split_rows(path: Path, lines: io.TextIOBase | Iterator[str], delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Number of the line in which each row ends, from 1 on, and its cells."""
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        for row in reader:
            yield reader.line_num, row
    except csv.Error as error:
        found = f"{path}, line {reader.line_num}: {error}"
        raise InputError(found, "cells that end in their line", "look for a quote that is left open") from None


def find_kind(cell: str) -> str:
    """What a cell holds: "" for nothing, otherwise the kind of a column."""
    if cell in NULLS:
        return ""
    return "list" if cell.startswith(LISTS) else "number" if is_number(cell) else "text"


def find_kinds(first: Sequence[Sequence[str]], more: Sequence[Sequence[str]]) -> list[str]:
    """The kind of each column: that of most of its cells in the later half of the first rows, or else of `more`."""
    width = Counter(len(row) for row in reversed(first)).most_common(1)[0][0]
    body = [row for row in first if len(row) == width]
    kinds = []
    for place, column in enumerate(zip(*body[len(body) // 2 :])):
        found = Counter(kind for cell in reversed(column) if (kind := find_kind(cell)))
        if not any(column):  # blank, where NaN would say that numbers come
            found = Counter(kind for row in more[len(first) :] if len(row) == width and (kind := find_kind(row[place])))
        kind = found.most_common(1)[0][0] if found else "number"
        widths = Counter(len(split_list(cell)) for cell in column if cell.startswith(LISTS)) if kind == "list" else {}
        ragged = bool(widths) and 2 * max(widths.values()) <= sum(widths.values())
        kinds.append("text" if ragged else kind)
    return kinds


def find_heads(rows: Sequence[Sequence[str]], kinds: Sequence[str]) -> tuple[int, int | None, int | None]:
    """Places of the first row of values, of the row of names, and of that of units; what is above them is a title."""
    numeric = [k for k, kind in enumerate(kinds) if kind != "text"]

    def find_values(row: Sequence[str]) -> set[str]:
        return {find_kind(row[k]) for k in numeric if k < len(row)} - {""}

    fits = (i for i, row in enumerate(rows) if find_values(row) and "text" not in find_values(row))
    begin = next(fits, min(len(rows), 1)) if numeric else min(len(rows), 1)
    words = [
        i for i in range(begin) if not find_values(rows[i]) - {"text"} and 2 * sum(map(bool, rows[i])) > len(kinds)
    ]
    if not words:
        return (1, 0, None) if begin else (0, None, None)  # names that are numbers, or none
    last, before = words[-1], words[-2] if len(words) > 1 else None
    filled = sum(map(bool, rows[last]))
    if before is None or begin == len(rows) or sum(map(bool, rows[before])) < filled:
        return last + 1, last, None
    # a row of units has no number where the row after it has some, and short words
    below = [i for i, cell in enumerate(rows[begin]) if cell and is_number(cell)]
    words_above = [rows[last][i].strip("[]()") for i in below if i < len(rows[last])]
    is_short = any(words_above) and len(words_above) == len(below) and max(map(len, rows[last])) <= _MAX_UNIT
    if not is_short or any(word not in ("1", *NULLS) and is_number(word) for word in words_above):
        return last + 1, last, None
    known = sum(clean_unit(word) in UNITS for word in rows[last])
    united: dict[str, str] = {}
    split_units(rows[last], united)
    is_named = 2 * known < filled and (bool(united) or any(split_time(cell)[0] for cell in rows[last]))
    return (last + 1, last, None) if is_named else (last + 1, before, last)


def split_list(cell: str) -> list[str]:
    """The elements of a list in a cell."""
    return re.findall(r"[^,;\s]+", cell.strip("[]()"))


def open_bytes(path: Path) -> IO[bytes]:
    """The file's content, unpacked if it is gzipped."""
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    return cast(IO[bytes], gzip.open(path)) if packed else path.open("rb")


def find_encoding(head: bytes) -> str:
    """Encoding of text that begins so."""
    for mark, name in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8")):
        if head.startswith(mark):
            return name
    for first, name in ((1, "utf-16-le"), (0, "utf-16-be")):  # of Latin letters one byte in two is zero
        if len(head) > 3 and head[first::2].count(0) > len(head) // 4:
            return name
    try:
        head.decode()
    except UnicodeDecodeError as error:
        if error.start <= len(head) - 4:
            return "latin-1" if re.search(rb"[\x81\x8d\x8f\x90\x9d]", head) else "cp1252"
    return "utf-8"


def find_delimiter(lines: Sequence[str]) -> str:
    """The delimiter that parts most lines into as many cells, at least two, most of which hold numbers."""

    def rate(mark: str) -> float:
        rows = list(csv.reader((f"{line}\n" for line in lines), delimiter=mark))
        width, same = Counter(len(row) for row in reversed(rows)).most_common(1)[0]
        columns = list(zip(*(row for row in rows if len(row) == width)))
        cells = [[cell.strip() for cell in column[-_MIN_LINES:]] for column in columns]
        numeric = sum(all(is_number(cell) or DATE.fullmatch(cell) for cell in column) for column in cells) / width
        return same / len(rows) * (0.1 + numeric) + 0.05 * (len(rows[0]) == width) if width > 1 else 0.0

    return max(";\t,| ", key=rate)  # of equals the first: semicolons part what commas are fractions of


def find_decimal(columns: Sequence[Sequence[str]]) -> str:
    """What fractions begin with, a dot or a comma, by the cells of columns."""
    certain = Counter[str]()
    doubt = Counter[str]()
    for column in columns:
        marks = Counter[str]()
        for cell in column:
            if match := GROUPED.fullmatch(cell):
                end = match.group(3) or match.group(5) or (match.group(7) or "")
                certain[end[:1]] += bool(end)
                marks["" if end else match.group(1)[:1]] += 1
            elif COMMA_NUMBER.fullmatch(cell):
                certain[","] += 1
            elif "." in cell and NUMBER.fullmatch(cell):
                certain["."] += 1
            else:
                marks["whole"] += len(cell.lstrip("+-")) == 3 and cell.lstrip("+-").isdigit()
        for mark, other in ((".", ","), (",", ".")):  # thousands follow hundreds, or else these are fractions
            doubt[other if marks["whole"] else mark] += marks[mark]
    return max(".,", key=lambda mark: (certain[mark], doubt[mark]))


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, or a list of them, or nothing."""
    if cell.isdigit() or cell in NULLS or NUMBER.fullmatch(cell) or cell.startswith(LISTS):
        return True
    return bool(COMMA_NUMBER.fullmatch(cell) or GROUPED.fullmatch(cell))
