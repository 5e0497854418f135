"""CSV as scripts and data loggers write it: any delimiter, decimal commas, lists in cells, units, gzip, any clock."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vpptwin.errors import InputError, load_extra
from vpptwin.fields import NANOSECONDS, Stamp
from vpptwin.logs.raw import Wish
from vpptwin.logs.tables import Table, choose_fields, list_names

if TYPE_CHECKING:
    import pyarrow as pa

_HEAD = 1 << 18  # characters that are looked at to see what kind of CSV it is
_LONGEST_UNIT = 12  # characters
_BLOCK = 1 << 22  # bytes of text converted at once, of which Arrow reads up to thirty ahead
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf(inity)?)|", re.IGNORECASE)
_COMMA_NUMBER = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d(:?\d\d)?)?")
_FORMS = {
    "double": ("a number", _NUMBER),
    "int64": ("a whole number", re.compile(r"[-+]?\d+")),
    "timestamp": ("a date", _DATE),
}
"""Arrow's type of a column → what its cells should be."""
_UNIT = re.compile(r"(.*?)[\s_]*[\[(]([^\[\]()]*)[\])]")
_ENDING = re.compile(
    r".*[a-zA-Z0-9]_(deg_per_s|deg_per_sec|deg_sec|deg_s|degps|dps|rad_per_s|rad_per_sec|rad_sec|rad_s|radps|"
    r"deg|degrees?|rad|radians|mm_s|mm|cm_s|cm|m_per_s|m_s|mps|rpm|mNm|Nm|N|mV|V|mA|A)"
)
"""What names of columns end with that is a unit, by upper and lower case: `q_m` or `phase_a` may be anything."""
_TIMES = ("t", "time", "timestamp", "stamp", "time_stamp", "clock", "elapsed", "elapsed_time", "seconds", "date_time",
          "datetime", "header_stamp", "log_time", "sec", "timestamps", "epoch", "unix_time", "ts", "zeit")  # fmt: skip
_SPELLED = {"s": "s sec secs second seconds", "ms": "ms msec millis milliseconds", "us": "us usec microseconds µs μs",
            "ns": "ns nsec nanoseconds"}  # fmt: skip
_WORDS = {word: unit for unit, words in _SPELLED.items() for word in words.split()}
_SUFFIXES = {f"_{word}": unit for word, unit in _WORDS.items()} | {"us": "us", "ms": "ms", "ns": "ns"}
"""What names of clocks end with → unit."""
_SLOWEST, _FASTEST = 5.0, 5000.0  # samples a second of a log whose clock tells no unit; three decades leave one unit

_DATES = 1e9, 4e9  # seconds since 1970: 2001 to 2096
_STEP = 60.0  # s, between samples of a log that shows dates


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
    is_comma = delimiter != "," and any(_COMMA_NUMBER.fullmatch(cell) for cell in values)
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
    if delimiter != "," and _COMMA_NUMBER.fullmatch(cell):
        return True
    return bool(_NUMBER.fullmatch(cell)) or cell.startswith(("[", "("))


def is_units(row: Sequence[str], after: Sequence[str], delimiter: str) -> bool:
    """Whether a row holds units: no number where the row after it has some, and short words."""
    numbers = [i for i, cell in enumerate(after) if cell and is_number(cell, delimiter)]
    words = [row[i].strip("[]()") for i in numbers if i < len(row)]
    if not any(words) or len(words) < len(numbers) or max(map(len, row)) > _LONGEST_UNIT:
        return False
    return not any(word and word != "1" and is_number(word, delimiter) for word in words)


def clean_unit(text: str) -> str:
    """A unit as `vpptwin.fields.UNITS` spells it, as far as it is one of those."""
    text = text.strip().strip("[]()").strip()
    text = re.sub(r"(_per)?_s(ec)?$|(?<=deg|rad)ps$", "/s", text)
    text = {"°": "deg", "degrees": "deg", "degree": "deg", "radians": "rad", "°/s": "deg/s", "dps": "deg/s",
            "mps": "m/s", "mNm": "mN m", "Nm": "N m",
            "N·m": "N m", "m/s²": "m/s^2", "m/s2": "m/s^2", "m/s/s": "m/s^2", "RPM": "rpm", "percent": "%",
            "meters": "m", "metres": "m"}.get(text, text)  # fmt: skip
    return _WORDS.get(text, text)


