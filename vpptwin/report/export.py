"""Twins' predictions and residuals as MCAP on the log's own clock: Foxglove and PlotJuggler lay them over the log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vpptwin.logs.flight import Flight
from vpptwin.logs.spelling import stem_log
from vpptwin.logs.write import FlightWriter, merge_times
from vpptwin.report.prediction import FlightPrediction, PredictedSeries
from vpptwin.twin.robot.robot import Robot, by_robot
from vpptwin.twin.spec import TwinSpec

TWINS = ("before", "after")
"""The twin that was diagnosed and the extended one; their topics are under `/twin/before` and `/twin/after`."""
MOST = 100.0
"""Samples per second of a quantity that are exported, out of those that the log has [Hz]."""
OTHER_CLOCK = 60.0
"""A recorder whose first message is this far from its stamp ran on another clock, say under simulated time [s]."""
POSE_COLUMNS = {"x": "x", "z": "z", "θ": "theta"}


@dataclass(frozen=True)
class Topic:
    """Messages of one topic."""

    name: str  # its name
    time: np.ndarray  # (n,) s on the log's clock
    values: Mapping[str, np.ndarray] | None = None  # column → (n,), of one of our topics (docs/logs.md)
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
    for stem in map(stem_log, logs):
        name, count = f"prediction_{stem}{suffix}", 2
        while name in names:
            name, count = f"prediction_{stem}_{count}{suffix}", count + 1
        names.append(name)
    return names


def write_prediction(
    path: Path, spec: TwinSpec, prediction: FlightPrediction, metadata: Mapping[str, str] | None = None
) -> None:
    """Write what twins predict for one log.

    `/measured/joint_states` is what was measured, as it was compared.

    `/twin/before/mocap/pose` is to `/mocap/pose` what the twin is to the rig: same type, same stamps, same signs; other
    rigs have `/twin/before/joint_states`. `/twin/before/residual/x` is a JointState of one name, whose position (or
    velocity) is measured minus predicted.

    The prediction is that of the diagnosed twin `spec` and, second, of the extended one if there is one.
    """
    tracks = thin_tracks(prediction.tracks)
    measured = [replace(track, predicted=track.measured[None]) for track in tracks]
    topics = [
        replace(topic, name=topic.name.removeprefix("/twin"))
        for topic in list_topics(spec.robot, "measured", measured, 0)
    ]
    for i, twin in enumerate(TWINS[: len(tracks[0].predicted)]):
        topics += list_topics(spec.robot, twin, tracks, i)
        topics += [list_residual(twin, track, i) for track in tracks]
    offset = find_offset(prediction.flight)
    with FlightWriter(path, prediction.flight.start_ns, metadata) as writer:
        for index, row in merge_times([topic.time for topic in topics]):
            topics[index].write(writer, row, offset)


def find_offset(flight: Flight) -> float:
    """Recording time minus stamp where a log was recorded on another clock than its stamps', else 0 [s]."""
    offset = 0.0 if flight.recorded_ns is None else (flight.recorded_ns - flight.start_ns) / 1e9
    return offset if abs(offset) > OTHER_CLOCK else 0.0


def thin_tracks(tracks: Sequence[PredictedSeries]) -> list[PredictedSeries]:
    """Of every quantity at most `MOST` samples a second, where every twin was simulated; all where that is about right.

    Of those in one stretch that is taken which shares its message with most others: one message holds them then.
    """
    known = [track.take(track.known) for track in tracks]
    stamps, shared = np.unique(np.concatenate([track.stamp for track in known]), return_counts=True)
    thinned = []
    for track in known:
        if len(track.time) > 1 and round(1e9 / (float(np.median(np.diff(track.stamp))) * MOST)) > 1:
            stretch, beside = track.stamp // round(1e9 / MOST), shared[np.searchsorted(stamps, track.stamp)]
            order = np.lexsort((track.stamp, -beside, stretch))
            track = track.take(np.sort(order[np.unique(stretch[order], return_index=True)[1]]))
        thinned.append(track)
    return thinned


def group_messages(tracks: Sequence[PredictedSeries]) -> Iterator[tuple[np.ndarray, dict[int, np.ndarray]]]:
    """Messages by which quantities they hold: their stamps (n,) [s], and index of a quantity → its rows (n,).

    What came in one message has its stamp, whatever else is missing there or was moved to another time since.
    """
    stamps = np.unique(np.concatenate([track.stamp for track in tracks])) if tracks else np.empty(0)
    row = np.full((len(tracks), len(stamps)), -1)
    for i, track in enumerate(tracks):
        row[i, np.searchsorted(stamps, track.stamp)] = np.arange(len(track.time))
    for held in np.unique(row >= 0, axis=1).T:
        among = ((row >= 0) == held[:, None]).all(axis=0)
        yield stamps[among] / 1e9, {int(i): row[i, among] for i in np.flatnonzero(held)}


@by_robot
def list_topics(robot: Robot, twin: str, tracks: Sequence[PredictedSeries], i: int) -> list[Topic]:
    """Joints of a rig as one twin gives them; in one message those that one of the log's held with the same columns."""
    dofs = {int(robot.model.joint(joint).dofadr[0]): joint for joint in robot.signals.joints}
    topics = []
    for source in dict.fromkeys(robot.signals.joints.values()):
        own = [t for t in tracks if t.dof in dofs and robot.signals.joints[dofs[t.dof]] == source]
        for time, rows in group_messages(own):
            joints: dict[str, dict[str, np.ndarray]] = {}
            for index, row in rows.items():
                joints.setdefault(dofs[own[index].dof], {})[own[index].kind] = own[index].predicted[i, row]
            for columns in dict.fromkeys(tuple(held) for held in joints.values()):
                alike = {joint: held for joint, held in joints.items() if tuple(held) == columns}
                topics.append(Topic(f"/twin/{twin}{source}", time, joints=alike))
    return topics


def plain_name(track: PredictedSeries) -> str:
    """What a quantity is called in names of topics."""
    return track.name.replace("θ", "theta").replace(" ", "_")


def list_residual(twin: str, track: PredictedSeries, i: int) -> Topic:
    """Measured minus predicted of one quantity."""
    name = plain_name(track)
    return Topic(f"/twin/{twin}/residual/{name}", track.stamp / 1e9, joints={name: {track.kind: track.residual[i]}})
