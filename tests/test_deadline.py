"""Time limits: what they are written as, when they stop a computation, and what is still done then."""

from __future__ import annotations

import signal

import pytest

from vpptwin.system.deadline import Deadline, Stopped, read_limit, tell_time
from vpptwin.system.errors import InputError


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("90s", 90.0), ("10m", 600.0), ("1h", 3600.0), ("45", 45.0), (" 1.5 min ", 90.0), (2.5, 2.5), (".5h", 1800.0)],
)
def test_a_limit_is_a_number_with_its_unit(text: str | float, seconds: float) -> None:
    """Plain numbers are seconds."""
    assert read_limit(text) == seconds


@pytest.mark.parametrize(
    "text", ["", "0", "-5", "ten", "10 minutes", "1h30", "1e3", "nan", "inf", "10ms", "5d", "9999h", "1٣s", True]
)
def test_nonsense_is_refused_in_one_line(text: str | float) -> None:
    """With what would have been accepted."""
    with pytest.raises(InputError, match=r"^--limit .*; expected a time such as 90s, 10m or 1h"):
        read_limit(text)


def test_times_are_told_in_their_unit() -> None:
    """Seconds, minutes, hours, three digits."""
    assert [tell_time(t) for t in (0.5, 45.0, 600.0, 5400.0)] == ["0.5 s", "45 s", "10 min", "1.5 h"]


def test_it_stops_once_and_only_where_it_may() -> None:
    """The first look after the limit raises; work that can be left out is left out from then on, and noted."""
    now = [0.0]
    deadline = Deadline(10.0, lambda: now[0])
    done: list[int] = []
    look = deadline.watch(done.append)
    look(3)
    assert deadline.attempt(["a"], lambda: 1, 2) == 1
    now[0] = 11.0
    with pytest.raises(Stopped, match="the time limit of 10 s"):
        look(4)
    look(5)
    assert done == [3, 4, 5]
    assert deadline.attempt(["b", "c"], lambda: 1, 2) == 2
    assert deadline.not_done == ["b", "c"]
    assert deadline.code == 0
    # Held, it raises in attempts alone.
    now = [0.0]
    deadline = Deadline(10.0, lambda: now[0])
    deadline.held = True

    def work() -> int:
        now[0] = 20.0
        deadline.check()
        return 1

    assert deadline.attempt(["a"], work, 2) == 2
    assert deadline.not_done == ["a"]
    deadline.check()
    assert deadline.why == "the time limit of 10 s"


def test_a_signal_waits_only_where_something_would_be_lost() -> None:
    """Before that it is not taken; after, the code is that of the signal."""
    deadline = Deadline()
    assert not deadline.interrupt(signal.SIGTERM)
    deadline.check()
    deadline.worth = True
    assert deadline.interrupt(signal.SIGTERM)
    with pytest.raises(Stopped, match="SIGTERM"):
        deadline.check()
    assert deadline.code == 143
