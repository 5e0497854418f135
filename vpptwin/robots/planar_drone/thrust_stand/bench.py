"""Thrust-stand runs: read, checked, and cut into stretches in which nothing was changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path

import numpy as np

from vpptwin.estimation.series import interpolate
from vpptwin.logs.flight import Flight
from vpptwin.logs.read import read_flight
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError

WRENCH, COMMAND, STATE = "/thrust_stand/wrench", "/rotor/command", "/rotor/state"
TURNING = 0.2
"""A rotor turns that is faster than this share of its governed speed."""
SETTLE, HOLD = 0.25, 0.15
"""After a change of pitch or throttle a stretch settles for so long, and counts if it is held for as long again [s]."""
STILL = 1e-4
"""Pitch commands that differ by less are the same one [rad]."""
SAME = 0.002
"""Held pitches that round to the same multiple of this are one [rad]."""
PITCH_LEVELS, SPEED_SPREAD = 5, 0.05
"""Least number of different pitches, and least share by which rotor speeds have to differ."""


@dataclass(frozen=True, kw_only=True)
class Readings:
    """What a stand tells at n times; only the rotors that turn, r of them."""

    pitch: np.ndarray  # commanded, (n, r) rad
    throttle: np.ndarray  # commanded, (n, r)
    speed: np.ndarray  # (n, r) rad/s
    current: np.ndarray  # (n, r) A
    thrust: np.ndarray  # of all together, (n,) N
    torque: np.ndarray | None  # likewise about the thrust axis, (n,) N m; None where the stand has no such channel
    voltage: np.ndarray  # of the battery, (n,) V


@dataclass(frozen=True, kw_only=True)
class BenchRun(Readings):
    """One run on one grid of time."""

    path: Path  # of the log
    dt: float  # s
    warnings: list[str]  # about the log

    @property
    def time(self) -> np.ndarray:
        """From the first reading, (n,) s."""
        return self.dt * np.arange(len(self.thrust))


@dataclass(frozen=True, kw_only=True)
class Levels(Readings):
    """Means over stretches in which nothing was changed."""

    run: np.ndarray  # index of the run, (n,)
    slope: np.ndarray  # what speed changes by meanwhile, (n, r) rad/s²

    @property
    def group(self) -> np.ndarray:
        """Which of the different pitches of the first rotor each has, (n,)."""
        return np.unique(np.round(self.pitch[:, 0] / SAME), return_inverse=True)[1]


def read_bench(path: Path, vehicle: Vehicle, topic_map: Path | None = None) -> BenchRun:
    """Read one run.

    Args:
        path: MCAP log with the topics of a thrust stand (docs/logs.md).
        vehicle: gives the inner rate, and the voltage where the log has none.
        topic_map: as of every command that reads logs.
    """
    flight = read_flight(path, topic_map)
    check_topics(flight)
    command, state, wrench = (flight.streams[topic] for topic in (COMMAND, STATE, WRENCH))
    if "current" not in state.values:
        found, needed = f"{path}: no current in {STATE}", "current, for motor and drag constants"
        raise InputError(found, needed, "record it")
    dt = 1.0 / vehicle.control.inner_rate
    begin = max(stream.time[0] for stream in (command, state, wrench))
    end = min(stream.time[-1] for stream in (command, state, wrench))
    time = np.arange(begin, end, dt)
    if len(time) < 2:
        raise InputError(f"{path}: command, state and wrench do not overlap in time", "one clock", "check the stamps")
    turning = np.median(state["speed"], axis=0) > TURNING * vehicle.rotor.speed
    if not turning.any():
        fastest = float(np.median(state["speed"], axis=0).max())
        found = f"{path}: no rotor turns, the faster one at {fastest:.0f} rad/s"
        raise InputError(found, f"about {vehicle.rotor.speed:.0f} rad/s", "spin one up, or check the unit")
    battery = flight.streams.get("/battery")
    voltage = np.full(len(time), vehicle.motor.battery)
    if battery is not None and "voltage" in battery.values:
        voltage = np.interp(time, battery.time, battery["voltage"])
    held = np.clip(np.searchsorted(command.time, time + 1e-9, side="right") - 1, 0, None)
    pitch, throttle = (command[name][held][:, turning] for name in ("blade_pitch", "throttle"))
    speed, current = (interpolate(time, state.time, state[name])[:, turning] for name in ("speed", "current"))
    thrust = np.interp(time, wrench.time, wrench["force_z"])
    torque = np.interp(time, wrench.time, wrench["torque_z"]) if "torque_z" in wrench.values else None
    return BenchRun(
        path=path, dt=dt, pitch=pitch, throttle=throttle, speed=speed, current=current, thrust=thrust, torque=torque,
        voltage=voltage, warnings=[f"{flight.name}: {text}" for text in flight.warnings],
    )  # fmt: skip


def check_topics(flight: Flight) -> None:
    """Refuse a log that lacks a topic, saying which constants it takes."""
    for topic, constants in (
        (WRENCH, "the thrust map and the servo's lag and delay"),
        (STATE, "drag and motor constants"),
        (COMMAND, "everything"),
    ):
        if topic not in flight.streams:
            found = f"{flight.path} has no messages on {topic}, only on {', '.join(sorted(flight.streams)) or 'others'}"
            raise InputError(found, f"{topic}, for {constants}", "record it, or name it in a topic map")


def find_levels(runs: Sequence[BenchRun]) -> Levels:
    """Average the stretches of all runs in which no pitch command changes."""
    stretches: list[tuple[int, slice]] = []
    for number, run in enumerate(runs):
        changed = (np.abs(np.diff(run.pitch, axis=0)) > STILL).any(axis=1)
        edges = np.concatenate([[0], np.flatnonzero(changed) + 1, [len(run.pitch)]])
        settle, hold = round(SETTLE / run.dt), round(HOLD / run.dt)
        kept = [(start + settle, end) for start, end in pairwise(edges) if end - start >= settle + hold]
        stretches += [(number, slice(*ends)) for ends in kept]

    def average(name: str) -> np.ndarray:
        return np.array([getattr(runs[number], name)[part].mean(axis=0) for number, part in stretches])

    slopes = [np.polyfit(runs[i].time[part], runs[i].speed[part], 1)[0] for i, part in stretches]
    torque = None if any(run.torque is None for run in runs) else average("torque")
    means = {f.name: average(f.name) for f in fields(Readings) if f.name != "torque"}
    levels = Levels(run=np.array([i for i, _ in stretches]), slope=np.array(slopes), torque=torque, **means)
    names, pitches = ", ".join(str(run.path) for run in runs), len(np.unique(levels.group)) if stretches else 0
    if pitches < PITCH_LEVELS:
        raise InputError(
            f"{names}: {pitches} different pitches held for {SETTLE + HOLD:g} s and more",
            f"{PITCH_LEVELS} at least, of both signs, for the thrust map and for k_d1, k_d2, k_d3",
            "step through more pitches, or hold each for longer",
        )
    speeds = levels.speed.mean(axis=1)
    if np.ptp(speeds) < SPEED_SPREAD * speeds.mean():
        raise InputError(
            f"{names}: one rotor speed, {speeds.mean():.0f} rad/s",
            f"speeds that differ by {SPEED_SPREAD:.0%} and more, for no_load_current, k_d1, k_v and resistance",
            "add a run at another speed",
        )
    return levels
