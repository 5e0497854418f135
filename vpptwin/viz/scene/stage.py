"""The scene of a show in meshcat: rig, log, twin, trail and what the robot adds, drawn once and moved by tracks."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from vpptwin.viz.plots.palette import GREY, TRAIL, TWIN, to_int
from vpptwin.viz.scene.camera import AZIMUTH, BACKDROP_BOTTOM, BACKDROP_TOP, ELEVATION, FIELD_OF_VIEW, CameraView
from vpptwin.viz.scene.geoms import (
    FIRST_HIDDEN_GROUP,
    GRID_STEP,
    PLANE_THICKNESS,
    ROOT,
    Paint,
    name_body,
    pose_bodies,
    read_paint,
)
from vpptwin.viz.scene.meshes import make_geom, make_material, make_ribbon
from vpptwin.viz.scene.nodes import Node, make_lines, paint_material, shift
from vpptwin.viz.scene.show import SampledMotion, Show, view_show
from vpptwin.viz.scene.tracks import KeyframeTrack, make_track

TRAIL_WIDTH = 0.012  # m
TRAIL_DEPTH = 0.03  # m, the trail's y: just behind the craft
GRID_DEPTH = 0.5  # m, the grid's y: behind the rig
TWIN_PAINT = Paint(TWIN, 0.5, behind=True)
CAMERA = "/Cameras/default/rotated/<object>"


def draw_show(vis: Node, show: Show) -> list[KeyframeTrack]:
    """Draw everything, aim the camera, and return the tracks that move it."""
    draw_surroundings(vis, show.model)
    tracks = draw_trajectory(vis, show, "log", show.log)
    if show.twin is not None:
        tracks += draw_trajectory(vis, show, "twin", show.twin, TWIN_PAINT)
    if show.followed >= 0:
        draw_trail(vis, show)
    tracks += show.overlay.draw_target(vis, show)
    aim_at(vis, view_show(show))
    return tracks


def draw_surroundings(vis: Node, model: mujoco.MjModel) -> None:
    """Draw the geoms that never move (floor, wall, rail) before a pale backdrop without meshcat's own grid and axes."""
    vis["/Grid"].set_property("visible", False)
    vis["/Axes"].set_property("visible", False)
    vis["/Background"].set_property("top_color", BACKDROP_TOP)
    vis["/Background"].set_property("bottom_color", BACKDROP_BOTTOM)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if model.body_weldid[body] == 0:
            place = vis[f"{ROOT}/world"][name_body(model, body)]
            draw_geom(place, model, geom, None)
            place.set_transform(make_matrix(data.xpos[body], data.xquat[body]))


def draw_bodies(node: Node, model: mujoco.MjModel, paint: Paint | None = None) -> None:
    """Draw the geoms of the moving bodies below node/BODY, all in one paint, or in the MJCF's colours."""
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if model.body_weldid[body] != 0:
            draw_geom(node[name_body(model, body)], model, geom, paint)


def draw_geom(node: Node, model: mujoco.MjModel, geom: int, paint: Paint | None) -> None:
    """Draw one geom below its body's node, unless it is transparent or in a hidden group."""
    own, shape = read_paint(model, geom), make_geom(model, geom)
    if shape is None or own.opacity == 0.0 or model.geom_group[geom] >= FIRST_HIDDEN_GROUP:
        return
    place = node[model.geom(geom).name or f"geom_{geom}"]
    if paint is not None:
        own = replace(paint, opacity=paint.opacity * own.opacity)
    place.set_object(shape[0], make_material(own, smooth=shape[1]))
    pose = make_matrix(model.geom_pos[geom], model.geom_quat[geom])
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        pose[:3, 3] -= 0.5 * PLANE_THICKNESS * pose[:3, 2]
    place.set_transform(pose)


def make_matrix(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """4 x 4 pose from a position [m] and MuJoCo's quaternion (w, x, y, z)."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.reshape(3, 3), position
    return matrix


def draw_trajectory(
    vis: Node, show: Show, name: str, trajectory: SampledMotion, paint: Paint | None = None
) -> list[KeyframeTrack]:
    """Draw the rig as it moves, in the MJCF's colours or in one paint, and what the robot adds to it."""
    path, model, time = f"{ROOT}/{name}", show.model, show.time
    draw_bodies(vis[path], model, paint)
    position, quaternion = pose_bodies(model, trajectory.qpos)
    tracks = [] if trajectory.shown.all() else [make_track(path, "visible", time, trajectory.shown)]
    for body in np.flatnonzero(model.body_weldid):
        node = f"{path}/{name_body(model, int(body))}"
        tracks.append(make_track(node, "position", time, position[:, body]))
        tracks.append(make_track(node, "quaternion", time, quaternion[:, body]))
    return tracks + show.overlay.draw_parts(vis, show, name, paint)


def draw_trail(vis: Node, show: Show) -> None:
    """Draw the path of what is followed as a ribbon; a page shows its last seconds only, which tracks cannot do."""
    position, _ = pose_bodies(show.model, show.log.qpos)
    path = position[:, show.followed] + [0.0, TRAIL_DEPTH, 0.0]
    material = paint_material("MeshBasicMaterial", to_int(TRAIL), 0.45, depthWrite=False)
    vis[f"{ROOT}/trail"].set_object(make_ribbon(path, TRAIL_WIDTH), material)


def aim_at(vis: Node, view: CameraView) -> None:
    """Draw a grid behind what the camera sees, and aim it; it always looks at the origin, so the rig is shifted."""
    centre, reach = view.centre[[0, 2]], view.half_height * np.array([2.5, 1.5])
    first = np.floor(np.maximum(centre - reach, [-np.inf, 0.0]) / GRID_STEP) * GRID_STEP
    last = np.ceil((centre + reach) / GRID_STEP) * GRID_STEP
    ends: list[tuple[float, float, float]] = []
    for x in np.arange(first[0], last[0] + 1e-9, GRID_STEP):
        ends += [(x, GRID_DEPTH, first[1]), (x, GRID_DEPTH, last[1])]
    for z in np.arange(first[1], last[1] + 1e-9, GRID_STEP):
        ends += [(first[0], GRID_DEPTH, z), (last[0], GRID_DEPTH, z)]
    paint = paint_material("LineBasicMaterial", to_int(GREY), 0.35)
    vis[f"{ROOT}/grid"].set_object(make_lines(np.array(ends)), paint, "LineSegments")
    vis[ROOT].set_transform(shift(-view.centre))
    aside, above = np.sin(AZIMUTH) * np.cos(ELEVATION), np.sin(ELEVATION)
    vis[CAMERA].set_property("fov", FIELD_OF_VIEW)
    before = float(np.cos(AZIMUTH) * np.cos(ELEVATION))
    vis[CAMERA].set_property("position", [view.distance * c for c in (aside, above, before)])
