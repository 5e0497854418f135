"""In which unit or scale quantities were logged: velocities and rates by what they integrate to, efforts by the motion.

Positions in per cent of a calibrated travel, as LeRobot logs them (-100 to 100, of grippers 0 to 100), are told by
where they are held.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from vpptwin.estimation.checks.orientation import BEND, MIN_SAMPLES
from vpptwin.estimation.dynamics import Forces, find_driven_joint, measure_forces
from vpptwin.estimation.series import Measurements, integrate
from vpptwin.logs.check import FASTEST, MIN_R_SQUARED, MIN_TURN, SLOWEST, compare_steps
from vpptwin.logs.flight import Flight, Stream
from vpptwin.system.doubt import object_to
from vpptwin.system.errors import InputError
from vpptwin.system.fields import UNITS, FieldEntry, SignalEntry
from vpptwin.twin.robot.actuation import JOINT, tell_control
from vpptwin.twin.robot.manifold import BALL, FREE
from vpptwin.twin.robot.signals import Signals
from vpptwin.twin.spec import TwinSpec

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

FAR = 3.3
"""Factor from which on a force is in another unit: `gain` reaches to 3, and no drive has less than a third of it."""
BESIDE, LIKE, ALIKE, SAME = 0.9, 0.96, 0.99, 0.999
"""Correlation with the force that motion asks for from which on a factor above 1 tells beside another one, by itself,
one below 1 that is a unit's, and those of all actuators together."""
EXCITED, AGREE = 0.05, 0.3
"""Share of that force that either part of it, inertia and the rest, must have to tell the factor by itself; by how
much both may differ."""
UNIT, NEAR, BEYOND = 0.03, 0.25, 50.0
"""How near a factor comes to that of a unit, and where no load or rotor explains it: those below 1 over the last."""


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


@dataclass(frozen=True)
class EffortScale:
    """A force that motion asks for is so many times the logged effort.

    Attributes:
        actuator, topic: whose effort, and where it is.
        factor: force over effort.
        likeness: their correlation, friction taken out.
        agree: whether inertia and weight each tell that factor.
        rotary: whether it acts on a hinge.
        entry: of the twin's signals, where it is read from a field.
    """

    actuator: str
    topic: str
    factor: float
    likeness: float
    agree: bool
    rotary: bool
    entry: SignalEntry | None

    @property
    def unit(self) -> str:
        """The unit that the effort is in, where the factor is that of one; else ""."""
        kind = "N m" if self.rotary else "N"
        off = {u: abs(np.log(abs(self.factor) / size)) for u, (si, size) in UNITS.items() if si == kind and size != 1.0}
        nearest = min(off, key=lambda unit: off[unit])
        near = NEAR if self.agree and abs(self.factor) < 1.0 / BEYOND else UNIT
        return nearest if off[nearest] < near and self.factor > 0.0 else ""

    @property
    def scale(self) -> float:
        """The `scale` that the twin's signals must have for it, with that which they have."""
        had = self.entry.effort.scale if self.entry is not None and self.entry.effort is not None else 1.0
        size = UNITS[self.unit][1] if self.unit else self.factor
        return size * (had if isinstance(had, float) else 1.0)

    @property
    def example(self) -> str:
        """What stands in the twin's signals then."""
        had, field = self.entry, self.entry.effort if self.entry is not None else None
        topic, path = had.topic if had is not None else self.topic, field.path if field is not None else "effort"
        return f"{self.actuator}: {{topic: {topic}, effort: {{path: {path}, scale: {self.scale:.4g}}}}}"

    def is_clear(self, likeness: float = LIKE) -> bool:
        """Whether no load and no rotor that the MJCF lacks would make such a factor."""
        if abs(self.factor) > 1.0:
            return self.likeness > likeness
        beyond = abs(self.factor) < 1.0 / BEYOND
        if beyond and self.agree:
            return self.likeness > (BESIDE if self.unit else ALIKE)
        return bool(self.unit) and (beyond or self.agree) and self.likeness > ALIKE

    def __str__(self) -> str:
        """The factor in words."""
        looks = self.unit or ("current" if abs(self.factor) > 1.0 else "another unit")
        kind = "torque" if self.rotary else "force"
        return (
            f"the effort of {self.actuator} looks like {looks}: {kind} is {self.factor:.3g} times it "
            f"(r = {np.floor(self.likeness * 1e4) / 1e4:.4f})"
        )


