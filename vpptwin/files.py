"""Files that appear whole or not at all."""

from __future__ import annotations

import json
import math
import os
from contextlib import suppress
from pathlib import Path

from vpptwin.errors import InputError


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write beside the file's place and move it there; one that was there stays if anything fails.

    Args:
        path: the file; folders are made if need be.
        content: text is written as UTF-8.

    Returns:
        `path`.

    Raises:
        InputError: if it cannot be written.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(draft, path)
    except BaseException as error:
        with suppress(OSError):  # where its folder is none, so is the draft
            draft.unlink()
        if isinstance(error, OSError):
            found = f"cannot write {path} ({error.strerror})"
            raise InputError(found, "a writable path", "choose another") from error
        raise
    return path


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
