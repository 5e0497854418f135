"""A picture of what an effect does: how a twin that has it departs from one that has not, over one flight."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from vpptwin.effects import Effect
from vpptwin.robots.planar_drone.pilot import Script, pilot_commands
from vpptwin.system.files import check_own, check_target, write_files
from vpptwin.twin import Twin, TwinSpec, TwinState
from vpptwin.twin.sensors import age_of_pose, measure_pose, measure_rate
from vpptwin.viz.plots.figure import find_loudest
from vpptwin.viz.plots.palette import BLUE, VERMILION

STRETCH = 0.05
"""The two twins start anew from the same state every so often [s]."""
DURATION = 9.0
"""Of the flight [s]: steps along x and z, a flip, steps inverted, a flip back."""
SIZES = 5.0
"""A parameter is shown this many of its typical sizes away from off."""
INK = "#7f7f7f"  # legible on white and on black
FLIGHT = Script(
    np.array([0.0, 1.2, 2.4, 3.6, 4.8, 6.0, 7.5]),
    np.array(
        [[-0.5, 1.4, 0], [0.5, 1.4, 0], [0.5, 1.9, 0], [0, 1.2, 0], [0, 1.5, np.pi], [-0.4, 1.5, np.pi], [0, 1.4, 0]]
    ),
)
START = np.array([0.0, 1.4, 0.0])


@dataclass(frozen=True)
class Trace:
    """One signal's departure."""

    name: str  # of the signal, with its unit in brackets
    axis: int  # degree of freedom that it belongs to; 3 for rotor 1
    departure: np.ndarray  # with the effect less without, (K,)
    noise: float  # what is hardly seen


@dataclass(frozen=True)
class Fingerprint:
    """What an effect does over a flight, K stretches."""

    effect: Effect  # the effect
    values: dict[str, float]  # its parameters as shown
    time: np.ndarray  # of the stretches' starts, (K,) s
    trace: Trace  # the signal that shows it best
    cause: np.ndarray  # what the effect follows, (K,)
    cause_name: str  # with its unit in brackets


def take_fingerprint(spec: TwinSpec, effect: Effect) -> Fingerprint:
    """Fly without the effect; from every stretch's start let two twins go on under the same commands, one with it.

    Args:
        spec: the drone.
        effect: of its catalogue.
    """
    active = [effect.id, *effect.modifies]
    states, commands = fly(spec, tuple(active))
    count = len(states.time)
    ends, twins = [], []
    for on in (False, True):
        twin = Twin(spec, count, active=active, num_threads=1)
        for other in active:
            for i, p in enumerate(twin.effects[other].parameters):
                shown = p.away(SIZES) if i == 0 else p.off
                twin.set_parameter(other, p.name, shown if on or other != effect.id else p.off)
        state = states.copy()
        state.effects[:] = twin.initial_state(states.qpos, states.qvel).effects  # those of what was off are old
        for k in range(commands.shape[1]):
            twin.advance_policy(state, commands[:, k])
        ends.append(state)
        twins.append(twin)
    traces = list(compare(twins[1], *ends))
    best = traces[find_loudest(trace.departure / trace.noise for trace in traces)[0]]
    cause, name = follow(effect, best.axis, states, ends[0], commands)
    values = {p.name: float(twins[1].parameter(effect.id, p.name)[0]) for p in effect.parameters}
    return Fingerprint(effect, values, states.time, best, cause, name)


def fly(spec: TwinSpec, active: tuple[str, ...]) -> tuple[TwinState, np.ndarray]:
    """The flight: states at the start of every stretch, K of them, and the commands in it, (K, steps, 2) N, rad/s."""
    twin = Twin(spec, 1, active=active, num_threads=1)
    for effect_id in active[1:]:  # what the effect modifies is there in both
        strength = twin.effects[effect_id].parameters[0]
        twin.set_parameter(effect_id, strength.name, strength.away(SIZES))
    vehicle, state = twin.vehicle, twin.initial_state(START)
    period = 1.0 / vehicle.control.policy_rate
    each = round(STRETCH / period)
    kept: list[TwinState] = []
    commands = []
    for k in range(round(DURATION / period)):
        if k % each == 0:
            kept.append(state)
        command = pilot_commands(vehicle, state.qpos, state.qvel, FLIGHT.at(k * period))
        commands.append(command[0])
        state = twin.step_policy(state, command, period)
    joined = {name: np.concatenate([s.arrays()[name] for s in kept]) for name in state.arrays()}
    return TwinState.from_arrays(joined), np.array(commands).reshape(len(kept), each, 2)


