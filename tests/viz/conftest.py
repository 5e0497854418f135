"""A short flight with a flip, made up, and a twin that drifts away from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vpptwin.estimation.replay import Prediction
from vpptwin.logs.flight import Flight, Stream

DURATION = 4.0  # s
HOVER_PITCH = 0.1  # rad, of both blades


def make_flight(duration: float = DURATION, rate: float = 100.0) -> Flight:
    """Moves along x at 0.2 m/s and turns over at half time; the blades change sign then."""
    time = np.arange(round(duration * rate) + 1) / rate
    over = np.clip((time - 0.5 * duration) / 0.4, 0.0, 1.0)
    pitch = np.where(time < 0.5 * duration, HOVER_PITCH, -HOVER_PITCH)
    both = np.ones((len(time), 2))
    streams = {
        "/mocap/pose": Stream(time, {"x": 0.2 * time, "z": 1.2 + 0.1 * np.sin(time), "theta": np.pi * over}),
        "/rotor/command": Stream(time, {"blade_pitch": pitch[:, None] * both, "throttle": 0.5 * both}),
        "/rotor/state": Stream(time, {"speed": 471.239 * both, "current": 0.0 * both}),
        "/setpoint/pose": Stream(
            np.array([1.0, 0.5 * duration]),
            {"x": np.array([0.0, 0.5]), "z": np.array([1.2, 1.3]), "theta": np.array([0.0, np.pi])},
        ),
    }
    return Flight(Path("made_up.mcap"), 0, streams, {})


def make_prediction(flight: Flight) -> Prediction:
    """10 cm to the right of the log; not a number for the first half second."""
    pose = flight.streams["/mocap/pose"]
    qpos = np.stack([pose["x"] + 0.1, pose["z"], pose["theta"]], -1)
    qpos[pose.time < 0.5] = np.nan
    pair = np.ones((len(pose.time), 2))
    return Prediction(pose.time, qpos, np.zeros_like(qpos), 0.1 * pair, 471.239 * pair, np.array([0.5, 1.0, 1.5]))


@pytest.fixture
def flight() -> Flight:
    """A log of 4 s."""
    return make_flight()


@pytest.fixture
def prediction(flight: Flight) -> Prediction:
    """A twin's answer to it."""
    return make_prediction(flight)
