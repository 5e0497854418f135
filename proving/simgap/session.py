"""A session as an entrant gets it: runs of one rig, its nominal model, what may be wrong with it; and the sealed truth.

A folder `WORLD-NUMBER/` has `session.json`, `rig.xml` and each run as CSV and MCAP. `held_out.csv` has short windows of
a run that nobody sees: motion up to the start of the forecast, commands to its end. The truth lies elsewhere.
"""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from proving.logs import PARTS, Log, write_log
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
        answer: the cause, `nothing`, or `unknown` for what is not among the causes.
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


def write_table(path: Path, runs: Sequence[tuple[Sequence[float], Run]], extra: Sequence[str] = ()) -> None:
    """Write runs as one CSV, each with leading cells of its own."""
    names = list(runs[0][1].columns)
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([*extra, "time", *names])
        for cells, run in runs:
            values = np.column_stack([run.columns[name] for name in names])
            for time, row in zip(run.time, values):
                writer.writerow([*cells, f"{time:.9g}", *("" if np.isnan(v) else f"{v:.9g}" for v in row)])


def read_table(path: Path) -> Run:
    """Read what `write_table` wrote."""
    names = path.open().readline().strip().split(",")
    values = np.genfromtxt(path, delimiter=",", skip_header=1, ndmin=2)
    return Run(values[:, names.index("time")], {n: values[:, i] for i, n in enumerate(names) if n != "time"})


def write_session(session: Session, logs: Sequence[Log], truth: Truth, folder: Path) -> Path:
    """Write a session, and its truth into `truth/` beside all sessions; returns the session's folder."""
    home = folder / "sessions" / session.name
    home.mkdir(parents=True, exist_ok=True)
    (home / "rig.xml").write_text(session.model)
    for i, (run, log) in enumerate(zip(session.runs, logs), 1):
        write_table(home / f"run_{i}.csv", [((), run)])
        write_log(log, home / f"run_{i}.mcap")
    if session.windows:
        write_table(home / "held_out.csv", [((k, w.start), w.run) for k, w in enumerate(session.windows)],
                    ("window", "start"))  # fmt: skip
    content = {
        "simgap": VERSION, "session": session.name, "tracks": session.tracks, "model": "rig.xml",
        "runs": [f"run_{i + 1}.csv" for i in range(len(session.runs))], "horizons_s": HORIZONS,
        "columns": {name: asdict(column) for name, column in session.columns.items()},
        "causes": {name: asdict(cause) for name, cause in session.causes.items()},
        "scales": session.scales, "data_sheet": session.data_sheet, "known": session.known,
        "truth_sha256": truth.seal(),
    }  # fmt: skip
    (home / "session.json").write_text(json.dumps(content, indent=1) + "\n")
    sealed = folder / "truth"
    sealed.mkdir(exist_ok=True)
    (sealed / f"{session.name}.json").write_text(dump(asdict(truth)) + "\n")
    return home


def read_session(home: Path) -> Session:
    """Read a session's folder.

    Raises:
        ValueError: where it is none, or of another version.
    """
    try:
        content = json.loads((home / "session.json").read_text())
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(f"{home} is no session ({error}): give a folder that `simgap draw` wrote") from None
    if content.get("simgap") != VERSION:
        raise ValueError(f"{home} is of version {content.get('simgap')}, this is {VERSION}: draw it again")
    columns = {name: Column(**column) for name, column in content["columns"].items()}
    windows = []
    if (home / "held_out.csv").exists():
        table = read_table(home / "held_out.csv")
        numbers, starts = table.columns.pop("window"), table.columns.pop("start")
        for k in np.unique(numbers):
            rows = numbers == k
            part = Run(table.time[rows], {name: values[rows] for name, values in table.columns.items()})
            windows.append(Window(float(starts[rows][0]), part))
    return Session(
        content["session"], content["tracks"], (home / content["model"]).read_text(), columns,
        {name: Cause(**cause) for name, cause in content["causes"].items()}, content["scales"], content["data_sheet"],
        content["known"], [read_table(home / run) for run in content["runs"]], windows,
    )  # fmt: skip


def read_truth(folder: Path, home: Path) -> Truth:
    """The truth of a session, checked against the hash that was published with it.

    Raises:
        ValueError: where it is not the one that was sealed.
    """
    truth = Truth(**json.loads((folder / "truth" / f"{home.name}.json").read_text()))
    published = json.loads((home / "session.json").read_text())["truth_sha256"]
    if truth.seal() != published:
        raise ValueError(f"the truth of {home.name} is not the one that was sealed: its SHA-256 is not {published}")
    return truth
