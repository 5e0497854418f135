"""What a report says and exports of the drone otherwise than of any rig."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from vpptwin.report.export import POSE_COLUMNS, Topic, group_messages
from vpptwin.report.html.advice import NextStep
from vpptwin.report.prediction import PredictedSeries
from vpptwin.robots.planar_drone.craft import PlanarDrone


def list_drone(robot: PlanarDrone, twin: str, tracks: Sequence[PredictedSeries], i: int) -> list[Topic]:
    """Pose and gyro of our drone as one twin gives them."""
    poses, topics = [track for track in tracks if track.kind == "position"], []
    for time, rows in group_messages(poses):
        if len(rows) == len(POSE_COLUMNS):
            values = {POSE_COLUMNS[poses[index].name]: poses[index].predicted[i, row] for index, row in rows.items()}
            topics.append(Topic(f"/twin/{twin}/mocap/pose", time, values))
    for track in tracks:
        if track.kind == "velocity":
            topics.append(Topic(f"/twin/{twin}/imu/data", track.stamp / 1e9, {"rate": track.predicted[i]}))
    return topics


def advise_drone(robot: PlanarDrone) -> str:
    """The library."""
    return "Manoeuvres: vpptwin fly --list"


def suggest_flip(robot: PlanarDrone, twin: str, extended: bool) -> list[NextStep]:
    """The flip."""
    told = f"Train a policy on the {'extended twin' if extended else 'twin'}."
    return [NextStep(told, shlex.join(["vpptwin", "train", "task=flip", f"twin={twin}", "out=runs/flip_extended"]))]
