"""What drives what in a MuJoCo model: joints and their actuators, rotors and drives that are alike, moment arms."""

from __future__ import annotations

import mujoco
import numpy as np

from vpptwin.twin.robot.model import HINGE, SLIDE

POSES, NO_ARM = 4, 1e-9
"""In how many poses moment arms are looked at, and the share of an actuator's largest that is none."""


def list_followers(model: mujoco.MjModel) -> list[str]:
    """Joints that an equality couples to another one, as a gear does, by the name of the one that follows."""
    coupled = model.eq_active0.astype(bool) & (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_obj2id >= 0)
    return [model.joint(int(joint)).name for joint in model.eq_obj1id[coupled]]


def group_rotors(model: mujoco.MjModel) -> list[tuple[str, ...]]:
    """Names of rotors that are alike, three or more at sites of one body, with like gears and laws."""
    groups: dict[tuple[float, ...], list[str]] = {}
    for i in range(model.nu):
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_SITE and model.actuator(i).name:
            body = find_carrier(model, model.actuator(i).name)
            law = *np.abs(model.actuator_gear[i]), *model.actuator_gainprm[i, :3], *model.actuator_biasprm[i, :3]
            groups.setdefault((body, *law), []).append(model.actuator(i).name)
    return [tuple(group) for group in groups.values() if len(group) > 2]


def find_carrier(model: mujoco.MjModel, rotor: str) -> int:
    """Index of the body that an actuator at a site sits on."""
    return int(model.site_bodyid[model.actuator_trnid[model.actuator(rotor).id, 0]])


def group_drives(model: mujoco.MjModel) -> dict[tuple[str, ...], tuple[str, ...]]:
    """Joints whose drives are of one make, three or more → their actuators: one each, of one law, and gears alike.

    Of motors of which the MJCF says neither inertia, friction nor a limit nothing tells whether they are.
    """
    groups: dict[tuple[float, ...], list[tuple[str, str]]] = {}
    for joint in map(int, np.flatnonzero((model.jnt_type == HINGE) | (model.jnt_type == SLIDE))):
        name, dof = model.joint(joint).name, int(model.jnt_dofadr[joint])
        drives = [i for i in range(model.nu) if acts_on(model, i, joint)]
        if not name or len(drives) != 1:
            continue
        i, limited = drives[0], bool(model.actuator_forcelimited[drives[0]])
        stated = [model.dof_damping[dof], model.dof_armature[dof], model.dof_frictionloss[dof]]
        law = [
            model.jnt_type[joint], model.actuator_dyntype[i], model.actuator_gaintype[i], model.actuator_biastype[i],
            abs(model.actuator_gear[i, 0]), *model.actuator_gainprm[i, :3], *model.actuator_biasprm[i, :3],
            *(model.actuator_forcerange[i] if limited else ()),
        ]  # fmt: skip
        if limited or any(stated):
            groups.setdefault((*map(float, law), *map(float, stated)), []).append((name, model.actuator(i).name))
    return {tuple(j for j, _ in group): tuple(a for _, a in group) for group in groups.values() if len(group) > 2}


def acts_on(model: mujoco.MjModel, actuator: int, joint: int) -> bool:
    """Whether an actuator acts on a joint itself."""
    direct = model.actuator_trntype[actuator] <= int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    return bool(direct and model.actuator_trnid[actuator, 0] == joint)


def is_geared(model: mujoco.MjModel, joint: str) -> bool:
    """Whether an actuator acts on a joint itself, as through gears."""
    return any(acts_on(model, i, model.joint(joint).id) for i in range(model.nu))


def is_driven(model: mujoco.MjModel, joint: str) -> bool:
    """Whether an actuator has a moment arm on a joint in any of a few poses: at it, through a tendon or as a rotor."""
    data, rng, dof = mujoco.MjData(model), np.random.default_rng(0), int(model.joint(joint).dofadr[0])
    for _ in range(POSES if model.nu else 0):
        arms = measure_arms(model, data)
        if (np.abs(arms[:, dof]) > NO_ARM * np.abs(arms).max(axis=1)).any():
            return True
        mujoco.mj_integratePos(model, data.qpos, rng.standard_normal(model.nv), 1.0)
    return False


def measure_arms(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Moment arms of all actuators in a pose, (nu, nv) m or 1."""
    arms = np.zeros((model.nu, model.nv))
    mujoco.mj_fwdPosition(model, data)
    if model.nu:
        mujoco.mju_sparse2dense(arms, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    return arms


def step_inertia(model: mujoco.MjModel) -> np.ndarray:
    """By how much the engine's step may seem to change the inertia of every degree of freedom, (nv,) kg, kg m².

    Half a step times the damping of joints and servos, which is taken at the end of the step (more), or at its start.
    """
    # h/2 (b + Σ k_v r²): what an implicit step of M v̇ = -b v adds to M (h the step, r moment arms).
    servos = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE) * np.abs(model.actuator_biasprm[:, 2])
    arms = measure_arms(model, mujoco.MjData(model))
    return np.asarray(0.5 * model.opt.timestep * (model.dof_damping + servos @ arms**2))
