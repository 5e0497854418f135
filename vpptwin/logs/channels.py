"""The channel table, shared by reader and writer: topics of docs/logs.md, their types, how messages map to columns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from vpptwin.logs.messages import shorten_type
from vpptwin.system.fields import BODIES, SITES, TURNS

# Axis names of a rotation -> (quaternion component, sign); theta of the planar drone turns about -y.
AXES = {f"{sign}{name}": (name, -1.0 if sign else 1.0) for name in "xyz" for sign in ("", "-")}


@dataclass(frozen=True)
class Source:
    """Where a column lies in a message: column = scale * polynomial(field) + offset."""

    paths: tuple[str, ...]  # one field, or one field per component
    scale: tuple[float, ...] = (1.0,)  # one factor, or one per component
    offset: float = 0.0  # added after scaling, in the unit of the column
    axis: str | None = None  # for a quaternion, the axis whose rotation angle is read, one of AXES; otherwise None
    polynomial: tuple[float, ...] = ()  # coefficients, that of the constant first; none for the field itself
    # field of a supply and its nominal value: before anything else the field is multiplied by their ratio
    voltage: tuple[str, float] | None = None

    @property
    def roots(self) -> tuple[str, ...]:
        """Fields that it takes, of a rotation the whole."""
        return self.paths if self.voltage is None else (*self.paths, self.voltage[0])


@dataclass(frozen=True)
class Column:
    """One column of a stream."""

    name: str  # column name
    unit: str  # SI unit
    source: Source  # where messages of the canonical type hold it
    width: int = 1  # number of components; 1 for a plain column
    optional: bool = False  # may be absent from other people's messages, or NaN throughout
    limit: float = math.inf  # magnitude that no sane value exceeds, in `unit`
    mistake: str = ""  # what values beyond the limit look like


@dataclass(frozen=True)
class MessageChannel:
    """One topic."""

    topic: str  # canonical name
    message_type: str  # ROS 2 type
    columns: tuple[Column, ...]  # what is read and written
    steady: bool = True  # messages come at a constant rate, so that gaps are worth a warning
    # field -> value written besides the columns; all others are written as zero
    constants: Mapping[str, float] = field(default_factory=dict)
    frame_id: str = "world"  # written to the header


def _plain(
    name: str, unit: str, path: str = "", *, limit: float = math.inf, mistake: str = "", width: int = 1,
    optional: bool = False, scale: float = 1.0,
) -> Column:  # fmt: skip
    return Column(name, unit, Source((path or name,), (scale,)), width, optional, limit, mistake)


def _pose(topic: str, steady: bool) -> MessageChannel:
    columns = (
        _plain("x", "m", "pose.position.x", limit=50.0, mistake="millimetres, centimetres or inches"),
        _plain("z", "m", "pose.position.z", limit=50.0, mistake="millimetres, centimetres or inches"),
        Column("theta", "rad", Source(("pose.orientation",), axis="-y")),
    )
    return MessageChannel(topic, "geometry_msgs/msg/PoseStamped", columns, steady)


_UNMEASURED = ("temperature", "current", "charge", "capacity", "design_capacity", "percentage")

CHANNELS: dict[str, MessageChannel] = {
    channel.topic: channel
    for channel in (
        _pose("/mocap/pose", steady=True),
        MessageChannel(
            "/imu/data",
            "sensor_msgs/msg/Imu",
            (
                _plain("rate", "rad/s", "angular_velocity.y", scale=-1.0, limit=200.0, mistake="degrees per second"),
                _plain("accel_x", "m/s^2", "linear_acceleration.x", optional=True),
                _plain("accel_z", "m/s^2", "linear_acceleration.z", optional=True),
            ),
            constants={"orientation.w": 1.0, "orientation_covariance[0]": -1.0},  # -1: the IMU estimates no orientation
            frame_id="body",
        ),
        MessageChannel(
            "/cmd/rate_thrust",
            "vpptwin_msgs/msg/RateThrust",
            (_plain("thrust", "N"), _plain("rate", "rad/s", limit=200.0, mistake="degrees per second")),
            frame_id="body",
        ),
        MessageChannel(
            "/rotor/command",
            "vpptwin_msgs/msg/RotorCommand",
            (
                _plain("blade_pitch", "rad", limit=1.6, mistake="degrees", width=2),
                _plain("throttle", "1", limit=2.0, mistake="percent", width=2),
            ),
            frame_id="body",
        ),
        MessageChannel(
            "/rotor/state",
            "vpptwin_msgs/msg/RotorState",
            (
                _plain("speed", "rad/s", limit=2000.0, mistake="rpm", width=2),
                _plain("current", "A", optional=True, limit=1000.0, mistake="milliamperes", width=2),
            ),
            frame_id="body",
        ),
        _pose("/setpoint/pose", steady=False),
        MessageChannel(
            "/battery",
            "sensor_msgs/msg/BatteryState",
            (_plain("voltage", "V", optional=True, limit=1000.0, mistake="millivolts"),),
            steady=False,
            constants=dict.fromkeys(_UNMEASURED, math.nan) | {"present": 1},
            frame_id="",
        ),
        MessageChannel(
            "/thrust_stand/wrench",
            "geometry_msgs/msg/WrenchStamped",
            (_plain("force_z", "N", "wrench.force.z"), _plain("torque_z", "N m", "wrench.torque.z", optional=True)),
            steady=False,
            frame_id="thrust_stand",
        ),
    )
}

SPATIAL: dict[str, dict[str, str]] = {
    "geometry_msgs/msg/PoseStamped": {"position": "pose.position", "attitude": "pose.orientation"},
    "geometry_msgs/msg/TransformStamped": {"position": "transform.translation", "attitude": "transform.rotation"},
    "nav_msgs/msg/Odometry": {
        "position": "pose.pose.position",
        "attitude": "pose.pose.orientation",
        "velocity": "twist.twist.linear",
        "rate": "twist.twist.angular",
    },
    "sensor_msgs/msg/Imu": {"rate": "angular_velocity", "acceleration": "linear_acceleration"},
}
"""Message type -> column -> the vector, or quaternion, that it is: of a body's pose (velocities in its own axes, as
ROS has them), or in the axes of an IMU [m, m/s, rad/s, m/s²]."""

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TOPICS = ("/joint_states", "/actuator_command")
JOINT_COLUMNS = {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "control input, N or N m"}

SPATIAL_COLUMNS = {BODIES: {"position": 3, "attitude": 4}, SITES: {"rate": 3}, TURNS: {"attitude": 4}}
"""Bodies, IMUs and ball joints out of fields: root of the topics that they are read as -> column -> numbers."""

OPTIONAL_COLUMNS = {BODIES: {"rate": 3}, TURNS: {"rate": 3}}
"""Likewise, what may be there besides."""

SIGNAL_COLUMNS = (*JOINT_COLUMNS, "attitude", "rate")
EULER = ("roll", "pitch", "yaw")
"""What may stand for the four numbers of an attitude [rad]: it yaws about z, then pitches about y, rolls about x."""


def is_spatial(message_type: str) -> bool:
    """Whether messages of a type are poses, odometry, or those of an IMU."""
    return shorten_type(message_type) in map(shorten_type, SPATIAL)


def is_joint_state(message_type: str) -> bool:
    """Whether a message type is JointState, with or without its `msg` part."""
    return shorten_type(message_type) == shorten_type(JOINT_STATE)
