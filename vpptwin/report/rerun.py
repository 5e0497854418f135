"""Twins' predictions over the recording as it was, for Rerun's viewer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vpptwin.logs.flight import Flight
from vpptwin.logs.spelling import stem_log
from vpptwin.report.export import TWINS, plain_name
from vpptwin.report.prediction import FlightPrediction
from vpptwin.system.errors import load_extra

TIMELINE = "stamp"
"""The log's own clock, by header stamps."""


def write_rrd(path: Path, prediction: FlightPrediction) -> None:
    """Write one log and what twins predict for it.

    `/x/measured` is what was recorded, `/x/before` and `/x/after` what the twins say of it, `/x/residual/before`
    measured minus predicted; every number of the log lies untouched under `/recording`, by topic and column.

    Raises:
        InputError: if Rerun is not installed.
    """
    rr = load_extra("rerun", "--rrd")
    flight = prediction.flight
    with rr.RecordingStream("vpptwin", recording_id=stem_log(flight.path)) as stream:
        stream.save(str(path))
        for entity, time, values in list_series(prediction):
            stamps = (flight.start_ns + np.rint(time * 1e9).astype(np.int64)).astype("datetime64[ns]")
            times = rr.TimeColumn(TIMELINE, timestamp=stamps)
            stream.send_columns(entity, [times], rr.Scalars.columns(scalars=values))
        stream.flush()
        stream.disconnect()


def list_series(prediction: FlightPrediction) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """What is written: entity, times (n,) s, numbers (n,)."""
    for track in prediction.tracks:
        name = f"/{plain_name(track)}"
        yield f"{name}/measured", track.time, track.measured
        for twin, predicted, residual in zip(TWINS, track.predicted, track.residual):
            known = np.isfinite(predicted)
            yield f"{name}/{twin}", track.time[known], predicted[known]
            yield f"{name}/residual/{twin}", track.time[known], residual[known]
    yield from list_recorded(prediction.flight)


def list_recorded(flight: Flight) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Every number of a log."""
    joints = {f"{topic}/{name}": stream for topic, names in flight.joints.items() for name, stream in names.items()}
    for topic, stream in {**flight.streams, **joints, **flight.spatial}.items():
        for column, values in stream.values.items():
            wide = values.reshape(len(values), -1)
            for i in range(wide.shape[1]):
                entity = f"/recording/{topic.strip('/')}/{column}"
                yield (entity if values.ndim == 1 else f"{entity}/{i}"), stream.time, wide[:, i].astype(float)
