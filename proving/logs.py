"""Logs in memory and as files: MCAP with ROS 2 messages. Nothing of vpptwin is imported."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from proving.messages import DEFINITIONS, encode, encode_joints

START_NS = 1_700_000_000 * 10**9
"""Stamp of time zero [ns since 1970]."""
PARTS = {"position": ("x", "y", "z"), "attitude": ("qw", "qx", "qy", "qz"), "rate": ("wx", "wy", "wz")}
"""Vectors of a log → the columns that they are in messages."""


@dataclass(frozen=True)
class Stream:
    """Samples: times (n,) [s], and column → (n,) or (n, k), SI."""

    time: np.ndarray
    values: dict[str, np.ndarray]

    def __getitem__(self, column: str) -> np.ndarray:
        """Samples of one column."""
        return self.values[column]

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.time)


@dataclass(frozen=True)
class Log:
    """One recording. What reads it may take it for a log that vpptwin has read: attributes of a name mean the same.

    Attributes:
        path: what its file is called.
        start_ns: stamp of time zero [ns].
        streams: none; there for vpptwin.
        joints: topic → joint or actuator → position, velocity, effort, as far as recorded.
        spatial: topic → position (n, 3), attitude w, x, y, z (n, 4), rate (n, 3), as far as recorded.
    """

    path: Path
    start_ns: int
    streams: dict[str, Stream]
    joints: dict[str, dict[str, Stream]]
    spatial: Mapping[str, Stream] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)
    clocks: Mapping[str, object] = field(default_factory=dict)
    recorded_ns: int | None = None
    dropped: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return str(self.path)

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        joints = (stream for names in self.joints.values() for stream in names.values())
        return max((float(s.time[-1]) for s in (*joints, *self.spatial.values()) if len(s)), default=0.0)

    def require(self, *topics: str) -> None:
        """Check that it holds these topics."""
        if missing := set(topics) - {*self.joints}:
            raise KeyError(f"{self.path} has no {', '.join(sorted(missing))}, only {', '.join(self.joints)}")


@dataclass(frozen=True)
class Channel:
    """Messages of one topic: their type, stamps and times of recording (n,) [ns], encoded."""

    topic: str
    kind: str
    stamps: np.ndarray
    logged: np.ndarray
    messages: Sequence[bytes]


def write_channels(path: Path, channels: Sequence[Channel], library: str = "proving") -> Path:
    """Write MCAP: `ros2` profile, zstd, definitions embedded, messages in the order they were recorded."""
    unfinished = path.with_name(path.name + ".part")
    with unfinished.open("wb") as stream:
        writer = Writer(stream, chunk_size=4 * 1024 * 1024, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library=library)
        schemas: dict[str, int] = {}
        messages: list[tuple[int, int, bytes]] = []
        for channel in channels:
            kind = channel.kind
            if kind not in schemas:
                schemas[kind] = writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
            number = writer.register_channel(channel.topic, "cdr", schemas[kind])
            messages += zip(channel.logged.tolist(), [number] * len(channel.messages), channel.messages)
        messages.sort(key=lambda message: message[:2])
        counts: dict[int, int] = {}
        for at, number, data in messages:
            counts[number] = counts.get(number, 0) + 1
            writer.add_message(number, at, data, at, counts[number])
        writer.finish()
    os.replace(unfinished, path)
    return path


def write_log(log: Log, path: Path) -> Path:
    """Write a log as MCAP: JointState, PoseStamped, Imu."""
    channels = []
    for topic, names in log.joints.items():
        first = next(iter(names.values()))
        stamps = START_NS + np.rint(first.time * 1e9).astype(np.int64)
        encoded = encode_joints(stamps, {name: stream.values for name, stream in names.items()})
        channels.append(Channel(topic, "sensor_msgs/msg/JointState", stamps, stamps, encoded))
    for topic, stream in log.spatial.items():
        kind = "sensor_msgs/msg/Imu" if "rate" in stream.values else "geometry_msgs/msg/PoseStamped"
        stamps = START_NS + np.rint(stream.time * 1e9).astype(np.int64)
        columns = {part: v[:, i] for c, v in stream.values.items() for i, part in enumerate(PARTS[c])}
        channels.append(Channel(topic, kind, stamps, stamps, encode(kind, "world", stamps, columns)))
    return write_channels(path, channels)
