"""Parts of a log by their names: LOG@START-END in seconds, FILE#TEST of several, FOLDER#EPISODE of LeRobot."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vpptwin.system.errors import InputError

FILES_OF_TESTS = (".mat", ".npz", ".parquet")
"""Endings of files that may hold several tests."""
_NUMBER = r"(\d+\.?\d*|\.\d+)"
_SPAN = re.compile(rf"(.+)@{_NUMBER}?-{_NUMBER}?", re.DOTALL)


@dataclass(frozen=True)
class Span:
    """From when to when messages are wanted [s since the first]. origin: the first's time [ns], once there is one."""

    start: float
    end: float
    origin: list[int] = field(default_factory=list)

    def choose(self, time: np.ndarray) -> np.ndarray:
        """Which of messages with these log times, (n,) ns, are in it, (n,) bool."""
        if not self.origin and len(time):
            self.origin.append(int(time[0]))
        since = (time - self.origin[0]) / 1e9 if len(time) else time
        return (since >= self.start) & (since < self.end)


def split_span(path: Path, origin: list[int] | None = None) -> tuple[Path, Span | None]:
    """A log and which stretch of it is given, of which one end may be left out; files of a recording share `origin`."""
    given = _SPAN.fullmatch(str(path))
    if given is None or not (given.group(2) or given.group(3)) or os.path.exists(path):
        return path, None
    start, end = float(given.group(2) or 0.0), float(given.group(3) or "inf")
    if start >= end:
        raise InputError(f"{path}: from {start:g} to {end:g} s", "a start before the end", "turn them round")
    return Path(given.group(1)), Span(start, end, [] if origin is None else origin)


def split_number(path: Path | str) -> tuple[str, int | None]:
    """What stands before and behind the # of a name, None where that is no number of a test or episode."""
    before, mark, number = str(path).rpartition("#")
    is_number = bool(mark) and number.isdecimal() and len(number) < 10
    return (before, int(number)) if is_number and not os.path.exists(path) else (str(path), None)


def split_test(path: Path) -> tuple[Path, int | None]:
    """File and number of FILE#TEST, a file alone without one."""
    file, number = split_number(path)
    is_test = number is not None and file.lower().endswith(FILES_OF_TESTS) and os.path.isfile(file)
    return (Path(file), number) if is_test else (path, None)


def split_episode(path: Path) -> tuple[Path, int | None]:
    """Folder and number of FOLDER#EPISODE of a LeRobot data set, anything else without one."""
    folder, number = split_number(path)
    return (Path(folder), number) if number is not None and is_lerobot(Path(folder)) else (path, None)


def is_lerobot(folder: Path) -> bool:
    """Whether a folder is a LeRobot data set."""
    return os.path.isfile(folder / "meta" / "info.json")


def is_part(path: Path) -> bool:
    """Whether a path is FOLDER#EPISODE of a LeRobot data set, or FILE#TEST of a file of several tests."""
    return split_episode(path)[1] is not None or split_test(path)[1] is not None