def compare(twin: Twin, without: TwinState, having: TwinState) -> Iterator[Trace]:
    """The departures at the ends of the stretches: accelerations, rotor speed, what sensors add."""
    gained = (having.qvel - without.qvel) / STRETCH
    for axis, name, noise in ((0, "ẍ [m/s²]", 0.05), (1, "z̈ [m/s²]", 0.05), (2, "θ̈ [rad/s²]", 0.5)):
        yield Trace(name, axis, gained[:, axis], noise)
    speed = having.rotor_speed - without.rotor_speed
    yield Trace("rotor 1\nspeed [rad/s]", 3, speed[:, 0], 1.0)
    pose, velocity = without.qpos, without.qvel
    late = pose - age_of_pose(twin.constants, without.time)[:, None] * velocity
    seen = 1000 * (measure_pose(twin.constants, late) - pose)
    for axis, name, noise in ((0, "x [mm]", 0.4), (1, "z [mm]", 0.4), (2, "θ [mrad]", 3.0)):
        yield Trace(f"measured\n{name}", axis, seen[:, axis], noise)
    yield Trace("measured\nq [rad/s]", 2, measure_rate(twin.constants, velocity[:, 2]) - velocity[:, 2], 0.02)


def follow(
    effect: Effect, axis: int, states: TwinState, ends: TwinState, commands: np.ndarray
) -> tuple[np.ndarray, str]:
    """What an effect on an axis follows, at the middle of every stretch, (K,), and its name."""
    if axis == 3:
        return states.blade_pitch[:, 0], "blade pitch [rad]"
    if effect.follows in ("velocity", "position"):
        start, end = (getattr(s, "qvel" if effect.follows == "velocity" else "qpos") for s in (states, ends))
        names = {"velocity": ("ẋ [m/s]", "ż [m/s]", "q [rad/s]"), "position": ("x [m]", "z [m]", "θ [rad]")}
        return 0.5 * (start + end)[:, axis], names[effect.follows][axis]
    pitch = 0.5 * (states.blade_pitch + ends.blade_pitch)
    change = (ends.blade_pitch - states.blade_pitch) / STRETCH
    wanted = pitch if effect.follows == "command" else change
    unit = "[rad]" if effect.follows == "command" else "[rad/s]"
    if axis == 2:
        return wanted[:, 1] - wanted[:, 0], f"difference of blade pitch {unit}"
    return wanted.sum(axis=1), f"sum of blade pitch {unit}"


def draw_fingerprint(print_: Fingerprint) -> bytes:
    """The picture, a PNG: the departure over time, and over what the effect follows."""
    style: dict[Any, object] = {"font.size": 7.0, "axes.spines.top": False,
             "axes.spines.right": False, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK,
             "xtick.color": INK, "ytick.color": INK, "axes.linewidth": 0.6}  # fmt: skip
    content = io.BytesIO()
    with mpl.rc_context(style):
        figure = Figure(figsize=(3.6, 1.25), layout="constrained")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2, sharey=True)
        left.plot(print_.time, print_.trace.departure, color=BLUE, linewidth=0.9)
        left.set_xlabel("time [s]")
        left.set_ylabel(print_.trace.name)
        right.plot(print_.cause, print_.trace.departure, ".", color=VERMILION, markersize=2.2, markeredgewidth=0.0)
        right.set_xlabel(print_.cause_name)
        for axes in (left, right):
            axes.axhline(0.0, color=INK, linewidth=0.4)
        figure.savefig(content, format="png", dpi=150, transparent=True, metadata={"Software": "vpptwin"})
    return content.getvalue()


def draw_catalogue(spec: TwinSpec, folder: Path, force: bool = False) -> list[Path]:
    """Write a picture of every effect of a drone's catalogue that acts in flight into a folder, `ID.png`."""
    flown = [effect for effect in spec.catalogue if not effect.touching]
    files = [folder / f"{effect.id}.png" for effect in flown]
    check_target(files[0])
    if not force:
        check_own(files)
    return write_files({file: draw_fingerprint(take_fingerprint(spec, effect)) for file, effect in zip(files, flown)})
