"""What is played: a log, perhaps a twin and a target, sampled at common frames on one rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from vpptwin.errors import InputError
from vpptwin.resources import find_model_file
from vpptwin.vehicle import Vehicle, load_vehicle
from vpptwin.viz.motion import (
    Motion,
    Target,
    choose_frames,
    has_craft,
    read_joints,
    read_target,
    sample_flight,
    sample_prediction,
)
from vpptwin.viz.scene import fit_craft

if TYPE_CHECKING:
    from vpptwin.logs.flight import Flight
    from vpptwin.twin.replay import Prediction


@dataclass(frozen=True)
class Show:
    """Everything to play.

    Attributes:
        model: the rig.
        vehicle: numbers of our craft, None for other rigs.
        frames: (T,) frame times [s of the log].
        log, twin: motions at the frames.
        target: the setpoint, if the log has one.
    """

    model: mujoco.MjModel
    vehicle: Vehicle | None
    frames: np.ndarray
    log: Motion
    twin: Motion | None
    target: Target | None

    @property
    def time(self) -> np.ndarray:
        """Frame times (T,) from the first frame [s]."""
        return self.frames - self.frames[0]


def prepare_show(
    flight: Flight,
    prediction: Prediction | None,
    model: Path | None,
    vehicle: Vehicle | None,
    joint_topics: Mapping[str, str] | None,
) -> Show:
    """Load the rig and sample log and prediction at the frames; arguments as vpptwin.viz.playback.play_page."""
    rig = load_model(find_model_file("rail_rig.xml") if model is None else model)
    craft = has_craft(flight, rig)
    joints = read_joints(flight, rig, joint_topics)
    start = min(float(time[0]) for time, _ in joints.values())
    end = max(float(time[-1]) for time, _ in joints.values())
    if end <= start:
        raise InputError(f"{flight.path}: a single position", "at least two to play", "record a longer log")
    vehicle = (vehicle or load_vehicle()) if craft else None
    if vehicle is not None:
        fit_craft(rig, vehicle)
    frames = choose_frames(start, end)
    return Show(
        rig,
        vehicle,
        frames,
        sample_flight(flight, rig, vehicle, joints, frames),
        None if prediction is None else sample_prediction(prediction, vehicle, frames),
        read_target(flight, start, end) if craft else None,
    )


def load_model(path: Path) -> mujoco.MjModel:
    """Compile an MJCF, with an InputError when it does not."""
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InputError(f"{path}: {error}", "an MJCF that compiles", "open it in MuJoCo's simulate") from error
