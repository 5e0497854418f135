"""The measurements of one log, by degree of freedom, on any rig."""

from __future__ import annotations

from collections.abc import Sequence

from vpptwin.estimation.joints import read_joints
from vpptwin.estimation.series import Measurements, Series
from vpptwin.logs.flight import Flight
from vpptwin.twin.robot.robot import Robot, by_robot
from vpptwin.twin.spec import TwinSpec

__all__ = ["Measurements", "Series", "list_warnings", "read_measurements"]


def read_measurements(spec: TwinSpec, flight: Flight) -> Measurements:
    """Sort a log's streams by degree of freedom.

    Raises:
        InputError: if the log lacks a topic, joint or actuator that the twin needs.
    """
    return read_signals(spec.robot, spec, flight)


def list_warnings(flights: Sequence[Flight], measurements: Sequence[Measurements]) -> list[str]:
    """What is wrong with logs and what was done about it; every command prints it."""
    pairs = zip(flights, measurements, strict=True)
    return [f"{flight.name}: {text}" for flight, read in pairs for text in (*flight.warnings, *read.warnings)]


@by_robot
def read_signals(robot: Robot, spec: TwinSpec, flight: Flight) -> Measurements:
    """Measurements of a robot of this class."""
    return read_joints(spec, flight)
