"""Topic maps: which topics and fields of other people's bags stand for ours."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import TypeAdapter, ValidationError

from vpptwin.logs.channels import (
    AXES,
    CHANNELS,
    EULER,
    JOINT_COLUMNS,
    JOINT_TOPICS,
    OPTIONAL_COLUMNS,
    SIGNAL_COLUMNS,
    SPATIAL_COLUMNS,
    Column,
    MessageChannel,
    Source,
)
from vpptwin.logs.messages import shorten_type
from vpptwin.system.errors import InputError
from vpptwin.system.fields import FieldEntry, SignalEntry, Stamp, TopicEntry, text_as
from vpptwin.system.plain import read_yaml

LOG_TIME = "log_time"
GEODETIC = {"lat", "latitude", "lon", "lng", "longitude"}
"""Words of places on the globe."""
_EXAMPLE = "/imu/data: {topic: /mavros/imu, fields: {rate: {path: angular_velocity.y, scale: -1.0}}}"
_EXAMPLE_JOINT = "/joint_states: {names: {elbow: {topic: /state, position: {path: 'q[2]', unit: deg}}}}"


_Document = TypeAdapter(dict[str, Annotated[TopicEntry, text_as("topic")]])


@dataclass(frozen=True)
class Route:
    """How one canonical topic is recorded in a log.

    Attributes:
        channel: of the channel table.
        topic: its name in the log.
        sources: column -> where it lies, for the columns that a topic map redirects.
        stamp: where the time lies.
        origin: the topic map file, or empty.
    """

    channel: MessageChannel
    topic: str
    sources: dict[str, Source]
    stamp: Stamp
    origin: str = ""

    def choose_columns(self, message_type: str) -> tuple[Column, ...]:
        """Columns that can be read from messages of a type."""
        known = shorten_type(message_type) == shorten_type(self.channel.message_type)
        chosen = [
            replace(column, source=self.sources.get(column.name, column.source))
            for column in self.channel.columns
            if known or column.name in self.sources
        ]
        missing = [c.name for c in self.channel.columns if not (known or c.optional or c.name in self.sources)]
        if missing:
            topic = self.channel.topic
            raise InputError(
                f"{self.topic} is of type {message_type or 'unknown'}",
                f"{self.channel.message_type} for {topic}",
                f"record that type, or say in a topic map where {', '.join(missing)} of {topic} lie (fields: ...)",
            )
        return tuple(chosen)

    def list_sources(self, message_type: str) -> list[Source]:
        """Where the columns lie in messages of a type; [] where they can't be read."""
        try:
            return [column.source for column in self.choose_columns(message_type)]
        except InputError:
            return []


@dataclass(frozen=True)
class JointRoute:
    """How one joint, actuator, body or IMU is recorded in a log, in fields of any topic.

    Attributes:
        canonical: topic that it is read as: JointState, or one of its own.
        name: of the joint, actuator, body or site.
        topic: in the log.
        sources: column, of `SIGNAL_COLUMNS` -> where it lies.
        stamp: where the time lies.
    """

    canonical: str
    name: str
    topic: str
    sources: dict[str, Source]
    stamp: Stamp

    def list_sources(self, message_type: str) -> list[Source]:
        """Where the columns lie, in messages of whatever type."""
        return list(self.sources.values())


SignalEntries = Mapping[str, Mapping[str, SignalEntry]]


@dataclass(frozen=True)
class TopicMap:
    """What is where.

    Attributes:
        routes: canonical topic -> route, for all of the channel table.
        joints: JointState topic in the log -> canonical name.
        named: joints and actuators out of fields.
    """

    routes: dict[str, Route]
    joints: dict[str, str]
    named: tuple[JointRoute, ...] = ()

    def list_routes(self) -> list[Route | JointRoute]:
        """All routes."""
        return [*self.routes.values(), *self.named]

    def list_fields(self) -> dict[str, set[str]]:
        """Topic in the log -> the fields of it that are read, for topics of other types than ours."""
        wanted: dict[str, set[str]] = {}
        for route in self.list_routes():
            if route.sources:
                paths = [path for source in route.sources.values() for path in source.roots]
                wanted.setdefault(slash(route.topic), set()).update(paths, [route.stamp.path])
        return wanted

    def list_stamps(self) -> dict[str, Stamp]:
        """Topic in the log -> where its time lies, where that is said."""
        named = {slash(route.topic): route.stamp for route in self.list_routes()}
        return {topic: stamp for topic, stamp in named.items() if stamp.path not in (Stamp().path, LOG_TIME)}


def slash(topic: str) -> str:
    """The topic with the slash that people leave out."""
    return topic if topic.startswith("/") else f"/{topic}"


