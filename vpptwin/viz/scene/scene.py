"""The rig in meshcat: every visible geom of an MJCF below its body, and the bodies' poses over time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.viz.plots.palette import DISC, GREY, to_int, to_rgb
from vpptwin.viz.scene.motion import Motion
from vpptwin.viz.scene.shapes import PLANE_THICKNESS, Paint, make_geom, read_paint
from vpptwin.viz.scene.tracks import Track, make_track

if TYPE_CHECKING:
    from meshcat import Visualizer

ROOT = "/rig"  # everything we draw; its origin is what the camera looks at
FIRST_HIDDEN_GROUP = 3  # MuJoCo's convention: geom groups 0-2 are drawn
GRID_STEP = 0.5  # m


def draw_bodies(node: Visualizer, model: mujoco.MjModel, paint: Paint | None = None) -> None:
    """Draw every visible geom of the moving bodies below node/BODY.

    Args:
        node: parent of the bodies.
        model: the rig.
        paint: one colour for all of it; None for the MJCF's colours.
    """
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if model.body_weldid[body] != 0:
            draw_geom(node[name_body(model, body)], model, geom, paint)


def draw_surroundings(node: Visualizer, model: mujoco.MjModel) -> None:
    """Draw the geoms that never move (floor, wall, rail) below node/BODY at their world pose."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if model.body_weldid[body] == 0:
            place = node[name_body(model, body)]
            draw_geom(place, model, geom, None)
            place.set_transform(make_matrix(data.xpos[body], data.xquat[body]))


def draw_geom(node: Visualizer, model: mujoco.MjModel, geom: int, paint: Paint | None) -> None:
    """Draw one geom below its body's node, unless it is transparent or in a hidden group."""
    own = read_paint(model, geom)
    shape = make_geom(model, geom)
    if shape is None or own.opacity == 0.0 or model.geom_group[geom] >= FIRST_HIDDEN_GROUP:
        return
    place = node[model.geom(geom).name or f"geom_{geom}"]
    if paint is not None:
        own = replace(paint, opacity=paint.opacity * own.opacity)
    place.set_object(shape[0], own.material(smooth=shape[1]))
    pose = make_matrix(model.geom_pos[geom], model.geom_quat[geom])
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        pose[:3, 3] -= 0.5 * PLANE_THICKNESS * pose[:3, 2]
    place.set_transform(pose)


def draw_grid(node: Visualizer, low: np.ndarray, high: np.ndarray, depth: float) -> None:
    """Lines every 0.5 m in the x-z plane at y = depth, covering the corners low and high (2,) [m]."""
    import meshcat.geometry as mg  # as in `vpptwin.viz.scene.shapes`

    first, last = np.floor(low / GRID_STEP) * GRID_STEP, np.ceil(high / GRID_STEP) * GRID_STEP
    ends: list[tuple[float, float, float]] = []
    for x in np.arange(first[0], last[0] + 1e-9, GRID_STEP):
        ends += [(x, depth, first[1]), (x, depth, last[1])]
    for z in np.arange(first[1], last[1] + 1e-9, GRID_STEP):
        ends += [(first[0], depth, z), (last[0], depth, z)]
    lines = mg.PointsGeometry(np.array(ends, dtype=np.float32).T)
    node.set_object(mg.LineSegments(lines, mg.LineBasicMaterial(color=to_int(GREY), opacity=0.35)))


def name_body(model: mujoco.MjModel, body: int) -> str:
    """The body's name in the MJCF, or a made-up one."""
    return model.body(body).name or f"body_{body}"


def find_craft(model: mujoco.MjModel) -> int:
    """The body of our craft: the one that carries the pitch joint."""
    return int(model.jnt_bodyid[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "pitch")])


def make_matrix(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """4 x 4 pose from a position [m] and MuJoCo's quaternion (w, x, y, z)."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.reshape(3, 3), position
    return matrix


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


def find_corners(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Corners (n, 3) [m] of the boxes around all drawn geoms but planes, with the joints at qpos (nq,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    drawn = (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_group < FIRST_HIDDEN_GROUP)
    corners = [
        data.geom_xpos[geom]
        + (model.geom_aabb[geom, :3] + signs * model.geom_aabb[geom, 3:]) @ data.geom_xmat[geom].reshape(3, 3).T
        for geom in np.flatnonzero(drawn)
    ]
    return np.concatenate(corners) if corners else np.zeros((1, 3))


def pose_bodies(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World poses of all bodies for joint positions (T, nq).

    Returns:
        positions (T, nbody, 3) [m] and quaternions (T, nbody, 4) in three.js's order x, y, z, w.
    """
    data = mujoco.MjData(model)
    position, quaternion = np.empty((len(qpos), model.nbody, 3)), np.empty((len(qpos), model.nbody, 4))
    for frame, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        position[frame], quaternion[frame] = data.xpos, data.xquat
    return position, np.roll(quaternion, -1, axis=-1)


def track_bodies(path: str, model: mujoco.MjModel, time: np.ndarray, motion: Motion) -> list[Track]:
    """Tracks that move the bodies drawn by draw_bodies below path; time (T,) [s] from the animation's start."""
    position, quaternion = pose_bodies(model, motion.qpos)
    tracks = [] if motion.shown.all() else [make_track(path, "visible", time, motion.shown)]
    for body in range(1, model.nbody):
        if model.body_weldid[body] != 0:
            node = f"{path}/{name_body(model, body)}"
            tracks.append(make_track(node, "position", time, position[:, body]))
            tracks.append(make_track(node, "quaternion", time, quaternion[:, body]))
    return tracks
