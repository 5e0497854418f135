"""When a body flies: it stands still before and after, on what its model may lack."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from vpptwin.estimation.series import Series
from vpptwin.twin.robot.manifold import FREE

STILL, STOOD = 0.5, 2e-3
"""Whoever moves by less than this [m] in the first or last so many seconds stands there."""
OFF = 0.05
"""It flies as soon as it is so far above there [m]: clear of its feet, though not of the cushion under it."""


def find_flown(
    model: mujoco.MjModel, positions: Mapping[int, Series], start: float, end: float
) -> tuple[float, float, list[str]]:
    """Span in which every body that can fall and touches nothing flies [s], and what is said of the rest, in one line.

    Args:
        model: of the rig; where such a body may touch something, nothing is left out.
        positions: degree of freedom → position.
        start: from when on everything needed is there [s].
        end: until when [s].
    """
    first, last, strength = start, end, max(float(np.linalg.norm(model.opt.gravity)), 1e-9)
    for joint in range(model.njnt):
        dof, body = int(model.jnt_dofadr[joint]), int(model.jnt_bodyid[joint])
        along = 3 if model.jnt_type[joint] == FREE else int(slides_down(model, joint))
        if not along or dof not in positions:
            continue
        geoms = model.body_treeid[model.geom_bodyid] == model.body_treeid[body]
        if (model.geom_contype[geoms] | model.geom_conaffinity[geoms]).any():
            continue
        track = [positions[dof + axis] for axis in range(along)]
        time = track[0].time[(track[0].time >= start) & (track[0].time <= end)]
        place = np.stack([np.interp(time, series.time, series.value) for series in track], axis=1)
        if len(time) < 3:
            continue
        clear = np.ones(len(time), dtype=bool)
        for rows in (time <= start + STILL, time >= end - STILL):
            stood = np.median(place[rows], axis=0)
            away = np.abs((place - stood) @ (model.opt.gravity / strength if along == 3 else np.ones(1)))
            if (np.linalg.norm(place[rows] - stood, axis=1) < STOOD).all():
                clear &= away > OFF
        edges = np.flatnonzero(np.diff(clear, prepend=False, append=False)).reshape(-1, 2)  # of runs; one hops, bounces
        aloft = edges[time[edges[:, 1] - 1] - time[edges[:, 0]] > STILL]
        if len(aloft):  # whoever comes by that height again, as from a hover, flies on
            begin, stop = aloft[0, 0], aloft[-1, 1]
            first = max(first, float(time[begin])) if begin else first
            last = min(last, float(time[stop - 1])) if stop < len(time) else last
    if (first == start and last == end) or last <= first:
        return start, end, []
    left = [f"the first {first - start:.1f} s"] * (first > start) + [f"the last {end - last:.1f} s"] * (last < end)
    return first, last, [f"{' and '.join(left)} are left out: it is still there, and the MJCF has nothing to stand on"]


def slides_down(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint is a slide along gravity on which nothing but actuators and constraints hold a body."""
    dof, gravity = model.jnt_dofadr[joint], model.opt.gravity
    held = model.dof_frictionloss[dof] or model.jnt_stiffness[joint] or model.jnt_limited[joint]
    slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE and not model.body_parentid[model.jnt_bodyid[joint]]
    return bool(slide and not held and abs(model.jnt_axis[joint] @ gravity) > 0.9 * np.linalg.norm(gravity) > 0.0)
