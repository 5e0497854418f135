"""A rig as a small drawing for a page, with the part that an effect acts on lit."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from vpptwin.effects import Effect, Stage
from vpptwin.twin.robot.robot import Robot
from vpptwin.twin.sensors import PERFECT
from vpptwin.viz.scene.geoms import find_hull, list_drawn, outline_geom

Place = Callable[[np.ndarray], np.ndarray]
"""From points of the world (..., 3) [m] to points of the drawing (..., 2) [px]."""

SIZE = 260.0
"""Longer side of the drawing [px]."""
MARGIN = 0.12
"""Around what moves, as a share of its larger extent."""
NARROWEST = 0.75
"""A drawing's shorter side, as a share of its longer one."""
MARK = 0.16
"""Reach of the arrows of a lit joint or actuator, as a share of the longer side."""
LIT, LINE = 'fill="var(--lit)"', 'fill="none" stroke="var(--lit)" stroke-width="3"'


@dataclass(frozen=True)
class ModelPart:
    """Indices into the MuJoCo model of what an effect acts on."""

    bodies: frozenset[int] = frozenset()
    joints: frozenset[int] = frozenset()
    actuators: frozenset[int] = frozenset()


def find_part(robot: Robot, effect: Effect) -> ModelPart:
    """The part of a rig that an effect acts on: a joint, an actuator, or a body."""
    model, site, sites = robot.model, robot.locate(effect), robot.list_sites(effect)
    joints = {int(model.dof_jntid[each.dof]) for each in sites if each.dof >= 0}
    if joints:
        return ModelPart(frozenset(int(model.jnt_bodyid[joint]) for joint in joints), frozenset(joints))
    actuators = frozenset(each.actuator for each in sites) - {-1}
    if actuators:
        return ModelPart(actuators=actuators)
    driven = effect.writes and not set(effect.writes) & {*PERFECT, *dir(model), "opt.gravity"}
    if not effect.target and (effect.stage is Stage.THRUST or driven):
        return ModelPart(actuators=frozenset(range(model.nu)))
    return ModelPart(
        bodies=frozenset({site.body} - {-1}) or frozenset({int(model.jnt_bodyid[0])})
    )  # or what the mount holds


def sketch_rig(robot: Robot, effects: Iterable[Effect], label: str) -> str:
    """A rig from the side, or from above where it is flat, as an SVG element that takes `--lit` from its page.

    Args:
        robot: the rig, drawn as it starts.
        effects: whose parts are lit.
        label: what a screen reader says.

    Returns:
        The element, "" for a rig without shapes.
    """
    model = robot.model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.start_pose
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    paints = list_drawn(model)
    drawn = [g for g in paints if model.geom_type[g] != mujoco.mjtGeom.mjGEOM_PLANE]
    places = {g: data.geom_xpos[g] + outline_geom(model, g) @ data.geom_xmat[g].reshape(3, 3).T for g in drawn}
    moving = [places[g] for g in drawn if model.body_weldid[model.geom_bodyid[g]] != 0]
    if not moving:
        return ""
    low, high = np.concatenate(moving).min(axis=0), np.concatenate(moving).max(axis=0)
    axes = [0, 2] if high[2] - low[2] >= 0.3 * (high[1] - low[1]) else [0, 1]
    extent, middle = (high - low)[axes], 0.5 * (low + high)[axes]
    extent = extent + 2.0 * MARGIN * extent.max()
    extent = np.maximum(extent, NARROWEST * extent.max())
    scale, corner = SIZE / extent.max(), middle + [-0.5, 0.5] * extent

    def place(points: np.ndarray) -> np.ndarray:
        pixels: np.ndarray = scale * (points[..., axes] - corner) * [1.0, -1.0]
        return pixels

    parts = [find_part(robot, effect) for effect in effects]
    bodies = {body for part in parts for body in part.bodies}
    deep = 3 - sum(axes)
    nearest_last = sorted(drawn, key=lambda g: data.geom_xpos[g][deep] * (-1.0 if deep == 1 else 1.0))
    shapes = [
        draw_outline(place(places[g]), int(model.geom_bodyid[g]) in bodies, paints[g].opacity) for g in nearest_last
    ]
    reach = MARK * extent.max()
    for joint in sorted({joint for part in parts for joint in part.joints}):
        shapes += mark_joint(model, data, joint, reach, place)
    for actuator in sorted({actuator for part in parts for actuator in part.actuators}):
        shapes += mark_actuator(model, data, actuator, reach, place)
    width, height = scale * extent
    title = html.escape(label, quote=True)
    return f'<svg role="img" aria-label="{title}" viewBox="0 0 {width:.0f} {height:.0f}">{"".join(shapes)}</svg>'


def draw_outline(points: np.ndarray, lit: bool, opacity: float) -> str:
    """The convex hull of points (k, 2) [px]."""
    hull, _ = find_hull(points)
    style = f'{LIT} stroke="var(--lit)"' if lit else 'fill="currentColor" stroke="currentColor"'
    return f'<path d="{trace(hull)}z" {style} opacity="{opacity * (1.0 if lit else 0.45):.2f}"/>'


def trace(points: np.ndarray) -> str:
    """A path along points (k, 2) [px]."""
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def mark_joint(model: mujoco.MjModel, data: mujoco.MjData, joint: int, reach: float, place: Place) -> list[str]:
    """An arrow both ways along a slide, a ring about a hinge; nothing for a free body, which is lit itself."""
    kind, anchor = model.jnt_type[joint], data.xanchor[joint]
    body = int(model.jnt_bodyid[joint])
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
        centre = data.geom_xpos[geoms[0]] if geoms else data.xpos[body]
        along = reach * data.xaxis[joint]
        return [*draw_arrow(place(centre), place(centre + along)), *draw_arrow(place(centre), place(centre - along))]
    if kind == mujoco.mjtJoint.mjJNT_HINGE:
        (x, y), edge = place(anchor), place(anchor + np.array([0.8 * reach, 0.0, 0.0]))
        return [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{edge[0] - x:.1f}" {LINE}/>']
    return []


def mark_actuator(model: mujoco.MjModel, data: mujoco.MjData, actuator: int, reach: float, place: Place) -> list[str]:
    """An arrow along the force of an actuator at a site, the mark of the joint of another."""
    target = int(model.actuator_trnid[actuator, 0])
    kind = model.actuator_trntype[actuator]
    if kind == mujoco.mjtTrn.mjTRN_JOINT:
        return mark_joint(model, data, target, reach, place)
    if kind != mujoco.mjtTrn.mjTRN_SITE:
        return []
    turn = data.site_xmat[target].reshape(3, 3)
    gear = model.actuator_gear[actuator]
    force = turn @ (gear[:3] if gear[:3].any() else gear[3:])
    start = data.site_xpos[target]
    return draw_arrow(place(start), place(start + reach * force / np.linalg.norm(force)))


def draw_arrow(start: np.ndarray, end: np.ndarray) -> list[str]:
    """An arrow between two places (2,) [px]; nothing if it points at the reader."""
    along = end - start
    length = float(np.linalg.norm(along))
    if length < 1.0:
        return []
    back, aside = 9.0 * along / length, 5.0 * np.array([-along[1], along[0]]) / length
    head = np.stack([end, end - back + aside, end - back - aside])
    return [f'<path d="{trace(np.stack([start, end - back]))}" {LINE}/>', f'<path d="{trace(head)}z" {LIT}/>']
