"""Other ways to read a log's columns: in another unit, of the other sign, exchanged; and the twin's line for each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from vpptwin.estimation.checks.orientation import ANGLES, QUATERNIONS, Convention, find_rate_source, is_angled
from vpptwin.estimation.dynamics import find_driven_joint
from vpptwin.logs.flight import Flight, Stream
from vpptwin.system.fields import UNITS, SignalEntry, dump_entry
from vpptwin.twin.robot.actuation import tell_control
from vpptwin.twin.robot.manifold import BALL, FREE
from vpptwin.twin.robot.model import HINGE
from vpptwin.twin.robot.signals import Signals
from vpptwin.twin.spec import TwinSpec

MOST = 8
"""Joints, and actuators, up to which every one and every pair of them is read otherwise by itself."""
POSITIONS = {True: ("rad", ("deg",)), False: ("m", ("mm", "cm"))}
"""Whether a joint is a hinge → SI unit of where it is, and units that are mistaken for it."""
RATES = {True: ("rad/s", ("deg/s", "rpm")), False: ("m/s", ("mm/s", "cm/s"))}
EFFORTS = {True: ("N m", ("mN m", "kgf cm")), False: ("N", ("kgf", "mN", "gf", "kN"))}
AXES = tuple(
    Convention("position", order, signs)
    for order, signs in [*((order, (1.0,) * 3) for order in permutations(range(3))), ((0, 1, 2), (1.0, 1.0, -1.0))]
    if (order, signs) != ((0, 1, 2), (1.0,) * 3)
)
"""Positions with their axes in another order, or z pointing down."""
PATHS = {"position": [f"pose.position.{axis}" for axis in "xyz"],
         "attitude": [f"pose.orientation.{axis}" for axis in "wxyz"]}  # fmt: skip
"""Fields of a body's pose that nobody has named."""


class Column(NamedTuple):
    """One quantity (position, velocity, effort, attitude) of what a twin's signals name in a group."""

    group: str
    name: str
    quantity: str

    def __str__(self) -> str:
        """In words."""
        return f"{self.quantity} of {self.name}"


class Change(NamedTuple):
    """A column that is read from another one, times a scale, or in another convention of its numbers."""

    column: Column
    source: Column
    scale: float = 1.0
    convention: Convention | None = None
    unit: str = ""  # that it is in, where that is not what it is


@dataclass(frozen=True)
class Reading:
    """One way to read some columns otherwise: what they look like then, what the twin takes them for, and how."""

    looks: str
    expected: str
    changes: tuple[Change, ...]

    def read(self, signals: Signals, flight: Flight) -> Flight:
        """The flight, with its columns read so."""
        joints = {topic: dict(names) for topic, names in flight.joints.items()}
        spatial = dict(flight.spatial)
        for change in self.changes:
            stream, source = (find_stream(signals, flight, each) for each in (change.column, change.source))
            if stream is None or source is None:
                continue
            values = source[change.source.quantity] * change.scale
            if change.convention is not None:
                turned = change.convention.of == "attitude"
                values = (change.convention.read_attitude if turned else change.convention.read)(values)
            if len(source) != len(stream) or (source.time != stream.time).any():
                values = np.interp(stream.time, source.time, values)
            topic, name = getattr(signals, change.column.group)[change.column.name], change.column.name
            names, key = (spatial, topic) if topic in spatial else (joints[topic], name)
            names[key] = Stream(stream.time, {**names[key].values, change.column.quantity: values})
        return replace(flight, joints=joints, spatial=spatial)

    @property
    def columns(self) -> list[Column]:
        """What it reads otherwise."""
        return [change.column for change in self.changes]


class Misread(NamedTuple):
    """Columns that look misread: how they fit otherwise, and the numbers that tell it."""

    reading: Reading
    why: str


def find_stream(signals: Signals, flight: Flight, column: Column) -> Stream | None:
    """The stream of a column; None where the log lacks it."""
    topic = getattr(signals, column.group).get(column.name, "")
    stream = flight.joints.get(topic, {}).get(column.name, flight.spatial.get(topic))
    return stream if stream is not None and column.quantity in stream.values else None