def judge_efforts(spec: TwinSpec, measurements: Sequence[Measurements]) -> list[EffortScale]:
    """Efforts that are in another unit than the force that motion asks for, beyond what a drive may be wrong by.

    Gravity, inertia and friction are those of the MJCF; more friction is no reason. A smaller factor may be a load or
    a rotor that the MJCF lacks, unless it is that of a unit, or so small, or all of them say so.
    """
    actuators = {name: spec.model.actuator(name).id for name in spec.robot.signals.actuators}
    dofs = {name: find_own_dof(spec, i) for name, i in actuators.items() if tell_control(spec.model, i) == "effort"}
    driving = {name: dof for name, dof in dofs.items() if dof is not None}
    if not driving or spec.model.neq:
        return []
    forces = measure_forces(spec, measurements)
    scales = [fit_scale(spec, forces, name, dof) for name, dof in driving.items()]
    far = [each for each in scales if each is not None and not 1.0 / FAR < abs(each.factor) < FAR]
    alike = len(far) == len(driving) > 1 and all(each.agree and each.likeness > SAME for each in far)
    more = any(abs(each.factor) > 1.0 and each.is_clear() for each in far)
    return [each for each in far if alike or each.is_clear(BESIDE if more else LIKE)]


def find_own_dof(spec: TwinSpec, actuator: int) -> int | None:
    """Degree of freedom of the simulated hinge or slide that an actuator drives, and no other does."""
    model, joint = spec.model, find_driven_joint(spec.model, actuator)
    if joint is None or model.jnt_type[joint] in (FREE, BALL) or model.jnt_dofadr[joint] in spec.robot.driven:
        return None
    others = [i for i in range(model.nu) if i != actuator]
    shared = any(model.actuator_trntype[i] != JOINT or model.actuator_trnid[i, 0] == joint for i in others)
    return None if shared else int(model.jnt_dofadr[joint])


def fit_scale(spec: TwinSpec, forces: Forces, actuator: str, dof: int) -> EffortScale | None:
    """By least squares with friction and an offset beside; None where too little moves, or nothing was asked for."""
    given, inertial = forces.actuator[:, dof], forces.inertial[:, dof]
    required, rate = forces.missing[:, dof] + given, forces.velocity[:, dof]
    if len(given) < MIN_SAMPLES or not np.ptp(given) or not np.ptp(required):
        return None
    # Offset, viscous and smoothed Coulomb friction.
    beside = np.column_stack([np.ones(len(rate)), rate, np.tanh(rate / (0.05 * max(float(rate.std()), 1e-9)))])

    def take_out(column: np.ndarray) -> np.ndarray:
        return np.asarray(column - beside @ np.linalg.lstsq(beside, column, rcond=None)[0])

    effort, force = take_out(given), take_out(required)
    parts = np.column_stack([take_out(inertial), take_out(required - inertial)])
    sizes = float(np.std(effort)), float(np.std(force))
    if min(sizes) <= 0.0:
        return None
    likeness = float(np.corrcoef(effort, force)[0, 1])
    shares = np.linalg.lstsq(parts, effort, rcond=None)[0]
    excited = bool((parts.std(axis=0) > EXCITED * sizes[1]).all())
    agree = excited and bool(np.abs(shares * sizes[1] / sizes[0] - np.sign(likeness)).max() < AGREE)
    signals = spec.robot.signals
    topic = signals.actuators[actuator]
    entry = signals.entries.get(topic, {}).get(actuator)
    factor = np.sign(likeness) * sizes[1] / sizes[0]
    return EffortScale(actuator, topic, float(factor), abs(likeness), agree, bool(spec.robot.rotary[dof]), entry)


def refuse_efforts(spec: TwinSpec, measurements: Sequence[Measurements]) -> None:
    """Refuse logs whose efforts are no forces: whatever was found would answer for that.

    Raises:
        InputError: with the factor of each, and the `scale` to give.
    """
    far = judge_efforts(spec, measurements)
    if far:
        kind = " and ".join(dict.fromkeys("N m" if each.rotary else "N" for each in far))
        given = " and ".join(f"`scale: {each.scale:.4g}` for {each.actuator}" for each in far)
        object_to(InputError(
            f"{measurements[0].name}: {', '.join(map(str, far))}",
            f"{kind} in every log, or a model as heavy as the rig",
            f"give {given} in the twin's signals ({far[0].example})",
        ))  # fmt: skip
