"""Twins' predictions and residuals as MCAP on the log's own clock: Foxglove and PlotJuggler lay them over the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from vpptwin.diagnosis.report.prediction import FlightPrediction, Track
from vpptwin.logs.flight import Flight
from vpptwin.logs.write import FlightWriter, merge_times
from vpptwin.twin.drone import PlanarDrone
from vpptwin.twin.robot import Robot
from vpptwin.twin.spec import TwinSpec

TWINS = ("before", "after")
"""The twin that was diagnosed and the extended one; their topics are under `/twin/before` and `/twin/after`."""
MOST = 100.0
"""Samples per second of a quantity that are exported, out of those that the log has [Hz]."""
OTHER_CLOCK = 60.0
"""A recorder whose first message is this far from its stamp ran on another clock, say under simulated time [s]."""
LATEST = 0.02
"""By which stamps of one quantity may be moved against another's of the same messages [s]."""
POSE_COLUMNS = {"x": "x", "z": "z", "θ": "theta"}


@dataclass(frozen=True)
class Topic:
    """Messages of one topic."""

    name: str  # its name
    time: np.ndarray  # (n,) s on the log's clock
    values: Mapping[str, np.ndarray] | None = None  # column → (n,), of a topic in the form of SPEC 3
    joints: Mapping[str, Mapping[str, np.ndarray]] | None = None  # joint → column → (n,), of a JointState

    def write(self, writer: FlightWriter, row: int, offset: float) -> None:
        """Write one message, recorded `offset` [s] after its stamp."""
        time = float(self.time[row])
        if self.values is not None:
            writer.write(self.name, time, {column: value[row] for column, value in self.values.items()}, time + offset)
        if self.joints is not None:
            joints = {name: {c: float(v[row]) for c, v in columns.items()} for name, columns in self.joints.items()}
            writer.write_joints(self.name, time, joints, time + offset)


def name_files(logs: Sequence[Path], suffix: str = ".mcap") -> list[str]:
    """A file for the prediction of each log: `prediction.mcap`, or `prediction_LOG.mcap` where there are several."""
    if len(logs) == 1:
        return [f"prediction{suffix}"]
    names: list[str] = []
    for log in logs:
        name, count = f"prediction_{log.stem}{suffix}", 2
        while name in names:
            name, count = f"prediction_{log.stem}_{count}{suffix}", count + 1
        names.append(name)
    return names


def write_prediction(
    path: Path, spec: TwinSpec, prediction: FlightPrediction, metadata: Mapping[str, str] | None = None
) -> None:
    """Write what twins predict for one log.

    `/twin/before/mocap/pose` is to `/mocap/pose` what the twin is to the rig: same type, same stamps, same signs; other
    rigs have `/twin/before/joint_states`. `/twin/before/residual/x` is a JointState of one name, whose position (or
    velocity) is measured minus predicted.

    The prediction is that of the diagnosed twin `spec` and, second, of the extended one if there is one.
    """
    tracks = thin_tracks(prediction.tracks)
    topics: list[Topic] = []
    for i, twin in enumerate(TWINS[: len(tracks[0].predicted)]):
        topics += list_topics(spec.robot, twin, tracks, i)
        topics += [list_residual(twin, track, i) for track in tracks]
    offset = find_offset(prediction.flight)
    with FlightWriter(path, prediction.flight.start_ns, metadata) as writer:
        for index, row in merge_times([topic.time for topic in topics]):
            topics[index].write(writer, row, offset)


def find_offset(flight: Flight) -> float:
    """Recording time minus stamp where a log was recorded on another clock than its stamps', else 0 [s]."""
    try:
        with flight.path.open("rb") as file:
            summary = make_reader(file).get_summary()
    except (OSError, McapError):  # a log that was cut off has no summary, though its messages can be read
        return 0.0
    if summary is None or summary.statistics is None:
        return 0.0
    offset = (summary.statistics.message_start_time - flight.start_ns) / 1e9
    return offset if abs(offset) > OTHER_CLOCK else 0.0


def thin_tracks(tracks: Sequence[Track]) -> list[Track]:
    """The samples at which every twin was simulated, thinned out evenly if there are too many.

    Of quantities that were logged together the same ones are kept, as one message holds them.
    """
    finite = [np.isfinite(track.predicted).all(axis=0) for track in tracks]
    thinned = []
    for track in tracks:
        known = np.logical_and.reduce([f for f, other in zip(finite, tracks) if is_beside(track, other)])
        period = float(np.median(np.diff(track.time))) if len(track.time) > 1 else 1.0 / MOST
        kept = np.flatnonzero(known)[:: max(round(1.0 / (period * MOST)), 1)]
        time, measured, predicted = track.time[kept], track.measured[kept], track.predicted[:, kept]
        thinned.append(replace(track, time=time, measured=measured, predicted=predicted))
    return thinned


def is_beside(one: Track, other: Track) -> bool:
    """Whether two quantities come from the same messages; a lateness that was found has moved the stamps of one."""
    if len(one.time) != len(other.time):
        return False
    period = float(np.diff(one.time).min()) if len(one.time) > 1 else 0.0
    return bool(np.abs(one.time - other.time).max() <= max(0.5 * period, LATEST))


@singledispatch
def list_topics(robot: Robot, twin: str, tracks: Sequence[Track], i: int) -> list[Topic]:
    """Joints of a rig as one twin gives them, those that were logged at the same instants in one message."""
    topics: dict[tuple[str, bytes], Topic] = {}
    for joint, source in robot.signals.joints.items():
        dof = int(robot.model.joint(joint).dofadr[0])
        own = [track for track in tracks if track.dof == dof]
        columns = {track.kind: track.predicted[i] for track in own}
        key = source + "/".join(columns), own[0].time.tobytes()
        topic = topics.setdefault(key, Topic(f"/twin/{twin}{source}", own[0].time, joints={}))
        topics[key] = replace(topic, joints={**(topic.joints or {}), joint: columns})
    return list(topics.values())


@list_topics.register(PlanarDrone)
def list_drone(robot: PlanarDrone, twin: str, tracks: Sequence[Track], i: int) -> list[Topic]:
    """Pose and gyro of our drone as one twin gives them."""
    poses = [track for track in tracks if track.kind == "position"]
    values = {POSE_COLUMNS[track.name]: track.predicted[i] for track in poses}
    topics = [Topic(f"/twin/{twin}/mocap/pose", poses[0].time, values)]
    for track in tracks:
        if track.kind == "velocity":
            topics.append(Topic(f"/twin/{twin}/imu/data", track.time, {"rate": track.predicted[i]}))
    return topics


def plain_name(track: Track) -> str:
    """What a quantity is called in names of topics."""
    return track.name.replace("θ", "theta").replace(" ", "_")


def list_residual(twin: str, track: Track, i: int) -> Topic:
    """Measured minus predicted of one quantity."""
    name = plain_name(track)
    return Topic(f"/twin/{twin}/residual/{name}", track.time, joints={name: {track.kind: track.residual[i]}})
