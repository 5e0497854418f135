"""A stretch of a log: FILE@START-END, in seconds since its first message; of the two one may be left out."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vpptwin.system.errors import InputError

_NUMBER = r"(\d+\.?\d*|\.\d+)"
_SPELLED = re.compile(rf"(.+)@{_NUMBER}?-{_NUMBER}?", re.DOTALL)


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


def part_span(path: Path, origin: list[int] | None = None) -> tuple[Path, Span | None]:
    """A log and which stretch of it is given; spans of files of one recording share their origin.

    Raises:
        InputError: if it ends before it begins.
    """
    given = _SPELLED.fullmatch(str(path))
    if given is None or not (given.group(2) or given.group(3)) or os.path.exists(path):
        return path, None
    start, end = float(given.group(2) or 0.0), float(given.group(3) or "inf")
    if start >= end:
        raise InputError(f"{path}: from {start:g} to {end:g} s", "a start before the end", "turn them round")
    return Path(given.group(1)), Span(start, end, [] if origin is None else origin)
