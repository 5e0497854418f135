"""In which unit quantities were logged: velocities and rates by what they integrate to.

Positions in per cent of a calibrated travel, as LeRobot logs them (-100 to 100, of grippers 0 to 100), are told by
where they are held.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np

from vpptwin.estimation.checks.orientation import BEND, MIN_SAMPLES
from vpptwin.estimation.dynamics import find_driven_joint
from vpptwin.estimation.series import integrate
from vpptwin.logs.check import FASTEST, MIN_R_SQUARED, MIN_TURN, SLOWEST, compare_steps
from vpptwin.logs.flight import Flight, Stream
from vpptwin.system.doubt import object_to
from vpptwin.system.errors import InputError
from vpptwin.system.fields import UNITS, FieldEntry
from vpptwin.twin.robot.actuation import tell_control
from vpptwin.twin.robot.signals import Signals

RATE_UNITS = {"deg/s": 180.0 / np.pi, "mrad/s": 1000.0}
"""Units of rates besides rad/s, and how many of them that is."""
SAME_UNIT = 1.3
"""A factor that is off by less is that of a unit."""

TRAVEL = "-100 to 100 of its travel, as LeRobot has them"
FULL, ROUNDING = 100.0, 1e-9
HELD_SAMPLES, MIN_VALUES = 3, 20
"""Samples at an end, one after another, that are held there; different values that a signal takes besides."""
LIMIT_MARGIN = 0.01
"""Within so much of its range of a joint's limit is at it."""


def is_dead(value: np.ndarray) -> bool:
    """Whether a channel (n,) or (n, k) of many samples never changes in any digit."""
    return len(value) >= MIN_SAMPLES and not np.ptp(value, axis=0).any()


def vet_joint(stream: Stream, label: str) -> tuple[Stream, list[str]]:
    """A joint's stream without velocities that are dead, or in another unit or sense than its positions."""
    if "velocity" not in stream.values or "position" not in stream.values or len(stream) < MIN_SAMPLES:
        return stream, []
    position, velocity = stream["position"], stream["velocity"]
    known = Stream(stream.time, {name: data for name, data in stream.values.items() if name != "velocity"})
    if is_dead(velocity) and not is_dead(position):
        return known, [f"{label}: velocity is {velocity[0]:g} throughout while the joint moves, left out"]
    if is_dead(position) and not is_dead(velocity):
        found = f"{label}: position is {position[0]:g} throughout while its velocity is not 0"
        object_to(InputError(found, "a position that moves", "correct the column that the twin names"))
        return stream, []
    stride = max(round(BEND / float(np.median(np.diff(stream.time)))), 1)
    integral = integrate(velocity, stream.time)
    factor, r_squared = compare_steps(np.diff(position[::stride]), np.diff(integral[::stride]))
    if r_squared < MIN_R_SQUARED or SLOWEST < factor < FASTEST:
        return stream, []
    return known, [f"{label}: velocity is {factor:.3g} times the motion of position, left out"]


def vet_rates(label: str, time: np.ndarray, turned: np.ndarray, rate: np.ndarray, aligned: np.ndarray) -> None:
    """Refuse rates (n, 3) that turn too far or not far enough for the attitudes of a body that `turned` so, (n, 3).

    What hardly turns, and what even the rates in the attitudes' axes, `aligned` (n, 3), do not explain, is not judged.

    Raises:
        InputError: if the two agree but for a factor, such as 57.3.
    """
    if len(time) < MIN_SAMPLES or np.ptp(turned, axis=0).max() < MIN_TURN:
        return
    stride = max(round(BEND / float(np.median(np.diff(time)))), 1)
    tracks = turned, integrate(rate, time), integrate(aligned, time)
    seen, logged, in_axes = (np.diff(track[::stride], axis=0) for track in tracks)
    factor = float(np.linalg.norm(logged - logged.mean(axis=0)) / np.linalg.norm(seen - seen.mean(axis=0)))
    if compare_steps(seen.ravel(), in_axes.ravel())[1] < MIN_R_SQUARED or SLOWEST < factor < FASTEST:
        return
    looks = ", which is no unit: a heading that wheels which slip have turned, or a gyro of another range"
    mend = "correct the `scale` of the one that is wrong, or leave it out"
    for unit, size in RATE_UNITS.items():
        if abs(np.log(factor / size)) < np.log(SAME_UNIT):
            looks, mend = f" and look like {unit}", f"correct its signal in the twin, for instance with `unit: {unit}`"
        if abs(np.log(factor * size)) < np.log(SAME_UNIT):
            looks = f" and look like rad/s that `unit: {unit}` makes too small"
            mend = "correct its signal in the twin, for instance with `unit: rad/s`"
    found = f"{label} are {factor:.3g} times the turning of the attitudes{looks}"
    object_to(InputError(found, "rad/s of the same motion", mend))


