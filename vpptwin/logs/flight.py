"""A log as arrays, whatever its format and the order in which it was recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vpptwin.logs.spelling import name_log
from vpptwin.logs.streams.clocks import Clock
from vpptwin.system.errors import InputError


@dataclass(frozen=True)
class Stream:
    """The samples of one topic, or of one joint.

    Attributes:
        time: (n,) s since Flight.start_ns, by header stamp, strictly increasing.
        values: column name -> (n,) or (n, k), SI units.
    """

    time: np.ndarray
    values: dict[str, np.ndarray]

    def __getitem__(self, column: str) -> np.ndarray:
        """Samples of one column, (n,) or (n, k)."""
        if column not in self.values:
            raise KeyError(f"no column {column}, only {', '.join(self.values)}")
        return self.values[column]

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.time)


@dataclass(frozen=True)
class Flight:
    """One recording.

    Attributes:
        path: the log as it was given (docs/logs.md), the files of a list joined by plus.
        start_ns: first header stamp of the log [ns since the epoch of its clock].
        streams: canonical topic -> stream, for the topics of the channel table.
        joints: JointState topic -> joint or actuator name -> stream of position, velocity, effort as far as recorded.
        spatial: topic of poses, odometry or an IMU -> stream of vectors (n, 3) and attitudes (n, 4), as
            `vpptwin.logs.channels.SPATIAL` names them.
        warnings: what was mended or looks odd, one line each.
        sources: canonical topic -> the topic it was recorded as, where a topic map renamed it.
        clocks: topic -> the clock that stamped it, where log times tell of it.
        dropped: columns of tables that nothing reads.
        recorded_ns: log time of the first message [ns since the epoch of the recorder's clock]; None if it is unknown.
    """

    path: Path
    start_ns: int
    streams: dict[str, Stream]
    joints: dict[str, dict[str, Stream]]
    warnings: tuple[str, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)
    clocks: Mapping[str, Clock] = field(default_factory=dict)
    spatial: Mapping[str, Stream] = field(default_factory=dict)
    recorded_ns: int | None = None
    dropped: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return name_log(self.path)

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        joints = (stream for names in self.joints.values() for stream in names.values())
        every = [*self.streams.values(), *joints, *self.spatial.values()]
        return max((float(stream.time[-1]) for stream in every if len(stream)), default=0.0)

    def require(self, *topics: str) -> None:
        """Check that the log holds these topics: of the channel table, or topics of JointState messages.

        Raises:
            InputError: naming the missing topics and those that the log holds.
        """
        present = {**self.streams, **self.joints}
        missing = [topic for topic in topics if topic not in present]
        if missing:
            names = [f"{t} (mapped to {self.sources[t]})" if t in self.sources else t for t in missing]
            raise InputError(
                f"{self.path} has no messages on {', '.join(names)}, only on {', '.join(sorted(present))}",
                f"a log with {', '.join(topics)}",
                "record the missing topic, or name it in a topic map if it is recorded under another name",
            )