def scale_columns(columns: Sequence[Column], factor: float, unit: str = "") -> tuple[Change, ...]:
    """Changes of columns by one factor, which is that of a unit for those that are no velocities."""
    return tuple(Change(c, c, factor, unit="" if c.quantity == "velocity" else unit) for c in columns)


def exchange(first: Column, second: Column) -> tuple[Change, Change]:
    """Two columns, each read from the other."""
    return Change(first, second), Change(second, first)


def name_columns(columns: Sequence[Column]) -> str:
    """Columns in words, those of many by their number."""
    if len(columns) <= 2:
        return " and ".join(map(str, columns))
    names = dict.fromkeys(column.name for column in columns)
    return f"{' and '.join(dict.fromkeys(column.quantity for column in columns))} of {', '.join(names)}"


def list_kin(spec: TwinSpec, flight: Flight) -> dict[str, tuple[bool, list[Column]]]:
    """Hinges and slides that are logged → whether it is a hinge, and its columns, position first."""
    found = {}
    for each in spec.robot.tracked:
        kind, group = spec.model.jnt_type[each.joint], "driven" if each.led else "joints"
        if kind in (FREE, BALL):
            continue
        columns = [Column(group, each.name, quantity) for quantity in ("position", "velocity")]
        columns = [column for column in columns if find_stream(spec.robot.signals, flight, column) is not None]
        found[each.name] = kind == HINGE, columns
    return found


def list_efforts(spec: TwinSpec, flight: Flight) -> dict[str, tuple[bool, Column]]:
    """Actuators that take a force or torque → whether it acts on a hinge, and its column."""
    found = {}
    for name in spec.robot.signals.actuators:
        index, column = spec.model.actuator(name).id, Column("actuators", name, "effort")
        if tell_control(spec.model, index) == "effort" and find_stream(spec.robot.signals, flight, column) is not None:
            joint = find_driven_joint(spec.model, index)
            found[name] = joint is not None and spec.model.jnt_type[joint] == HINGE, column
    return found


def rescale(spec: TwinSpec, columns: Sequence[Column], unit: str, others: Sequence[str]) -> Iterator[Reading]:
    """Columns that are in another unit than they are taken for; of those that are scaled: in `unit` after all."""
    for other in others:
        yield Reading(f"in {other}", unit, scale_columns(columns, UNITS[other][1], other))
    for other in others if any(is_scaled(spec.robot.signals, column) for column in columns) else ():
        looks = f"in {unit}, and scaled as if it were in {other}"
        yield Reading(looks, unit, scale_columns(columns, 1.0 / UNITS[other][1]))
    given = {tell_factor(spec.robot.signals, column) for column in columns}
    for other in others if len(given) == 1 and given != {1.0} else ():  # mm that are cm
        if (factor := UNITS[other][1] / next(iter(given))) != 1.0:
            yield Reading(f"in {other}", unit, scale_columns(columns, factor, other))


def list_readings(spec: TwinSpec, flight: Flight) -> Iterator[Reading]:
    """Ways to read a log's columns otherwise that inverse dynamics may tell, the commonest mistake first."""
    kin, efforts = list_kin(spec, flight), list_efforts(spec, flight)
    for rotary, (unit, others) in POSITIONS.items():
        own = [columns for hinge, columns in kin.values() if hinge == rotary and columns]
        groups = [[column for columns in own for column in columns]]
        groups += [[columns[0] for columns in own]] * any(len(columns) > 1 for columns in own)
        if 1 < len(own) <= MOST:
            groups += [part for columns in own for part in (columns, columns[:1])[: len(columns)]]
        for group in groups if own else ():
            yield from rescale(spec, group, unit, others)
    yield from list_bodies(spec, flight)
    for rotary, (unit, others) in EFFORTS.items():
        pushed = [column for hinge, column in efforts.values() if hinge == rotary]
        alone = [c for c in pushed if find_driven_joint(spec.model, spec.model.actuator(c.name).id) is not None]
        singles = [[column] for column in alone] if 1 < len(alone) <= MOST else []
        for group in [pushed, *singles] if pushed else ():
            changes = scale_columns(group, -1.0)
            yield Reading("of the other sign", "a push in the joint's sense", changes)
            yield from rescale(spec, group, unit, others)
        yield from list_geared(spec, [column for column in alone if not rotary])
    for _, columns in kin.values() if len(kin) <= MOST else ():
        yield Reading("of the other sign", "the sense of the MJCF's joint axis", scale_columns(columns, -1.0))
    yield from list_exchanges(kin, efforts)


