"""What is played: a log, perhaps a twin and a target, sampled at common frames on one rig."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec
from vpptwin.viz.scene.motion import (
    Motion,
    Target,
    choose_frames,
    count_frames,
    find_positions,
    read_target,
    sample_flight,
    sample_prediction,
)
from vpptwin.viz.scene.scene import fit_craft

if TYPE_CHECKING:
    from vpptwin.estimation.replay import Prediction
    from vpptwin.logs.flight import Flight


@dataclass(frozen=True)
class Show:
    """Everything to play."""

    model: mujoco.MjModel  # the rig
    rotorcraft: Vehicle | None  # numbers of the rotors that are drawn; None where there are none
    followed: int  # index of the body that the view and a trail follow; -1 for none
    frames: np.ndarray  # (T,) frame times [s of the log]
    log: Motion  # the log's motion at the frames
    twin: Motion | None  # the prediction's motion at the frames
    target: Target | None  # the setpoint, if the log has one

    @property
    def time(self) -> np.ndarray:
        """Frame times (T,) from the first frame [s]."""
        return self.frames - self.frames[0]


def prepare_show(flight: Flight, prediction: Prediction | None, spec: TwinSpec) -> Show:
    """Sample a log and a prediction at the frames of an animation.

    Args:
        flight: the log.
        prediction: the twin's motion under the log's commands; None for the log alone.
        spec: the rig to draw.

    Raises:
        InputError: if the log lacks the positions of the rig, or is too short to play.
    """
    model, rotorcraft = copy.deepcopy(spec.model), spec.robot.rotorcraft
    positions = find_positions(spec.robot, flight)
    start = min(float(time[0]) for time, _ in positions.values())
    end = max(float(time[-1]) for time, _ in positions.values())
    if end <= start:
        raise InputError(f"{flight.path}: a single position", "at least two to play", "record a longer log")
    if rotorcraft is not None:
        fit_craft(model, rotorcraft)
    frames = choose_frames(start, end, most=count_frames(model, 1 if prediction is None else 2))
    followed = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, spec.robot.followed)
    log = sample_flight(flight, model, rotorcraft, positions, frames)
    twin = None if prediction is None else sample_prediction(prediction, rotorcraft, frames)
    return Show(model, rotorcraft, followed, frames, log, twin, read_target(flight, start, end))
