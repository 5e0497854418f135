"""ROS 2 definitions of the messages in docs/logs.md and their CDR encoding, a whole topic at a time.

Written apart from vpptwin.logs: a reader that only understands its own writer would not be noticed otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

_HEADER = """\
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
_TIME = """\
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_POINT = "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
_VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_POSE = "MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n"
_BAR = "=" * 80 + "\n"


def _define(body: str, *parts: str) -> str:
    return _BAR.join((body, *parts, _HEADER, _TIME))


DEFINITIONS: dict[str, str] = {
    "geometry_msgs/msg/PoseStamped": _define(
        "std_msgs/Header header\ngeometry_msgs/Pose pose\n", _POSE, _POINT, _QUATERNION
    ),
    "sensor_msgs/msg/Imu": _define(
        "std_msgs/Header header\n"
        "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
        _QUATERNION,
        _VECTOR,
    ),
    "sensor_msgs/msg/JointState": _define(
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    ),
    "sensor_msgs/msg/BatteryState": _define(
        "uint8 POWER_SUPPLY_STATUS_DISCHARGING=2\nuint8 POWER_SUPPLY_TECHNOLOGY_LIPO=3\n"
        "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\n"
        "float32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\n"
        "uint8 power_supply_health\nuint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\n"
        "float32[] cell_temperature\nstring location\nstring serial_number\n"
    ),
    "vpptwin_msgs/msg/RateThrust": _define("std_msgs/Header header\nfloat64 thrust\nfloat64 rate\n"),
    "vpptwin_msgs/msg/RotorCommand": _define("std_msgs/Header header\nfloat64[2] blade_pitch\nfloat64[2] throttle\n"),
    "vpptwin_msgs/msg/RotorState": _define("std_msgs/Header header\nfloat64[2] speed\nfloat64[2] current\n"),
}


@dataclass
class _Layout:
    """CDR bytes of one message, and where its varying fields lie. Little endian, aligned after the 4-byte preamble."""

    data: bytearray = field(default_factory=lambda: bytearray(b"\x00\x01\x00\x00"))
    slots: dict[str, tuple[int, str]] = field(default_factory=dict)

    def add(self, name: str | None, kind: str, value: float = 0) -> None:
        """Append a number; `name` makes it a field to fill."""
        size = np.dtype(kind).itemsize
        self.data += bytes(-(len(self.data) - 4) % size)
        if name:
            self.slots[name] = (len(self.data), kind)
        self.data += np.array(value, dtype=kind).tobytes()

    def add_text(self, text: str) -> None:
        """Append a string."""
        encoded = text.encode() + b"\x00"
        self.add(None, "<u4", len(encoded))
        self.data += encoded

    def add_header(self, frame: str) -> None:
        """Append a std_msgs/Header."""
        self.add("sec", "<i4")
        self.add("nanosec", "<u4")
        self.add_text(frame)

    def add_doubles(self, names: tuple[str | None, ...], value: float = 0.0) -> None:
        """Append float64 fields."""
        for name in names:
            self.add(name, "<f8", value)


def _lay_out(kind: str, frame: str, imu_std: tuple[float, float]) -> _Layout:
    layout = _Layout()
    layout.add_header(frame)
    if kind == "geometry_msgs/msg/PoseStamped":
        layout.add_doubles(("x", "y", "z"))
        layout.add_doubles(("qx", "qy", "qz", "qw"))
    elif kind == "sensor_msgs/msg/Imu":
        layout.add_doubles((None, None, None))
        layout.add_doubles((None,), 1.0)
        layout.add_doubles((None,), -1.0)  # no orientation in these messages
        layout.add_doubles((None,) * 8)
        layout.add_doubles(("wx", "wy", "wz"))
        _add_diagonal(layout, imu_std[0] ** 2)
        layout.add_doubles(("ax", "ay", "az"))
        _add_diagonal(layout, imu_std[1] ** 2)
    elif kind == "sensor_msgs/msg/BatteryState":
        layout.add("voltage", "<f4")
        for _ in range(6):
            layout.add(None, "<f4", np.nan)
        for value in (2, 0, 3, 1):  # discharging, health unknown, lithium polymer, present
            layout.add(None, "<u1", value)
        layout.add(None, "<u4")
        layout.add(None, "<u4")
        layout.add_text("")
        layout.add_text("")
    else:
        columns = {
            "vpptwin_msgs/msg/RateThrust": ("thrust", "rate"),
            "vpptwin_msgs/msg/RotorCommand": ("blade_pitch_1", "blade_pitch_2", "throttle_1", "throttle_2"),
            "vpptwin_msgs/msg/RotorState": ("speed_1", "speed_2", "current_1", "current_2"),
        }
        layout.add_doubles(columns[kind])
    return layout


def _add_diagonal(layout: _Layout, variance: float) -> None:
    for row in range(3):
        for column in range(3):
            layout.add(None, "<f8", variance if row == column else 0.0)


def encode(
    kind: str,
    frame: str,
    stamps: np.ndarray,
    columns: Mapping[str, np.ndarray],
    imu_std: tuple[float, float] = (0.0, 0.0),
) -> list[bytes]:
    """Encode every message of a topic.

    Args:
        kind: Message type.
        frame: frame_id.
        stamps: ns since 1970. (n,).
        columns: One array per varying field, (n,); of poses and IMUs what is missing is zero.
        imu_std: Standard deviation of gyro rad/s and accelerometer m/s^2, for the covariances.
    """
    layout = _lay_out(kind, frame, imu_std)
    if kind.endswith(("PoseStamped", "Imu")):
        columns = {name: np.zeros(len(stamps)) for name in [*layout.slots][2:]} | columns
    return _fill(kind, layout, stamps, columns)


def encode_joints(stamps: np.ndarray, joints: Mapping[str, Mapping[str, np.ndarray]]) -> list[bytes]:
    """Encode JointState messages.

    Args:
        stamps: ns since 1970, (n,).
        joints: joint or actuator → position, velocity, effort as far as there are any, (n,) each; all have the same.
    """
    layout = _Layout()
    layout.add_header("")
    layout.add(None, "<u4", len(joints))
    for name in joints:
        layout.add_text(name)
    present = next(iter(joints.values()))
    for column in ("position", "velocity", "effort"):
        layout.add(None, "<u4", len(joints) if column in present else 0)
        if column in present:
            layout.add_doubles(tuple(f"{name}.{column}" for name in joints))
    columns = {f"{name}.{column}": values for name, given in joints.items() for column, values in given.items()}
    return _fill("sensor_msgs/msg/JointState", layout, stamps, columns)


def _fill(kind: str, layout: _Layout, stamps: np.ndarray, columns: Mapping[str, np.ndarray]) -> list[bytes]:
    columns = {"sec": stamps // 10**9, "nanosec": stamps % 10**9, **columns}
    if missing := layout.slots.keys() ^ columns.keys():
        raise ValueError(f"{kind}: fields and columns differ by {sorted(missing)}")
    rows = np.tile(np.frombuffer(bytes(layout.data), dtype=np.uint8), (len(stamps), 1))
    for name, (offset, dtype) in layout.slots.items():
        values = np.ascontiguousarray(columns[name]).astype(dtype)
        rows[:, offset : offset + values.itemsize] = values.view(np.uint8).reshape(len(stamps), -1)
    return [row.tobytes() for row in rows]
