"""Before a twin stands beside a log: does another unit, sign or order of its columns explain the motion far better?

Five tests. A joint's velocity is the slope of its position. A joint that a servo drives follows its target. A joint
that a force drives moves as the MJCF's inertia, weight and friction ask for. Weight pulls down. Parts of the MJCF touch
at most. Columns are refused where they contradict that as they are read, whatever gain or load would be wrong within
reason, and where one other reading agrees with it. What is merely explained badly is left for the diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from vpptwin.estimation.checks.balance import compare_forces
from vpptwin.estimation.checks.efforts import judge_efforts, list_scales
from vpptwin.estimation.checks.model import refuse_beyond, refuse_overlap
from vpptwin.estimation.checks.readings import Misread, compose_entry, locate_line, name_columns
from vpptwin.estimation.checks.slopes import compare_ranges, compare_slopes, compare_targets
from vpptwin.estimation.checks.weight import compare_weight
from vpptwin.estimation.series import Measurements
from vpptwin.logs.flight import Flight
from vpptwin.system.doubt import object_to
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec

GEARED = 200.0
"""Largest ratio of a gear that an MJCF may lack."""


def check_columns(spec: TwinSpec, flights: Sequence[Flight], measurements: Sequence[Measurements]) -> None:
    """Refuse logs of which some columns are in another unit, sign or order than the twin reads them in.

    Args:
        spec: the twin; the drone's topics have units of their own, which reading checks.
        flights: as they were read.
        measurements: what was measured on them.

    Raises:
        InputError: with the line of the twin to change.
    """
    if not (spec.robot.signals.joints or spec.robot.signals.bodies):
        return
    for flight in flights:
        for test in (compare_slopes, compare_targets, compare_ranges):
            misread = join_alike(test(spec, flight))
            if misread is not None:
                object_to(compose_error(spec, flight, misread))
                break
    flight, misread = compare_forces(spec, flights, measurements)
    if misread is not None:
        error = compose_error(spec, flight, misread)
        moved = any(column.quantity != "effort" for column in misread.reading.columns)
        far = judge_efforts(spec, measurements) if moved else []
        if far and all(1.0 < each.factor < GEARED for each in far):  # too much motion, or too little force
            other = f"if that is right already, give {list_scales(far)}, as for a gear that the MJCF lacks"
            error = InputError(error.found, error.expected, f"{error.action}; {other}")
        object_to(error)
    elif (wrong := compare_weight(spec, flights, measurements)) is not None:
        object_to(wrong)
    refuse_beyond(spec, measurements)
    refuse_overlap(spec, measurements)


def join_alike(found: Iterable[Misread]) -> Misread | None:
    """The first column that looks misread, with all others that look the same; None where none does."""
    misread = list(found)
    if not misread or "exchanged" in misread[0].reading.looks:
        return next(iter(misread), None)
    first, look = misread[0], (misread[0].reading.looks, misread[0].reading.expected)
    alike = [each.reading for each in misread if (each.reading.looks, each.reading.expected) == look]
    known, changes = {change.column for change in first.reading.changes}, list(first.reading.changes)
    for change in (change for reading in alike for change in reading.changes):
        if change.column not in known:
            known.add(change.column)
            changes.append(change)
    return Misread(replace(first.reading, changes=tuple(changes)), first.why)


def compose_error(spec: TwinSpec, flight: Flight, misread: Misread) -> InputError:
    """One line: what was found, what was expected, which line of the twin to change and how."""
    reading, signals = misread.reading, spec.robot.signals
    lines, numbers = [], []
    for name in dict.fromkeys(column.name for column in reading.columns):
        changes = [change for change in reading.changes if change.column.name == name]
        lines.append(compose_entry(spec, flight, name, changes))
        numbers.append(locate_line(spec, changes[0].column.group, name))
    found = f"{flight.path}: {name_columns(reading.columns)} seem{'s' * (len(reading.columns) == 1)} to be "
    found += f"{reading.looks}: {misread.why}"
    if not all(lines):
        topic = getattr(signals, reading.columns[0].group)[reading.columns[0].name]
        action = f"exchange the names on {topic} where the log is written, or in the MJCF"
    else:
        known = [str(number) for number in numbers if number is not None]
        where = (
            f"line{'s' * (len(known) > 1)} {' and '.join(known)} of {spec.name}"
            if known
            else f"the signals of {spec.name}"
        )
        action = f"change {where} to {' and '.join(f'`{line}`' for line in lines)}"
    return InputError(found, reading.expected, action)
