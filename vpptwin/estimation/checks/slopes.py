"""Columns against each other: a velocity is the slope of its position, a joint follows the target of its servo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from vpptwin.estimation.checks.orientation import BEND, MIN_SAMPLES
from vpptwin.estimation.checks.readings import (
    POSITIONS,
    RATES,
    Column,
    Misread,
    Reading,
    compose_entry,
    exchange,
    find_stream,
    list_kin,
    rescale,
    scale_columns,
)
from vpptwin.estimation.dynamics import find_driven_joint
from vpptwin.estimation.joints import straighten_joint
from vpptwin.estimation.series import integrate
from vpptwin.logs.check import MIN_R_SQUARED, compare_steps
from vpptwin.logs.flight import Flight, Stream
from vpptwin.system.fields import UNITS
from vpptwin.twin.robot.actuation import tell_control
from vpptwin.twin.robot.model import HINGE
from vpptwin.twin.spec import TwinSpec

NEAR = 0.05
"""By how much a factor between two columns of one motion may differ from that of a unit."""
NEAR_SERVO = 0.15
"""The same between a target and what follows it, which may fall short of it."""
FOLLOWS, STRANGE, FARTHER = 0.9, 0.3, 0.2
"""Squared correlation from which on one column follows another, below which they have nothing in common, and by how
much it must be greater than that of the columns as they are read."""
SERVED = (0.33, 3.0)
"""How many times its target a joint goes at most and at least, whatever its servo is."""
LAGS = np.arange(0.0, 0.31, 0.02)
"""By how much a joint may follow its target late [s]."""
LEADS = 0.5
"""Share of what is unexplained where a target follows its joint, of that where the joint follows it: the two are
exchanged. No measured servo comes below 0.9."""
FARTHEST = 2.0
"""Times the range of its joint, and a turn, from which on no position travels."""


def near(factor: float, size: float, within: float) -> bool:
    """Whether a factor is that of a unit."""
    return factor * size > 0.0 and abs(np.log(factor / size)) < np.log1p(within)


def compare_slopes(spec: TwinSpec, flight: Flight) -> Iterator[Misread]:
    """Velocities that are slopes of positions but for a unit or a sign, of another joint's, or the other way round."""
    slopes = {}
    tracked = {each.name: each for each in spec.robot.tracked}
    for name, (rotary, columns) in list_kin(spec, flight).items():
        if len(columns) < 2:
            continue
        whole = find_stream(spec.robot.signals, flight, columns[0])
        assert whole is not None
        stream, _ = straighten_joint(spec.model, tracked[name], whole)
        if len(stream) < MIN_SAMPLES:
            continue
        slopes[name] = rotary, columns, stream
        factor, likeness = fit_slope(stream["position"], stream["velocity"], stream.time)
        if likeness > MIN_R_SQUARED:
            yield from judge_slope(spec, flight, rotary, columns, factor, likeness)
        else:
            back, alike = fit_slope(whole["velocity"], whole["position"], whole.time)
            if alike > max(FOLLOWS, likeness + FARTHER) and near(back, 1.0, 0.5):
                why = f"position is {back:.2f} times the slope of velocity (R² {alike:.2f}; as given {likeness:.2f})"
                yield Misread(Reading("exchanged", "a position and its slope", exchange(columns[0], columns[1])), why)
    for one, other in permutations(slopes, 2):
        if one < other and (misread := compare_crossed(slopes[one], slopes[other])) is not None:
            yield misread


def judge_slope(
    spec: TwinSpec, flight: Flight, rotary: bool, columns: Sequence[Column], factor: float, likeness: float
) -> Iterator[Misread]:
    """A velocity that is so many times the slope of its position: by a unit, or a sign."""
    why = f"velocity is {factor:.4g} times the slope of position (R² {likeness:.3f})"
    position, velocity = columns[:1], columns[1:]
    found = []
    for part, units, power in ((velocity, RATES, -1.0), (position, POSITIONS, 1.0)):
        for reading in rescale(spec, part, *units[rotary]):
            if near(factor, reading.changes[0].scale ** power, NEAR):
                found.append(reading)
    if near(factor, -1.0, NEAR):
        found = [Reading("of the other sign", "the sense of its position", scale_columns(velocity, -1.0))]
    if found:
        yield Misread(choose_stated(spec, flight, found), why)


