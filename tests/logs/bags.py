"""Bags for the tests, written by mcap-ros2-support's own writer: with nothing of vpptwin but its definitions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as RawWriter
from mcap_ros2.writer import Writer

from vpptwin.logs import read_flight
from vpptwin.logs.messages import compose_definition
from vpptwin.system.errors import InputError

EPOCH = 1_700_000_000 * 10**9  # ns
POSE, IMU, ROTOR_STATE, ROTOR_COMMAND, RATE_THRUST, JOINTS = (
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/Imu",
    "vpptwin_msgs/msg/RotorState",
    "vpptwin_msgs/msg/RotorCommand",
    "vpptwin_msgs/msg/RateThrust",
    "sensor_msgs/msg/JointState",
)
Message = dict[str, object]


def stamp_header(stamp_ns: int, frame: str = "world") -> Message:
    """Build a std_msgs/Header."""
    return {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": frame}


def make_pose(stamp_ns: int, x: float = 0.1, z: float = 1.0, theta: float = 0.0) -> Message:
    """PoseStamped at x, z [m], turned by theta [rad] about -y (docs/logs.md)."""
    orientation = {"x": 0.0, "y": -np.sin(theta / 2), "z": 0.0, "w": np.cos(theta / 2)}
    return {
        "header": stamp_header(stamp_ns),
        "pose": {"position": {"x": x, "y": 0.0, "z": z}, "orientation": orientation},
    }


def make_imu(stamp_ns: int, rate: float = 0.0) -> Message:
    """Imu of a craft that hovers and turns with rate [rad/s]."""
    return {
        "header": stamp_header(stamp_ns, "imu"),
        "angular_velocity": {"x": 0.0, "y": -rate, "z": 0.0},
        "linear_acceleration": {"x": 0.0, "y": 0.0, "z": 9.81},
        **{f"{name}_covariance": [0.0] * 9 for name in ("orientation", "angular_velocity", "linear_acceleration")},
    }


@dataclass
class Bag:
    """Messages of one file in record order."""

    path: Path
    entries: list[tuple[str, str, str, int, Message]] = field(default_factory=list)

    def add(self, topic: str, kind: str, messages: Iterable[Message], text: str | None = None) -> Bag:
        """Append messages, logged at their stamp, or one per millisecond if they have none."""
        for index, message in enumerate(messages):
            header = message.get("header")
            logged = EPOCH + index * 10**6
            if isinstance(header, Mapping):
                logged = header["stamp"]["sec"] * 10**9 + header["stamp"]["nanosec"]
            self.entries.append((topic, kind, compose_definition(kind) if text is None else text, logged, message))
        return self

    def write(self, compression: CompressionType = CompressionType.ZSTD, chunk_size: int = 1 << 20) -> Path:
        """Write the file."""
        with self.path.open("wb") as file:
            writer = Writer(file, chunk_size=chunk_size, compression=compression)
            schemas = {}
            for topic, kind, text, logged, message in self.entries:
                if kind not in schemas:
                    schemas[kind] = writer.register_msgdef(kind, text)
                writer.write_message(topic, schemas[kind], message, log_time=logged)
            writer.finish()
        return self.path


def make_poses(count: int, period: int = 10**7, change: Callable[[int, Message], None] | None = None) -> list[Message]:
    """Poses every `period` [ns] from EPOCH on; `change` may spoil each."""
    poses = [make_pose(EPOCH + index * period, x=0.01 * index) for index in range(count)]
    for index, pose in enumerate(poses):
        if change is not None:
            change(index, pose)
    return poses


def pose_bag(path: Path, stamps_ns: Iterable[int]) -> Path:
    """Write a bag of poses with these stamps, in this order, x = 0.01 times the place in the order."""
    return Bag(path).add("/mocap/pose", POSE, [make_pose(s, x=0.01 * i) for i, s in enumerate(stamps_ns)]).write()


def write_payloads(
    path: Path, payloads: Iterable[bytes], topic: str = "/mocap/pose", kind: str = POSE, profile: str = "ros2",
    encoding: str = "cdr", schema: str = "ros2msg",
) -> Path:  # fmt: skip
    """Write an MCAP of one channel whose messages, 10 ms apart, hold these bytes."""
    with path.open("wb") as file:
        writer = RawWriter(file)
        writer.start(profile)
        number = writer.register_schema(kind, schema, compose_definition(kind).encode())
        channel = writer.register_channel(topic, encoding, number)
        for index, payload in enumerate(payloads):
            writer.add_message(channel, EPOCH + index * 10**7, payload, EPOCH + index * 10**7)
        writer.finish()
    return path


def refuse(
    path: Path | str | list[Path], *parts: str, topics: Path | None = None, read: Callable[..., object] = read_flight
) -> None:
    """Require that reading fails with one short line that holds these parts, and says what to do."""
    with pytest.raises(InputError) as caught:
        read(path, topics) if topics is not None else read(path)
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 1000
    assert caught.value.found
    assert caught.value.expected
    assert caught.value.action
    for part in parts:
        assert part in line