def list_geared(spec: TwinSpec, columns: Sequence[Column]) -> Iterator[Reading]:
    """Efforts of motors that move slides by pulleys or screws, logged as the force on the slide, or in kgf cm."""
    gears = [float(spec.model.actuator(column.name).gear[0]) for column in columns]
    if any(abs(gear) != 1.0 for gear in gears):
        changes = tuple(Change(column, column, 1.0 / gear) for column, gear in zip(columns, gears))
        yield Reading("behind the gear already", "what goes into the gear", changes)
        yield from rescale(spec, columns, "N m", ("kgf cm",))


def list_exchanges(
    kin: dict[str, tuple[bool, list[Column]]], efforts: dict[str, tuple[bool, Column]]
) -> Iterator[Reading]:
    """Pairs of joints, and of actuators, each of which has the other's columns."""
    for one, other in combinations(kin.values(), 2) if len(kin) <= MOST else ():
        if one[0] == other[0] and len(one[1]) == len(other[1]):
            changes = tuple(change for pair in zip(one[1], other[1]) for change in exchange(*pair))
            yield Reading("exchanged", "each joint's own columns", changes)
    for (_, first), (_, second) in combinations(efforts.values(), 2) if len(efforts) <= MOST else ():
        yield Reading("exchanged", "each actuator's own column", exchange(first, second))


def list_bodies(spec: TwinSpec, flight: Flight) -> Iterator[Reading]:
    """Poses of bodies in other units, with other axes, in another order or sense of the attitude."""
    for each in spec.robot.tracked:
        if spec.model.jnt_type[each.joint] not in (FREE, BALL) or each.led:
            continue
        group = "bodies" if each.posed else "joints"
        place, turn = (Column(group, each.name, quantity) for quantity in ("position", "attitude"))
        if find_stream(spec.robot.signals, flight, place) is not None:
            yield from rescale(spec, [place], *POSITIONS[False])
            for convention in AXES:
                looks = "with z down" if convention.signs[2] < 0.0 else "with its axes in another order"
                yield Reading(looks, "x, y, z of the world, z up", (Change(place, place, 1.0, convention),))
        entry, pose = find_entry(spec.robot.signals, group, each.name), find_stream(spec.robot.signals, flight, turn)
        if pose is None or find_rate_source(spec, flight, each, pose) is not None:  # rates have told that already
            continue
        for convention in ANGLES if is_angled(entry) else QUATERNIONS:
            order = convention.order != tuple(range(len(convention.order)))
            looks = "in another order" if order else "of the other sense"
            yield Reading(looks, "w, x, y, z of the body in the world", (Change(turn, turn, 1.0, convention),))


def compose_entry(spec: TwinSpec, flight: Flight, name: str, changes: Sequence[Change]) -> str:
    """The line of a twin's signals that reads one joint, actuator or body so; "" where no line can say it.

    Args:
        spec: the twin.
        flight: a log, which tells the columns of topics that nobody has named fields of.
        name: of the joint, actuator or body.
        changes: of its columns.
    """
    signals, group = spec.robot.signals, changes[0].column.group
    content = dump_signal(signals, flight, group, name)
    for change in changes:
        others = dump_signal(signals, flight, change.source.group, change.source.name)
        plain = find_entry(signals, group, name) is None
        if change.source.name != name and (plain or others["topic"] != content["topic"]):
            return ""
        field = others[change.source.quantity]
        field = dict(field) if isinstance(field, dict) else {"path": field}
        content[change.column.quantity] = write_field(field, change)
    text = yaml.safe_dump({name: content}, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True)
    return text.strip()[1:-1]


