"""When a long computation has to stop: after a time, or when it is asked to; what it has by then is kept."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence
from signal import Signals
from typing import TypeVar

from vpptwin.system.errors import InputError

Found = TypeVar("Found")
SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
"""Units of a time limit [s]."""
MAX_LIMIT_S = 30 * 86_400.0
"""More [s] is a mistake of units."""


class Stopped(Exception):  # noqa: N818 - no error: it ends what is left of a computation
    """Raised once, where a computation looks whether it has to stop, with the reason in words."""


class Deadline:
    """Until when something is computed.

    Attributes:
        limit: time that there is [s]; None for as much as it takes.
        worth: there is something that would be lost.
        held: nothing is stopped any more but what can be left out, `attempt`.
        why: what stopped it, in words; "" as long as nothing has.
        not_done: what was left out since, in words.
    """

    def __init__(self, limit: float | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin to count by a clock [s]."""
        self.limit, self._clock, self._began = limit, clock, clock()
        self._signal: int | None = None
        self.worth, self.held, self.why = False, False, ""
        self.not_done: list[str] = []

    @property
    def passed(self) -> float:
        """Time since the beginning [s]."""
        return self._clock() - self._began

    @property
    def code(self) -> int:
        """Exit code of a process that was asked to stop so; 0 where only its time ran out."""
        return 0 if self._signal is None else 128 + self._signal

    def interrupt(self, number: int) -> bool:
        """Have it stop by a signal where it looks next, if that is worth waiting for; safe in the signal's handler."""
        if self.worth:
            self._signal = number
        return self.worth

    def is_due(self) -> bool:
        """Whether it is time to stop; notes why."""
        if not self.why and self._signal is not None:
            self.why = Signals(self._signal).name
        if not self.why and self.limit is not None and self.passed > self.limit:
            self.why = f"the time limit of {tell_time(self.limit)}"
        return bool(self.why)

    def check(self) -> None:
        """Raise `Stopped` if it is time, the first time only: what follows makes the best of what there is."""
        if not self.held and not self.why and self.is_due():
            raise Stopped(self.why)

    def watch(self, progress: Callable[[int], None] | None) -> Callable[[int], None]:
        """A report of progress that looks whether to stop, too."""

        def report(steps: int) -> None:
            if progress is not None:
                progress(steps)
            self.check()

        return report

    def attempt(self, what: Sequence[str], work: Callable[[], Found], otherwise: Found) -> Found:
        """Do work that can be left out; where it is, or is stopped in its middle, note `what` it was."""
        if not self.is_due():
            held, self.held = self.held, False
            try:
                return work()
            except Stopped:
                pass
            finally:
                self.held = held
        self.not_done += what
        return otherwise


def read_limit(text: str | float, name: str = "--limit") -> float:
    """A time limit [s], as 90, 90s, 10m or 1h."""
    match = re.fullmatch(r"(\d+\.?\d*|\.\d+) *(s|m|min|h|)", str(text).strip(), re.ASCII)
    seconds = float(match[1]) * SECONDS[match[2]] if match else math.nan
    if not 0.0 < seconds <= MAX_LIMIT_S:
        raise InputError(f"{name} {text}", "a time such as 90s, 10m or 1h, of 30 days at most", "correct it")
    return seconds


def tell_time(seconds: float) -> str:
    """A time in words: 45 s, 10 min, 1.5 h."""
    unit, size = next((each for each in (("h", 3600.0), ("min", 60.0)) if seconds >= each[1]), ("s", 1.0))
    return f"{seconds / size:.3g} {unit}"