class LoggedPosition(NamedTuple):
    """Values (n,) of a joint or of its target as logged, and between which its MJCF keeps it in the same unit."""

    name: str
    values: np.ndarray
    limits: tuple[float, float]  # infinite where it has none


class TravelEnds(NamedTuple):
    """Where a position is held, of -100, 0 and 100, and whether the joint cannot be there."""

    name: str
    at: tuple[float, ...]
    beyond: bool

    def __str__(self) -> str:
        """In words."""
        return f"{self.name} is held at exactly {' and '.join(f'{end:g}' for end in self.at)}"


def find_ends(position: LoggedPosition) -> TravelEnds | None:
    """Where per cents of a travel would end: at exactly 100 or -100, in several samples in a row, and nowhere beyond.

    Counts of an encoder, steps between a few values, and a joint at its own limit are none.
    """
    values, (low, high) = position.values[np.isfinite(position.values)], position.limits
    if not len(values) or np.abs(values).max() > FULL + ROUNDING or not np.any(values % 1.0 > ROUNDING):
        return None

    def is_held(end: float) -> bool:
        there = np.abs(values - end) < ROUNDING
        row = np.convolve(there, np.ones(HELD_SAMPLES), "valid") if len(values) >= HELD_SAMPLES else np.zeros(1)
        return bool(np.any(row > HELD_SAMPLES - 0.5))

    extremes = {float(np.round(end)) for end in (values.min(), values.max())}
    far = LIMIT_MARGIN * (high - low) if np.isfinite(high - low) else 0.0
    at = tuple(end for end in (-FULL, 0.0, FULL) if end in extremes and is_held(end)
               and min(abs(end - low), abs(end - high)) > far)  # fmt: skip
    if len(np.unique(values)) < MIN_VALUES or not {FULL, -FULL} & set(at):
        return None
    return TravelEnds(position.name, at, any(end < low - far or end > high + far for end in at))


def find_normalised(positions: Iterable[LoggedPosition]) -> list[TravelEnds]:
    """Which positions are per cents of a travel: held beyond a limit, at both ends, or like another one."""
    ended = [ends for ends in map(find_ends, positions) if ends is not None]
    return ended if len(ended) > 1 or any(ends.beyond or len(ends.at) > 1 for ends in ended) else []


def vet_travel(model: mujoco.MjModel, signals: Signals, flight: Flight) -> list[str]:
    """A warning for positions and targets read as angles or lengths that look like per cents of a travel.

    Raises:
        InputError: if one is held where its joint cannot be.
    """
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    tracked = [*signals.joints.items(), *signals.driven.items()]
    columns = [(topic, name, "position", joints[name]) for name, topic in tracked if name in joints]
    for name, topic in signals.actuators.items():
        i = model.actuator(name).id
        if (joint := find_driven_joint(model, i)) is not None and tell_control(model, i) == "position":
            columns += [(topic, name, column, joint) for column in ("effort", "position")]
    positions = list[LoggedPosition]()
    for topic, name, column, joint in columns:
        entry = signals.entries.get(topic, {}).get(name)
        given = getattr(entry, column) if entry is not None else FieldEntry(path=column)
        stream = flight.joints.get(topic, {}).get(name)
        if given is None or stream is None or column not in stream.values or given.polynomial or given.offset:
            continue
        if abs(given.factors[0]) != (UNITS[given.unit][1] if given.unit else 1.0):  # somebody has worked out a scale
            continue
        limits = model.jnt_range[joint] / given.factors[0] if model.jnt_limited[joint] else np.array([-np.inf, np.inf])
        values = stream[column] / given.factors[0]
        positions.append(LoggedPosition(f"{topic} {name}: {column}", values, (limits.min(), limits.max())))
    ends = find_normalised(positions)
    found = f"{'; '.join(map(str, ends[:3]))}, as per cents of a calibrated travel are, which LeRobot logs"
    if any(each.beyond for each in ends):
        advice = "give `scale` and `offset` of its calibration, scale alone if it is in that unit after all"
        object_to(InputError(f"{flight.path}: {found}, where the joint cannot be", "rad, m or a unit", advice))
    return [f"{found}: is the unit right?"] * bool(ends)
