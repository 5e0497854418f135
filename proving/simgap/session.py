"""A session as an entrant gets it: runs of one rig, its nominal model, what may be wrong with it; and the sealed truth.

Windows are of a run that nobody sees: motion up to the start of the forecast, commands to its end.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from proving.logs import PARTS, Log
from proving.simgap.scores import NOTHING, UNKNOWN

VERSION = 1
HORIZONS = tuple(round(0.1 * k, 1) for k in range(1, 11))
"""Times of a forecast after its start [s]."""
WINDOWS, HISTORY = 12, 0.3
"""Forecasts of a session, and how much of the motion before each is shown [s]."""
MOTION = ("position", "velocity", *(part for parts in PARTS.values() for part in parts))
"""Roles of columns that are motion; the only other one is `command`."""
PREDICTED = ("position", "x", "y", "z")
"""Roles of columns that are forecast."""


@dataclass(frozen=True)
class Column:
    """A column of a run: its role, the joint, actuator, body or site that it is of, its unit, and its topic in MCAP."""

    role: str
    of: str
    unit: str
    topic: str


@dataclass(frozen=True)
class Cause:
    """Something that may be wrong with the model.

    Attributes:
        kind: of law; causes of a kind at one joint or actuator are a group.
        law: what it does, in words and a formula of `size`.
        parameter: what its size is called, in `unit`.
        off: size without it.
        scale: typical difference from that.
    """

    kind: str
    law: str
    parameter: str
    unit: str
    off: float
    scale: float


@dataclass(frozen=True)
class Run:
    """Columns (n,) at times (n,) [s]; a sample that was not taken is NaN."""

    time: np.ndarray
    columns: dict[str, np.ndarray]

    def cut(self, first: float, last: float) -> Run:
        """Samples between two times, both included."""
        rows = (self.time >= first - 1e-9) & (self.time <= last + 1e-9)
        return Run(self.time[rows], {name: values[rows] for name, values in self.columns.items()})


@dataclass(frozen=True)
class Window:
    """A forecast to make: motion before its start, commands to its end."""

    start: float  # s
    run: Run


@dataclass(frozen=True)
class Truth:
    """What is true of a session.

    Attributes:
        answer: the cause (of several the first), `nothing`, or `unknown` for what is not among the causes.
        sizes: cause → size; of what is unknown, its numbers.
        seen: sigma by which the runs show it; None where that is not worked out.
        apart: likewise from its nearest look-alike.
        alike: causes that these runs cannot tell from it.
        forecasts: measured motion of the forecasts, (windows, horizons, columns).
        onset: when the effect sets in [s]; None for never.
        salt: that makes the hash of the truth impossible to guess.
    """

    answer: str
    sizes: dict[str, float] = field(default_factory=dict)
    seen: float | None = None
    apart: float | None = None
    alike: list[str] = field(default_factory=list)
    forecasts: list[Any] = field(default_factory=list)
    onset: float | None = None
    salt: str = ""

    @property
    def present(self) -> list[str]:
        """All causes that are there, or else `answer`."""
        return list(self.sizes) if len(self.sizes) > 1 else [self.answer]

    @property
    def difficulty(self) -> str:
        """How hard the session is, by what was worked out."""
        if self.answer in (NOTHING, UNKNOWN):
            return self.answer
        if self.seen is None or self.apart is None:
            return "not worked out"
        return (
            "identifiable" if min(self.seen, self.apart + 1.0) >= 4.0 else "look-alikes" if self.seen >= 4.0 else "weak"
        )

    def seal(self) -> str:
        """Its SHA-256."""
        return hashlib.sha256(dump(asdict(self)).encode()).hexdigest()


@dataclass(frozen=True)
class Session:
    """What an entrant knows of a session.

    Attributes:
        name: `WORLD-NUMBER`.
        tracks: of `name`, `predict`, `watch`.
        model: the nominal MJCF.
        columns: name → column of runs.
        causes: id → cause; exactly one of them is there, or none, or something that is not listed.
        scales: predicted column → standard deviation over the runs: the unit of scores.
        data_sheet: column → standard deviation of its noise, as the maker of the sensor gives it; may be empty.
        known: cause → size that the owner knows beside the model, such as a motor's lag.
        runs: all recordings; of the track `watch`, the last is the one to watch and nothing is wrong in the others.
        windows: forecasts to make.
        many: how many causes there are, where there is any that is listed.
    """

    name: str
    tracks: list[str]
    model: str
    columns: dict[str, Column]
    causes: dict[str, Cause]
    scales: dict[str, float]
    data_sheet: dict[str, float]
    known: dict[str, float]
    runs: list[Run]
    windows: list[Window]
    many: int = 1

    @property
    def world(self) -> str:
        """Its world."""
        return self.name.rsplit("-", 1)[0]

    @property
    def predicted(self) -> list[str]:
        """Columns that are forecast."""
        return list(self.scales)

    @property
    def groups(self) -> dict[str, str]:
        """Cause → its group: causes of one kind at one joint or actuator."""
        return {name: f"{name.split('.')[0]}: {cause.kind}" for name, cause in self.causes.items()}

    def find(self, role: str) -> dict[str, str]:
        """What a column is of → its name, of all columns of a role."""
        return {column.of: name for name, column in self.columns.items() if column.role == role}


def dump(content: object) -> str:
    """JSON in one spelling, so that hashes can be compared."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def make_run(log: Log) -> tuple[Run, dict[str, Column]]:
    """A log as a table with one clock, and what its columns are."""
    found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    columns: dict[str, Column] = {}
    for topic, names in log.joints.items():
        for of, stream in names.items():
            for role, values in stream.values.items():
                name = {"position": of, "velocity": f"v_{of}"}.get(role, of)
                found[name] = stream.time, values
                columns[name] = Column({"effort": "command"}.get(role, role), of, "", topic)
    for topic, stream in log.spatial.items():
        for role, values in stream.values.items():
            for i, part in enumerate(PARTS[role]):
                found[part] = stream.time, values[:, i]
                columns[part] = Column(part, topic.strip("/"), "", topic)
    clock = np.unique(np.round(np.concatenate([time for time, _ in found.values()]), 9))
    table = {}
    for name, (time, values) in found.items():
        table[name] = np.full(len(clock), np.nan)
        table[name][np.searchsorted(clock, np.round(time, 9))] = values
    return Run(clock, table), columns


def cut_windows(run: Run, columns: Mapping[str, Column], predicted: Sequence[str]) -> tuple[list[Window], np.ndarray]:
    """Forecasts of a run that nobody sees, and what was measured, (windows, horizons, columns)."""
    starts = np.linspace(run.time[0] + HISTORY, run.time[-1] - HORIZONS[-1] - 0.02, WINDOWS)
    windows, measured = [], np.empty((WINDOWS, len(HORIZONS), len(predicted)))
    for k, start in enumerate(starts):
        first = float(run.time[np.searchsorted(run.time, start)])
        part = run.cut(first - HISTORY, first + HORIZONS[-1])
        for j, name in enumerate(predicted):
            there = np.isfinite(run.columns[name])
            measured[k, :, j] = np.interp(first + np.array(HORIZONS), run.time[there], run.columns[name][there])
        shown = {
            name: np.where((columns[name].role in MOTION) & (part.time > first + 1e-9), np.nan, values)
            for name, values in part.columns.items()
        }
        windows.append(Window(first, Run(part.time, shown)))
    return windows, measured
