"""What moves on screen: logs and predictions sampled at the frames of an animation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from vpptwin.actuators.blade import compute_thrust
from vpptwin.estimation.joints import straighten_joint
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.manifold import BALL, FREE, follow_sign
from vpptwin.twin.robot.robot import Robot, by_robot
from vpptwin.twin.robot.signals import Tracked, turn_from_parent

if TYPE_CHECKING:
    from vpptwin.estimation.replay import Prediction
    from vpptwin.logs.flight import Flight, Stream

FRAME_RATE = 50.0  # Hz
MOST_NUMBERS = 1_200_000  # in all tracks of a page, 6.4 MB of it; longer logs get fewer frames a second
NUMBERS_OF_BODY = 9  # a frame of a body: position, quaternion and their two times
NUMBERS_OF_ROTORS = 40  # a frame of both rotors: turn, pitch of two blades, arrows, and the times of each
TRAIL_DURATION = 1.5  # s of the past that the trail of a craft shows
LONGEST_GAP = 0.03  # s without a sample of the prediction after which the twin is hidden


@dataclass(frozen=True)
class Rotors:
    """Both rotors at T frames, (T, 2) each, or at one time, (2,): turned, blade pitch [rad], thrust along z [N]."""

    angle: np.ndarray
    blade_pitch: np.ndarray
    thrust: np.ndarray


@dataclass(frozen=True)
class Motion:
    """One craft or rig at the frames of an animation."""

    qpos: np.ndarray  # (T, nq) joint positions in the model's order [m, rad]
    shown: np.ndarray  # (T,) false where nothing is known
    rotors: Rotors | None = None  # None for rigs without rotors and logs without rotor channels


@dataclass(frozen=True)
class Target:
    """Setpoint at its changes: time (k,) [s], x, z [m] and theta [rad], each (k,)."""

    time: np.ndarray
    x: np.ndarray
    z: np.ndarray
    theta: np.ndarray


Positions = dict[int, tuple[np.ndarray, np.ndarray]]


@by_robot
def find_positions(robot: Robot, flight: Flight) -> Positions:
    """Joint positions and poses of bodies that the log holds.

    Returns:
        qpos index -> time (n,) [s], position (n,) [m or rad], or number of a quaternion.

    Raises:
        InputError: if the log holds no position of our craft, or of any joint or body that the twin's signals name.
    """
    model = robot.model
    found: Positions = {}
    for tracked in robot.tracked:
        place, stream = int(model.jnt_qposadr[tracked.joint]), flight.joints.get(tracked.topic, {}).get(tracked.name)
        whole = None if stream is None else straighten_joint(model, tracked, stream)[0]
        if whole is not None and "position" in whole.values:
            found[place] = (whole.time, whole["position"])
        elif (poses := place_body(model, tracked, flight)) is not None:
            found |= {place + i: (poses[0], column) for i, column in enumerate(poses[1].T)}
    if not found:
        named = " or ".join(f"{tracked.name} on {tracked.topic}" for tracked in robot.tracked)
        present = ", ".join([*flight.streams, *flight.joints, *flight.spatial]) or "none"
        advice = "correct `signals` of the twin or use a topic map"
        wanted = f"the position of {named or 'a joint'}"
        raise InputError(f"{flight.path}: no position to draw, topics {present}", wanted, advice)
    return found


def place_body(model: mujoco.MjModel, tracked: Tracked, flight: Flight) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (n,) [s] and the numbers of a joint that turns any way, (n, 7) or (n, 4), as a log has them."""
    stream, kind = flight.spatial.get(tracked.topic), model.jnt_type[tracked.joint]
    if stream is None or kind not in (FREE, BALL) or "attitude" not in stream.values:
        return None
    attitude = follow_sign(stream["attitude"])
    if kind == FREE:
        return stream.time, np.concatenate([stream["position"], attitude], axis=1)
    return stream.time, turn_from_parent(model, tracked, attitude)


def choose_frames(start: float, end: float, most: int) -> np.ndarray:
    """Frame times (T,) [s] from start to end: 50 a second, or fewer where that would be more than `most` frames."""
    count = int(np.clip(round((end - start) * FRAME_RATE) + 1, 2, most))
    return np.linspace(start, end, count)


