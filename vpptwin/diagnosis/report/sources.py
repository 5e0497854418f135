"""What is diagnosed and compared: logs and twins, by name or read already."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from vpptwin.errors import InputError
from vpptwin.logs.flight import Flight
from vpptwin.logs.read import expand_logs, read_flight
from vpptwin.logs.topic_map import SignalEntries
from vpptwin.twin.spec import TwinSpec, load_twin

Log = str | PathLike[str] | Flight
"""A flight log: its file, or what was read from it."""


def open_twin(twin: str | PathLike[str] | TwinSpec, effects: Sequence[str | PathLike[str]] = ()) -> TwinSpec:
    """A twin by name or file, or as it was read.

    Raises:
        InputError: as `load_twin`.
    """
    return twin if isinstance(twin, TwinSpec) else load_twin(str(twin), [Path(file) for file in effects])


def list_logs(logs: Log | Sequence[Log]) -> list[Log]:
    """Logs, folders of flights given as the flights in them."""
    given = [logs] if isinstance(logs, (str, PathLike, Flight)) else logs
    return [each for log in given for each in ([log] if isinstance(log, Flight) else expand_logs([log]))]


def open_flights(
    logs: Log | Sequence[Log], topic_map: str | PathLike[str] | None = None, signals: SignalEntries | None = None
) -> list[Flight]:
    """Logs, read where they are not yet, by the fields that a twin's `signals` name.

    Raises:
        InputError: if there is none, one is no log, or given twice.
    """
    given = list_logs(logs)
    if not given:
        raise InputError("no logs", "at least one flight log", "name one")
    paths = [log.path if isinstance(log, Flight) else Path(log) for log in given]
    for i, path in enumerate(paths):
        if path.resolve() in [other.resolve() for other in paths[:i]]:
            expected = "every flight once, as those that judge must not be those that are fitted"
            raise InputError(f"{path} is given twice", expected, "leave one out")
    return [log if isinstance(log, Flight) else read_flight(Path(log), topic_map, signals) for log in given]
