"""The craft as it is drawn: where its rotors are, and how they turn, pitch and push at the frames of an animation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from vpptwin.actuators.blade import compute_thrust
from vpptwin.estimation.series import integrate, interpolate
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.viz.plots.palette import DISC, to_rgb

if TYPE_CHECKING:
    from vpptwin.logs.flight import Flight

TURN_SLOWDOWN = 20.0  # rotors are drawn this much slower, so that 75 turns a second do not alias at 50 frames a second
PITCH_EXAGGERATION = 2.5  # blade pitch is drawn this much larger: its 12 degrees are a few pixels
ARROW_LENGTH = 0.45  # m, arrow of the rotor's largest thrust
ROOT_RADIUS, CHORD, THICKNESS = 0.012, 0.030, 0.003  # m, of a blade
HEAD_RADIUS, HEAD_HEIGHT, SHAFT_RADIUS = 0.022, 0.05, 0.008  # m, of an arrow
SHORTEST_ARROW = 1e-3  # m; three.js cannot invert a scale of zero
TURN_SIGNS = (1.0, -1.0)  # the rotors turn against each other, so that their drag torques cancel


@dataclass(frozen=True)
class RotorMotion:
    """Both rotors at T frames, (T, 2) each: turned [rad], blade pitch [rad], thrust along z [N]."""

    angle: np.ndarray
    blade_pitch: np.ndarray
    thrust: np.ndarray


@dataclass(frozen=True)
class SetpointChanges:
    """Setpoint at its changes: time (k,) [s], x, z [m] and theta [rad], each (k,)."""

    time: np.ndarray
    x: np.ndarray
    z: np.ndarray
    theta: np.ndarray


def find_craft(model: mujoco.MjModel) -> int:
    """The body of our craft: the one that carries the pitch joint."""
    return int(model.jnt_bodyid[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "pitch")])


def find_rotor(model: mujoco.MjModel, vehicle: Vehicle, number: int) -> tuple[np.ndarray, float]:
    """Hub position (3,) in the craft's frame [m] and radius [m] of rotor 1 or 2, the latter from the MJCF's disc."""
    side = -1.0 if number == 1 else 1.0
    disc = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"disc_{number}")
    height, radius = (model.geom_pos[disc, 2], model.geom_size[disc, 0]) if disc >= 0 else (0.02, 0.13)
    return np.array([side * vehicle.airframe.half_length, 0.0, height]), float(radius)


def fit_craft(model: mujoco.MjModel, vehicle: Vehicle) -> None:
    """Stretch the drawn arm to the vehicle's half length and grey the discs, since colours have other meanings here."""
    disc = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "disc_2")
    if disc < 0:
        return
    stretch = vehicle.airframe.half_length / model.geom_pos[disc, 0]
    on_craft = model.geom_bodyid == find_craft(model)
    boxes = on_craft & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    model.geom_pos[on_craft, 0] *= stretch
    model.geom_size[boxes, 0] *= stretch
    discs = on_craft & (model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER)
    model.geom_rgba[discs, :3] = to_rgb(DISC)


def hold(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The value that acts at each time: the last one stamped at or before it, the first one before that."""
    return values[np.clip(np.searchsorted(time, at, side="right") - 1, 0, None)]


def turn_rotors(
    time: np.ndarray, speed: np.ndarray, pitch: np.ndarray, at: np.ndarray, vehicle: Vehicle
) -> RotorMotion:
    """Rotors at the frames from speed (n, 2) [rad/s] at time (n,) and blade pitch (T, 2) [rad]."""
    angle = integrate(speed, time)  # φ = ∫ ω dt
    thrust = compute_thrust(vehicle.rotor, interpolate(at, time, speed), pitch)
    return RotorMotion(interpolate(at, time, angle), pitch, thrust)


def sample_rotors(flight: Flight, vehicle: Vehicle, at: np.ndarray) -> RotorMotion | None:
    """Rotors of the log, at the governed speed where it has none; thrust follows from the commanded pitch."""
    command, state = flight.streams.get("/rotor/command"), flight.streams.get("/rotor/state")
    if command is None:
        return None
    pitch = hold(command.time, command["blade_pitch"], at)
    if state is None:
        return turn_rotors(at, np.full((len(at), 2), vehicle.rotor.speed), pitch, at, vehicle)
    return turn_rotors(state.time, state["speed"], pitch, at, vehicle)


def read_setpoint(flight: Flight, start: float, end: float) -> SetpointChanges | None:
    """The setpoint between start and end [s], times from start; None if the log has none."""
    stream = flight.streams.get("/setpoint/pose")
    if stream is None or len(stream.time) == 0 or stream.time[0] > end:
        return None
    first = max(int(np.searchsorted(stream.time, start, side="right")) - 1, 0)
    inside = slice(first, int(np.searchsorted(stream.time, end, side="right")))
    x, z, theta = (stream[column][inside] for column in ("x", "z", "theta"))
    return SetpointChanges(np.maximum(stream.time[inside] - start, 0.0), x, z, theta)
