"""Geoms of an MJCF as they are drawn everywhere: which ones, in which colours, of which outline, at which pose."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from vpptwin.viz.plots.palette import LOG, SURROUNDINGS, to_hex

ROOT = "/rig"  # scene node of everything we draw; its origin is what the camera looks at
FIRST_HIDDEN_GROUP = 3  # MuJoCo's convention: geom groups 0-2 are drawn
GRID_STEP = 0.5  # m
PLANE_HALF_SIZE = 3.0  # m, drawn for a plane that the MJCF leaves infinite
PLANE_THICKNESS = 0.01  # m
UNSET_RGBA = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's colour of a geom that names none
ROUND = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T


@dataclass(frozen=True)
class Paint:
    """Colour "#RRGGBB" and opacity 0..1 of a surface; behind puts it behind whatever coincides with it."""

    colour: str
    opacity: float = 1.0
    behind: bool = False


def read_paint(model: mujoco.MjModel, geom: int) -> Paint:
    """The MJCF's own colour of a geom: its material's, else its rgba, else dark where it moves and pale where not."""
    material = model.geom_matid[geom]
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    if material < 0 and np.allclose(rgba, UNSET_RGBA):
        return Paint(LOG if model.body_weldid[model.geom_bodyid[geom]] != 0 else SURROUNDINGS)
    return Paint(to_hex(tuple(rgba[:3])), float(rgba[3]))


def list_drawn(model: mujoco.MjModel) -> dict[int, Paint]:
    """The geoms that are drawn, neither transparent nor in a hidden group, and their paint."""
    shown = np.flatnonzero(model.geom_group < FIRST_HIDDEN_GROUP).tolist()
    return {g: paint for g in shown if (paint := read_paint(model, g)).opacity > 0.0}


def size_plane(model: mujoco.MjModel, geom: int) -> tuple[float, float]:
    """Half width and depth of a plane as it is drawn [m]."""
    width, depth = (s if s > 0.0 else PLANE_HALF_SIZE for s in model.geom_size[geom, :2])
    return width, depth


def outline_geom(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Points (k, 3) [m] in a geom's own frame whose hull is the geom, nearly."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        half = [*size_plane(model, geom), 0.5 * PLANE_THICKNESS]
        return CORNERS * half - [0.0, 0.0, 0.5 * PLANE_THICKNESS]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = model.mesh_vertadr[mesh]
        return np.asarray(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], dtype=float)
    circle = np.stack([np.cos(ROUND), np.sin(ROUND), 0.0 * ROUND], -1)
    ball = np.concatenate([np.roll(circle, k, axis=1) for k in range(3)])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return size[0] * ball
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return size * ball
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        end = ball if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else circle
        return np.concatenate([size[0] * end + [0.0, 0.0, s * size[1]] for s in (-1, 1)])
    return CORNERS * size


def find_hull(points: np.ndarray) -> tuple[np.ndarray, bool]:
    """Corners of the convex hull of points (k, 2), and whether it has a width; else the two ends of the line."""
    try:
        return points[ConvexHull(points).vertices], True
    except QhullError:  # seen from its edge
        order = np.lexsort(points.T)
        return points[[order[0], order[-1]]], False


def name_body(model: mujoco.MjModel, body: int) -> str:
    """The body's name in the MJCF, or a made-up one."""
    return model.body(body).name or f"body_{body}"


def find_corners(model: mujoco.MjModel, qpos: np.ndarray, moving: bool = False) -> np.ndarray:
    """Corners (n, 3) [m] of boxes around drawn geoms but planes, or those that move, with joints at qpos (nq,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    drawn = (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_group < FIRST_HIDDEN_GROUP)
    if moving:
        drawn &= model.body_weldid[model.geom_bodyid] != 0
    corners = [
        data.geom_xpos[geom]
        + (model.geom_aabb[geom, :3] + CORNERS * model.geom_aabb[geom, 3:]) @ data.geom_xmat[geom].reshape(3, 3).T
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
