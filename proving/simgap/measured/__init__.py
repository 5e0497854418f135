"""The track with measured data: logs that anybody may fetch, with what a fit by hand says of them. Scored apart.

Nothing of the data lies here. `manifest.json` has for each session the repository, commit, file, hash and licence; the
columns; the seconds to use, which leave out where somebody touched the robot; the cause that a fit by hand gives, with
its size, and the span that the fit leaves in doubt.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np

from proving.logs import Log, Stream
from proving.simgap.causes import assemble, make_cause
from proving.simgap.session import Truth
from proving.simgap.sets import add_to_manifest
from proving.simgap.storage import write_session

HERE = Path(__file__).parent
RAW = "https://raw.githubusercontent.com"


def write_measured(folder: Path, data: Path | None) -> list[str]:
    """Write the sessions with measured data; names of those written.

    Args:
        folder: of the set.
        data: where files lie already, under whatever names; None to fetch them.

    Raises:
        ValueError: where a file is neither there nor can be fetched, or is another one.
    """
    local = {hashlib.sha256(p.read_bytes()).hexdigest(): p for p in data.rglob("*.csv")} if data else {}
    names = []
    for entry in json.loads((HERE / "manifest.json").read_text()):
        table = read_columns(find_file(entry, local))
        logs = [cut_log(table, entry, span) for span in (*entry["runs_s"], entry["held_out_s"])]
        causes = {name: make_cause(name.split(".")[1], "", True, *sizes) for name, sizes in entry["causes"].items()}
        truth = Truth(entry["answer"], {entry["answer"]: entry["size"]}, salt=entry["sha256"])
        mjcf = (HERE / entry["model"]).read_text()
        units = {of: "rad" for role, of in entry["columns"].values() if role == "position"}
        session, logs, truth = assemble(mjcf, logs, causes, truth, {}, units)
        home = write_session(replace(session, name=entry["session"]), logs, truth, folder)
        names.append(home.name)
        add_to_manifest(folder, home, truth)
    return names


def find_file(entry: Mapping[str, Any], local: Mapping[str, Path]) -> str:
    """The text of an entry's file."""
    if entry["sha256"] in local:
        return local[entry["sha256"]].read_text()
    url = f"{RAW}/{entry['repository']}/{entry['commit']}/{entry['file']}"
    try:
        with urlopen(url, timeout=60) as stream:
            content = stream.read()
    except OSError as error:
        raise ValueError(f"{url} can't be fetched ({error}): download it, then give its folder with --data") from None
    if (found := hashlib.sha256(content).hexdigest()) != entry["sha256"]:
        raise ValueError(f"{url} has SHA-256 {found}, not {entry['sha256']}: it is not the file that was described")
    return str(content.decode())


def read_columns(text: str) -> dict[str, np.ndarray]:
    """Columns of a CSV."""
    rows = list(csv.reader(io.StringIO(text)))
    return dict(zip(rows[0], np.array(rows[1:], float).T))


def cut_log(table: Mapping[str, np.ndarray], entry: Mapping[str, Any], span: tuple[float, float]) -> Log:
    """Some seconds of a file as a log that starts at zero."""
    kept = (table["time"] >= span[0]) & (table["time"] <= span[1])
    time, topics = table["time"][kept] - table["time"][kept][0], dict[str, dict[str, Stream]]()
    values: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    for column, (role, of) in entry["columns"].items():
        topic, name = ("/commands", "effort") if role == "command" else ("/joint_states", role)
        values.setdefault((topic, of), {})[name] = table[column][kept]
    for (topic, of), columns in values.items():
        topics.setdefault(topic, {})[of] = Stream(time, columns)
    return Log(Path("run.mcap"), 0, {}, topics)