def choose_stated(spec: TwinSpec, flight: Flight, readings: Sequence[Reading]) -> Reading:
    """Of readings that explain the same the one whose positions keep within what the joint can do, else in a unit."""
    for reading in readings:
        taken = reading.read(spec.robot.signals, flight)
        given, other = (measure_reach(spec, each, reading.columns[0].name) for each in (flight, taken))
        if other <= FARTHEST < given:
            return reading
    common = [reading for reading in readings if "scaled" not in reading.looks] or list(readings)
    lines = [compose_entry(spec, flight, reading.columns[0].name, reading.changes) for reading in common]
    return common[int(np.argmin(["scale" in line for line in lines]))]  # units are likelier than odd factors


def compare_crossed(one: tuple[bool, list[Column], Stream], other: tuple[bool, list[Column], Stream]) -> Misread | None:
    """Two joints of which each has the slope of the other's position for its velocity; None where they do not."""
    (_, first, stream), (_, second, beside) = one, other
    if len(stream) != len(beside) or (stream.time != beside.time).any():
        return None
    own = max(fit_slope(s["position"], s["velocity"], s.time)[1] for s in (stream, beside))
    crossed = [fit_slope(a["position"], b["velocity"], stream.time) for a, b in ((stream, beside), (beside, stream))]
    if own < STRANGE and all(alike > FOLLOWS and near(factor, 1.0, 0.5) for factor, alike in crossed):
        why = f"each is the slope of the other's position (R² {min(alike for _, alike in crossed):.2f}; own {own:.2f})"
        return Misread(Reading("exchanged", "each joint's own velocity", exchange(first[1], second[1])), why)
    return None


def fit_slope(position: np.ndarray, velocity: np.ndarray, time: np.ndarray) -> tuple[float, float]:
    """How many times the slope of a position (n,) a velocity is, and R² of that."""
    known = np.isfinite(position) & np.isfinite(velocity)
    if np.count_nonzero(known) < MIN_SAMPLES or not np.ptp(velocity[known]):
        return 1.0, 0.5
    position, velocity, time = position[known], velocity[known], time[known]
    stride = max(round(BEND / float(np.median(np.diff(time)))), 1)
    return compare_steps(np.diff(position[::stride]), np.diff(integrate(velocity, time)[::stride]))


def compare_targets(spec: TwinSpec, flight: Flight) -> Iterator[Misread]:
    """Targets that joints follow but for a unit or a sign, or that another joint follows."""
    model, signals, servos = spec.model, spec.robot.signals, {}
    kin = list_kin(spec, flight)
    for name in signals.actuators:
        index = model.actuator(name).id
        joint = find_driven_joint(model, index)
        columns = [Column("actuators", name, quantity) for quantity in ("effort", "position")]
        column = next((c for c in columns if find_stream(signals, flight, c) is not None), None)
        driven = "" if joint is None else str(model.joint(joint).name)
        if tell_control(model, index) == "position" and column is not None and kin.get(driven, (0, []))[1]:
            servos[name] = model.actuator_gear[index, 0], kin[driven][0], column, kin[driven][1][0]
    for gear, rotary, column, position in servos.values():
        factor, alike = follow_target(spec, flight, column, position)
        _, before = follow_target(spec, flight, column, position, -LAGS[1:])
        if before > FOLLOWS and 1.0 - before < LEADS * (1.0 - alike):
            why = f"{column.name}'s target follows {position.name} (R² {before:.3f}; as given {alike:.3f})"
            yield Misread(Reading("exchanged", "a joint that follows its target", exchange(position, column)), why)
            continue
        if alike < FOLLOWS:
            continue
        factor *= gear
        why = f"{position.name} follows it {factor:.4g} times (R² {alike:.2f})"
        units = [("target", r) for r in rescale(spec, [column], *POSITIONS[rotary])]
        matching = [r for _, r in units if near(factor, r.changes[0].scale, NEAR_SERVO)]
        if matching:
            yield Misread(matching[0], why)
        elif near(factor, -1.0, NEAR_SERVO):
            yield Misread(Reading("of the other sign", "the sense of its joint", scale_columns([column], -1.0)), why)
        elif not SERVED[0] < factor < SERVED[1]:
            taken = scale_columns([column], float(f"{factor / gear:.3g}"))
            yield Misread(Reading("in another unit than its joint", "about as much as its joint moves", taken), why)
    yield from compare_swapped_targets(spec, flight, [(column, position) for _, _, column, position in servos.values()])


