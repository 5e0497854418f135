"""What a twin says of everything that a flight measured, at the log's own stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.estimation.measurements import Measurements, Series, read_measurements
from vpptwin.estimation.replay import Prediction, replay
from vpptwin.logs.flight import Flight
from vpptwin.twin.robot.manifold import difference_attitudes, find_place, rotate
from vpptwin.twin.sensors import Constants, find_age, measure_coordinate, measure_rate, turn_rates
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

RESTART = 0.5
"""The twin is put back to the state estimated from the log this often [s]."""


@dataclass(frozen=True)
class PredictedSeries:
    """One measured quantity of a flight."""

    name: str  # what it is, e.g. `x` or `pitch rate`
    unit: str  # SI unit
    kind: str  # `position` or `velocity`
    dof: int  # degree of freedom it measures
    time: np.ndarray  # when it was so (n,) [s since the log's first]
    measured: np.ndarray  # (n,)
    noise: float  # sensor noise of one sample, 1 sigma
    predicted: np.ndarray  # (twins, n) what each twin says; NaN where none could be simulated
    late: float = 0.0  # by how much later the log stamped the samples [s]

    @property
    def residual(self) -> np.ndarray:
        """Measured minus predicted, (twins, n)."""
        return self.measured - self.predicted

    @property
    def stamp(self) -> np.ndarray:
        """Stamps of the messages that the samples came in, (n,) [ns since the log's first]."""
        return np.rint((self.time + self.late) * 1e9).astype(np.int64)

    @property
    def known(self) -> np.ndarray:
        """Where all twins were simulated, (n,) bool."""
        return np.isfinite(self.predicted).all(axis=0)

    def take(self, rows: np.ndarray) -> PredictedSeries:
        """Some of the samples, by index or (n,) bool."""
        time, measured, predicted = self.time[rows], self.measured[rows], self.predicted[:, rows]
        return replace(self, time=time, measured=measured, predicted=predicted)


@dataclass(frozen=True)
class FlightPrediction:
    """A flight beside one or several twins."""

    flight: Flight  # the log
    tracks: list[PredictedSeries]  # everything measured, positions first
    restarts: np.ndarray  # when the twins were put back to the log [s]


def predict_flight(
    twins: Sequence[TwinSpec], flight: Flight, measurements: Measurements | None = None
) -> FlightPrediction:
    """Drive twins with a flight's commands, restarted every half second, and read their sensors at the log's stamps.

    Args:
        twins: of one robot, so that all read the log alike.
        flight: the log.
        measurements: what it says; None to read it.

    Raises:
        InputError: if the flight is shorter than that, or lacks what the twins need.
    """
    measurements = measurements or read_measurements(twins[0], flight)
    rate = 1.0 / float(twins[0].model.opt.timestep)
    replays = [replay(twin, flight, RESTART, rate, measurements) for twin in twins]
    constants = [Twin(twin, 1).constants for twin in twins]
    tracks = []
    for kind, quantities in (("position", measurements.positions), ("velocity", measurements.velocities)):
        for dof, series in sorted(quantities.items()):
            first = next((f for f in measurements.attitudes if f <= dof < f + 3), None)
            if first is not None and kind == "position":
                attitude, place = measurements.attitudes[first], find_place(twins[0].model, first)
                shown = (read_attitude(r, c, attitude, first, place) for r, c in zip(replays, constants, strict=True))
                turned = [each[:, dof - first] for each in shown]
                predicted = [series.value + each for each in turned]
            else:
                place = find_place(twins[0].model, dof) if kind == "position" else dof
                given = series, dof, kind, place, first
                predicted = [read_sensor(r, c, *given) for r, c in zip(replays, constants, strict=True)]
            logged = (series.time, series.value, float(series.std), np.array(predicted), series.late)
            tracks.append(PredictedSeries(series.name, series.unit, kind, dof, *logged))
    return FlightPrediction(flight, tracks, replays[0].restarts)


def read_sensor(
    prediction: Prediction, constants: Constants, series: Series, dof: int, kind: str, place: int,
    first: int | None = None,
) -> np.ndarray:  # fmt: skip
    """What the sensor of one quantity would have shown in a twin, (n,); NaN where the twin was not simulated.

    Args:
        prediction: the twin's replay, one sample per step.
        constants: of its sensors, (1,).
        series: the quantity as logged.
        dof: degree of freedom.
        kind: `position` or `velocity`.
        place: where in a pose its coordinate lies.
        first: degree of freedom at which the body's rotation begins, of its rates.
    """
    time = series.time - find_age(constants, "pose" if kind == "position" else "rate", dof, series.time)
    before, ahead, known = find_steps(prediction, time)
    velocity = prediction.qvel[before, dof]
    if kind == "velocity" and first is not None:
        velocity = turn_rates(constants, prediction.qvel[before, first : first + 3], first)[:, dof - first]
    if kind == "velocity":
        value = measure_rate(constants, velocity, dof)
    else:
        value = measure_coordinate(constants, dof, prediction.qpos[before, place] + velocity * ahead)
    return np.where(known, value, np.nan)


def find_steps(prediction: Prediction, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The step before each of some times [s], how long before [s], and whether the twin was simulated there, (n,)."""
    # Between steps the twin goes on as it was: nothing reaches across a restart.
    before = np.clip(np.searchsorted(prediction.time, time + 1e-9, side="right") - 1, 0, len(prediction.time) - 1)
    ahead = time - prediction.time[before]
    step = float(np.median(np.diff(prediction.time)))
    return before, ahead, (ahead > -1e-6) & (ahead < 1.5 * step)


def read_attitude(prediction: Prediction, constants: Constants, attitude: Series, first: int, place: int) -> np.ndarray:
    """Rotation from measured attitudes to those that a twin's sensor would show, about the body's axes, (n, 3) rad.

    NaN where it was not simulated. Its rates begin at degree of freedom `first`, its quaternion at `place` of a pose.
    """
    before, ahead, known = find_steps(prediction, attitude.time - find_age(constants, "pose", first, attitude.time))
    quaternion = prediction.qpos[before, place : place + 4]
    predicted = rotate(quaternion, ahead[:, None] * prediction.qvel[before, first : first + 3])
    offset = constants["pose.offset"][0, first : first + 3]
    if offset.any():
        predicted = rotate(predicted, np.broadcast_to(offset, (len(predicted), 3)))
    return np.where(known[:, None], difference_attitudes(attitude.value, predicted), np.nan)
