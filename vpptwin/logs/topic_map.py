"""Topic maps: which topics and fields of other people's bags stand for ours."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from vpptwin.errors import InputError
from vpptwin.logs.channels import AXES, CHANNELS, JOINT_TOPICS, Channel, Column, Source
from vpptwin.logs.messages import shorten_type
from vpptwin.plain import read_yaml

LOG_TIME = "log_time"
NANOSECONDS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_EXAMPLE = "/imu/data: {topic: /mavros/imu, fields: {rate: {path: angular_velocity.y, scale: -1.0}}}"


@dataclass(frozen=True)
class Stamp:
    """Where a message's time lies: a field of type Time, a number in `unit`, or the log time."""

    path: str = "header.stamp"
    unit: str | None = None


def _text_as(key: str) -> BeforeValidator:
    """A text alone stands for an entry with this key only."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value)


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _FieldEntry(_Entry):
    path: str | list[str]
    scale: float | list[float] = 1.0
    offset: float = 0.0
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None


class _StampEntry(_Entry):
    path: str
    unit: Literal["s", "ms", "us", "ns"] | None = None


class _TopicEntry(_Entry):
    topic: str
    fields: dict[str, Annotated[_FieldEntry, _text_as("path")]] = Field(default_factory=dict)
    stamp: Annotated[_StampEntry, _text_as("path")] = _StampEntry(path="header.stamp")


_Document = TypeAdapter(dict[str, Annotated[_TopicEntry, _text_as("topic")]])


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

    channel: Channel
    topic: str
    sources: dict[str, Source]
    stamp: Stamp
    origin: str = ""

    def choose_columns(self, message_type: str) -> tuple[Column, ...]:
        """Columns that can be read from messages of a type.

        Raises:
            InputError: if the type is another than SPEC's and the topic map doesn't say where the columns lie.
        """
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


@dataclass(frozen=True)
class TopicMap:
    """routes: canonical topic -> route, for all of SPEC 3. joints: JointState topic in the log -> canonical name."""

    routes: dict[str, Route]
    joints: dict[str, str]


def load_topic_map(path: str | os.PathLike[str] | None) -> TopicMap:
    """Read a topic map; topics that it leaves out keep their names.

    Args:
        path: YAML file, or None for the names of SPEC 3.

    Raises:
        InputError: naming the key that is wrong.
    """
    routes = {topic: Route(channel, topic, {}, Stamp()) for topic, channel in CHANNELS.items()}
    joints: dict[str, str] = {}
    for canonical, entry in _read_document(Path(path)).items() if path is not None else ():
        where = f"{path}: {canonical}"
        if canonical in JOINT_TOPICS:
            if entry.fields:
                expected = "only a topic, as JointState names its joints itself"
                raise InputError(f"{where}.fields", expected, "remove the fields")
            joints[entry.topic] = canonical
        elif canonical in CHANNELS:
            channel = CHANNELS[canonical]
            given = entry.fields.items()
            sources = {name: _build_source(f"{where}.fields.{name}", channel, name, item) for name, item in given}
            stamp = Stamp(entry.stamp.path, entry.stamp.unit)
            routes[canonical] = Route(channel, entry.topic, sources, stamp, str(path))
        else:
            raise InputError(f"{where}", f"one of {', '.join((*CHANNELS, *JOINT_TOPICS))} as key", "correct the key")
    named = {route.topic for route in routes.values() if route.origin}
    routes = {topic: route for topic, route in routes.items() if route.origin or route.topic not in named}
    return TopicMap(routes, joints)


def _read_document(path: Path) -> dict[str, _TopicEntry]:
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


def _build_source(where: str, channel: Channel, name: str, entry: _FieldEntry) -> Source:
    columns = {column.name: column for column in channel.columns}
    if name not in columns:
        raise InputError(f"{where}", f"one of the columns {', '.join(columns)}", "correct the key")
    column = columns[name]
    paths = (entry.path,) if isinstance(entry.path, str) else tuple(entry.path)
    scale = (entry.scale,) if isinstance(entry.scale, float) else tuple(entry.scale)
    if len(paths) not in (1, column.width):
        raise InputError(f"{where}.path: {len(paths)} fields", f"1 or {column.width}", "name one field per component")
    if len(scale) not in (1, column.width):
        expected, action = f"1 or {column.width}", "give one factor per component"
        raise InputError(f"{where}.scale: {len(scale)} factors", expected, action)
    axis = entry.axis
    if axis is None and column.source.axis and paths[0].rsplit(".", 1)[-1] in ("orientation", "rotation"):
        axis = "-y"
    if axis is not None and column.source.axis is None:
        action = f"remove it; axes {', '.join(AXES)} are for theta"
        raise InputError(f"{where}.axis", f"no axis, as {name} is no angle", action)
    return Source(paths, scale, entry.offset, axis)
