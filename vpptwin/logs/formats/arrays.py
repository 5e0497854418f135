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

from vpptwin.logs.formats.raw import Wish, refuse_damaged
from vpptwin.logs.formats.structures import holds_table, list_tests, part_tables, simplify
from vpptwin.logs.formats.tables import Table
from vpptwin.logs.parts import split_test
from vpptwin.system.errors import InputError

MAX_ARRAYS = 10**9
"""Bytes that arrays may take."""
_HEAD, _COMPRESSED = 128, 15  # bytes of the head of a .mat, and the kind of an element that is compressed
_PIECE = 1 << 20  # bytes that are unpacked at once
_MAX_CACHED = 1 << 26  # bytes of a file whose content is kept for the next question
_TRY = "import sys; from scipy.io import loadmat; loadmat(sys.argv[1], simplify_cells=True)"
"""What a process of its own tries where no checksum vouches for a file: scipy crashes on some that are damaged."""
_BROKEN = (ValueError, TypeError, KeyError, IndexError, EOFError, OSError, struct.error, zlib.error, MemoryError,
           OverflowError, zipfile.BadZipFile, AttributeError, NotImplementedError, RuntimeError,
           SyntaxError, TokenError)  # fmt: skip
# What readers raise on content that makes no sense.


def read_arrays(path: Path, topic: str, wish: Wish, notes: list[str]) -> Iterator[Table]:
    """Tables of a MATLAB file up to version 7, or of a NumPy archive: one of each group of arrays with its time."""
    yield from part_tables(path, topic, load_file(split_test(path)[0], notes), wish, notes)


def load_file(path: Path, notes: list[str]) -> dict[str, Any]:
    """The variables of a file, structures of arrays as mappings, arrays of structures and cells as lists."""
    about = path.stat()
    load = _load if about.st_size < _MAX_CACHED else _load.__wrapped__
    content, said = load(path, (about.st_mtime_ns, about.st_size))
    notes += said
    return content


@lru_cache(1)
def _load(path: Path, about: tuple[int, int]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Variables and notes of a file as it was then: what tests it holds is asked before one is read."""
    notes: list[str] = []
    is_numpy = path.suffix.lower() == ".npz"
    try:
        content = _load_npz(path, notes) if is_numpy else _load_mat(path)
    except InputError:
        raise
    except _BROKEN as error:
        raise refuse_damaged(path, "NumPy file" if is_numpy else "MATLAB file", error) from None
    return {name: simplify(value) for name, value in content.items() if not name.startswith("__")}, tuple(notes)


def _load_mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat  # which few logs wait for
    from scipy.io.matlab import MatReadError

    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head.startswith(b"MATLAB 7.3"):
        found = f"{path} is a MATLAB file of version 7.3, which is HDF5"
        raise InputError(found, "version 7 or older", "save it so: save(file, '-v7')")
    sealed = False
    if head.startswith(b"MATLAB"):
        size, sealed = measure_mat(path, "<" if head[126:128] == b"IM" else ">")
        check_size(path, size)
    if not sealed and subprocess.run([sys.executable, "-c", _TRY, str(path)], capture_output=True).returncode < 0:
        raise ValueError("what reads it crashes")
    try:
        return loadmat(path, simplify_cells=True)
    except MatReadError as error:
        raise ValueError(*error.args) from None


def _load_npz(path: Path, notes: list[str]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        check_size(path, sum(item.file_size for item in archive.infolist()))
    with np.load(path, allow_pickle=False) as arrays:
        for name in arrays.files:
            try:
                content[name] = arrays[name]
            except ValueError as error:
                if "pickle" not in str(error).lower():
                    raise
                notes.append(f"{path.name}: {name} holds Python objects, left out")
    return content


def check_size(path: Path, size: int) -> None:
    """Refuse arrays that take more than `MAX_ARRAYS` bytes."""
    if size > MAX_ARRAYS:
        found = f"{path} holds arrays of more than {MAX_ARRAYS / 1e9:g} GB"
        raise InputError(found, "less", "save a part of it, or write CSV or MCAP")


def measure_mat(path: Path, order: str) -> tuple[int, bool]:
    """Bytes that a MATLAB file's elements take, those unpacked that are compressed, and whether all are, as sealed.

    It is counted as far as `MAX_ARRAYS`.
    """
    total, sealed = 0, True
    with path.open("rb") as file:
        file.seek(_HEAD)
        while len(tag := file.read(8)) == 8 and total <= MAX_ARRAYS:
            kind, size = struct.unpack(f"{order}II", tag)
            end = file.tell() + size
            if kind != _COMPRESSED:
                total, sealed = total + size, False
            unpacker = zlib.decompressobj()
            while kind == _COMPRESSED and (rest := end - file.tell()) > 0 and total <= MAX_ARRAYS:
                packed = file.read(min(rest, _PIECE))
                while packed and total <= MAX_ARRAYS:
                    total += len(unpacker.decompress(packed, _PIECE))
                    packed = unpacker.unconsumed_tail
                if not packed and file.tell() >= path.stat().st_size:
                    break
            sealed = sealed and unpacker.eof
            file.seek(end)
    return total, sealed


def list_array_tests(path: Path) -> list[int]:
    """The numbers of the tests of a file that is an array of them, those without time left out, [] for other files."""
    content = load_file(path, [])
    tests = [] if holds_table(content) else list_tests(content)
    return [number for number, (_, part) in enumerate(tests) if holds_table(part)]
