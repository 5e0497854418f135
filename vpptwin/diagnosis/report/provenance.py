"""Where results come from: logs by their contents, versions, the day, and what was typed."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import file_digest, sha256
from importlib.metadata import version
from pathlib import Path

from vpptwin import __version__


@dataclass(frozen=True)
class Provenance:
    """What it takes to get the same results again."""

    command: str  # what to type
    date: str  # when, ISO 8601
    twin: str  # name of the diagnosed twin
    versions: dict[str, str]  # package → version
    logs: dict[str, str]  # log → SHA-256 of its file; of a folder that of the hashes of its files, sorted by name


def trace_origin(arguments: Sequence[str], twin: str, logs: Sequence[Path]) -> Provenance:
    """Provenance of a run that starts now.

    Args:
        arguments: of the command line, the program's name aside.
        twin: name of the diagnosed twin.
        logs: files or rosbag2 folders.
    """
    versions = {"vpptwin": __version__, "python": platform.python_version()}
    versions |= {package: version(package) for package in ("mujoco", "numpy")}
    command, date = shlex.join(["vpptwin", *arguments]), datetime.now(UTC).isoformat(timespec="seconds")
    return Provenance(command, date, twin, versions, {str(log): hash_log(log) for log in logs})


def hash_log(log: Path) -> str:
    """SHA-256 of a log, in hexadecimal."""
    if log.is_dir():
        joined = "".join(hash_log(file) for file in sorted(log.iterdir()) if file.is_file())
        return sha256(joined.encode()).hexdigest()
    with log.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()
