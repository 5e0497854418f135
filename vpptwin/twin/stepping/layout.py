"""What of a model can be stepped without MuJoCo: how it hangs together, its numbers, and what could touch."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import mujoco
import numpy as np

from vpptwin.effects.link import to_matrix
from vpptwin.engine.tree import Pose, Reach, Shape, Tree, gear_actuators, place_bodies, weigh_bodies
from vpptwin.twin.robot.model import HINGE, SLIDE, find_meeting

SITE, JOINT = int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_JOINT)
EULER, IMPLICITFAST = int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
PLANE, BOX = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_BOX)
MAX_DOFS = 12
"""Degrees of freedom up to which it pays."""
EQUAL = 1e-9
"""By which inertia, bias and moments may differ from MuJoCo's, as shares of the largest."""
IGNORED = sum(int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")) for name in (
    "CONSTRAINT", "EQUALITY", "FRICTIONLOSS", "LIMIT", "CONTACT", "WARMSTART", "FILTERPARENT", "REFSAFE", "SENSOR",
    "MIDPHASE", "AUTORESET", "NATIVECCD", "ISLAND", "MULTICCD", "SPRING",
))  # fmt: skip
"""Flags that change nothing where nothing touches; springs are read off the joints."""
PER_SIMULATION = {"body_mass": "body_mass", "body_inertia": "body_inertia", "body_ipos": "body_ipos",
                  "jnt_stiffness": "jnt_stiffness", "qpos_spring": "qpos_spring", "qpos0": "qpos0",
                  "dof_damping": "dof_damping", "dof_armature": "dof_armature", "opt.gravity": "gravity",
                  "actuator_gainprm": "gain", "actuator_biasprm": "bias", "actuator_forcerange": "force_range",
                  "body_iquat": "body_imat"}  # fmt: skip
"""Fields that effects may write → what the fused step calls them."""
AT_CONTACTS = {"geom_solref", "geom_friction"}
"""Fields that they may write and it does not need: whatever touches is stepped by MuJoCo."""


@dataclass(frozen=True)
class TreeLayout:
    """What the fused step needs to know of a model: see `Tree`, `Shape` and `Reach`."""

    tree: Tree  # how it hangs together
    numbers: dict[str, np.ndarray]  # `Shape`, gravity, gain, bias and force range of the nominal model, by name
    reach: Reach  # what could touch
    implicit: bool = False  # whether velocities of actuators are integrated implicitly, as damping always is


def read_layout(model: mujoco.MjModel, written: Set[str]) -> TreeLayout | None:
    """The layout of a model; None where it has what only MuJoCo steps, or what the tree gets otherwise than MuJoCo.

    Args:
        model: that is stepped.
        written: its fields that effects write.
    """
    known = PER_SIMULATION.keys() | AT_CONTACTS
    if not is_plain(model) or any(name not in known for name in written if is_of_model(model, name)):
        return None
    tree, numbers = read_tree(model)
    reach = read_reach(model, tree)
    implicit = int(model.opt.integrator) == IMPLICITFAST and bool(find_braking(model).any())
    layout = None if reach is None else TreeLayout(tree, numbers, reach, implicit)
    return layout if layout is not None and agrees(layout, model) else None