def load_topic_map(path: str | os.PathLike[str] | None, signals: SignalEntries | None = None) -> TopicMap:
    """Read a topic map; topics that it leaves out keep their names.

    Args:
        path: YAML file, or None for the names of the channel table.
        signals: topic -> name -> the fields that a twin names for it; what it names is none of the drone's.

    Raises:
        InputError: naming the key that is wrong.
    """
    routes = {topic: Route(channel, topic, {}, Stamp()) for topic, channel in CHANNELS.items()}
    joints: dict[str, str] = {}
    named = {(topic, name): ("", entry) for topic, names in (signals or {}).items() for name, entry in names.items()}
    for canonical, entry in _read_document(Path(path)).items() if path is not None else ():
        where = f"{path}: {canonical}"
        if canonical in JOINT_TOPICS:
            if entry.fields:
                expected = "only a topic, as JointState names its joints itself"
                raise InputError(f"{where}.fields", expected, "remove the fields")
            if bool(entry.names) == bool(entry.topic):
                raise InputError(where, "a topic, or names of joints with their fields", f"write {_EXAMPLE_JOINT}")
            if entry.topic:
                joints[entry.topic] = canonical
            named |= {(canonical, name): (f"{where}.names.{name}: ", item) for name, item in entry.names.items()}
        elif canonical in CHANNELS:
            if not entry.topic or entry.names:
                raise InputError(where, f"an entry like {_EXAMPLE}", "name the topic in the log")
            channel = CHANNELS[canonical]
            given = entry.fields.items()
            sources = {name: _build_source(f"{where}.fields.{name}", channel, name, item) for name, item in given}
            stamp = entry.stamp
            routes[canonical] = Route(channel, entry.topic, sources, stamp, str(path))
        else:
            raise InputError(f"{where}", f"one of {', '.join((*CHANNELS, *JOINT_TOPICS))} as key", "correct the key")
    taken = {route.topic for route in routes.values() if route.origin} | {*(signals or ())}
    routes = {topic: route for topic, route in routes.items() if route.origin or route.topic not in taken}
    return TopicMap(routes, joints, tuple(_build_joint(*key, *item) for key, item in named.items()))


def _build_joint(canonical: str, name: str, where: str, entry: SignalEntry) -> JointRoute:
    root = next((root for root in SPATIAL_COLUMNS if canonical.startswith(root)), "")
    columns, more = SPATIAL_COLUMNS.get(root), OPTIONAL_COLUMNS.get(root, {})
    widths = {**columns, **more} if columns else dict.fromkeys(JOINT_COLUMNS, 1)
    given = {column: item for column in SIGNAL_COLUMNS if (item := getattr(entry, column)) is not None}
    if not given.keys() & widths.keys() or (columns and given.keys() - more.keys() != columns.keys()):
        expected = " and ".join(columns) if columns else " or ".join(JOINT_COLUMNS)
        raise InputError(
            f"{where}{name} on {entry.topic} with {' and '.join(given) or 'no fields'}", expected, "name it"
        )
    sources = {}
    for column, item in given.items():
        paths, wanted = (item.path,) if isinstance(item.path, str) else tuple(item.path), widths.get(column, 0)
        wanted = len(EULER) if column == "attitude" and len(paths) == len(EULER) else wanted
        if len(paths) != wanted or len(item.factors) not in (1, wanted):
            found = f"{where}{name}.{column}: {len(paths)} fields, {len(item.factors)} factors"
            expected = f"{wanted} fields{', or roll, pitch and yaw' * (column == 'attitude')}"
            raise InputError(found, expected if wanted else "none, as it is no such signal", "correct it")
        globe = [path for path in paths if set(re.findall(r"[a-z]+", path.lower())) & GEODETIC]
        is_place = column == "position" and len(paths) == wanted == 3
        if is_place and globe and max(item.factors) == min(item.factors) == 1.0:
            raise InputError(
                f"{where}{name}.position: {' and '.join(globe)}, which are degrees on the globe", "x, y, z in metres",
                "convert them to metres east and north of a place, or scale each: `scale: [m per degree, ..., 1]`",
            )  # fmt: skip
        if item.frame != "body" and column != "rate":
            raise InputError(f"{where}{name}.{column} with frame {item.frame}", "a frame of rates alone", "remove it")
        sources[column] = _make_source(paths, item, item.axis)
    return JointRoute(canonical, name, slash(entry.topic), sources, entry.stamp)


def _read_document(path: Path) -> dict[str, TopicEntry]:
    try:
        content = read_yaml(path)
    except FileNotFoundError:
        raise InputError(f"no topic map {path}", "a YAML file", "check the path") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        found = f"{path}: no readable YAML ({error})"
        raise InputError(found, f"entries like {_EXAMPLE}", "correct the file") from None
    if not isinstance(content, dict):
        found = f"{path}: {type(content).__name__} at top level"
        raise InputError(found, f"entries like {_EXAMPLE}", "correct the file")
    try:
        return _Document.validate_python(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: {key}: {first['msg']}", f"an entry like {_EXAMPLE}", "correct this key") from None


def _build_source(where: str, channel: MessageChannel, name: str, entry: FieldEntry) -> Source:
    columns = {column.name: column for column in channel.columns}
    if name not in columns:
        raise InputError(f"{where}", f"one of the columns {', '.join(columns)}", "correct the key")
    column = columns[name]
    paths = (entry.path,) if isinstance(entry.path, str) else tuple(entry.path)
    if len(paths) not in (1, column.width):
        raise InputError(f"{where}.path: {len(paths)} fields", f"1 or {column.width}", "name one field per component")
    if len(entry.factors) not in (1, column.width):
        expected, action = f"1 or {column.width}", "give one factor per component"
        raise InputError(f"{where}.scale: {len(entry.factors)} factors", expected, action)
    axis = entry.axis
    if axis is None and column.source.axis and paths[0].rsplit(".", 1)[-1] in ("orientation", "rotation"):
        axis = "-y"
    if axis is not None and column.source.axis is None:
        action = f"remove it; axes {', '.join(AXES)} are for theta"
        raise InputError(f"{where}.axis", f"no axis, as {name} is no angle", action)
    return _make_source(paths, entry, axis)


def _make_source(paths: tuple[str, ...], entry: FieldEntry, axis: str | None) -> Source:
    voltage = (entry.voltage.path, entry.voltage.nominal) if entry.voltage else None
    return Source(paths, entry.factors, entry.offset, axis, tuple(entry.polynomial), voltage)
