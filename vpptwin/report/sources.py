"""What is diagnosed and compared: logs and twins, by name or read already."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import inf
from os import PathLike
from pathlib import Path

from vpptwin.logs.flight import Flight
from vpptwin.logs.read import expand_logs, read_flight
from vpptwin.logs.spelling import list_parts, spell
from vpptwin.logs.topic_map import SignalEntries
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec, load_twin

Log = str | PathLike[str] | Flight
"""A flight log: its name, as docs/logs.md has them, or what was read from it."""
Part = tuple[Path, float, float]
"""A file, and from when to when it is taken [s]."""


def open_twin(twin: str | PathLike[str] | TwinSpec, effects: Sequence[str | PathLike[str]] = ()) -> TwinSpec:
    """A twin by name or file, or as it was read.

    Raises:
        InputError: as `load_twin`.
    """
    return twin if isinstance(twin, TwinSpec) else load_twin(str(twin), [Path(file) for file in effects])


def read_log(
    path: str | PathLike[str] | Sequence[str | PathLike[str]], topic_map: str | PathLike[str] | None = None,
    twin: str | PathLike[str] | TwinSpec | None = None,
) -> Flight:  # fmt: skip
    """Read a log.

    Args:
        path: a log in any format of docs/logs.md, a rosbag2 folder, or a list of the files of one recording.
        topic_map: YAML file for logs with other topics, types or units (docs/logs.md).
        twin: whose signals say where joints and actuators lie: its name or YAML, or what `load_twin` read.

    Returns:
        All topics of the channel table that have messages, and all joints of all JointState topics.

    Raises:
        InputError: if the log is damaged, is no log, or holds values that cannot be right.
    """
    return read_flight(path, topic_map, None if twin is None else open_twin(twin).robot.signals.entries)


def list_logs(logs: Log | Sequence[Log]) -> list[Log]:
    """Logs, folders of flights given as the flights in them."""
    given = [logs] if isinstance(logs, (str, PathLike, Flight)) else logs
    return [each for log in given for each in ([log] if isinstance(log, Flight) else expand_logs([log]))]


def open_flights(
    logs: Log | Sequence[Log], topic_map: str | PathLike[str] | None = None, signals: SignalEntries | None = None,
    apart: bool = False,
) -> list[Flight]:  # fmt: skip
    """Logs, read where they are not yet, by the fields that a twin's `signals` name.

    Args:
        logs: however they are spelled, or flights.
        topic_map: as of every command that reads logs.
        signals: as of `read_flight`.
        apart: whether some are fitted and others judge, so that they may not share a stretch either.

    Raises:
        InputError: if there is none, one is no log, or given twice.
    """
    given = list_logs(logs)
    if not given:
        raise InputError("no logs", "at least one log", "name one")
    paths = [log.path if isinstance(log, Flight) else spell(log) for log in given]
    parts = [locate(path, isinstance(log, Flight)) for path, log in zip(paths, given)]
    for i, j in combinations(range(len(given)), 2):
        if parts[i] == parts[j] or (apart and (holds(parts[i], parts[j]) or holds(parts[j], parts[i]))):
            found = f"{paths[j]} is given twice" if parts[i] == parts[j] else f"{paths[i]} and {paths[j]} overlap"
            expected = "every log once, because fitted data must not be held-out data"
            raise InputError(found, expected, "leave one out")
    return [log if isinstance(log, Flight) else read_flight(log, topic_map, signals) for log in given]


def locate(path: Path, read: bool) -> list[Part]:
    """The parts of a log, sorted; of one that was read before, whose files may be gone, else its name."""
    try:
        return sorted(list_parts(path))
    except InputError:
        if not read:
            raise
        return [(path.resolve(), 0.0, inf)]


def holds(whole: Sequence[Part], parts: Sequence[Part]) -> bool:
    """Whether something of all parts of a log is in another one."""
    return all(
        any(file == other and max(start, begin) < min(end, until) for other, begin, until in whole)
        for file, start, end in parts
    )