def count_frames(model: mujoco.MjModel, copies: int) -> int:
    """How many frames a page has room for, with so many copies of the rig moving."""
    bodies = int(np.count_nonzero(model.body_weldid))
    return max(MOST_NUMBERS // (copies * (NUMBERS_OF_BODY * bodies + NUMBERS_OF_ROTORS)), 2)


def hold(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The value that acts at each time: the last one stamped at or before it, the first one before that."""
    return values[np.clip(np.searchsorted(time, at, side="right") - 1, 0, None)]


def interpolate(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Linear interpolation of (n,) or (n, k) values."""
    if values.ndim == 1:
        return np.interp(at, time, values)
    return np.stack([np.interp(at, time, column) for column in values.T], -1)


def sample_rotors(flight: Flight, vehicle: Vehicle, at: np.ndarray) -> Rotors | None:
    """Rotors of the log, at the governed speed where it has none; thrust follows from the commanded pitch."""
    command: Stream | None = flight.streams.get("/rotor/command")
    state: Stream | None = flight.streams.get("/rotor/state")
    if command is None:
        return None
    pitch = hold(command.time, command["blade_pitch"], at)
    if state is None:
        return turn_rotors(at, np.full((len(at), 2), vehicle.rotor.speed), pitch, at, vehicle)
    return turn_rotors(state.time, state["speed"], pitch, at, vehicle)


def turn_rotors(time: np.ndarray, speed: np.ndarray, pitch: np.ndarray, at: np.ndarray, vehicle: Vehicle) -> Rotors:
    """Rotors at the frames from speed (n, 2) [rad/s] at time (n,) and blade pitch (T, 2) [rad]."""
    step = 0.5 * (speed[1:] + speed[:-1]) * np.diff(time)[:, None]
    angle = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    thrust = compute_thrust(vehicle.rotor, interpolate(time, speed, at), pitch)
    return Rotors(interpolate(time, angle, at), pitch, thrust)


def sample_flight(
    flight: Flight, model: mujoco.MjModel, rotorcraft: Vehicle | None, positions: Positions, at: np.ndarray
) -> Motion:
    """The log at the frame times at (T,) [s], with rotors if any; joints that it lacks stay where they start."""
    qpos = np.tile(model.qpos0, (len(at), 1))
    for address, (time, position) in positions.items():
        qpos[:, address] = np.interp(at, time, position)
    rotors = None if rotorcraft is None else sample_rotors(flight, rotorcraft, at)
    return Motion(qpos, np.ones(len(at), dtype=bool), rotors)


def sample_prediction(prediction: Prediction, rotorcraft: Vehicle | None, at: np.ndarray) -> Motion:
    """The twin at the frame times; hidden where the prediction has no finite sample nearby."""
    known = np.isfinite(prediction.qpos).all(axis=1)
    if not known.any():
        raise InputError("a prediction without one finite state", "at least one", "check the twin and the log")
    time, qpos = prediction.time[known], prediction.qpos[known]
    after = np.clip(np.searchsorted(time, at), 1, max(len(time) - 1, 1))
    nearest = np.minimum(np.abs(at - time[after - 1]), np.abs(at - time[np.minimum(after, len(time) - 1)]))
    rotors = None
    if rotorcraft is not None:
        pitch = hold(time, prediction.blade_pitch[known], at)
        rotors = turn_rotors(time, prediction.rotor_speed[known], pitch, at, rotorcraft)
    return Motion(interpolate(time, qpos, at), nearest <= LONGEST_GAP, rotors)


def read_target(flight: Flight, start: float, end: float) -> Target | None:
    """The setpoint between start and end [s], times from start; None if the log has none."""
    stream = flight.streams.get("/setpoint/pose")
    if stream is None or len(stream.time) == 0 or stream.time[0] > end:
        return None
    first = max(int(np.searchsorted(stream.time, start, side="right")) - 1, 0)
    inside = slice(first, int(np.searchsorted(stream.time, end, side="right")))
    x, z, theta = (stream[column][inside] for column in ("x", "z", "theta"))
    return Target(np.maximum(stream.time[inside] - start, 0.0), x, z, theta)
