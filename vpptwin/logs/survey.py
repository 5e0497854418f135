"""What is in a log: every signal with its type, rate and range, and what looks odd about it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mcap.well_known import MessageEncoding

from vpptwin.errors import InputError, escape_text
from vpptwin.fields import Stamp
from vpptwin.logs.channels import is_joint_state
from vpptwin.logs.container import RawChannel
from vpptwin.logs.layout import LayoutError, locate_fields, parse_definition
from vpptwin.logs.recording import PathLike, Recording, open_recording
from vpptwin.logs.samples import read_fields, read_joints
from vpptwin.logs.tables import Wish

_WIDEST = 64  # elements of a list that are signals of their own
_DULL = re.compile(r"header\.|(^|\.)stamp\.|covariance|(^|\.)sequence$")
_GAP = 5.0  # median periods
_JUMP = 20.0  # times the step that 99 of 100 stay below


@dataclass(frozen=True, eq=False)
class Signal:
    """One number over time.

    Attributes:
        topic, field: where it lies.
        label: as the log calls the field.
        name: of the joint of a JointState topic, else "".
        kind: type of its numbers.
        unit: as the log says, "" where it doesn't.
        time: (n,) s since the log's first sample, increasing.
        values: (n,), NaN where there was none.
    """

    topic: str
    field: str
    label: str
    name: str
    kind: str
    unit: str
    time: np.ndarray
    values: np.ndarray

    @property
    def title(self) -> str:
        """Topic and name as they are shown."""
        return f"{self.topic} {self.name} {self.label}" if self.name else f"{self.topic} {self.label}"

    @cached_property
    def finite(self) -> np.ndarray:
        """Values without NaN and infinities, (m,)."""
        return self.values[np.isfinite(self.values)]

    @property
    def rate(self) -> float:
        """Samples a second while it is sampled; NaN for fewer than two."""
        return 1.0 / float(np.median(np.diff(self.time))) if len(self.time) > 1 else float("nan")

    @cached_property
    def is_constant(self) -> bool:
        """Whether it never changes."""
        return not len(self.finite) or bool((self.finite == self.finite[0]).all())

    def list_oddities(self) -> Iterator[str]:
        """What looks odd: gaps, jumps, what is missing."""
        if len(self.finite) < len(self.values):
            yield f"{len(self.values) - len(self.finite)} missing"
        if self.is_constant:
            yield "constant"
            return
        steps = np.diff(self.time)
        gaps = int(np.count_nonzero(steps > _GAP * np.median(steps)))
        if gaps:
            yield f"{gaps} gaps, longest {steps.max():.3g} s"
        moves = np.abs(np.diff(self.finite))
        moves = moves[moves > 0.0]
        jumps = int(np.count_nonzero(moves > _JUMP * np.quantile(moves, 0.99))) if len(moves) > 100 else 0
        if jumps:
            yield f"{jumps} jumps, up to {moves.max():.3g}"


def survey(log: PathLike) -> tuple[Recording, list[Signal]]:
    """Everything that a log holds as numbers.

    Raises:
        InputError: if it cannot be read, or holds no numbers.
    """
    recording = open_recording(log, Wish(lambda channel: channel.encoding == MessageEncoding.CDR))
    channels = {channel.topic: channel for file in recording.files for channel in file.channels if channel.blocks}
    found: list[tuple[np.ndarray, Signal]] = []
    for topic, channel in channels.items():
        try:
            joints = is_joint_state(channel.message_type)
            found += list(list_joints(recording, topic) if joints else list_columns(recording, channel))
        except (InputError, LayoutError):  # messages of many shapes, of which no twin names a field
            continue
    if not found:
        raise InputError(f"{recording.path} holds no numbers over time", "a log with signals", "check what recorded it")
    start = min(int(stamp.min()) for stamp, _ in found)
    return recording, [place(signal, stamp, start) for stamp, signal in found]


def place(signal: Signal, stamp: np.ndarray, start: int) -> Signal:
    """A signal in order of time, stamps (n,) ns once each."""
    _, rows = np.unique(stamp, return_index=True)
    time = (stamp[rows] - start) / 1e9
    parts = signal.topic, signal.field, signal.label, signal.name, signal.kind, signal.unit
    return Signal(*parts, time, signal.values[rows].astype(float))


def list_joints(recording: Recording, topic: str) -> Iterator[tuple[np.ndarray, Signal]]:
    """Signals of a JointState topic, with their stamps [ns]."""
    for name, samples in read_joints(recording, topic, topic)[0].items():
        for column, values in samples.fields.items():
            yield samples.stamp, Signal(topic, column, column, escape_text(name), "float64", "", samples.stamp, values)


def list_columns(recording: Recording, channel: RawChannel) -> Iterator[tuple[np.ndarray, Signal]]:
    """Signals of any other topic, with their stamps [ns]."""
    definitions = parse_definition(channel.message_type, channel.definition)
    layout = locate_fields(definitions, channel.message_type, channel.blocks[0].payload[0].tobytes())
    comments = dict(re.findall(r"^\S+ (\w+)  # (.*)$", channel.definition, flags=re.MULTILINE))
    paths = {}
    for path, leaf in layout.leaves.items():
        if not _DULL.search(path) and (leaf.count is None or 0 < leaf.count <= _WIDEST):
            paths[path] = leaf
    stamped = Stamp() if "header.stamp.sec" in layout.leaves else Stamp(path="log_time")
    samples = read_fields(recording, channel.topic, stamped, list(paths), channel.topic)
    for path, leaf in paths.items():
        said = re.fullmatch(r"(.*?)(?: \[([^\[\]]*)\])?", comments.get(path, path))
        label, unit = (said.group(1), said.group(2) or "") if said else (path, "")
        data = samples.fields[path]
        for index in range(leaf.count or 1):
            suffix = "" if leaf.count is None else f"[{index}]"
            values = data if leaf.count is None else data[:, index]
            yield (
                samples.stamp,
                Signal(
                    channel.topic,
                    label + suffix,
                    label + suffix,
                    "",
                    np.dtype(leaf.code).name,
                    unit,
                    samples.stamp,
                    values,
                ),
            )
