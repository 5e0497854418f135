"""Whose word lets code run: files that data names (a twin YAML, a checkpoint) run only if the user named them too."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from vpptwin.system.errors import InputError
from vpptwin.system.installed import list_installed, locate_effects

EVERY = Path("*")
_trusted: set[Path] = set()  # of this process, as the user's word is


def trust(files: Iterable[Path | str] = (EVERY,)) -> None:
    """Let Python files run that data names; by default every one, as `--trust` does."""
    _trusted.update(Path(file) if file == EVERY else locate_effects(file).resolve() for file in files)


def trusted() -> frozenset[Path]:
    """What may run in this process, for another one that works for it."""
    return frozenset(_trusted)


def check_trusted(files: Iterable[Path | str], source: object, given: Iterable[Path | str] = ()) -> None:
    """Refuse Python files that `source` names and that are neither installed, trusted, nor `given` for this call."""
    named = [] if EVERY in _trusted else list(files)
    if not named:
        return
    allowed = {locate_effects(file).resolve() for file in (*given, *list_installed().values())} | _trusted
    for file in named:
        if locate_effects(file).resolve() not in allowed:
            found = f"{source} names {Path(file)}, Python code that would be run"
            action = (
                f"read it, then say `--effects {file}` (train: `effects=[{file}]`), or `--trust` for all such files"
            )
            raise InputError(found, "your word before a file's code runs", action)
