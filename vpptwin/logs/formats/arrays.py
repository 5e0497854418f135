"""Files of named arrays, as laboratories save them, read within bounds: MATLAB's .mat, NumPy's .npz."""

from __future__ import annotations

import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from vpptwin.logs.formats.raw import Wish
from vpptwin.logs.formats.structures import holds_table, list_runs, part_tables, simplify, split_run
from vpptwin.logs.formats.tables import Table
from vpptwin.system.errors import InputError

MOST = 10**9
"""Bytes that arrays may take."""
_FIRST, _COMPRESSED = 128, 15  # bytes of the head of a .mat, and the kind of an element that is compressed
_PIECE = 1 << 20
_SMALL = 1 << 26  # bytes of a file whose content is kept for the next question
_TRY = "import sys; from scipy.io import loadmat; loadmat(sys.argv[1], simplify_cells=True)"
"""What a process of its own tries where no checksum vouches for a file: scipy crashes on some that are damaged."""
_BROKEN = (ValueError, TypeError, KeyError, IndexError, EOFError, OSError, struct.error, zlib.error, MemoryError,
           OverflowError, zipfile.BadZipFile, AttributeError, NotImplementedError, RuntimeError,
           SyntaxError, TokenError)  # fmt: skip
# What readers raise on content that makes no sense.


def read_mat(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Tables of a MATLAB file up to version 7: one of each structure, or group of arrays, that holds its time.

    Raises:
        InputError: if it is damaged, of version 7.3, or no time is found in it.
    """
    yield from part_tables(path, topic, load_file(split_run(path)[0], notes), wish, notes)


def load_mat(path: Path) -> dict[str, Any]:
    """The variables of a MATLAB file.

    Raises:
        InputError: if it is damaged, or of version 7.3.
    """
    from scipy.io import loadmat  # which few logs wait for
    from scipy.io.matlab import MatReadError

    with path.open("rb") as file:
        head = file.read(_FIRST)
    if head.startswith(b"MATLAB 7.3"):
        found = f"{path} is a MATLAB file of version 7.3, which is HDF5"
        raise InputError(found, "version 7 or older", "save it so: save(file, '-v7')")
    try:
        sealed = False
        if head.startswith(b"MATLAB"):
            size, sealed = measure_mat(path, "<" if head[126:128] == b"IM" else ">")
            weigh(path, size)
        if not sealed and subprocess.run([sys.executable, "-c", _TRY, str(path)], capture_output=True).returncode < 0:
            raise ValueError("what reads it crashes")
        return loadmat(path, simplify_cells=True)
    except InputError:
        raise
    except (MatReadError, *_BROKEN) as error:
        raise damaged(path, "MATLAB", error) from None


def read_npz(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """The table of a NumPy archive.

    Raises:
        InputError: if it is damaged, holds pickles alone, or no time is found in it.
    """
    yield from part_tables(path, topic, load_file(split_run(path)[0], notes), wish, notes)


def load_file(path: Path, notes: list[str]) -> dict[str, Any]:
    """The variables of a file, structures of arrays as mappings, arrays of structures and cells as lists.

    Raises:
        InputError: if it is damaged.
    """
    about = path.stat()
    load = _load if about.st_size < _SMALL else _load.__wrapped__
    content, said = load(path, (about.st_mtime_ns, about.st_size))
    notes += said
    return content


@lru_cache(1)
def _load(path: Path, about: tuple[int, int]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Variables and notes of a file as it was then: what tests it holds is asked before one is read."""
    notes: list[str] = []
    content = load_npz(path, notes) if path.suffix.lower() == ".npz" else load_mat(path)
    return {name: simplify(value) for name, value in content.items() if not name.startswith("__")}, tuple(notes)


def load_npz(path: Path, notes: list[str]) -> dict[str, Any]:
    """The variables of a NumPy archive.

    Raises:
        InputError: if it is damaged.
    """
    content: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            weigh(path, sum(item.file_size for item in archive.infolist()))
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                try:
                    content[name] = archive[name]
                except ValueError as error:
                    if "pickle" not in str(error).lower():
                        raise
                    notes.append(f"{path.name}: {name} holds Python objects, left out")
    except InputError:
        raise
    except _BROKEN as error:
        raise damaged(path, "NumPy", error) from None
    return content


def damaged(path: Path, kind: str, error: Exception) -> InputError:
    """What to say of a file that cannot be read."""
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return InputError(f"{path} is damaged ({reason})", f"a whole {kind} file", "copy it again")


def weigh(path: Path, size: int) -> None:
    """Refuse arrays that take more than `MOST` bytes."""
    if size > MOST:
        found = f"{path} holds arrays of more than {MOST / 1e9:g} GB"
        raise InputError(found, "less", "save a part of it, or write CSV or MCAP")


def measure_mat(path: Path, order: str) -> tuple[int, bool]:
    """Bytes that a MATLAB file's elements take, those unpacked that are compressed, and whether all are, as sealed.

    It is counted as far as `MOST`.
    """
    total, sealed = 0, True
    with path.open("rb") as file:
        file.seek(_FIRST)
        while len(tag := file.read(8)) == 8 and total <= MOST:
            kind, size = struct.unpack(f"{order}II", tag)
            end = file.tell() + size
            if kind != _COMPRESSED:
                total, sealed = total + size, False
            unpacker = zlib.decompressobj()
            while kind == _COMPRESSED and (left := end - file.tell()) > 0 and total <= MOST:
                packed = file.read(min(left, _PIECE))
                while packed and total <= MOST:
                    total += len(unpacker.decompress(packed, _PIECE))
                    packed = unpacker.unconsumed_tail
                if not packed and file.tell() >= path.stat().st_size:
                    break
            sealed = sealed and unpacker.eof
            file.seek(end)
    return total, sealed


def list_array_tests(path: Path) -> list[int]:
    """The numbers of the tests of a file that is an array of them, those without time left out, [] for other files.

    Raises:
        InputError: if it is damaged.
    """
    content = load_file(path, [])
    runs = [] if holds_table(content) else list_runs(content)
    return [number for number, (_, part) in enumerate(runs) if holds_table(part)]
