"""What is played: a log, and perhaps a twin, sampled at common frames on one rig, and what the robot adds to it."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from vpptwin.estimation.joints import straighten_joint
from vpptwin.estimation.series import interpolate
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.manifold import BALL, FREE, follow_sign
from vpptwin.twin.robot.robot import Robot, by_robot
from vpptwin.twin.robot.signals import Tracked, turn_from_parent
from vpptwin.twin.spec import TwinSpec
from vpptwin.viz.scene.camera import CameraView, frame_view
from vpptwin.viz.scene.geoms import Paint, find_corners, pose_bodies

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

    from vpptwin.estimation.replay import Prediction
    from vpptwin.logs.flight import Flight
    from vpptwin.viz.scene.frames import Painter
    from vpptwin.viz.scene.nodes import Node
    from vpptwin.viz.scene.tracks import KeyframeTrack

FRAME_RATE = 50.0  # Hz
MAX_PAGE_NUMBERS = 1_200_000  # in all tracks of a page, 6.4 MB of it; longer logs get fewer frames a second
NUMBERS_OF_BODY = 9  # a frame of a body: position, quaternion and their two times
NUMBERS_OF_OVERLAY = 40  # a frame of what the robot adds: turn, pitch of two blades, arrows, and the times of each
TRAIL_DURATION = 1.5  # s of the past that the trail of a craft shows
LONGEST_GAP = 0.03  # s without a sample of the prediction after which the twin is hidden
VIEWED = 100  # frames that say how far a rig reaches
AROUND, SMALLEST_RIG = 0.2, 0.05  # share of a rig's size that is left around it; size of the smallest rig [m]
Positions = dict[int, tuple[np.ndarray, np.ndarray]]
"""qpos index → time (n,) [s], position (n,) [m or rad], or number of a quaternion."""


@dataclass(frozen=True)
class SampledMotion:
    """Joint positions (T, nq) [m, rad] at the frames, and where they are known, (T,)."""

    qpos: np.ndarray
    shown: np.ndarray


class LegendEntry(NamedTuple):
    """A colour, how it is drawn (solid, translucent, line) and what it stands for."""

    colour: str
    style: str
    text: str


class Overlay:
    """What is drawn of a robot beside its bodies, such as rotors or a setpoint: nothing, unless its room says so.

    Attributes:
        legend: what its colours mean.
        notes: sentences about what is not drawn to scale.
    """

    legend: tuple[LegendEntry, ...] = ()
    notes: tuple[str, ...] = ()

    def draw_parts(self, vis: Node, show: Show, name: str, paint: Paint | None) -> list[KeyframeTrack]:
        """Draw what hangs on the bodies of `log` or `twin`, in its colours or in one paint; returns what moves it."""
        return []

    def draw_target(self, vis: Node, show: Show) -> list[KeyframeTrack]:
        """Draw what stands for itself; returns what moves it."""
        return []

    def paint_target(self, painter: Painter, pen: ImageDraw, time: float) -> None:
        """Paint what lies behind the bodies at a time from the show's start [s]."""

    def paint_parts(self, painter: Painter, pen: ImageDraw, time: float) -> None:
        """Paint what lies before the bodies, which are where the painter's kinematics have them."""


BARE = Overlay()


@dataclass(frozen=True)
class Show:
    """Everything to play."""

    model: mujoco.MjModel  # the rig
    followed: int  # index of the body that the view and a trail follow; -1 for none
    frames: np.ndarray  # (T,) frame times [s of the log]
    log: SampledMotion  # the log's at the frames
    twin: SampledMotion | None  # the prediction's at the frames
    overlay: Overlay = BARE  # what the robot adds

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
    model = copy.deepcopy(spec.model)
    positions = find_positions(spec.robot, flight)
    start = min(float(time[0]) for time, _ in positions.values())
    end = max(float(time[-1]) for time, _ in positions.values())
    if end <= start:
        raise InputError(f"{flight.path}: a single position", "at least two to play", "record a longer log")
    frames = choose_frames(start, end, most=count_frames(model, 1 if prediction is None else 2))
    followed = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, spec.robot.followed)
    qpos = np.tile(model.qpos0, (len(frames), 1))  # joints that the log lacks stay where they start
    for address, (time, position) in positions.items():
        qpos[:, address] = np.interp(frames, time, position)
    twin = None if prediction is None else sample_prediction(prediction, frames)
    show = Show(model, followed, frames, SampledMotion(qpos, np.ones(len(frames), dtype=bool)), twin)
    return replace(show, overlay=make_overlay(spec.robot, show, flight, prediction))


@by_robot
def make_overlay(robot: Robot, show: Show, flight: Flight, prediction: Prediction | None) -> Overlay:
    """What is drawn of a robot beside its bodies; may change how the show's model looks."""
    return BARE


@by_robot
def find_positions(robot: Robot, flight: Flight) -> Positions:
    """Joint positions and poses of bodies that the log holds.

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
    return np.linspace(start, end, int(np.clip(round((end - start) * FRAME_RATE) + 1, 2, most)))


def count_frames(model: mujoco.MjModel, copies: int) -> int:
    """How many frames a page has room for, with so many copies of the rig moving."""
    bodies = int(np.count_nonzero(model.body_weldid))
    return max(MAX_PAGE_NUMBERS // (copies * (NUMBERS_OF_BODY * bodies + NUMBERS_OF_OVERLAY)), 2)


def sample_prediction(prediction: Prediction, at: np.ndarray) -> SampledMotion:
    """The twin at the frame times; hidden where the prediction has no finite sample nearby."""
    known = np.isfinite(prediction.qpos).all(axis=1)
    if not known.any():
        raise InputError("a prediction without one finite state", "at least one", "check the twin and the log")
    time, qpos = prediction.time[known], prediction.qpos[known]
    after = np.clip(np.searchsorted(time, at), 1, max(len(time) - 1, 1))
    nearest = np.minimum(np.abs(at - time[after - 1]), np.abs(at - time[np.minimum(after, len(time) - 1)]))
    return SampledMotion(interpolate(at, time, qpos), nearest <= LONGEST_GAP)


def view_show(show: Show, **options: float) -> CameraView:
    """The view that holds the path of what is followed, or all of the rig that moves.

    Options are those of `frame_view`; where nothing is followed the rig's size decides on margin and least size.
    """
    if show.followed >= 0:
        position, _ = pose_bodies(show.model, show.log.qpos)
        return frame_view(position[:, show.followed], **options)
    frames = np.linspace(0, len(show.frames) - 1, min(len(show.frames), VIEWED)).round().astype(int)
    corners = np.concatenate([find_corners(show.model, show.log.qpos[frame], moving=True) for frame in frames])
    size = max(float(np.ptp(corners[:, [0, 2]], axis=0).max()), SMALLEST_RIG)
    given = {name: value for name, value in options.items() if name == "aspect"}
    return frame_view(corners, margin=AROUND * size, smallest=AROUND * size, **given)
