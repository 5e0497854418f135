"""Before anything is fitted: how well a flight was recorded, and what was excited on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from vpptwin.estimation.gaps import LOOK_BACK, PROBE, usable_starts
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.twin.spec import TwinSpec

SPAN = 0.05
"""Speeds are differences of positions over this time [s]."""
MOVING = 3.0
"""A joint moves when its speed exceeds its noise by this factor."""
RESOLUTION = 1e-3
"""Changes of the lag below this are not mentioned [s]."""
AT_LIMIT = 0.99
"""A command beyond this share of its limit is saturated."""


@dataclass(frozen=True)
class StreamCheck:
    """How one quantity was recorded: mean rate [Hz], share of samples that are missing, longest gap [s]."""

    rate: float
    missing: float
    longest_gap: float


@dataclass(frozen=True)
class Preflight:
    """One flight before it is diagnosed."""

    name: str  # file the flight came from
    duration: float  # length of the common span [s]
    usable: float  # share of it that no gap spoils
    streams: dict[str, StreamCheck]  # quantity → how it was recorded
    lag: float | None  # of the motion capture behind the gyro at the start [s]; None where nothing tells
    lag_drift: float | None  # by which that lag grows [s/s]
    clock_drift: float | None  # by which the motion capture's stamps run fast against the IMU's, by log times [s/s]
    saturated: dict[str, float]  # actuator → share of time at its limits
    moving: dict[str, float]  # joint → share of time in which it moves
    reversals: dict[str, int]  # joint → how often its motion turned round
    inverted: float | None  # share of time upside down; None for rigs of which that can't be said
    ranges: dict[str, tuple[float, float]]  # quantity → least and greatest value, in SI units
    units: dict[str, str]  # joint → unit of its position
    # length of the windows that it is cut into, where it is too short for the usual one [s]; else None
    window: float | None = None

    def as_dict(self) -> dict[str, object]:
        """All of it as numbers, strings, lists and dicts."""
        return asdict(self)

    def describe(self) -> str:
        """The flight in one line."""
        parts = [f"{self.duration:.1f} s, {self.usable:.0%} of it usable"]
        parts += [f"short: in windows of {self.window:g} s"] if self.window else []
        rates = (f"{name} {check.rate:.0f} Hz{tell_missing(check)}" for name, check in self.streams.items())
        parts.append(", ".join(rates))
        parts += [f"{name} moves {share:.0%} of the time{self.tell_reach(name)}" for name, share in self.moving.items()]
        if self.inverted:
            parts.append(f"inverted {self.inverted:.0%} of the time")
        limited = {name: share for name, share in self.saturated.items() if share >= 0.005}
        parts += [f"{name} at its limits {share:.0%} of the time" for name, share in limited.items()]
        if self.lag is not None:
            drift = self.lag_drift or 0.0
            growing = f", growing by {1e3 * drift:.2g} ms/s" if abs(drift) * self.duration > RESOLUTION else ""
            parts.append(f"motion capture {1e3 * self.lag:.1f} ms behind the gyro{growing}")
        return f"{self.name}: {'; '.join(parts)}"

    def tell_reach(self, name: str) -> str:
        """Between which values and how fast a joint moved."""
        (low, high), (least, greatest) = self.ranges[name], self.ranges[f"{name} rate"]
        unit = self.units[name]
        return f" between {low:.2f} and {high:.2f} {unit}, at up to {max(-least, greatest):.2g} {unit}/s"


def tell_missing(check: StreamCheck) -> str:
    """The samples that a stream lacks, in brackets; nothing where it lacks none."""
    if check.missing < 0.0005:
        return ""
    return f" ({check.missing:.1%} missing, longest gap {check.longest_gap:.2g} s)"


def inspect_flight(spec: TwinSpec, measurements: Measurements) -> Preflight:
    """Look a flight over; the twin knows the actuators' limits."""
    starts = np.arange(measurements.start + LOOK_BACK, measurements.end - PROBE, 0.1)
    speeds = {series.name: measure_speed(series) for series in measurements.positions.values()}
    moving, reversals = {}, {}
    for series in measurements.positions.values():
        fast = np.abs(speeds[series.name]) > MOVING * np.sqrt(2.0) * series.std / SPAN
        directions = np.sign(speeds[series.name][fast])
        moving[series.name], reversals[series.name] = float(fast.mean()), int(np.count_nonzero(np.diff(directions)))
    lag, clocks, attitude = measurements.lag, measurements.clocks, spec.robot.attitude
    known = "/mocap/pose" in clocks and "/imu/data" in clocks
    return Preflight(
        name=measurements.name,
        duration=measurements.duration,
        usable=float(np.mean(usable_starts(measurements, starts, PROBE))) if len(starts) else 0.0,
        streams={name: check_stream(series.time) for name, series in list_series(measurements)},
        lag=None if lag is None else lag.start,
        lag_drift=None if lag is None else lag.drift,
        clock_drift=clocks["/mocap/pose"].drift - clocks["/imu/data"].drift if known else None,
        saturated=measure_saturation(spec, measurements),
        moving=moving,
        reversals=reversals,
        inverted=None if attitude is None else float(np.mean(np.cos(measurements.positions[attitude].value) < 0.0)),
        ranges=describe_range([measurements]),
        units={series.name: series.unit for series in measurements.positions.values()},
        window=spec.robot.window if spec.robot.is_short else None,
    )