def read_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4), as effects write them, as rows of rotations (..., 9)."""
    return to_matrix(quaternions.reshape(-1, 4)).reshape(*quaternions.shape[:-1], 9)


def is_of_model(model: mujoco.MjModel, name: str) -> bool:
    """Whether a constant is a field of the model, not of sensors or actuators of ours."""
    return name.startswith("opt.") or hasattr(model, name)


def is_plain(model: mujoco.MjModel) -> bool:
    """Whether a model has but hinges, slides, and actuators at joints and sites, in vacuum, stepped simply.

    That is by Euler, or by implicitfast without actuators at sites, or joints with a limit, that brake by velocity.
    """
    flags = model.opt.disableflags & ~IGNORED
    absent = ("neq", "ntendon", "nflex", "npair", "nmocap", "nplugin", "ngravcomp", "nplastic", "na", "nhistory")
    zero = ("dof_dampingpoly", "jnt_stiffnesspoly", "actuator_damping", "actuator_dampingpoly", "actuator_armature",
            "geom_adhesion")  # fmt: skip
    kinds, integrator = np.asarray(model.jnt_type), int(model.opt.integrator)
    return bool(
        0 < model.nv <= MAX_DOFS and not flags and not model.opt.density and not model.opt.viscosity
        and (integrator == EULER or (integrator == IMPLICITFAST and brakes_at_joints(model)))
        and not any(getattr(model, name) for name in absent)
        and not any(np.any(getattr(model, name)) for name in zero)
        and np.isin(kinds, (HINGE, SLIDE)).all()
        and np.isin(model.actuator_trntype, (SITE, JOINT)).all()
        and (np.asarray(model.actuator_trnid)[:, 1] < 0).all()
        and not (model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_SPRING) and np.any(model.jnt_stiffness))
    )  # fmt: skip


def find_braking(model: mujoco.MjModel) -> np.ndarray:
    """Whose force depends on velocity, by the kind of actuator, (nu,): effects may change by how much."""
    gain, bias = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_AFFINE
    return (np.asarray(model.actuator_gaintype) == int(gain)) | (np.asarray(model.actuator_biastype) == int(bias))


def brakes_at_joints(model: mujoco.MjModel) -> bool:
    """Whether all actuators whose force depends on velocity are at joints without a limit of their force."""
    braking = find_braking(model)
    joints = np.asarray(model.actuator_trnid)[braking, 0]
    at_joints = np.asarray(model.actuator_trntype)[braking] == JOINT
    return bool(at_joints.all() and not np.asarray(model.jnt_actfrclimited)[joints].any())


def read_tree(model: mujoco.MjModel) -> tuple[Tree, dict[str, np.ndarray]]:
    """How a model hangs together, and its numbers."""
    nu = int(model.nu)
    first = np.where(model.body_jntnum > 0, model.body_jntadr, 0).astype(np.int64)
    last = first + np.asarray(model.body_jntnum)
    deepest = np.full(model.nbody, -1, np.int64)
    for b in range(1, model.nbody):
        deepest[b] = last[b] - 1 if model.body_jntnum[b] else deepest[model.body_parentid[b]]
    at_site = np.asarray(model.actuator_trntype) == SITE
    sites, target = np.asarray(model.actuator_trnid)[:, 0], np.zeros(nu, np.int64)
    target[~at_site] = sites[~at_site]
    seat, place = np.full(nu, -1, np.int64), np.zeros((nu, 3))
    forces, torques = np.zeros((nu, 3)), np.zeros((nu, 3))
    for i in np.flatnonzero(at_site):
        seat[i], place[i] = model.site_bodyid[sites[i]], model.site_pos[sites[i]]
        turn = to_matrix(model.site_quat[sites[i]][None])[0]
        forces[i], torques[i] = turn @ model.actuator_gear[i, :3], turn @ model.actuator_gear[i, 3:]
    tree = Tree(
        np.array(model.body_parentid, np.int64), first, last.astype(np.int64), deepest,
        np.array(model.dof_parentid, np.int64), np.array(model.jnt_type == HINGE), seat, target,
    )  # fmt: skip
    copied = ("body_pos", "body_ipos", "body_mass", "body_inertia", "jnt_pos", "jnt_axis", "qpos0", "jnt_stiffness",
              "qpos_spring", "dof_damping", "dof_armature")  # fmt: skip
    numbers = {name: np.array(getattr(model, name), float) for name in copied}
    numbers |= {"body_mat": to_matrix(model.body_quat), "body_imat": to_matrix(model.body_iquat)}
    numbers |= {"site_pos": place, "gear_force": forces, "gear_torque": torques}
    numbers["gear"] = np.array(model.actuator_gear[:, 0]).reshape(nu)
    numbers["gravity"] = np.array(model.opt.gravity)
    numbers |= {"gain": np.array(model.actuator_gainprm), "bias": np.array(model.actuator_biasprm)}
    numbers["force_range"] = np.array(model.actuator_forcerange)
    numbers |= {name: numbers[name].reshape(-1, 9) for name in ("body_mat", "body_imat")}
    return tree, numbers


def read_reach(model: mujoco.MjModel, tree: Tree) -> Reach | None:
    """What could touch in a model; None where that is taken to touch in its reference pose already."""
    nv, held = int(model.nv), tree.deepest < 0
    ranges = np.tile([-np.inf, np.inf], (nv, 1))
    limited = np.asarray(model.jnt_limited, bool)
    margin = np.asarray(model.jnt_margin)[:, None] * [1.0, -1.0]
    ranges[limited] = (np.asarray(model.jnt_range) + margin)[limited]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rows, meeting = [], find_meeting(model)
    for g in range(model.ngeom):
        for h in range(model.ngeom):
            if not meeting[g, h] or held[model.geom_bodyid[g]] or (g > h and not held[model.geom_bodyid[h]]):
                continue
            kind, radius = int(model.geom_type[h]), model.geom_rbound[g]
            if kind not in (PLANE, BOX) or not held[model.geom_bodyid[h]]:
                kind = -1
            size = model.geom_size[h] if kind == BOX else [model.geom_rbound[h], 0.0, 0.0]
            radius += model.geom_margin[g] + model.geom_margin[h] + model.geom_gap[g] + model.geom_gap[h]
            other = 0 if held[model.geom_bodyid[h]] else model.geom_bodyid[h]
            place = data.geom_xpos[h] if other == 0 else model.geom_pos[h]
            if not model.geom_rbound[g]:  # a plane that moves, a height field
                return None
            rows.append((
                model.geom_bodyid[g], (*model.geom_pos[g], radius), {PLANE: 0, BOX: 1}.get(kind, 2), other,
                (*place, *data.geom_xmat[h], *size),
            ))  # fmt: skip
    return Reach(
        ranges, np.array([r[0] for r in rows], np.int64), np.array([r[1] for r in rows]).reshape(-1, 4),
        np.array([r[2] for r in rows], np.int64), np.array([r[3] for r in rows], np.int64),
        np.array([r[4] for r in rows]).reshape(-1, 15),
    )  # fmt: skip


def make_pose(nbody: int, nv: int) -> Pose:
    """Room for a pose."""
    bodies, joints = (nbody, 3), (nv, 3)
    return Pose(
        np.zeros(bodies), np.zeros((nbody, 9)), np.zeros(joints), np.zeros(joints), np.zeros(bodies), np.zeros(bodies),
        np.zeros(bodies), np.zeros((2, *joints)), np.zeros((nbody, 16)),
    )  # fmt: skip


def agrees(layout: TreeLayout, model: mujoco.MjModel) -> bool:
    """Whether inertia, bias and moments are MuJoCo's, in three random poses and motions."""
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    nv, nu = int(model.nv), int(model.nu)
    shape, pose = Shape(**{name: layout.numbers[name] for name in Shape._fields}), make_pose(model.nbody, nv)
    mass, bias, moment, dense = np.zeros((nv, nv)), np.zeros(nv), np.zeros((nu, nv)), np.zeros((nv, nv))
    for _ in range(3):
        data.qpos[:], data.qvel[:] = rng.uniform(-1, 1, nv), rng.uniform(-3, 3, nv)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        place_bodies(layout.tree, shape, data.qpos, data.qvel, layout.numbers["gravity"], pose)
        weigh_bodies(layout.tree, shape, pose, mass, bias)
        gear_actuators(layout.tree, shape, pose, moment)
        mujoco.mj_fullM(model, data, dense)
        theirs = np.zeros((nu, nv))
        if nu:
            mujoco.mju_sparse2dense(
                theirs, data.actuator_moment.ravel(), data.moment_rownnz, data.moment_rowadr, data.moment_colind.ravel()
            )
        passive = -shape.dof_damping * data.qvel - shape.jnt_stiffness * (data.qpos - shape.qpos_spring)
        lengths = np.where(layout.tree.seat < 0, shape.gear * data.qpos[layout.tree.drives], 0.0) if nu else np.zeros(0)
        for ours, own in (
            (mass, dense), (bias, data.qfrc_bias), (moment, theirs), (passive, data.qfrc_passive),
            (lengths, data.actuator_length),
        ):  # fmt: skip
            if ours.size and not np.abs(ours - own).max() <= EQUAL * max(float(np.abs(own).max()), 1e-12):
                return False
    return True
