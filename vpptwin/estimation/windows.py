"""Short stretches of a flight, each with the commands that drive the twin through it and the state it starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from vpptwin.estimation.initial import SMOOTH, estimate_states, fit_end, follow_log, limit_times
from vpptwin.estimation.series import Measurements, Series, interpolate
from vpptwin.twin.robot.manifold import integrate_pose
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.state import TwinState
from vpptwin.twin.stepping.recall import Past
from vpptwin.twin.twin import Driven, Twin

SPIN_SPAN = 0.01
"""Rotor speeds this long around a window's start, or as long before it, tell the speed there [s]."""


@dataclass(frozen=True)
class Windows:
    """K windows of equal length, possibly from several flights.

    Attributes:
        flight: index of each window's flight, (K,).
        start: start time on its flight's clock, (K,) s.
        steps: inner steps in a window.
        dt: inner step [s].
        warm: past commands, (R, warm steps, nu).
        past: in which row of these its own are, (K,).
        command: actuator commands, mean over each step, (K, steps, nu).
        rotor_speed: measured rotor speed, mean over each step, (K, steps, 2); None where it was not measured.
        pose: estimated pose at the start, (K, nq).
        velocity: estimated velocity at the start, (K, nv).
        driven: tracks of joints that follow the log; None where there are none.
        throttle: mean over each step, (K, steps, 2); None where it or the rotor speed is not known.
        spin: estimated rotor speed at the start, (K, 2) rad/s; None where there is no throttle.
    """

    flight: np.ndarray
    start: np.ndarray
    steps: int
    dt: float
    warm: np.ndarray
    past: np.ndarray
    command: np.ndarray
    rotor_speed: np.ndarray | None
    pose: np.ndarray
    velocity: np.ndarray
    driven: Driven | None = None
    throttle: np.ndarray | None = None
    spin: np.ndarray | None = None

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.start)

    @property
    def free_dofs(self) -> int:
        """Degrees of freedom that are simulated."""
        return self.velocity.shape[1] - (0 if self.driven is None else len(self.driven.dofs))

    def take(self, ids: np.ndarray) -> Windows:
        """Some of the windows; repeats are allowed."""
        driven = self.driven and Driven(self.driven.dofs, self.driven.pose[ids], self.driven.velocity[ids])
        return replace(self, driven=driven, **{name: rows[ids] for name, rows in self.known_rows().items()})

    def known_rows(self) -> dict[str, Any]:
        """The arrays with a row a window, by name, but those that are not known and the tracks of driven joints."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in arrays.items() if isinstance(value, np.ndarray) and name != "warm"}

    def part(self, first: int, count: int, pose: np.ndarray, velocity: np.ndarray) -> Windows:
        """So many steps from the first on, of windows without driven joints, and the states before them."""
        steps = slice(first, first + count)
        lasting = {"command": self.command, "rotor_speed": self.rotor_speed, "throttle": self.throttle}
        cut: dict[str, Any] = {name: rows if rows is None else rows[:, steps] for name, rows in lasting.items()}
        return replace(
            self, start=self.start + first * self.dt, steps=count, pose=pose, velocity=velocity, spin=None, **cut
        )

    def shift(self, model: mujoco.MjModel, pose: np.ndarray, velocity: np.ndarray) -> Windows:
        """The same windows with their starting states moved along tangent vectors, (K, nv) each."""
        moved = integrate_pose(model, self.pose, pose)
        return replace(self, pose=moved, velocity=self.velocity + velocity)


def average_held(series: Series, edges: np.ndarray) -> np.ndarray:
    """Mean over each cell between neighbouring `edges` (K, n + 1) of a value held from sample to sample, (K, n, nu)."""
    value = series.value[:, None] if series.value.ndim == 1 else series.value
    steps = np.diff(series.time)[:, None] * value[:-1]
    area = np.concatenate([np.zeros((1, value.shape[1])), np.cumsum(steps, axis=0)])
    index = np.clip(np.searchsorted(series.time, edges, side="right") - 1, 0, len(series.time) - 1)
    until = area[index] + (edges - series.time[index])[..., None] * value[index]
    return np.diff(until, axis=1) / np.diff(edges, axis=1)[..., None]


def average_sampled(series: Series, edges: np.ndarray) -> np.ndarray:
    """Mean over each cell of a quantity sampled at instants, by the trapezoid between samples, (K, n, k)."""
    at_edges = interpolate(edges, series.time, series.value)
    return 0.5 * (at_edges[:, 1:] + at_edges[:, :-1])


def cut_windows(
    spec: TwinSpec, measurements: Measurements, starts: np.ndarray, length: float, causal: bool, flight: int = 0
) -> Windows:
    """Cut windows out of one flight.

    Args:
        spec: the twin that will be driven through them.
        measurements: the flight.
        starts: (K,) s on the flight's clock.
        length: s.
        causal: estimate the starting states from the past only.
        flight: index to remember the flight by.
    """
    dt = float(spec.model.opt.timestep)
    steps, warm = round(length / dt), round(spec.robot.warm_up / dt)
    edges = starts[:, None] + dt * np.arange(-warm, steps + 1)
    command = average_held(measurements.command, edges)
    speed = throttle = spin = None
    if measurements.rotor_speed is not None:
        speed = average_sampled(measurements.rotor_speed, edges[:, warm:])
        if measurements.throttle is not None:
            throttle = average_held(measurements.throttle, edges[:, warm:])
            spin = estimate_spin(measurements.rotor_speed, starts, causal)
    pose, velocity = estimate_states(measurements, starts, spec.model, causal)
    driven = None
    if measurements.driven:
        driven = Driven(spec.robot.driven, *follow_log(measurements, edges[:, warm:-1], spec.model))
    return Windows(
        flight=np.full(len(starts), flight), start=starts, steps=steps, dt=dt, warm=command[:, :warm],
        past=np.arange(len(starts)), command=command[:, warm:], rotor_speed=speed, pose=pose, velocity=velocity,
        driven=driven, throttle=throttle, spin=spin,
    )  # fmt: skip


def estimate_spin(speed: Series, times: np.ndarray, causal: bool) -> np.ndarray:
    """Speeds of both rotors at `times` (K,), from a line through the samples around or before them, (K, 2) rad/s."""
    rotors = [replace(speed, value=speed.value[:, i]) for i in range(speed.value.shape[1])]
    return np.stack([fit_end(rotor, times, SPIN_SPAN, limit_times(times, causal)) for rotor in rotors], axis=1)


def join_windows(parts: list[Windows]) -> Windows:
    """All windows of several flights as one set."""
    tracks = [part.driven for part in parts if part.driven is not None]
    driven = None
    if tracks:
        pose, velocity = (np.concatenate([getattr(t, name) for t in tracks]) for name in ("pose", "velocity"))
        driven = Driven(tracks[0].dofs, pose, velocity)
    behind = np.cumsum([0, *(len(part.warm) for part in parts)])
    rows = [part.known_rows() | {"past": part.past + first} for part, first in zip(parts, behind)]
    known: dict[str, Any] = dict.fromkeys(rows[0])  # None where one part does not know it
    known |= {name: np.concatenate([r[name] for r in rows]) for name in known if all(name in r for r in rows)}
    return replace(parts[0], driven=driven, warm=np.concatenate([part.warm for part in parts]), **known)


class WindowMotion(NamedTuple):
    """What a twin does in K windows, at the start and after every step.

    Attributes:
        pose: (K, steps + 1, nq) m, rad.
        velocity: at the same times, (K, steps + 1, nv) m/s, rad/s.
        rotor_speed: of the simulated motors, (K, steps + 1, 2) rad/s; None where the throttle is not known.
    """

    pose: np.ndarray
    velocity: np.ndarray
    rotor_speed: np.ndarray | None

    def put(self, rows: tuple[Any, ...], part: WindowMotion) -> None:
        """Write another motion into some of the rows of this very one, which has more axes in front."""
        for whole, given in zip(self, part):
            if whole is not None:
                whole[rows] = given


def trace_past(spec: TwinSpec, flights: Sequence[Measurements], windows: Windows, causal: bool) -> Past:
    """How flights moved up to the start of their windows, at every step.

    With `causal` nothing is used of what comes after a window's start: what leads up to it is estimated anew for each.
    """
    model, dt, number = spec.model, windows.dt, len(windows)
    lead = round(SMOOTH / dt) if causal else 0
    stops, parts = np.zeros(number, int), list[tuple[np.ndarray, ...]]()
    for i in np.unique(windows.flight):
        rows = windows.flight == i
        ends = windows.start[rows] - lead * dt
        count = max(round((ends.min() - flights[i].start) / dt), 0)
        time = ends.min() + dt * np.arange(-count, round(float(np.ptp(ends)) / dt) + 1)
        stops[rows] = sum(part[0].size for part in parts) + np.round((ends - time[0]) / dt).astype(int)
        parts.append((time, *trace(flights[i], time, spec), np.arange(len(time)) == 0))
    qpos, qvel = np.empty((number, lead + 1, model.nq)), np.empty((number, lead + 1, model.nv))
    for i in np.unique(windows.flight):
        rows = windows.flight == i
        times = windows.start[rows][:, None] + dt * np.arange(-lead, 1)
        until = np.repeat(windows.start[rows] if causal else np.full(rows.sum(), np.inf), lead + 1)
        states = trace(flights[i], times.ravel(), spec, until)
        qpos[rows], qvel[rows] = (part.reshape(rows.sum(), lead + 1, -1) for part in states)
    time, *track, first = [np.concatenate(each) for each in zip(*parts)]
    return Past(time, track[0], track[1], first, stops, qpos, qvel)


def trace(
    flight: Measurements, times: np.ndarray, spec: TwinSpec, until: np.ndarray | float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """Positions as the engine has them, (T, nq), and velocities (T, nv) at `times` (T,), as `estimate_states`."""
    pose, velocity = estimate_states(flight, times, spec.model, False, np.broadcast_to(until, times.shape))
    return integrate_pose(spec.model, pose, 0.5 * float(spec.model.opt.timestep) * velocity), velocity


def fly_windows(
    twin: Twin, windows: Windows, disturbance: np.ndarray | None = None, past: np.ndarray | None = None
) -> WindowMotion:
    """Drive a twin of len(windows) simulations through the windows.

    Thrust goes by the measured rotor speed. Where the throttle is known, the motors run beside, from the measured
    speed at the start, as they do in the twin.

    Args:
        twin: one simulation a window.
        windows: the windows.
        disturbance: generalized force added, (K, segments, nv) N, N m; None for none.
        past: what it left in the effects: how far their states are from rest at the start, (K, S); None for none.
    """
    return fly_on(twin, enter_windows(twin, windows, past), windows, disturbance)[1]


def enter_windows(twin: Twin, windows: Windows, past: np.ndarray | None = None) -> TwinState:
    """The state of a twin at the start of the windows; as `fly_windows`."""
    qpos = twin.pose_for_engine(windows.pose, windows.velocity)
    start = twin.initial_state(qpos=qpos, qvel=windows.velocity, time=windows.start)
    layer = start.actuators
    begin = windows.warm[windows.past, 0]
    layer["horn"], layer["blade"], layer["history"] = begin, begin, begin[:, None]
    if windows.spin is not None:
        layer["rotor_speed"] = windows.spin
    start = replace(start, actuators=twin.warm_up(layer, windows.warm, windows.past))
    return start if past is None else replace(start, effects=start.effects + past)


def fly_on(
    twin: Twin, start: TwinState, windows: Windows, disturbance: np.ndarray | None = None
) -> tuple[TwinState, WindowMotion]:
    """Drive a twin through the windows from a state; the state after them, and what `fly_windows` returns."""
    after, qpos, qvel, rotor_speed = twin.trace_commands(
        start, windows.command, windows.rotor_speed, windows.throttle, disturbance, windows.driven
    )
    velocity = np.concatenate([qvel, after.qvel[:, None]], axis=1)
    qpos = np.concatenate([qpos, after.qpos[:, None]], axis=1)
    velocity[:, 0] = windows.velocity
    with np.errstate(invalid="ignore", over="ignore"):  # a twin that diverged shows that in what it predicts
        pose = twin.pose_at_time(qpos, velocity)
    pose[:, 0] = windows.pose  # joints that follow the log do so from there on
    if rotor_speed is not None:
        rotor_speed = np.concatenate([start.rotor_speed[:, None], rotor_speed], axis=1)
    return after, WindowMotion(pose, velocity, rotor_speed)
