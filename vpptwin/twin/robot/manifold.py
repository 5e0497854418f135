"""Poses on manifolds: moving along a tangent vector, and the tangent vector between two poses.

Positions have nq numbers, velocities and everything else that is added to a pose nv. Where joints are hinges and slides
both are the same and poses can be added; a quaternion can't. Nothing outside adds to a pose or subtracts two.
Attitudes are unit quaternions (w, x, y, z); what is added to them is a rotation vector in the body's own axes [rad],
as MuJoCo's angular velocities of free and ball joints are.
"""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

BALL, FREE = int(mujoco.mjtJoint.mjJNT_BALL), int(mujoco.mjtJoint.mjJNT_FREE)
SMALL = 1e-9
"""Angle [rad] below which a rotation is its own sine."""


def multiply_attitudes(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The product of quaternions, (..., 4) each: the second rotation in the axes that the first made."""
    # (w, v)(s, u) = (w s - v·u, w u + s v + v × u) (Hamilton).
    w, v = first[..., :1], first[..., 1:]
    scalar, vector = second[..., :1], second[..., 1:]
    product = w * scalar - (v * vector).sum(axis=-1, keepdims=True)
    return np.concatenate([product, w * vector + scalar * v + np.cross(v, vector)], axis=-1)


def conjugate(attitude: np.ndarray) -> np.ndarray:
    """The rotations back, (..., 4)."""
    return attitude * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(attitude: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Attitudes (..., 4) turned by rotation vectors in body axes, (..., 3) rad; unit quaternions."""
    # q exp(φ/2) with exp(φ/2) = (cos |φ|/2, φ/|φ| sin |φ|/2) (Solà 2017, Quaternion kinematics).
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    scale = np.where(angle > SMALL, np.sin(0.5 * angle) / np.maximum(angle, SMALL), 0.5)
    moved = multiply_attitudes(attitude, np.concatenate([np.cos(0.5 * angle), scale * turn], axis=-1))
    return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))


def difference_attitudes(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Rotation vectors in the body axes of `before` that lead to `after`, (..., 3) rad, no longer than π."""
    # φ = 2 log(q* p) = 2 atan2(|v|, w) v/|v|, the shorter way round.
    turned = multiply_attitudes(conjugate(before), after)
    turned = np.where(turned[..., :1] < 0.0, -turned, turned)
    sine = np.linalg.norm(turned[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, turned[..., :1])
    return np.asarray(np.where(sine > SMALL, angle / np.maximum(sine, SMALL), 2.0) * turned[..., 1:])


def follow_sign(attitude: np.ndarray) -> np.ndarray:
    """Unit quaternions (n, 4) with the sign of the one before: q and -q are one rotation."""
    unit = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    signs = np.cumprod(np.where((unit[1:] * unit[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))
    return np.asarray(unit * np.concatenate([[1.0], signs])[:, None])


def turn_to_world(attitude: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors in body axes, (..., 3), in the world's."""
    w, v = attitude[..., :1], attitude[..., 1:]
    # x + 2 w (v × x) + 2 v × (v × x), which is q x q*.
    across = 2.0 * np.cross(v, vector)
    return np.asarray(vector + w * across + np.cross(v, across))


def read_angles(attitude: np.ndarray) -> np.ndarray:
    """Roll, pitch and yaw of attitudes (n, 4), (n, 3) rad: they yaw about z, then pitch about y, roll about x."""
    w, x, y, z = attitude.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([roll, np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)), yaw])


def list_attitudes(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Where quaternions lie in positions, and their rotation vectors in velocities, of free and ball joints."""
    found = []
    for joint in range(model.njnt):
        q, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        if model.jnt_type[joint] == FREE:
            found.append((q + 3, dof + 3))
        elif model.jnt_type[joint] == BALL:
            found.append((q, dof))
    return found


def list_plain(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """The other coordinates, which can be added: where they lie in positions and in velocities, (n,) each."""
    turning = list_attitudes(model)
    q = np.setdiff1d(np.arange(model.nq), [address + i for address, _ in turning for i in range(4)])
    dof = np.setdiff1d(np.arange(model.nv), [address + i for _, address in turning for i in range(3)])
    return q, dof


def find_place(model: mujoco.MjModel, dof: int) -> int:
    """Where in a pose the coordinate of a degree of freedom lies; its quaternion's first number if it turns a body."""
    joint = int(model.dof_jntid[dof])
    q, offset = int(model.jnt_qposadr[joint]), dof - int(model.jnt_dofadr[joint])
    if model.jnt_type[joint] == BALL:
        return q
    return q + min(offset, 3)


def find_places(model: mujoco.MjModel, dofs: Iterable[int]) -> np.ndarray:
    """Where in a pose the numbers of some degrees of freedom lie, all four of a quaternion for those that turn."""
    turning = {turn + i: q for q, turn in list_attitudes(model) for i in range(3)}
    places = ([turning[d] + i for i in range(4)] if d in turning else [find_place(model, d)] for d in map(int, dofs))
    return np.unique([place for found in places for place in found]).astype(int)


def chart(model: mujoco.MjModel, pose: np.ndarray) -> np.ndarray:
    """A number for every degree of freedom of poses (..., nq): coordinates, and rotation vectors from upright."""
    if model.nq == model.nv:
        return pose
    q, dof = list_plain(model)
    found = difference_poses(model, model.qpos0, pose)
    found[..., dof] = pose[..., q]
    return found


def integrate_pose(model: mujoco.MjModel, pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Where poses are after a step along their tangent: `mj_integratePos`, many at once.

    Args:
        model: whose joints they are of.
        pose: (..., nq) m, rad, unit quaternions.
        step: what broadcasts with it to (..., nv) m, rad.

    Returns:
        (..., nq).
    """
    if model.nq == model.nv:
        return np.asarray(pose + step)
    shape = np.broadcast_shapes(pose.shape[:-1], step.shape[:-1])
    moved = np.array(np.broadcast_to(pose, (*shape, model.nq)), dtype=float)
    steps = np.broadcast_to(step, (*shape, model.nv))
    q, dof = list_plain(model)
    moved[..., q] += steps[..., dof]
    for address, turn in list_attitudes(model):
        moved[..., address : address + 4] = rotate(moved[..., address : address + 4], steps[..., turn : turn + 3])
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
    first, second = (np.broadcast_to(p, (*shape, model.nq)) for p in (before, after))
    steps = np.empty((*shape, model.nv))
    q, dof = list_plain(model)
    steps[..., dof] = second[..., q] - first[..., q]
    for address, turn in list_attitudes(model):
        ends = (p[..., address : address + 4] for p in (first, second))
        steps[..., turn : turn + 3] = difference_attitudes(*ends)
    return steps
