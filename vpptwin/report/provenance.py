"""Where results come from: logs by their contents, versions, the day, and what was typed."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import file_digest, sha256
from importlib.metadata import version
from pathlib import Path

from vpptwin import __version__
from vpptwin.logs.spelling import list_sources
from vpptwin.system.errors import InputError


@dataclass(frozen=True)
class Provenance:
    """What it takes to get the same results again."""

    command: str  # what to type
    date: str  # when, ISO 8601
    twin: str  # name of the diagnosed twin
    versions: dict[str, str]  # package → version
    logs: dict[str, str]  # log → SHA-256, as `hash_logs` has it

    def add(self, options: Sequence[str]) -> Provenance:
        """The same of a command with further options, which are known when its results are written."""
        return replace(self, command=shlex.join([*shlex.split(self.command), *options]))


def trace_origin(arguments: Sequence[str], twin: str, logs: Sequence[Path]) -> Provenance:
    """Provenance of a run that starts now, before the work: what was read is what is named.

    Args:
        arguments: of the command line, the program's name aside.
        twin: name of the diagnosed twin.
        logs: as they were given.
    """
    versions = {"vpptwin": __version__, "python": platform.python_version()}
    versions |= {package: version(package) for package in ("mujoco", "numpy")}
    command, date = shlex.join(["vpptwin", *arguments]), datetime.now(UTC).isoformat(timespec="seconds")
    return Provenance(command, date, twin, versions, hash_logs(logs))


def hash_logs(logs: Sequence[Path]) -> dict[str, str]:
    """Log, however it is spelled → SHA-256 of its file, in hexadecimal; of several files that of their hashes in order.

    Of a flight that was read before, from files that are gone, it says so.
    """
    known: dict[Path, str] = {}  # episodes of a data set lie in one file
    hashes = {}
    for log in logs:
        try:
            sources = list_sources(log)
            known |= {file: hash_file(file) for file in sources if file not in known}
            own = [known[file] for file in sources]
            hashes[str(log)] = own[0] if len(own) == 1 else sha256("".join(own).encode()).hexdigest()
        except (OSError, InputError) as error:
            hashes[str(log)] = f"cannot be read any more ({error})"
    return hashes


def hash_file(file: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with file.open("rb") as content:
        return file_digest(content, "sha256").hexdigest()
