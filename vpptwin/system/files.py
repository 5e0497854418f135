"""Files that appear whole or not at all, and several of them together."""

from __future__ import annotations

import json
import math
import mmap
import os
import re
import shutil
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from errno import EEXIST, EISDIR
from fcntl import LOCK_EX, flock
from pathlib import Path
from secrets import token_hex

from vpptwin.system.errors import InputError

DRAFTS = ".vpptwin."
"""How names of folders of drafts begin."""
LEFT = 86_400.0
"""Drafts that nobody has touched for so long [s] are those of a run that was killed."""
OWN = {
    ".mcap": rb"\x07\0\0\0vpptwin",
    ".yaml": rb"\bvpptwin (diagnose|identify|train)\b",
    ".json": rb'"horizons_s"|"vpptwin"',
    ".xml": rb"ritten by vpptwin export",
    ".py": rb"ritten by vpptwin export",
}
"""By what files that vpptwin wrote are known: MCAP by a record of that name, YAML by the command, JSON by a key."""
STDOUT = Path("-")
"""Stands for standard output where a file is asked for."""
ANYWAY = "choose another name, or overwrite it with --force"
_staged: dict[Path, list[Path]] = {}  # of this process: drafts → folders that were made for them


@contextmanager
def replace_files(folder: Path, names: Collection[str], stale: Collection[str] = ()) -> Iterator[Path]:
    """A hidden folder inside `folder` to write files into; when the block ends they take the place of the old ones.

    Whatever goes wrong (an exception, a full disk, Ctrl-C), the old files stay, and folders made for the new ones go,
    as they do where none was written.
    Two processes that write into one folder do so one after the other.

    Args:
        folder: made if need be.
        names: files that will be written.
        stale: files of before that go when the new ones come.

    Raises:
        OSError: if the folder cannot be written to, or a name is taken by something that is no file.
    """
    drafts = folder / f"{DRAFTS}{token_hex(6)}"
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    _staged[drafts] = made
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in (folder / name for name in names):
            if path.exists() and not path.is_file():
                number = EISDIR if path.is_dir() else EEXIST
                raise OSError(number, "is a folder" if path.is_dir() else "is no file", str(path))
        for left in folder.glob(f"{DRAFTS}*"):
            with suppress(OSError):
                if time.time() > left.stat().st_mtime + LEFT:
                    shutil.rmtree(left)
        drafts.mkdir()
        yield drafts
        exchange(drafts, folder, stale)
    finally:
        discard(drafts)


def discard(drafts: Path) -> None:
    """Remove a folder of drafts, and the folders that were made for it."""
    shutil.rmtree(drafts, ignore_errors=True)
    for folder in _staged.pop(drafts, ()):
        with suppress(OSError):  # where something lies in it, it stays
            folder.rmdir()


def discard_all() -> None:
    """Remove all drafts of this process, which is about to end."""
    for drafts in list(_staged):
        discard(drafts)


def exchange(drafts: Path, folder: Path, stale: Collection[str]) -> None:
    """Move files from `drafts` to `folder`, and put the old ones back if it fails midway.

    An old file stays in its place until the moment in which the new one takes it: `kill -9` loses none.
    """
    held = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some network drives lock no folders
            flock(held, LOCK_EX)
        fresh = [file.name for file in drafts.iterdir()]
        existed = {name for name in {*fresh, *stale} if (folder / name).is_file()}
        old = drafts / "old"
        old.mkdir()
        for name in existed:
            try:
                os.link(folder / name, old / name)
            except OSError:  # a file system without links
                shutil.copy2(folder / name, old / name)
        try:
            for name in fresh:
                os.replace(drafts / name, folder / name)
            for name in existed.difference(fresh):
                (folder / name).unlink()
        except BaseException:
            for file in old.iterdir():
                os.replace(file, folder / file.name)
            for name in set(fresh) - existed:
                (folder / name).unlink(missing_ok=True)
            raise
    finally:
        os.close(held)


def check_own(paths: Iterable[Path], action: str = ANYWAY) -> None:
    """Refuse to overwrite what vpptwin did not write, before the work rather than after it."""
    for path in paths:
        if path.is_symlink() and not path.exists():
            raise InputError(f"{path} is a link that leads nowhere", "a new file, or one of vpptwin's", action)
        if path.is_file() and not is_own(path):
            found = f"{path} is there, and vpptwin did not write it, or it may have been edited"
            raise InputError(found, "a new file, or one of vpptwin's", action)


def is_same(path: Path, others: Iterable[Path]) -> bool:
    """Whether a path leads to one of others; a link to itself leads nowhere."""
    return os.path.realpath(path) in [os.path.realpath(other) for other in others]


def check_target(path: Path, json: bool = False) -> None:
    """Refuse a file that cannot be written, before the work rather than after it; what is there stays.

    Args:
        path: where it is to lie; folders are made for it as `write_files` does.
        json: whether it is a --json, for which no folder is made.
    """
    if path == STDOUT:
        return
    try:
        if json:
            path.parent.stat()
        with replace_files(path.parent, [path.name]):
            pass
    except OSError as error:
        found = f"cannot write {'--json ' if json else ''}{path} ({error.strerror or error})"
        expected = "a file in an existing folder, or - for stdout" if json else "a writable path"
        raise InputError(found, expected, "choose another") from error


def is_own(path: Path) -> bool:
    """Whether vpptwin wrote a file; an empty one is nobody's."""
    with path.open("rb") as file:
        if not path.stat().st_size:
            return True
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return re.search(OWN.get(path.suffix.lower(), rb"vpptwin"), content) is not None


def write_whole(path: Path, content: str | bytes, force: bool = True) -> Path:
    """Write a file and return its path; see `write_files`."""
    return write_files({path: content}, force)[0]


def write_files(contents: Mapping[Path, str | bytes], force: bool = True) -> list[Path]:
    """Write files that lie in one folder, all or none; what was there stays if anything fails.

    Args:
        contents: by path; folders are made if need be, text is written as UTF-8.
        force: overwrite files that vpptwin did not write and that say something else, too.

    Returns:
        The paths.

    Raises:
        InputError: if they cannot be written.
    """
    paths = list(contents)
    data = {path: text.encode() if isinstance(text, str) else text for path, text in contents.items()}
    try:
        if not force:
            check_own(path for path in paths if not (path.is_file() and path.read_bytes() == data[path]))
        with replace_files(paths[0].parent, [path.name for path in paths]) as drafts:
            for path in paths:
                (drafts / path.name).write_bytes(data[path])
    except OSError as error:
        found = f"cannot write {paths[0]} ({error.strerror or error})"
        raise InputError(found, "a writable path", "choose another") from error
    return paths


def write_json(content: object, path: Path) -> None:
    """Write JSON, whole or not at all; numbers that are not finite become null, which JSON lacks."""
    write_whole(path, json.dumps(without_nan(content), indent=2, ensure_ascii=False) + "\n")


def without_nan(content: object) -> object:
    """The same content with null for NaN and infinity."""
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if isinstance(content, dict):
        return {key: without_nan(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [without_nan(value) for value in content]
    return content
