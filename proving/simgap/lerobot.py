"""Runs of a session as a LeRobot data set, version 3: an episode each, states and actions by their names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from proving.simgap.session import Session

FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


def write_lerobot(session: Session, folder: Path) -> Path | None:
    """Write a data set; None where columns are sampled at different instants, which the format cannot hold.

    Raises:
        ValueError: where pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise ValueError("LeRobot's format needs pyarrow: pip install pyarrow, or leave --lerobot out") from None
    if any(np.isnan(run.columns[name]).any() for run in session.runs for name in session.columns):
        return None
    parts = {"observation.state": [n for n, c in session.columns.items() if c.role != "command"],
             "action": [n for n, c in session.columns.items() if c.role == "command"]}  # fmt: skip
    lengths = [len(run.time) for run in session.runs]
    features = {k: {"names": v, "dtype": "float64", "shape": [len(v)]} for k, v in parts.items() if v}
    rate = round(1.0 / float(np.median(np.diff(session.runs[0].time))))
    about = {"codebase_version": "v3.0", "fps": rate, "total_episodes": len(lengths), "features": features,
             "data_path": f"data/{FILE}"}  # fmt: skip
    frames, episodes = [np.arange(n) for n in lengths], [np.full(n, k) for k, n in enumerate(lengths)]
    table = {"timestamp": np.concatenate([run.time for run in session.runs]), "frame_index": np.concatenate(frames),
             "episode_index": np.concatenate(episodes), "index": np.arange(sum(lengths)),
             "task_index": np.zeros(sum(lengths), int)}  # fmt: skip
    lists = {}
    for part in features:
        rows = np.concatenate([np.stack([run.columns[n] for n in parts[part]], axis=1) for run in session.runs])
        lists[part] = pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), rows.shape[1])
    zeros = [0] * len(lengths)
    index = {
        "episode_index": range(len(lengths)),
        "length": lengths,
        "data/chunk_index": zeros,
        "data/file_index": zeros,
    }
    for name, content in (("data", {**lists, **table}), ("meta/episodes", {k: list(v) for k, v in index.items()})):
        path = folder / name / FILE.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pa.table(content), path)
    (folder / "meta" / "info.json").write_text(json.dumps(about, indent=1) + "\n")
    return folder
