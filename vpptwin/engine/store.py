"""Compiled steps on disk: for this user alone, sealed by checksums, the oldest making way."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from platformdirs import user_cache_path

from vpptwin.engine.compile import KEPT
from vpptwin.system.files import write_whole

MAX_ENTRIES = 300
"""Steps kept: one of each model and catalogue, some 0.4 MB each."""
SEAL = "seal"


def open_entry(name: str, source: str) -> Path | None:
    """The file with a step's text, beside which numba keeps what it compiles; None where no file lasts.

    Folders are the user's own, of mode 700. An entry that is someone else's, open to others, or whose compiled files
    are not those that were sealed, is emptied, and compiled anew.
    """
    try:
        root = user_cache_path("vpptwin") / "kernels"
        if not root.is_absolute():  # nobody's home
            return None
        root.mkdir(parents=True, exist_ok=True, mode=0o700)
        for folder in (root.parent, root):
            if not is_private(folder):
                if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                    return None
                if folder == root:  # others may have put anything there
                    shutil.rmtree(root)
                    root.mkdir(mode=0o700)
                folder.chmod(0o700)
        entry = root / name
        file = entry / "step.py"
        if entry.is_symlink() or (entry.exists() and not (entry.is_dir() and is_private(entry) and is_sealed(entry))):
            entry.unlink() if entry.is_symlink() or entry.is_file() else shutil.rmtree(entry)
        if not entry.exists():
            make_room(root)
            entry.mkdir(mode=0o700)
        if not file.is_file() or file.read_text() != source:
            file.write_text(source)
    except (OSError, UnicodeDecodeError):
        return None
    return file


def seal_entry(file: Path) -> None:
    """Note what numba has compiled beside a file, so that only that is loaded again."""
    with suppress(OSError, ValueError):  # a full disk: the entry is compiled anew
        seal = file.parent / SEAL
        now = sum_files(file.parent)
        if not seal.is_file() or seal.read_text() != now:
            write_whole(seal, now)


def is_sealed(entry: Path) -> bool:
    """Whether what is kept in an entry is what was sealed there."""
    with suppress(OSError, UnicodeDecodeError):
        return (entry / SEAL).read_text() == sum_files(entry)
    return not any(entry.glob(KEPT))


def sum_files(entry: Path) -> str:
    """Checksum of the compiled files of an entry, names included."""
    total = sha256()
    for file in sorted(entry.glob(KEPT)):
        total.update(file.name.encode() + b"\0" + sha256(file.read_bytes()).digest())
    return total.hexdigest()


def is_private(folder: Path) -> bool:
    """Whether a folder is this user's, no link, and closed to writing by others."""
    about = folder.lstat()
    return not folder.is_symlink() and about.st_uid == os.getuid() and not about.st_mode & 0o022


def make_room(root: Path) -> None:
    """Remove the oldest entries until there is room for one more."""
    entries = sorted(root.iterdir(), key=lambda entry: entry.lstat().st_mtime)
    for entry in entries[: max(len(entries) - MAX_ENTRIES + 1, 0)]:
        shutil.rmtree(entry, ignore_errors=True)
