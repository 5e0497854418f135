"""What kind of CSV a file is, told from its beginning: encoding, delimiter, decimals, names, units."""

from __future__ import annotations

import csv
import gzip
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vpptwin.errors import InputError
from vpptwin.logs.headings import clean_unit, part_units

_HEAD = 1 << 18  # characters that are looked at to see what kind of CSV it is
_LONGEST_UNIT = 12  # characters
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf(inity)?)|", re.IGNORECASE)
COMMA_NUMBER = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
DATE = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d(:?\d\d)?)?")


@dataclass
class Format:
    """What kind of CSV a file is.

    Attributes:
        encoding: of its text.
        delimiter, decimal: of cells and fractions.
        skip: lines before the first row of values.
        names: of the columns, each once.
        units: of columns that have one.
        first: row of values.
    """

    encoding: str
    delimiter: str
    decimal: str
    skip: int
    names: list[str]
    units: dict[str, str] = field(default_factory=dict)
    first: list[str] = field(default_factory=list)


def sniff(path: Path, notes: list[str]) -> Format:
    """Find out what kind of CSV a file is, from its beginning.

    Raises:
        InputError: if it is none.
    """
    with open_bytes(path) as file:
        head = read_head(path, file)
    encoding = find_encoding(head)
    if encoding == "latin-1":
        notes.append(f"{path.name} is not in UTF-8, read as Latin-1")
    text = head.decode(encoding, "ignore").lstrip("\ufeff")
    lines = re.split(r"\r\n|\n|\r", text)
    lines = lines[:-1] if len(head) >= _HEAD and len(lines) > 1 else lines
    start = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))
    rows = [line for line in lines[start:] if line.strip()][:50]
    if not rows:
        raise InputError(f"{path} has no rows", "a row of names, then rows of numbers", "check what wrote it")
    delimiter = find_delimiter(rows)
    cells = [[cell.strip() for cell in row] for row in csv.reader(rows, delimiter=delimiter)]
    skip, names = start, cells[0]
    if all(is_number(cell, delimiter) for cell in cells[0]):
        said = next(csv.reader([lines[start - 1].lstrip("# ")], delimiter=delimiter)) if start else []
        names = (
            [cell.strip() for cell in said] if len(said) == len(cells[0]) else [f"c{i}" for i in range(len(cells[0]))]
        )
    else:
        skip, cells = start + 1, cells[1:]
    units: dict[str, str] = {}
    names = part_units(names, units)
    if len(cells) > 1 and is_units(cells[0], cells[1], delimiter):
        units |= {name: clean_unit(cell) for name, cell in zip(names, cells[0]) if cell}
        skip, cells = skip + 1, cells[1:]
    skip += sum(not line.strip() for line in lines[start : start + (skip - start)])
    values = [cell for row in cells for cell in row]
    is_comma = delimiter != "," and any(COMMA_NUMBER.fullmatch(cell) for cell in values)
    return Format(encoding, delimiter, "," if is_comma else ".", skip, names, units, cells[0] if cells else [])


def open_bytes(path: Path) -> Any:  # noqa: ANN401
    """The file's content, unpacked if it is gzipped."""
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    return gzip.open(path) if packed else path.open("rb")


def read_head(path: Path, file: Any) -> bytes:  # noqa: ANN401
    """The beginning of a file's content."""
    try:
        return file.read(_HEAD)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise refuse_damaged(path, error) from None


def refuse_damaged(path: Path, error: Exception) -> InputError:
    """What to say of a gzip file that ends early or is broken."""
    return InputError(f"{path} is damaged ({error})", "a whole gzip file", "copy it again")


def find_encoding(head: bytes) -> str:
    """Encoding of text that begins so."""
    for mark, name in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8")):
        if head.startswith(mark):
            return name
    try:
        head.decode()
    except UnicodeDecodeError as error:
        return "utf-8" if error.start > len(head) - 4 else "latin-1"
    return "utf-8"


def find_delimiter(rows: Sequence[str]) -> str:
    """The delimiter that parts most rows into as many cells as the first, at least two."""

    def rate(mark: str) -> tuple[float, int]:
        counts = [len(row) for row in csv.reader(rows, delimiter=mark)]
        same = sum(count == counts[0] for count in counts) / len(counts)
        return (round(same, 1) if counts[0] > 1 else 0.0), counts[0]

    return max(";\t,| ", key=rate)  # of equals the first: semicolons part what commas are fractions of


def is_number(cell: str, delimiter: str) -> bool:
    """Whether a cell holds a number, or a list of them, or nothing."""
    cell = cell.strip().strip('"')
    if delimiter != "," and COMMA_NUMBER.fullmatch(cell):
        return True
    return bool(NUMBER.fullmatch(cell)) or cell.startswith(("[", "("))


def is_units(row: Sequence[str], after: Sequence[str], delimiter: str) -> bool:
    """Whether a row holds units: no number where the row after it has some, and short words."""
    numbers = [i for i, cell in enumerate(after) if cell and is_number(cell, delimiter)]
    words = [row[i].strip("[]()") for i in numbers if i < len(row)]
    if not any(words) or len(words) < len(numbers) or max(map(len, row)) > _LONGEST_UNIT:
        return False
    return not any(word and word != "1" and is_number(word, delimiter) for word in words)