def describe_range(flights: Sequence[Measurements]) -> dict[str, tuple[float, float]]:
    """Least and greatest value of every quantity over all flights, in SI units.

    On the drone: `x`, `z`, `θ` (within a turn), `x rate`, `z rate`, `θ rate`, `specific force`, `blade pitch`,
    `rotor speed`, and `axial speed`, along the thrust axis. On other rigs: joints, their rates, `control`.
    """
    ranges: dict[str, tuple[float, float]] = {}
    for flight in flights:
        for name, value in list_quantities(flight):
            low, high = ranges.get(name, (np.inf, -np.inf))
            ranges[name] = (min(low, float(value.min())), max(high, float(value.max())))
    return ranges


def list_quantities(flight: Measurements) -> Iterator[tuple[str, np.ndarray]]:
    """Every quantity of a flight with its values."""
    drone = bool(flight.delayed)
    for dof, series in flight.positions.items():
        turning = drone and dof == 2
        yield series.name, np.arctan2(np.sin(series.value), np.cos(series.value)) if turning else series.value
        if dof not in flight.velocities:
            yield f"{series.name} rate", measure_speed(series)
    for measured in (*flight.velocities.values(), flight.specific_force, flight.command, flight.rotor_speed):
        if measured is not None and measured.value.size:  # a rig without actuators has no control inputs
            yield measured.name, measured.value
    if drone:
        x, z, angle = (flight.positions[dof] for dof in range(3))
        yield "axial speed", measure_speed(z) * np.cos(angle.value) - measure_speed(x) * np.sin(angle.value)


def measure_speed(series: Series) -> np.ndarray:
    """Speed at every sample, from the position half a SPAN before and after it, (n,)."""
    low, high = series.time[0], series.time[-1]
    ahead, behind = (np.clip(series.time + side * 0.5 * SPAN, low, high) for side in (1.0, -1.0))
    moved = np.interp(ahead, series.time, series.value) - np.interp(behind, series.time, series.value)
    return np.asarray(moved / np.maximum(ahead - behind, 1e-9))


def list_series(measurements: Measurements) -> Iterator[tuple[str, Series]]:
    """One series of every topic that was recorded, by name."""
    for series in measurements.positions.values():
        yield "poses" if measurements.delayed else series.name, series
    for other in (*measurements.velocities.values(), measurements.command, measurements.rotor_speed):
        if other is not None and other.value.size:
            yield other.name, other


def check_stream(time: np.ndarray) -> StreamCheck:
    """How a stream came that should have come at a constant rate, time (n,) s."""
    steps = np.diff(time)
    if not len(steps):
        return StreamCheck(0.0, 0.0, 0.0)
    expected = float(np.sum(np.maximum(np.rint(steps / np.median(steps)), 1.0)))
    span = float(time[-1] - time[0])
    return StreamCheck(len(steps) / span, 1.0 - len(steps) / expected, float(steps.max()))


def measure_saturation(spec: TwinSpec, measurements: Measurements) -> dict[str, float]:
    """Share of samples in which each actuator's command is at its limits; actuators without limits are left out."""
    value = measurements.command.value
    limits = spec.robot.limits.items()
    return {name: float(np.mean(np.abs(value[:, i]) > AT_LIMIT * limit)) for name, (i, limit) in limits}
