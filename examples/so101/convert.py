"""Convert a motion of the SO-101: python -m examples.so101.convert DATA/so101/multisine out.mcap."""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path

import numpy as np

from vpptwin.logs.flight import Stream
from vpptwin.logs.write import write_flight

JOINTS = ("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll")
"""The joints that the twin has, in the order of the columns; the jaw, behind them, is left out."""


def read_motion(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,) s, targets (n, 5) and positions (n, 5) rad, of rows that are stamped alike in both files."""
    tables = []
    for name in ("control", "state_motor"):
        with (folder / f"{name}.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        time = np.array([float(row["timestamp"]) for row in rows]) * 1e-6
        tables.append((time, np.array([json.loads(row["positions"])[: len(JOINTS)] for row in rows])))
    (time, target), (measured, position) = tables
    if not np.array_equal(time, measured):
        raise ValueError(f"{folder}: control.csv and state_motor.csv are not stamped alike")
    return time, target, position


def convert(folder: Path, out: Path, first: float = 0.0, last: float = np.inf) -> None:
    """Write the MCAP, from `first` to `last` s: positions as /joint_states, targets as /actuator_command."""
    time, target, position = read_motion(folder)
    rows = (time >= first) & (time <= last)
    joints = {name: Stream(time[rows], {"position": position[rows, i]}) for i, name in enumerate(JOINTS)}
    servos = {f"{name}_servo": Stream(time[rows], {"effort": target[rows, i]}) for i, name in enumerate(JOINTS)}
    write_flight(out, {}, {"/joint_states": joints, "/actuator_command": servos})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=float, default=0.0, help="s")
    parser.add_argument("--last", type=float, default=np.inf, help="s")
    options = parser.parse_args()
    convert(options.folder, options.out, options.first, options.last)