def part_units(names: Sequence[str], units: dict[str, str]) -> list[str]:
    """Names without the units that some of them bring, each once; nameless ones are called by their place."""
    parted: list[str] = []
    for place, given in enumerate(names):
        match = _UNIT.fullmatch(given)
        is_index = match is not None and match.group(2).isdigit()
        name = first = (match.group(1) if match and match.group(1) and not is_index else given) or f"c{place}"
        count = 1
        while name in parted:
            count += 1
            name = f"{first}_{count}"
        parted.append(name)
        if match is not None and not is_index and match.group(2):
            units[name] = clean_unit(match.group(2))
    for name in parted:
        ending = _ENDING.fullmatch(name)
        if ending and name not in units:
            units[name] = clean_unit(ending.group(1))
        stem, unit = split_time(name)
        if stem and unit and name not in units:
            units[name] = unit
    return parted


def split_time(name: str) -> tuple[bool, str]:
    """Whether a column is called as clocks are, and the unit that its name ends with, "" for none."""
    plain = list_names(name)[2]
    if plain in _TIMES:
        return True, ""
    for suffix, unit in _SUFFIXES.items():
        if plain.endswith(suffix) and plain.removesuffix(suffix).rstrip("_") in _TIMES:
            return True, unit
    return False, ""


def find_clock(path: Path, names: Sequence[str], stamp: Stamp | None) -> str:
    """The column of the time.

    Raises:
        InputError: if there is none, or none of the name that somebody gave.
    """
    if stamp is not None:
        known = [name for name in names if stamp.path in list_names(name)]
    else:
        known = sorted((n for n in names if split_time(n)[0]), key=lambda n: _rank(n))
    if not known:
        wanted = stamp.path if stamp is not None else "time, t or timestamp"
        listed = ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
        action = "call it so, or name it: `stamp: {path: NAME, unit: ms}`"
        raise InputError(f"{path}: columns {listed}", f"a column {wanted} with the time", action)
    return known[0]


def _rank(name: str) -> int:
    plain = list_names(name)[2]
    return next((i for i, known in enumerate(_TIMES) if plain == known or plain.startswith(f"{known}_")), len(_TIMES))


def guess_unit(time: np.ndarray) -> str:
    """Unit of a clock: in which it shows a date of these years, otherwise in which its steps are those of a log."""
    steps = np.abs(np.diff(time[:10_000].astype(float)))
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    latest = float(np.abs(time).max())
    for unit, factor in NANOSECONDS.items():
        if _DATES[0] < latest * factor / 1e9 < _DATES[1] and step * factor / 1e9 < _STEP:
            return unit
    for unit, factor in NANOSECONDS.items():
        if step and _SLOWEST < 1e9 / (step * factor) <= _FASTEST:
            return unit
    return "s"


def is_date(form: Format, clock: str) -> bool:
    """Whether the time is told as a date."""
    place = form.names.index(clock)
    return place < len(form.first) and bool(_DATE.fullmatch(form.first[place]))


def check_times(path: Path, clock: str, time: np.ndarray) -> None:
    """Refuse a column of times (n,) with gaps.

    Raises:
        InputError: naming the first row without one.
    """
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        raise InputError(f"{path}: no time in row {row} of {clock}", "a time in every row", "remove the row")


def count_ns(time: np.ndarray, unit: str) -> np.ndarray:
    """Times in ns, (n,) int64."""
    factor = NANOSECONDS[unit]
    if time.dtype.kind in "iu":
        return time.astype(np.int64) * factor
    whole = np.floor(time)
    wild = ~(np.abs(time) < 2.0**62 / factor)
    whole = np.where(wild, 0.0, whole)
    counted = whole.astype(np.int64) * factor + np.rint((np.where(wild, 0.0, time) - whole) * factor).astype(np.int64)
    return np.where(wild, np.int64(2**62), counted)


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
                good = _NUMBER.fullmatch(text) or text.lower() in ("null", "none", "n/a", "na", "-", "-nan")
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
