"""Sessions as folders `WORLD-NUMBER`: `session.json`, `rig.xml`, runs as CSV and MCAP; truths lie beside them."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from proving.logs import Log, write_log
from proving.simgap.session import HORIZONS, VERSION, Cause, Column, Run, Session, Truth, Window, dump


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
        "truth_sha256": truth.seal(), **({"many": session.many} if session.many > 1 else {}),
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
        content["known"], [read_table(home / run) for run in content["runs"]], windows, content.get("many", 1),
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