def compare_swapped_targets(
    spec: TwinSpec, flight: Flight, servos: Sequence[tuple[Column, Column]]
) -> Iterator[Misread]:
    """Pairs of servos each of whose targets the other's joint follows, and not its own."""
    alike = np.array([[follow_target(spec, flight, c, p) for _, p in servos] for c, _ in servos])
    for i, j in permutations(range(len(servos)), 2):
        own, crossed = max(alike[i, i, 1], alike[j, j, 1]), min(alike[i, j, 1], alike[j, i, 1])
        equal = all(near(alike[a, b, 0], 1.0, NEAR_SERVO) for a, b in ((i, j), (j, i)))
        if i < j and own < STRANGE and crossed > FOLLOWS and equal:
            why = f"each joint follows the other's target (R² {crossed:.2f}; its own {own:.2f})"
            yield Misread(Reading("exchanged", "each joint's own target", exchange(servos[i][0], servos[j][0])), why)


def follow_target(
    spec: TwinSpec, flight: Flight, column: Column, position: Column, lags: np.ndarray = LAGS
) -> tuple[float, float]:
    """How many times its target a joint goes, at the lag at which it does best, and R² of that.

    Half a wave late a joint that turns to and fro goes the other way: that counts only where it does far better so.
    """
    target, seen = (find_stream(spec.robot.signals, flight, each) for each in (column, position))
    assert target is not None
    assert seen is not None
    asked, was, best = target[column.quantity], seen["position"], {1.0: (1.0, 0.0), -1.0: (1.0, 0.0)}
    for lag in lags:
        held = np.interp(seen.time - lag, target.time, asked)
        spread = float(held.std()) * float(was.std())
        if spread > 0.0:
            likeness = float(np.corrcoef(held, was)[0, 1])
            if likeness**2 > best[sense := float(np.sign(likeness) or 1.0)][1]:
                best[sense] = float(likeness * was.std() / held.std()), likeness**2
    return best[-1.0] if best[-1.0][1] > best[1.0][1] + FARTHER else best[1.0]


def measure_reach(spec: TwinSpec, flight: Flight, name: str) -> float:
    """How many times its range, and a turn, a joint travels in a log; 0 for one without limits."""
    found = list_kin(spec, flight).get(name)
    model = spec.model
    joint = next((i for i in range(model.njnt) if model.joint(i).name == name), None)
    if found is None or joint is None or not model.jnt_limited[joint] or not found[1]:
        return 0.0
    stream = find_stream(spec.robot.signals, flight, found[1][0])
    values = stream["position"] if stream is not None else np.zeros(1)
    low, high = np.nanpercentile(values, [1.0, 99.0])
    least = 2.0 * np.pi if model.jnt_type[joint] == HINGE else 0.0
    return float((high - low) / max(float(np.ptp(model.jnt_range[joint])), least, 1e-9))


def compare_ranges(spec: TwinSpec, flight: Flight) -> Iterator[Misread]:
    """Positions that travel farther than any turn and the range of their joint, and would not in a smaller unit."""
    kin = list_kin(spec, flight)
    far = {name: reach for name in kin if (reach := measure_reach(spec, flight, name)) > FARTHEST}
    for rotary, (unit, (other, *_)) in POSITIONS.items():
        columns = [column for name in far if kin[name][0] == rotary for column in kin[name][1][:1]]
        size = UNITS[other][1]
        if columns and all(far[column.name] * size < 1.0 for column in columns):
            why = f"{columns[0].name} travels {far[columns[0].name]:.3g} times its range"
            yield Misread(Reading(f"in {other}", unit, scale_columns(columns, size, other)), why)