def tell_factor(signals: Signals, column: Column) -> float:
    """By what a twin multiplies a column; 1 where it says nothing, or more than one number."""
    field = getattr(find_entry(signals, column.group, column.name), column.quantity, None)
    return float(field.factors[0]) if field is not None and len(set(field.factors)) == 1 else 1.0


def is_scaled(signals: Signals, column: Column) -> bool:
    """Whether a twin says a unit or scale of a column."""
    field = getattr(find_entry(signals, column.group, column.name), column.quantity, None)
    return field is not None and set(field.factors) != {1.0}


def find_entry(signals: Signals, group: str, name: str) -> SignalEntry | None:
    """What a twin says of a joint, actuator or body out of fields; None where it names no more than a topic."""
    return signals.entries.get(getattr(signals, group)[name], {}).get(name)


def dump_signal(signals: Signals, flight: Flight, group: str, name: str) -> dict[str, Any]:
    """The entry of a joint, actuator or body as YAML's plain data; one with all fields where only a topic is named."""
    entry, topic = find_entry(signals, group, name), getattr(signals, group)[name]
    if entry is not None:
        return dump_entry(entry)
    stream = flight.joints.get(topic, {}).get(name)
    if stream is None:
        return {"topic": topic, **{quantity: list(paths) for quantity, paths in PATHS.items()}}
    wanted = ("position", "velocity") if group != "actuators" else ("effort",)
    return {"topic": topic, **{quantity: quantity for quantity in wanted if quantity in stream.values}}


def write_field(field: dict[str, Any], change: Change) -> Any:  # noqa: ANN401
    """A field of a signal's entry with a change in it, as short as it can be."""
    if (convention := change.convention) is not None:
        field["path"] = [field["path"][i] for i in convention.order]
        if min(convention.signs) < 0.0:
            signs = np.array(convention.signs) * (1.0 if convention.signs[0] > 0.0 or len(convention.signs) < 4 else -1)
            field["scale"] = [float(s) for s in signs * np.broadcast_to(field.get("scale", 1.0), len(signs))]
    elif change.scale != 1.0:
        unit, scale = field.pop("unit", None), field.pop("scale", 1.0)
        kind, size = UNITS[unit] if unit else (None, 1.0)
        wanted = scale * size * change.scale if isinstance(scale, float | int) else 1.0
        known = [change.unit] if change.unit else [u for u in UNITS if is_alike(u, kind, change)]
        fitting = [u for u in known if np.isclose(UNITS[u][1], wanted, rtol=1e-6)]
        if change.scale == -1.0:
            field |= ({"unit": unit} if unit else {}) | {"scale": -scale}
        elif not np.isclose(wanted, 1.0, rtol=1e-6):
            field |= {"unit": fitting[0]} if fitting else {"scale": float(f"{wanted:.6g}")}
    return field if len(field) > 1 else field["path"]


def is_alike(unit: str, kind: str | None, change: Change) -> bool:
    """Whether a unit measures what a column is."""
    quantities = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "effort": ("N m", "N")}
    return UNITS[unit][0] == kind if kind else UNITS[unit][0] in quantities[change.column.quantity]


def locate_line(spec: TwinSpec, group: str, name: str) -> int | None:
    """Line of a twin YAML on which a signal is named; None where nothing can be found."""
    try:
        node = yaml.compose(Path(spec.name).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return None
    for key in ("signals", group, name):
        if not isinstance(node, yaml.MappingNode):
            return None
        found = next(((k, v) for k, v in node.value if k.value == key), None)
        if found is None:
            return None
        line, node = found[0].start_mark.line + 1, found[1]
    return int(line)
