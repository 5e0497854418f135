"""The scene of a show: rig, log, twin, target and trail, each drawn once and moved by tracks."""

from __future__ import annotations

from dataclasses import replace

import meshcat.geometry as mg
import mujoco
import numpy as np
from meshcat import Visualizer

from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.viz.plots.palette import TARGET, TRAIL, TWIN, to_int
from vpptwin.viz.scene.camera import View, frame_view, place_camera, set_backdrop
from vpptwin.viz.scene.motion import Motion, Target
from vpptwin.viz.scene.rotors import draw_arrows, draw_rotors, track_arrows, track_rotors
from vpptwin.viz.scene.scene import (
    ROOT,
    draw_bodies,
    draw_geom,
    draw_grid,
    draw_surroundings,
    find_craft,
    name_body,
    pose_bodies,
    track_bodies,
)
from vpptwin.viz.scene.shapes import Paint, make_ribbon
from vpptwin.viz.scene.show import Show
from vpptwin.viz.scene.tracks import Track, make_track

TRAIL_WIDTH = 0.012  # m
TRAIL_DEPTH = 0.03  # m, the trail's y: just behind the craft
GRID_DEPTH = 0.5  # m, the grid's y: behind the rig
TWIN_PAINT = Paint(TWIN, 0.5, behind=True)
TARGET_PAINT = Paint(TARGET, 0.4, behind=True)


def draw_show(vis: Visualizer, show: Show) -> list[Track]:
    """Draw everything, aim the camera, and return the tracks that move it."""
    set_backdrop(vis)
    draw_surroundings(vis[f"{ROOT}/world"], show.model)
    tracks = draw_motion(vis, show, "log", show.log)
    view = view_flight(show)
    if show.twin is not None:
        tracks += draw_motion(vis, show, "twin", join_phase(show.twin, show.log), TWIN_PAINT)
    if show.followed >= 0:
        draw_trail(vis, show)
    if show.target is not None and show.rotorcraft is not None:
        tracks += draw_target(vis, show, show.rotorcraft, show.target)
    aim_at(vis, view)
    return tracks


def aim_at(vis: Visualizer, view: View) -> None:
    """Place the camera, and a grid behind what it sees."""
    centre, reach = view.centre[[0, 2]], view.half_height * np.array([2.5, 1.5])
    draw_grid(vis[f"{ROOT}/grid"], np.maximum(centre - reach, [-np.inf, 0.0]), centre + reach, GRID_DEPTH)
    place_camera(vis, view)


def view_flight(show: Show, **options: float) -> View:
    """The view that holds the path of what is followed, or all that moves; options are those of `frame_view`."""
    position, _ = pose_bodies(show.model, show.log.qpos)
    if show.followed >= 0:
        return frame_view(position[:, show.followed], **options)
    return frame_view(position[:, show.model.body_weldid != 0].reshape(-1, 3), **options)


def draw_motion(vis: Visualizer, show: Show, name: str, motion: Motion, paint: Paint | None = None) -> list[Track]:
    """Draw the rig as it moves: solid in the MJCF's colours, with thrust arrows, or in one paint without them."""
    node = f"{ROOT}/{name}"
    draw_bodies(vis[node], show.model, paint)
    tracks = track_bodies(node, show.model, show.time, motion)
    if show.rotorcraft is None:
        return tracks
    craft = f"{node}/{name_body(show.model, find_craft(show.model))}"
    draw_rotors(vis[craft], show.model, show.rotorcraft, paint)
    if motion.rotors is not None:
        tracks += track_rotors(craft, show.time, motion.rotors)
        if paint is None:
            draw_arrows(vis[craft])
            tracks += track_arrows(craft, show.time, motion.rotors, show.rotorcraft)
    return tracks


def join_phase(twin: Motion, log: Motion) -> Motion:
    """The twin with its rotors turned to where the log's are when it first shows: nobody models their phase."""
    if twin.rotors is None or log.rotors is None:
        return twin
    first = int(np.argmax(twin.shown))
    angle = twin.rotors.angle + log.rotors.angle[first] - twin.rotors.angle[first]
    return replace(twin, rotors=replace(twin.rotors, angle=angle))


def draw_ghost(vis: Visualizer, model: mujoco.MjModel, vehicle: Vehicle) -> None:
    """Draw the craft once more, as what shows the setpoint."""
    for geom in np.flatnonzero(model.geom_bodyid == find_craft(model)):
        draw_geom(vis, model, int(geom), TARGET_PAINT)
    draw_rotors(vis, model, vehicle, TARGET_PAINT)


def draw_target(vis: Visualizer, show: Show, vehicle: Vehicle, target: Target) -> list[Track]:
    """Draw the ghost at the setpoint, hidden before the first one."""
    node = f"{ROOT}/target"
    draw_ghost(vis[node], show.model, vehicle)
    half = -0.5 * target.theta  # θ turns about -y
    zero = np.zeros_like(half)
    end = show.time[-1]
    rows = np.append(np.arange(len(half)), len(half) - 1)  # the last setpoint stays until the end
    time = np.append(target.time, end)
    position = np.stack([target.x, zero, target.z], -1)[rows]
    quaternion = np.stack([zero, np.sin(half), zero, np.cos(half)], -1)[rows]
    moves = {"position": position, "quaternion": quaternion}
    tracks = [make_track(node, name, time, values, hold=True) for name, values in moves.items()]
    if target.time[0] > 0.0:
        shown = np.array([False, True, True])
        tracks.append(make_track(node, "visible", np.array([0.0, target.time[0], end]), shown))
    return tracks


def draw_trail(vis: Visualizer, show: Show) -> None:
    """Draw the path of what is followed as a ribbon; a page shows its last seconds only, which tracks cannot do."""
    position, _ = pose_bodies(show.model, show.log.qpos)
    path = position[:, show.followed] + [0.0, TRAIL_DEPTH, 0.0]
    material = mg.MeshBasicMaterial(color=to_int(TRAIL), opacity=0.45, depthWrite=False)
    vis[f"{ROOT}/trail"].set_object(make_ribbon(path, TRAIL_WIDTH), material)
