"""The rig for the 3D panels of Foxglove and RViz: frames on /tf, and markers that are fixed to them."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import mujoco
import numpy as np

from vpptwin.logs.flight import Stream
from vpptwin.logs.write import START_NS, Message
from vpptwin.robots.planar_drone.craft import CRAFT_JOINTS
from vpptwin.robots.planar_drone.display.rotors import find_craft, fit_craft
from vpptwin.twin.spec import TwinSpec
from vpptwin.viz.plots.palette import TARGET, to_rgb
from vpptwin.viz.scene.geoms import PLANE_THICKNESS, Paint, list_drawn, pose_bodies, size_plane

TRANSFORMS, MARKERS = "/tf", "/rig/markers"
WORLD, BODY, GHOST = "world", "body", "target"
"""Frames; `body` is that of the headers of rotor and IMU messages."""
RATE = 50.0
"""Transforms per second; viewers interpolate."""
EVERY = 1.0
"""Markers come again after so long, for those who start in the middle [s]."""
CUBE, SPHERE, CYLINDER = 1, 2, 3


def describe_flight(spec: TwinSpec, streams: Mapping[str, Stream]) -> list[Message]:
    """Messages that show the streams of a flight of our craft on its rig, by time; none for logs without poses."""
    if "/mocap/pose" not in streams:
        return []
    model, pose, target = copy.copy(spec.model), streams["/mocap/pose"], streams.get("/setpoint/pose")
    fit_craft(model, spec.vehicle)
    times = np.arange(pose.time[0], pose.time[-1], 1.0 / RATE)
    qpos = np.tile(mujoco.MjData(model).qpos, (len(times), 1))
    columns = [np.interp(times, pose.time, pose[column]) for column in ("x", "z", "theta")]
    qpos[:, [model.joint(joint).qposadr[0] for joint in CRAFT_JOINTS]] = np.stack(columns, axis=-1)
    places, turns = pose_bodies(model, qpos)
    turns = np.roll(turns, 1, axis=-1)  # w first
    moving = {name_frame(model, int(b)): b for b in np.flatnonzero(model.body_weldid != 0)}
    rows = None if target is None else np.searchsorted(target.time, times, side="right") - 1
    markers = list_markers(model, target is not None)
    messages, shown = [], -np.inf
    for k, time in enumerate(times):
        nanoseconds = START_NS + round(float(time) * 1e9)
        stamp = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
        if time - shown > EVERY - 1e-9:
            shown = time
            stamped = [{**marker, "header": {"stamp": stamp, "frame_id": marker["frame"]}} for marker in markers]
            messages.append(Message(MARKERS, "visualization_msgs/msg/MarkerArray", time, {"markers": stamped}))
        frames = {name: (places[k, b], turns[k, b]) for name, b in moving.items()}
        if target is not None and rows is not None and rows[k] >= 0:
            place = np.array([target["x"][rows[k]], 0.0, target["z"][rows[k]]])
            half = -0.5 * target["theta"][rows[k]]  # θ turns about -y
            frames[GHOST] = place, np.array([np.cos(half), 0.0, np.sin(half), 0.0])
        header = {"stamp": stamp, "frame_id": WORLD}
        transforms = [
            {"header": header, "child_frame_id": name,
             "transform": {"translation": name_axes(place), "rotation": name_turn(turn)}}
            for name, (place, turn) in frames.items()
        ]  # fmt: skip
        messages.append(Message(TRANSFORMS, "tf2_msgs/msg/TFMessage", time, {"transforms": transforms}))
    return messages


def name_frame(model: mujoco.MjModel, body: int) -> str:
    """The frame of a body: its name, `body` for the craft's, `world` for what does not move."""
    if body == find_craft(model):
        return BODY
    return model.body(body).name if model.body_weldid[body] != 0 else WORLD


def list_markers(model: mujoco.MjModel, ghost: bool) -> list[dict[str, object]]:
    """A marker for every geom that is drawn, in its body's frame, and the craft once more as a ghost at the target."""
    craft, data = find_craft(model), mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    markers: list[dict[str, object]] = []
    for geom, paint in list_drawn(model).items():
        body = int(model.geom_bodyid[geom])
        moves = model.body_weldid[body] != 0
        frame = name_frame(model, body)
        place, turn = model.geom_pos[geom], model.geom_quat[geom]
        if not moves:
            place, turn = data.geom_xpos[geom], np.zeros(4)
            mujoco.mju_mat2Quat(turn, data.geom_xmat[geom])
        markers.append(make_marker(model, geom, frame, place, turn, paint, len(markers)))
        if ghost and body == craft:
            pale = Paint(TARGET, 0.4 * paint.opacity)
            markers.append(make_marker(model, geom, GHOST, place, turn, pale, len(markers)))
    return markers


def make_marker(
    model: mujoco.MjModel, geom: int, frame: str, place: np.ndarray, turn: np.ndarray, paint: Paint, number: int
) -> dict[str, object]:
    """One geom as a marker; capsules lose their round ends, which no marker has."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    shape, scale = CUBE, 2.0 * size
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        shape, scale = CYLINDER, 2.0 * np.array([size[0], size[0], size[1]])
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        shape, scale = SPHERE, np.full(3, 2.0 * size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        shape = SPHERE
    elif kind == mujoco.mjtGeom.mjGEOM_PLANE:
        scale = np.array([*(2.0 * s for s in size_plane(model, geom)), PLANE_THICKNESS])
        place = place - [0.0, 0.0, 0.5 * PLANE_THICKNESS]
    red, green, blue = to_rgb(paint.colour)
    return {
        "frame": frame, "ns": frame, "id": number, "type": shape, "action": 0, "frame_locked": True,
        "pose": {"position": name_axes(place), "orientation": name_turn(turn)}, "scale": name_axes(scale),
        "color": {"r": red, "g": green, "b": blue, "a": paint.opacity},
    }  # fmt: skip


def name_axes(values: np.ndarray) -> Mapping[str, float]:
    """Three numbers as x, y, z."""
    return dict(zip("xyz", map(float, values)))


def name_turn(quaternion: np.ndarray) -> Mapping[str, float]:
    """MuJoCo's quaternion (w, x, y, z) as x, y, z, w."""
    return dict(zip("wxyz", map(float, quaternion)))
