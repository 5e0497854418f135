"""A CSV of joint motion and torque as a flight log: /joint_states and /actuator_command, stamps as they are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from examples.by_hand import read_columns
from vpptwin.logs import FlightWriter


def write_log(csv: Path, out: Path, joints: Mapping[str, tuple[str, str]], torques: Mapping[str, str]) -> None:
    """Write one MCAP.

    Args:
        csv: file with one line of column names and a column `time` [s].
        out: file to write.
        joints: joint → columns of position [rad] and velocity [rad/s].
        torques: actuator → column of torque [N m].
    """
    columns = read_columns(csv)
    missing = {"time", *torques.values(), *(name for pair in joints.values() for name in pair)} - set(columns)
    if missing:
        raise SystemExit(f"{csv} has no column {', '.join(sorted(missing))}; it has {', '.join(columns)}")
    out.parent.mkdir(parents=True, exist_ok=True)
    with FlightWriter(out, metadata={"source": csv.name}) as writer:
        for row, time in enumerate(columns["time"]):
            motion = {
                joint: {"position": float(columns[position][row]), "velocity": float(columns[velocity][row])}
                for joint, (position, velocity) in joints.items()
            }
            effort = {actuator: {"effort": float(columns[name][row])} for actuator, name in torques.items()}
            writer.write_joints("/joint_states", float(time), motion)
            writer.write_joints("/actuator_command", float(time), effort)
