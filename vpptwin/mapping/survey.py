"""What is in a log: every signal with its type, rate and range, and what looks odd about it."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from mcap.well_known import MessageEncoding

from vpptwin.logs.channels import is_joint_state
from vpptwin.logs.formats.layout import STAMP, LayoutError, describe_columns, locate_fields, parse_definition
from vpptwin.logs.formats.raw import Query, RawChannel, RawFile
from vpptwin.logs.formats.tables import NAMES, is_text
from vpptwin.logs.recording import Recording, open_recording
from vpptwin.logs.spelling import PathLike
from vpptwin.logs.streams.clocks import check_order
from vpptwin.logs.streams.samples import read_fields, read_joints
from vpptwin.logs.topic_map import LOG_TIME
from vpptwin.system.errors import InputError, escape_text
from vpptwin.system.fields import Stamp

_WIDEST = 64  # elements of a list that are signals of their own
_DULL = re.compile(r"header\.|(^|\.)stamp\.|covariance|(^|\.)sequence$")
_GAP = 5.0  # median periods
_JUMP = 20.0  # times the step that 99 of 100 stay below


@dataclass(frozen=True)
class Stretch:
    """What a signal does for some time.

    Attributes:
        start, end: stamps of its first and last sample [ns].
        first, last, low, high: of its values; NaN if it has none.
        missing: samples without a value.
        period: median time between samples [s]; NaN for a single one.
        gaps, longest: how many steps of time are over `_GAP` periods; the longest of all [s].
        jumps, highest: how many steps of values are over `reach`; the highest of all.
        reach: beyond which a step is a jump.
    """

    start: int
    end: int
    first: float
    last: float
    low: float
    high: float
    missing: int
    period: float
    gaps: int
    longest: float
    jumps: int
    highest: float
    reach: float


def look(stamp: np.ndarray, values: np.ndarray) -> Stretch:
    """A stretch of samples: stamps (n,) ns, increasing; values (n,), NaN where there was none."""
    steps = np.diff(stamp) / 1e9
    period = float(np.median(steps)) if len(steps) else np.nan
    some = values[np.isfinite(values)]
    moves = np.abs(np.diff(some))
    moves = moves[moves > 0.0]
    reach = _JUMP * float(np.quantile(moves, 0.99)) if len(moves) > 100 else np.inf
    none = len(some) == 0
    return Stretch(
        int(stamp[0]), int(stamp[-1]), *((np.nan, np.nan) if none else (float(some[0]), float(some[-1]))),
        float(np.nan if none else some.min()), float(np.nan if none else some.max()), len(values) - len(some), period,
        int(np.count_nonzero(steps > _GAP * period)), float(steps.max(initial=0.0)),
        int(np.count_nonzero(moves > reach)), float(moves.max(initial=0.0)), reach,
    )  # fmt: skip


def join(stretches: Sequence[Stretch]) -> Stretch:
    """Stretches that follow one another, as one; periods and reaches are each stretch's own."""
    if len(stretches) == 1:
        return stretches[0]
    valued = [s for s in stretches if np.isfinite(s.low)] or list(stretches[:1])
    steps = [((b.start - a.end) / 1e9, a.period) for a, b in pairwise(stretches)]
    moves = [(abs(b.first - a.last), a.reach) for a, b in pairwise(valued)]
    return Stretch(
        stretches[0].start, stretches[-1].end, valued[0].first, valued[-1].last,
        min(s.low for s in valued), max(s.high for s in valued), sum(s.missing for s in stretches),
        float(np.nanmedian([s.period for s in stretches])),
        sum(s.gaps for s in stretches) + sum(step > _GAP * period for step, period in steps),
        max(max(s.longest for s in stretches), *(step for step, _ in steps)),
        sum(s.jumps for s in valued) + sum(move > reach for move, reach in moves),
        max([s.highest for s in valued] + [move for move, _ in moves]),
        max(s.reach for s in valued),
    )  # fmt: skip


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
        stretches: all of it, where time and values hold but the first of several.
        headless: whether its messages have no time of their own, but the log's.
        alone: whether its topic is the log's only one, whose name tells what the log is, not what of it.
        called: what a column of names beside it calls it throughout (`name0` of `position0`), else "".
    """

    topic: str
    field: str
    label: str
    name: str
    kind: str
    unit: str
    time: np.ndarray
    values: np.ndarray
    stretches: tuple[Stretch, ...] = ()
    headless: bool = False
    alone: bool = False
    called: str = ""

    @property
    def title(self) -> str:
        """Topic and name as they are shown."""
        title = f"{self.topic} {self.name} {self.label}" if self.name else f"{self.topic} {self.label}"
        return f"{title} ({self.called})" if self.called else title

    @cached_property
    def finite(self) -> np.ndarray:
        """Values without NaN and infinities, (m,)."""
        return self.values[np.isfinite(self.values)]

    @cached_property
    def whole(self) -> Stretch:
        """What it does from beginning to end."""
        return join(self.stretches or [look(np.rint(self.time * 1e9).astype(np.int64), self.values)])

    @property
    def rate(self) -> float:
        """Samples a second while it is sampled; NaN for fewer than two."""
        return 1.0 / self.whole.period

    @property
    def is_constant(self) -> bool:
        """Whether it never changes."""
        return not self.whole.low < self.whole.high

    def list_oddities(self) -> Iterator[str]:
        """What looks odd: gaps, jumps, what is missing."""
        whole = self.whole
        if whole.missing:
            yield f"{whole.missing} missing"
        if self.is_constant:
            yield "constant"
            return
        if whole.gaps:
            yield f"{whole.gaps} gaps, longest {whole.longest:.3g} s"
        if whole.jumps:
            yield f"{whole.jumps} jumps, up to {whole.highest:.3g}"


def survey(log: PathLike | Sequence[PathLike]) -> tuple[Recording, list[Signal]]:
    """Everything that a log holds as numbers; of large logs stretch by stretch, the first of which is kept.

    Raises:
        InputError: if it cannot be read, or holds no numbers.
    """
    called = os.fspath(log) if isinstance(log, str | os.PathLike) else "+".join(map(str, log))
    first: dict[tuple[str, ...], Signal] = {}
    stretches: dict[tuple[str, ...], list[Stretch]] = {}
    clocks: dict[str, np.ndarray] = {}  # how often a topic's time falls, and stands
    latest: dict[tuple[str, str], np.ndarray] = {}  # joints of one topic may come in messages of their own
    refused: dict[str, InputError] = {}

    def note(recording: Recording, channel: RawChannel) -> None:
        joints = is_joint_state(channel.message_type)
        last, rising = np.zeros(0, np.int64), False
        stamp = rows = last
        try:
            signals = list(list_joints(recording, channel.topic) if joints else list_columns(recording, channel))
            signals = name_elements(signals, read_names(channel))
        except (InputError, LayoutError):  # messages of many shapes, of which no twin names a field
            return
        for signal in signals:
            if signal.time is not last:  # signals of one topic share their time
                last = signal.time
                rising = bool((last[1:] > last[:-1]).all())
                odd = np.array([np.count_nonzero(last[1:] < last[:-1]), np.count_nonzero(last[1:] == last[:-1])])
                clocks[channel.topic] = clocks.get(channel.topic, np.zeros(2, int)) + odd
                stamp, rows = (last, rows) if rising else np.unique(last, return_index=True)
                before = latest.get((channel.topic, signal.name), last[:0])
                try:  # runs that follow one another are not laid over each other
                    if last.any() and not (rising and (before < last[0]).all()):
                        check_order(np.append(before, last), called, channel.topic)
                except InputError as error:
                    refused.setdefault(channel.topic, error)
                latest[channel.topic, signal.name] = stamp[-1:]
            values = (signal.values if rising else signal.values[rows]).astype(float, copy=False)
            key = signal.topic, signal.field, signal.name
            stretches.setdefault(key, []).append(look(stamp, values))
            first.setdefault(key, replace(signal, time=stamp, values=values))

    def take(channels: Sequence[RawChannel]) -> None:
        for channel in channels:
            if channel.is_kept:
                note(
                    Recording(Path(channel.topic), (RawFile(Path(channel.topic), "ros2", [channel], (0, 0)),)), channel
                )
                channel.forget()

    recording = open_recording(log, Query(lambda channel: channel.encoding == MessageEncoding.CDR, take=take))
    for channel in {c.topic: c for file in recording.files for c in file.channels if c.is_kept}.values():
        note(recording, channel)
    for topic, error in refused.items():
        recording.files[0].notes.append(f"{error.found}, left out: {error.action}")
        first = {key: signal for key, signal in first.items() if key[0] != topic}
        if not first:
            raise error
    if not first:
        raise InputError(f"{recording.path} holds no numbers over time", "a log with signals", "check what recorded it")
    for topic, (falls, stands) in clocks.items():
        if falls or stands:
            recording.files[0].notes.append(f"{topic}: the time falls {falls} times and repeats {stands} times")
    start = min(int(signal.time[0]) for signal in first.values())
    stamps = {id(signal.time): signal.time for signal in first.values()}
    times = {key: (stamp - start) / 1e9 for key, stamp in stamps.items()}
    alone = len({signal.topic for signal in first.values()}) == 1
    return recording, [
        replace(s, time=times[id(s.time)], stretches=tuple(stretches[k]), alone=alone) for k, s in first.items()
    ]


def list_joints(recording: Recording, topic: str) -> Iterator[Signal]:
    """Signals of a JointState topic in record order, over their stamps [ns]."""
    for name, samples in read_joints(recording, topic, topic)[0].items():
        for column, values in samples.fields.items():
            yield Signal(topic, column, column, escape_text(name), "float64", "", samples.stamp, values)


def read_names(channel: RawChannel) -> dict[tuple[str, int], str]:
    """What texts `name0`, `joint_names[0]` say throughout: what comes before the word, and the number → the name."""
    texts: dict[str, set[str]] = {}
    for rows in channel.rows:
        for name, data in rows.columns.items():
            if is_text(data):
                texts.setdefault(name, set()).update(map(str, np.unique(data.astype(str))))
    if channel.blocks:
        definitions = parse_definition(channel.message_type, channel.definition)
        for payload in (channel.blocks[0].payload[0].tobytes(), channel.blocks[-1].payload[-1].tobytes()):
            for name, (start, length) in locate_fields(definitions, channel.message_type, payload).strings.items():
                texts.setdefault(name, set()).add(
                    payload[start : start + max(length - 1, 0)].decode("utf-8", "replace")
                )
    labels = tell_labels(channel)
    names = {labels.get(name, (name, ""))[0]: said.pop() for name, said in texts.items() if len(said) == 1}
    named = {label: match for label in names if (match := NAMES.fullmatch(label))}
    return {(match.group(1), int(match.group(2))): names[label] for label, match in named.items()}


def name_elements(signals: Sequence[Signal], names: Mapping[tuple[str, int], str]) -> list[Signal]:
    """Signals with what names beside them call those of one number, if as many share a name as are named."""
    ends = [re.fullmatch(r"(.*?)[_.\[]?(\d+)\]?", signal.label) if not signal.name else None for signal in signals]
    counts = Counter(end.group(1) for end in ends if end)
    called = []
    for end in ends:
        stems = {stem for stem, _ in names if end and end.group(1).startswith(stem)}
        stem = max(stems, key=len, default="")
        fits = end is not None and counts[end.group(1)] == sum(each == stem for each, _ in names)
        called.append(names.get((stem, int(end.group(2))), "") if end and fits else "")
    return [replace(signal, called=escape_text(name)) for signal, name in zip(signals, called)] if names else [*signals]


def tell_labels(channel: RawChannel) -> dict[str, tuple[str, str]]:
    """Field → what the log that messages were packed from calls it, and its unit, as comments in the definition say."""
    comments = dict(re.findall(r"^\S+ (\w+)  # (.*)$", channel.definition, flags=re.MULTILINE))
    said = {path: re.fullmatch(r"(.*?)(?: \[([^\[\]]*)\])?", text) for path, text in comments.items()}
    return {path: (match.group(1), match.group(2) or "") for path, match in said.items() if match}


def list_columns(recording: Recording, channel: RawChannel) -> Iterator[Signal]:
    """Signals of any other topic in record order, over their stamps [ns]."""
    if channel.rows:
        layout = describe_columns(channel.rows[0].columns)
    else:
        definitions = parse_definition(channel.message_type, channel.definition)
        layout = locate_fields(definitions, channel.message_type, channel.blocks[0].payload[0].tobytes())
    labels, paths = tell_labels(channel), {}
    for path, leaf in layout.leaves.items():
        if not _DULL.search(path) and (leaf.count is None or 0 < leaf.count <= _WIDEST):
            paths[path] = leaf
    stamped = Stamp() if layout.leaves.keys() & {STAMP, f"{STAMP}.sec"} else Stamp(path=LOG_TIME)
    samples = read_fields(recording, channel.topic, stamped, list(paths), channel.topic)
    for path, leaf in paths.items():
        label, unit = labels.get(path, (path, ""))
        data = samples.fields[path]
        for index in range(leaf.count or 1):
            suffix = "" if leaf.count is None else f"[{index}]"
            values = data if leaf.count is None else data[:, index]
            kind = np.dtype(leaf.code).name
            named = channel.topic, label + suffix, label + suffix, "", kind, unit
            yield Signal(*named, samples.stamp, values, headless=stamped.path == LOG_TIME)
