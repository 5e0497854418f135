"""Poses on manifolds: moving along a tangent vector, and the tangent vector between two poses.

Positions have nq numbers, velocities and everything else that is added to a pose nv. Where joints are hinges and slides
both are the same and poses can be added; a quaternion can't. Nothing outside adds to a pose or subtracts two.
"""

from __future__ import annotations

import mujoco
import numpy as np


def integrate_pose(model: mujoco.MjModel, pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Where poses are after a step along their tangent: `mj_integratePos`.

    Args:
        model: whose joints they are of.
        pose: (..., nq) m, rad, unit quaternions.
        step: what broadcasts with it to (..., nv) m, rad.

    Returns:
        (..., nq).
    """
    if model.nq == model.nv:  # no quaternions: what MuJoCo does to hinges and slides, many at once
        return np.asarray(pose + step)
    shape = np.broadcast_shapes(pose.shape[:-1], step.shape[:-1])
    moved = np.array(np.broadcast_to(pose, (*shape, model.nq)), dtype=float, order="C")
    steps = np.ascontiguousarray(np.broadcast_to(step, (*shape, model.nv)), dtype=float)
    for row, along in zip(moved.reshape(-1, model.nq), steps.reshape(-1, model.nv)):
        mujoco.mj_integratePos(model, row, along, 1.0)
    return moved


def difference_poses(model: mujoco.MjModel, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The tangent step from one pose to another: `mj_differentiatePos`, the inverse of `integrate_pose`.

    Args:
        model: whose joints they are of.
        before: (..., nq) m, rad, unit quaternions.
        after: what broadcasts with it.

    Returns:
        (..., nv) m, rad.
    """
    if model.nq == model.nv:
        return np.asarray(after - before)
    shape = np.broadcast_shapes(before.shape[:-1], after.shape[:-1])
    first, second = (np.ascontiguousarray(np.broadcast_to(p, (*shape, model.nq)), float) for p in (before, after))
    steps = np.empty((*shape, model.nv))
    rows = (steps.reshape(-1, model.nv), first.reshape(-1, model.nq), second.reshape(-1, model.nq))
    for step, one, other in zip(*rows):
        mujoco.mj_differentiatePos(model, step, 1.0, one, other)
    return steps
