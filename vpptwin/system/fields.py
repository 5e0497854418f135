"""Where a value lies in somebody's log, as topic maps and twins say it: topic, field, unit, scale, clock."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator

UNITS: dict[str, tuple[str, float]] = {
    "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "in": ("m", 0.0254), "ft": ("m", 0.3048),
    "rad": ("rad", 1.0), "deg": ("rad", math.pi / 180.0), "rev": ("rad", 2.0 * math.pi),
    "m/s": ("m/s", 1.0), "mm/s": ("m/s", 1e-3), "cm/s": ("m/s", 1e-2), "km/h": ("m/s", 1.0 / 3.6),
    "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", math.pi / 180.0), "mrad/s": ("rad/s", 1e-3),
    "rpm": ("rad/s", math.pi / 30.0), "rev/s": ("rad/s", 2.0 * math.pi),
    "m/s^2": ("m/s^2", 1.0), "g": ("m/s^2", 9.80665), "mg": ("m/s^2", 9.80665e-3),
    "N": ("N", 1.0), "mN": ("N", 1e-3), "kN": ("N", 1e3), "kgf": ("N", 9.80665), "gf": ("N", 9.80665e-3),
    "N m": ("N m", 1.0), "mN m": ("N m", 1e-3), "kgf cm": ("N m", 9.80665e-2),
    "V": ("V", 1.0), "mV": ("V", 1e-3), "A": ("A", 1.0), "mA": ("A", 1e-3),
    "%": ("1", 1e-2), "1": ("1", 1.0), "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9),
}  # fmt: skip
"""Unit → that of the SI which it measures in, and how many of those it is."""

UNSAID = "unsaid"
"""Unit of a column of a LeRobot data set, which may have radians, degrees or -100 to 100 of the calibrated travel."""

BODIES, SITES, TURNS = "/bodies/", "/sites/", "/turns/"
"""Roots of the topics that bodies, IMUs and ball joints out of fields are read as, one for each name."""
FRAMES = ("body", "world", "euler")
"""What rates are about: the body's axes, the world's, or those of roll, pitch and yaw, whose slopes they are."""
TIME_UNITS = ("s", "ms", "us", "ns")
NANOSECONDS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


def text_as(key: str) -> BeforeValidator:
    """A text alone stands for an entry with this key only."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value)


class Entry(BaseModel):
    """A mapping of known keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Voltage(Entry):
    """A supply that a command works against: the command counts `path` / `nominal` times."""

    path: str
    nominal: float = Field(gt=0.0)


class FieldEntry(Entry):
    """A column: polynomial of the field (of as much of it as the supply gives), times scale and unit, plus offset."""

    path: str | list[str]
    scale: float | list[float] = 1.0
    offset: float = 0.0
    unit: str | None = None
    polynomial: list[float] = []
    voltage: Voltage | None = None
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    frame: Literal["body", "world", "euler"] = "body"

    @field_validator("unit")
    @classmethod
    def check_unit(cls, unit: str | None) -> str | None:
        """Refuse a unit that nobody knows the size of."""
        if unit is not None and unit not in UNITS:
            raise ValueError(f"one of {', '.join(UNITS)}")
        return unit

    @property
    def factors(self) -> tuple[float, ...]:
        """Scale with the unit's size, one factor or one per component."""
        size = UNITS[self.unit][1] if self.unit is not None else 1.0
        return tuple(size * scale for scale in (self.scale if isinstance(self.scale, list) else [self.scale]))


class Stamp(Entry):
    """Where a message's time lies: a field of type Time, a number in `unit`, or the log time.

    Of a clock that is rounded, `rate` tells how many messages come a second [Hz]; they are spaced so from the first on.
    """

    path: str = "header.stamp"
    unit: Literal["s", "ms", "us", "ns"] | None = None
    rate: float | None = Field(default=None, gt=0.0)


FieldText = Annotated[FieldEntry, text_as("path")]
StampText = Annotated[Stamp, text_as("path")]


FieldList = Annotated[FieldEntry, BeforeValidator(lambda value: {"path": value} if isinstance(value, list) else value)]
"""An entry, or the fields of a vector alone."""


class SignalEntry(Entry):
    """A joint or an actuator, one field each, or a free body or an IMU out of fields of any topic.

    Of a body: position x, y, z and attitude w, x, y, z in the world; of a ball joint: attitude from its parent; of an
    IMU: rate x, y, z in its axes, or in what `frame` says, as a body's own rate may be.
    """

    topic: str
    position: Annotated[FieldList, text_as("path")] | None = None
    velocity: FieldText | None = None
    effort: FieldText | None = None
    attitude: FieldList | None = None
    rate: FieldList | None = None
    stamp: StampText = Stamp()


class TopicEntry(Entry):
    """What a topic map says of one topic; `names` of the joints of a JointState topic that the log has in pieces."""

    topic: str = ""
    fields: dict[str, FieldText] = Field(default_factory=dict)
    stamp: StampText = Stamp()
    names: dict[str, SignalEntry] = Field(default_factory=dict)


def dump_entry(entry: BaseModel) -> dict[str, Any]:
    """An entry as YAML's plain data, without what it says by default."""
    return entry.model_dump(exclude_defaults=True)
