"""The folder of results: all files of a run appear together, or the old ones stay as they were."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from errno import EISDIR
from pathlib import Path

from vpptwin.errors import InputError
from vpptwin.files import without_nan, write_json

STDOUT = Path("-")
"""Stands for standard output where a file is asked for."""


@contextmanager
def stage_results(out: Path, names: Collection[str], stale: Collection[str] = ()) -> Iterator[Path]:
    """A hidden folder inside `out` to write results into; when the block ends they take the place of the old ones.

    Whatever goes wrong (an exception, a full disk, Ctrl-C), the old results stay, and folders made for the new ones go.

    Args:
        out: folder of results, made if need be.
        names: results that will be written.
        stale: results of an earlier run that go when the new ones come.

    Raises:
        InputError: if the folder cannot be written to, or a result's name is taken by a folder.
    """
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    staged = None
    try:
        try:
            out.mkdir(parents=True, exist_ok=True)
            taken = [name for name in names if (out / name).is_dir()]
            if taken:
                raise InputError(f"{out / taken[0]} is a folder", "a folder to write to", "choose another --out")
            staged = Path(tempfile.mkdtemp(prefix=".diagnose.", dir=out))
        except OSError as error:
            found = f"cannot write to {out} ({error.strerror or error})"
            raise InputError(found, "a folder to write to", "choose another --out") from error
        yield staged
        exchange(staged, out, stale)
    except BaseException:
        if staged is not None:
            shutil.rmtree(staged, ignore_errors=True)
        for folder in made:
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
        raise
    shutil.rmtree(staged, ignore_errors=True)


def exchange(staged: Path, out: Path, stale: Collection[str]) -> None:
    """Move results from the staging folder to `out`, the old ones the other way; put those back if it fails midway."""
    fresh = [file.name for file in staged.iterdir()]
    existed = {name for name in {*fresh, *stale} if (out / name).is_file()}
    old = staged / "old"
    old.mkdir()
    try:
        for name in existed:
            os.replace(out / name, old / name)
        for name in fresh:
            os.replace(staged / name, out / name)
    except BaseException:
        for file in old.iterdir():
            os.replace(file, out / file.name)
        for name in set(fresh) - existed:
            (out / name).unlink(missing_ok=True)
        raise


def check_target(path: Path) -> None:
    """Refuse a --json that cannot be written, before the work rather than after it."""
    if path == STDOUT:
        return
    probe = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        if path.is_dir():
            raise IsADirectoryError(EISDIR, os.strerror(EISDIR))
        probe.touch()
        probe.unlink()
    except OSError as error:
        found = f"cannot write --json {path} ({error.strerror or error})"
        raise InputError(found, "a file in an existing folder, or - for stdout", "choose another") from error


def give_json(content: object, target: Path) -> None:
    """Write a --json, to a file or, for `-`, to standard output."""
    if target == STDOUT:
        json.dump(without_nan(content), sys.stdout, indent=2, ensure_ascii=False)
        print()
    else:
        write_json(content, target)
