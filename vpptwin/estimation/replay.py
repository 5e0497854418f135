"""A whole flight replayed in the twin, restarted every so often from an estimated state."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vpptwin.estimation.correct import correct_measurements
from vpptwin.estimation.measurements import Measurements, list_warnings, read_measurements
from vpptwin.estimation.windows import cut_windows, fly_windows, trace_past
from vpptwin.logs.flight import Flight
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

RATE = 100.0
"""Samples per second of a prediction, if nobody asks for more [Hz]."""


@dataclass(frozen=True)
class Prediction:
    """What the twin did under a log's commands."""

    time: np.ndarray  # (T,) s on the flight's clock
    qpos: np.ndarray  # (T, nq) m, rad; where the twin is, not what its sensors show
    qvel: np.ndarray  # (T, nv) m/s, rad/s
    blade_pitch: np.ndarray  # command as the servos see it, (T, nu) rad (control input on other rigs)
    rotor_speed: np.ndarray  # (T, nu) rad/s; nominal where it was not measured
    restarts: np.ndarray  # (R,) s, instants at which the twin was put back to the estimated state
    warnings: list[str] = field(default_factory=list)  # about the log


def replay(
    spec: TwinSpec, flight: Flight, restart: float | None = 0.5, rate: float = RATE,
    measurements: Measurements | None = None,
) -> Prediction:  # fmt: skip
    """Drive the twin with a flight's logged commands.

    Args:
        spec: the twin.
        flight: the log.
        restart: seconds between restarts from a state estimated without looking ahead; None runs freely from the start.
        rate: samples per second of the prediction, at most one per step of the twin [Hz].
        measurements: what the log says, if it was read already.

    Raises:
        InputError: if the flight is shorter than one restart interval.
    """
    # Where the twin's sensors err, its state is not what they showed.
    measurements = correct_measurements(measurements or read_measurements(spec, flight), Twin(spec, 1).constants)
    begin = measurements.start + 0.2
    available = measurements.end - begin
    length = available if restart is None else restart
    if available < length or available < 0.1:
        found = f"{flight.path}: {measurements.duration:.2f} s of usable log"
        raise InputError(found, f"at least {length + 0.2:.2f} s", "log for longer")
    starts = begin + length * np.arange(int(available / length + 1e-9))
    windows = cut_windows(spec, measurements, starts, length, causal=True)
    twin = Twin(spec, len(windows))
    past = None
    if twin.remembers:
        past = twin.recall_effects(trace_past(spec, [measurements], windows, causal=True), np.arange(1))[0]
    motion = fly_windows(twin, windows, past=past)
    every = max(round(1.0 / (rate * windows.dt)), 1)
    picked = slice(0, windows.steps, every)
    time = (starts[:, None] + windows.dt * np.arange(windows.steps))[:, picked]
    speed = windows.rotor_speed
    if speed is None:
        speed = np.full_like(windows.command, spec.robot.rotor_speed)
    time, nq, nv, nu = time.reshape(-1), spec.model.nq, spec.model.nv, spec.model.nu
    shape = len(time), nu  # of which nu may be 0: no number of rows could be told from no numbers
    return Prediction(
        time=time,
        qpos=motion.pose[:, :-1][:, picked].reshape(-1, nq),
        qvel=motion.velocity[:, :-1][:, picked].reshape(-1, nv),
        blade_pitch=windows.command[:, picked].reshape(shape),
        rotor_speed=speed[:, picked].reshape(shape),
        restarts=starts,
        warnings=list_warnings([flight], [measurements]),
    )
