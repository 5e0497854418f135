"""`vpptwin fly`: a pilot flies a twin, and its log is written."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vpptwin import __version__
from vpptwin.actuators.adaptive import DRAG, FAULT, FAULTS, HALF_GAP, TRIM
from vpptwin.logs.flight import Stream
from vpptwin.logs.write import Message, write_flight
from vpptwin.robots.planar_drone.pilot.flight import SETTLING, Pilot, SimulatedFlights, fly
from vpptwin.robots.planar_drone.pilot.gusts import CARRIERS, GustProcess
from vpptwin.robots.planar_drone.pilot.library import LIBRARY
from vpptwin.robots.planar_drone.pilot.recording import record_streams
from vpptwin.robots.planar_drone.pilot.safety import find_danger
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError
from vpptwin.system.terminal import open_console
from vpptwin.twin import Twin, TwinSpec


@dataclass(frozen=True)
class Sortie:
    """What a flight is to be."""

    spec: TwinSpec  # the twin
    out: Path  # log to write
    seed: int  # of noise and gusts
    gusts: bool  # whether gusts of 1 % of the weight blow
    about: Mapping[str, str]  # what is flown, stored in the log
    # what the log says besides, say for 3D panels: from twin and streams to messages in order of time
    describe: Callable[[TwinSpec, Mapping[str, Stream]], Iterable[Message]] = lambda spec, streams: ()


def check_out(out: Path | None) -> Path:
    """Refuse a log that cannot be written, before the flight rather than after it."""
    if out is None:
        raise InputError("no --out", "the log to write, e.g. --out flight.mcap", "name it")
    if out.is_dir():
        raise InputError(f"{out} is a folder", "a log to write", f"name a file, e.g. --out {out / 'flight.mcap'}")
    if not out.parent.is_dir():
        raise InputError(f"no folder {out.parent}", "an existing folder for --out", "make it, or choose another")
    return out


def fly_log(pilot: Pilot, sortie: Sortie) -> SimulatedFlights:
    """Fly once, write the log and say what happened.

    Raises:
        InputError: if the twin diverges or the log cannot be written; nothing is left behind then.
    """
    spec, vehicle = sortie.spec, sortie.spec.vehicle
    period = 1.0 / vehicle.control.policy_rate
    gusts = GustProcess(spec, 1, pilot.ticks + round(SETTLING / period), sortie.seed) if sortie.gusts else None
    twin = Twin(spec, 1, active=CARRIERS if gusts is not None else (), num_threads=1)
    tracks = fly(twin, pilot, sortie.seed, gusts)
    if np.isfinite(tracks.diverged[0]):
        found = f"twin {spec.name} diverges {max(float(tracks.diverged[0]), 0.0):.2f} s into the flight"
        advice = "look at the values of its effects, or fly something tamer"
        raise InputError(found, "a twin whose numbers stay finite", advice)
    metadata = {
        "vpptwin": __version__, "twin": spec.name, "effects": json.dumps(spec.effects), "seed": str(sortie.seed),
        "gusts": str(sortie.gusts).lower(), "controller": spec.controller, **sortie.about,
    }  # fmt: skip
    streams = record_streams(tracks)
    write_flight(sortie.out, streams, metadata=metadata, messages=sortie.describe(spec, streams))
    describe_flight(tracks, vehicle, sortie)
    return tracks


def describe_flight(tracks: SimulatedFlights, vehicle: Vehicle, sortie: Sortie) -> None:
    """Print how the flight went and where its log lies."""
    lead, lead_ticks = tracks.lead
    pose = tracks.pose[0, lead:]
    each = round(tracks.period / tracks.step)
    off = np.hypot(*(tracks.target[0, lead_ticks:, :2] - pose[::each, :2]).T)
    console = open_console()
    what = ", ".join(f"{key} {value}" for key, value in sortie.about.items())
    console.print(f"{what}: {len(pose) * tracks.step:g} s in twin {sortie.spec.name}", soft_wrap=True)
    (low_x, low_z), (high_x, high_z) = pose[:, :2].min(axis=0), pose[:, :2].max(axis=0)
    where = f"x {low_x:.2f} to {high_x:.2f} m, z {low_z:.2f} to {high_z:.2f} m"
    console.print(f"{where}, {1000 * off.mean():.0f} mm off its target on average")
    for line in describe_learned(tracks.actuators["adaptive"][0]):
        console.print(line, soft_wrap=True)
    danger = find_danger(vehicle, pose, tracks.velocity[0, lead:])
    if danger:
        console.print(f"not to be flown on a real rig: {danger}", style="bold")
    console.print(f"log: {sortie.out}", soft_wrap=True)


def describe_learned(memories: np.ndarray) -> list[str]:
    """What the adaptive controller of each rotor believes at the end of a flight, (2, SIZE), or (2, 0) without one."""
    lines = []
    for rotor, memory in enumerate(memories, 1):
        if not len(memory):
            continue
        trim, gap, drag = 1000.0 * memory[TRIM], 2000.0 * memory[HALF_GAP], memory[DRAG]
        fault = FAULTS[int(memory[FAULT])]
        lines.append(
            f"rotor {rotor} learned: trim {trim:+.1f} mrad, play {gap:.1f} mrad, drag {drag:.2f} of the map's"
            + (f"; flies by the map alone: {fault}" if fault else "")
        )
    return lines


def print_library() -> None:
    """List every manoeuvre with its settings and what it reveals."""
    console = open_console()
    for manoeuvre in LIBRARY:
        console.print(f"{manoeuvre.name}: {manoeuvre.summary}", style="bold")
        console.print(f"    shows {', '.join(manoeuvre.reveals)}", soft_wrap=True)
        for s in manoeuvre.settings:
            bounds = f"{s.low:g} to {s.high:g} {s.unit}".rstrip()
            text = f"    --set {s.name}={s.default:g}  {bounds}, {s.meaning}"
            console.print(text, soft_wrap=True)
