"""Positions in per cent of a calibrated travel, as LeRobot logs them: -100 to 100, of grippers 0 to 100."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np

from vpptwin.logs.flight import Flight
from vpptwin.system.errors import InputError
from vpptwin.system.fields import UNITS, FieldEntry
from vpptwin.twin.robot.actuation import tell_control
from vpptwin.twin.robot.signals import Signals

TRAVEL = "-100 to 100 of its travel, as LeRobot has them"
FULL, CLOSE = 100.0, 1e-9
ROW, MANY = 3, 20
"""Samples at an end, one after another, that are held there; different values that a signal takes besides."""
MARGIN = 0.01
"""Within so much of its range of a joint's limit is at it."""


class Position(NamedTuple):
    """Values (n,) of a joint or of its target as logged, and between which its MJCF keeps it in the same unit."""

    name: str
    values: np.ndarray
    limits: tuple[float, float]  # infinite where it has none


class Ends(NamedTuple):
    """Where a position is held, of -100, 0 and 100, and whether the joint cannot be there."""

    name: str
    at: tuple[float, ...]
    beyond: bool

    @property
    def told(self) -> str:
        """In words."""
        return f"{self.name} is held at exactly {' and '.join(f'{end:g}' for end in self.at)}"


def find_ends(position: Position) -> Ends | None:
    """Where per cents of a travel would end: at exactly 100 or -100, in several samples in a row, and nowhere beyond.

    Counts of an encoder, steps between a few values, and a joint at its own limit are none.
    """
    values, (low, high) = position.values[np.isfinite(position.values)], position.limits
    if not len(values) or np.abs(values).max() > FULL + CLOSE or not np.any(values % 1.0 > CLOSE):
        return None
    extremes = {float(np.round(end)) for end in (values.min(), values.max())}
    far = MARGIN * (high - low) if np.isfinite(high - low) else 0.0
    at = tuple(end for end in (-FULL, 0.0, FULL) if end in extremes and stays(values, end)
               and min(abs(end - low), abs(end - high)) > far)  # fmt: skip
    if len(np.unique(values)) < MANY or not {FULL, -FULL} & set(at):
        return None
    return Ends(position.name, at, any(end < low - far or end > high + far for end in at))


def stays(values: np.ndarray, end: float) -> bool:
    """Whether values (n,) stay at exactly this for `ROW` samples."""
    there = np.abs(values - end) < CLOSE
    return bool(np.any(np.convolve(there, np.ones(ROW), "valid") > ROW - 0.5)) if len(values) >= ROW else False


def tell_normalised(positions: Iterable[Position]) -> list[Ends]:
    """Which positions are per cents of a travel: held beyond a limit, at both ends, or like another one."""
    found = [ends for ends in map(find_ends, positions) if ends is not None]
    return found if len(found) > 1 or any(ends.beyond or len(ends.at) > 1 for ends in found) else []


def vet_travel(model: mujoco.MjModel, signals: Signals, flight: Flight) -> list[str]:
    """A warning for positions and targets read as angles or lengths that look like per cents of a travel.

    Raises:
        InputError: if one is held where its joint cannot be.
    """
    positions = list[Position]()
    for topic, name, column, joint in list_columns(model, signals):
        entry = signals.entries.get(topic, {}).get(name)
        given = getattr(entry, column) if entry is not None else FieldEntry(path=column)
        stream = flight.joints.get(topic, {}).get(name)
        if given is None or stream is None or column not in stream.values or given.polynomial or given.offset:
            continue
        unit = UNITS[given.unit][1] if given.unit else 1.0
        if abs(given.factors[0]) != unit:  # somebody has worked out a scale
            continue
        limits = model.jnt_range[joint] / given.factors[0] if model.jnt_limited[joint] else np.array([-np.inf, np.inf])
        label = f"{topic} {name}: {column}"
        positions.append(Position(label, stream[column] / given.factors[0], (limits.min(), limits.max())))
    ends = tell_normalised(positions)
    told = f"{'; '.join(each.told for each in ends[:3])}, as per cents of a calibrated travel are, which LeRobot logs"
    beyond = any(each.beyond for each in ends)
    if beyond:
        advice = "give `scale` and `offset` of its calibration, scale alone if it is in that unit after all"
        raise InputError(f"{flight.path}: {told}, where the joint cannot be", "rad, m or a unit", advice)
    return [f"{told}: is the unit right?"] * bool(ends)


def list_columns(model: mujoco.MjModel, signals: Signals) -> Iterable[tuple[str, str, str, int]]:
    """Topic, name, column and joint of every position that is logged, and of every target of one."""
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    for name, topic in [*signals.joints.items(), *signals.driven.items()]:
        if name in joints:
            yield topic, name, "position", joints[name]
    for name, topic in signals.actuators.items():
        i = model.actuator(name).id
        if model.actuator_trntype[i] == 0 and tell_control(model, i) == "position":
            for column in ("effort", "position"):
                yield topic, name, column, int(model.actuator_trnid[i, 0])
