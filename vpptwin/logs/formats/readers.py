"""All kinds of log files. A new format is a function that reads it, named in `FORMATS` here.

The function yields tables of named columns over time, as `read_arrays` does. They are kept as channels and, by
`convert`, written as MCAP. Columns are named by `headings`, which finds the timestamps among them too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.writer import MCAP0_MAGIC

from vpptwin.logs.formats.arrays import list_array_tests, read_arrays
from vpptwin.logs.formats.bags import read_bag
from vpptwin.logs.formats.columnar import list_file_episodes, read_parquet
from vpptwin.logs.formats.container import read_container
from vpptwin.logs.formats.delimited import read_csv
from vpptwin.logs.formats.lerobot import read_lerobot
from vpptwin.logs.formats.raw import Query, RawFile
from vpptwin.logs.formats.tables import Table, keep_tables, name_topic
from vpptwin.logs.formats.unpack import ZSTD, unpack_file
from vpptwin.logs.formats.vehicles import read_dataflash, read_ulog, read_usd
from vpptwin.logs.parts import split_episode, split_test
from vpptwin.system.errors import InputError, check_name

LOG = "a log: MCAP (ros2 profile, CDR messages), CSV, or another of docs/logs.md"
"""What is expected where none was given."""


@dataclass(frozen=True)
class FileFormat:
    """A kind of log file.

    Attributes:
        endings: of names of such files in a folder of logs, in small letters.
        magic: pattern of the bytes that such files begin with.
        read_tables: yields named columns over time of (path, topic, query, notes); or else
        read_messages: takes (path, query) apart into channels of messages.
        by_ending: whether the ending tells the format where the first bytes tell none.
        is_single: whether it holds one table as a rule, which is called as the file.
        list_tests: numbers of the tests of a file that may hold several.
    """

    endings: tuple[str, ...] = ()
    magic: bytes = b"(?!)"
    read_tables: Callable[[Path, str, Query, list[str]], Iterator[Table]] | None = None
    read_messages: Callable[[Path, Query], RawFile] | None = None
    by_ending: bool = False
    is_single: bool = False
    list_tests: Callable[[Path], list[int]] | None = None


MCAP = FileFormat((".mcap",), re.escape(MCAP0_MAGIC), read_messages=read_container)
LEROBOT = FileFormat(read_tables=read_lerobot, is_single=True)
CSV = FileFormat(
    (".csv", ".tsv", ".csv.gz", ".tsv.gz", ".txt", ".txt.gz", ".dat"), rb"\x1f\x8b", read_csv, by_ending=True,
    is_single=True,
)  # fmt: skip
FORMATS = (
    MCAP, LEROBOT, CSV,
    FileFormat((".parquet",), b"PAR1", read_parquet, is_single=True, list_tests=list_file_episodes),
    FileFormat((".mat",), b"MATLAB ", read_arrays, by_ending=True, is_single=True, list_tests=list_array_tests),
    FileFormat((".npz",), read_tables=read_arrays, by_ending=True, is_single=True, list_tests=list_array_tests),
    FileFormat((".ulg",), b"ULog", read_ulog),
    FileFormat((".bin",), rb"\xa3\x95", read_dataflash),
    FileFormat((), rb"\xbc.\0", read_usd),
    FileFormat((".bag", ".db3"), b"#ROSBAG|SQLite format 3", read_messages=read_bag),
)  # fmt: skip
"""Every kind of log that is read."""
_FOREIGN = {
    b"\x89PNG": ("a PNG picture", "give the .mcap file itself"),
    b"PK\x03\x04": ("a ZIP archive", "unpack it and give the .mcap file inside"),
    b"\x7fELF": ("a program", "give a log"),
    b"\x89HDF": ("an HDF5 file", "convert it to MCAP"),
}
"""What other files begin with."""


def find_format(path: Path, start: bytes) -> FileFormat | None:
    """The format of a file that begins so, None for what is no log."""
    if split_episode(path)[1] is not None:
        return LEROBOT
    fitting = [form for form in FORMATS if re.match(form.magic, start, re.DOTALL)]
    if not fitting:
        name, is_foreign = split_test(path)[0].name.lower(), start.startswith(tuple(_FOREIGN))
        fitting = [form for form in FORMATS if form.by_ending and name.endswith(form.endings)]
        fitting = [form for form in fitting if not (form is CSV and is_foreign)]
    return fitting[0] if fitting else None


def name_table(path: Path, form: FileFormat) -> str:
    """What the only table of a file is called."""
    return "/episode" if form is LEROBOT else name_topic(path)


def read_start(path: Path) -> bytes:
    """The first bytes of a file."""
    check_name(str(path))
    folder, episode = split_episode(path)
    try:
        with (split_test(path)[0] if episode is None else folder / "meta" / "info.json").open("rb") as file:
            start = file.read(64)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})", LOG, "check its permissions") from None
    if not start:
        advice = "check that the recorder was stopped properly, and record again"
        raise InputError(f"{path} is empty (0 bytes)", LOG, advice)
    return start


def read_file(path: Path, query: Query) -> RawFile:
    """The channels of a file of any format, as far as wanted."""
    start = read_start(path)
    if start.startswith(ZSTD):
        with unpack_file(path) as plain:
            try:
                return replace(read_file(plain, query), path=path)
            except InputError as error:
                raise InputError(error.found.replace(str(plain), str(path)), error.expected, error.action) from None
    form = find_format(path, start)
    if form is not None and form.read_messages is not None:
        return form.read_messages(path, query)
    if form is not None and form.read_tables is not None:
        notes: list[str] = []
        name = name_table(path, form)
        return keep_tables(path, form.read_tables(path, query.names.get(name, name), query, notes), query, notes)
    for signature, (found, action) in _FOREIGN.items():
        if start.startswith(signature):
            raise InputError(f"{path} is {found}", LOG, action)
    if MCAP0_MAGIC.startswith(start):
        raise InputError(f"{path} ends after {len(start)} bytes", LOG, "copy or record it again")
    kind = "text" if all(32 <= byte < 127 or byte in b"\t\r\n" for byte in start) else "not MCAP"
    raise InputError(f"{path} is {kind}, starting with {start[:12]!r}", LOG, "give the .mcap file itself")
