"""What one simulation's mjModel and mjData show while MuJoCo's control callback runs, as numpy arrays."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from vpptwin.engine.compile import compilable

GAIN_AFFINE = int(mujoco.mjtGain.mjGAIN_AFFINE)
BIAS_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)


class View(NamedTuple):
    """Arrays over one simulation, with MuJoCo's names and units; `qfrc_applied` and `ctrl` are written."""

    time: float  # s
    timestep: float  # s
    qpos: np.ndarray  # (nq,)
    qvel: np.ndarray  # (nv,)
    ctrl: np.ndarray  # (nu,)
    qfrc_applied: np.ndarray  # (nv,)
    qfrc_passive: np.ndarray  # (nv,)
    qfrc_bias: np.ndarray  # (nv,)
    qfrc_constraint: np.ndarray  # of the last step, (nv,)
    qacc_warmstart: np.ndarray  # acceleration of the last step, (nv,)
    constraints: int  # how many are active, rows of contacts, end stops and equalities
    colliding: bool  # whether a contact is
    inertia: np.ndarray  # sparse joint-space inertia, with the three that follow, (nC,)
    row_length: np.ndarray
    row_start: np.ndarray
    column: np.ndarray
    dof_damping: np.ndarray  # (nv,)
    dof_armature: np.ndarray  # (nv,)
    body_mass: np.ndarray  # (nbody,)
    gravity: np.ndarray  # (3,) m/s²
    moment: np.ndarray  # sparse moments of the actuators, with the three that follow
    moment_length: np.ndarray
    moment_start: np.ndarray
    moment_column: np.ndarray
    length: np.ndarray  # of the actuators, (nu,)
    velocity: np.ndarray  # likewise
    gain: np.ndarray  # parameters of the actuators, (nu, 10)
    bias: np.ndarray  # likewise
    gain_type: np.ndarray  # (nu,)
    bias_type: np.ndarray  # (nu,)
    ctrl_limited: np.ndarray  # (nu,)
    force_limited: np.ndarray  # (nu,)
    ctrl_range: np.ndarray  # (nu, 2)
    force_range: np.ndarray  # (nu, 2)
    joint: np.ndarray  # of each degree of freedom, (nv,)
    joint_limited: np.ndarray  # whether what all actuators together exert on a joint is limited, (njnt,)
    joint_range: np.ndarray  # to what, (njnt, 2)
    joint_lifted: np.ndarray  # whether the actuators of a joint compensate gravity, (njnt,)
    qfrc_gravcomp: np.ndarray  # what that takes, (nv,)


MODEL_ARRAYS = {
    "row_length": ("M_rownnz", np.int32, "nv"), "row_start": ("M_rowadr", np.int32, "nv"),
    "column": ("M_colind", np.int32, "nC"),
    "dof_damping": ("dof_damping", np.float64, "nv"), "dof_armature": ("dof_armature", np.float64, "nv"),
    "body_mass": ("body_mass", np.float64, "nbody"),
    "gain": ("actuator_gainprm", np.float64, "nu"), "bias": ("actuator_biasprm", np.float64, "nu"),
    "gain_type": ("actuator_gaintype", np.int32, "nu"), "bias_type": ("actuator_biastype", np.int32, "nu"),
    "ctrl_limited": ("actuator_ctrllimited", np.bool_, "nu"),
    "force_limited": ("actuator_forcelimited", np.bool_, "nu"),
    "ctrl_range": ("actuator_ctrlrange", np.float64, "nu"), "force_range": ("actuator_forcerange", np.float64, "nu"),
    "joint": ("dof_jntid", np.int32, "nv"),
    "joint_limited": ("jnt_actfrclimited", np.bool_, "njnt"), "joint_range": ("jnt_actfrcrange", np.float64, "njnt"),
    "joint_lifted": ("jnt_actgravcomp", np.bool_, "njnt"),
}  # fmt: skip
"""View field → field of mjModel, its type and its leading size."""
DATA_ARRAYS = {
    "qpos": ("qpos", np.float64, "nq"), "ctrl": ("ctrl", np.float64, "nu"), "inertia": ("M", np.float64, "nC"),
    **{name: (name, np.float64, "nv") for name in (
        "qvel", "qfrc_applied", "qfrc_passive", "qfrc_bias", "qfrc_constraint", "qacc_warmstart", "qfrc_gravcomp",
    )},
    "moment": ("actuator_moment", np.float64, "nJmom"), "moment_column": ("moment_colind", np.int32, "nJmom"),
    "moment_length": ("moment_rownnz", np.int32, "nu"), "moment_start": ("moment_rowadr", np.int32, "nu"),
    "length": ("actuator_length", np.float64, "nu"), "velocity": ("actuator_velocity", np.float64, "nu"),
}  # fmt: skip
"""View field → field of mjData, its type and its leading size."""
COLUMNS = {
    "gain": int(mujoco.mjNGAIN),
    "bias": int(mujoco.mjNBIAS),
    "ctrl_range": 2,
    "force_range": 2,
    "joint_range": 2,
}
"""View fields with a second axis and its size."""


def look_at(model: mujoco.MjModel, data: mujoco.MjData) -> View:
    """The view of an MjModel and MjData in Python: what compiled code gets from their addresses."""
    fields = {name: getattr(model, field) for name, (field, *_) in MODEL_ARRAYS.items()}
    fields |= {name: getattr(data, field) for name, (field, *_) in DATA_ARRAYS.items()}
    own = {"time": data.time, "timestep": model.opt.timestep, "gravity": model.opt.gravity}
    return View(**own, constraints=data.nefc, colliding=data.ncon > 0, **fields)


@compilable(forceinline=True, keep=True)
def foresee_actuators(view: View, exerted: np.ndarray) -> None:
    """Write what the actuators will exert under `view.ctrl`, (nv,) [N, N m], as the engine is about to compute it."""
    exerted[:] = 0.0
    for i in range(len(view.ctrl)):
        add_actuator_force(view, i, exerted)
    for i in range(len(exerted)):
        joint = view.joint[i]
        if view.joint_lifted[joint]:
            exerted[i] += view.qfrc_gravcomp[i]
        if view.joint_limited[joint]:
            exerted[i] = min(max(exerted[i], view.joint_range[joint, 0]), view.joint_range[joint, 1])


@compilable(forceinline=True, keep=True)
def find_idle(view: View, i: int) -> float:
    """The control at which a servo exerts nothing: where it is, how fast it is; 0 of what is no servo."""
    gain, stiffness, damping = view.gain[i, 0], view.bias[i, 1], view.bias[i, 2]
    if view.bias_type[i] != BIAS_AFFINE or gain == 0.0 or (stiffness != -gain and damping != -gain):
        return 0.0
    # g u + b_0 + b_1 l + b_2 l' = 0 solved for u (MuJoCo, Computation, Actuation model)
    return -(view.bias[i, 0] + stiffness * view.length[i] + damping * view.velocity[i]) / gain


@compilable(forceinline=True, keep=True)
def find_control(view: View, i: int) -> float:
    """The control of actuator i within its range."""
    control = view.ctrl[i]
    if view.ctrl_limited[i]:
        control = min(max(control, view.ctrl_range[i, 0]), view.ctrl_range[i, 1])
    return control


@compilable(forceinline=True, keep=True)
def find_force(view: View, i: int) -> float:
    """What actuator i would exert without a limit of its force."""
    gain = view.gain[i, 0]
    if view.gain_type[i] == GAIN_AFFINE:
        gain += view.gain[i, 1] * view.length[i] + view.gain[i, 2] * view.velocity[i]
    force = gain * find_control(view, i)
    if view.bias_type[i] == BIAS_AFFINE:
        force += view.bias[i, 0] + view.bias[i, 1] * view.length[i] + view.bias[i, 2] * view.velocity[i]
    return force


@compilable(forceinline=True, keep=True)
def add_actuator_force(view: View, i: int, exerted: np.ndarray) -> None:
    """Add to `exerted`, (nv,), what actuator i will exert by itself."""
    force = find_force(view, i)
    if view.force_limited[i]:
        force = min(max(force, view.force_range[i, 0]), view.force_range[i, 1])
    for k in range(view.moment_start[i], view.moment_start[i] + view.moment_length[i]):
        exerted[view.moment_column[k]] += view.moment[k] * force


@compilable(forceinline=True, keep=True)
def foresee_drag(view: View, drag: np.ndarray) -> None:
    """Write by how much joints are braked for every unit of velocity, (nv,): by damping and by actuators at them.

    As implicitfast takes it into its matrix, which of an actuator at the limit of its force takes nothing.
    """
    for j in range(len(drag)):
        drag[j] = view.dof_damping[j]
    for i in range(len(view.ctrl)):
        slope, force = 0.0, find_force(view, i)
        if view.bias_type[i] == BIAS_AFFINE:
            slope += view.bias[i, 2]
        if view.gain_type[i] == GAIN_AFFINE:
            slope += view.gain[i, 2] * find_control(view, i)
        if view.force_limited[i] and not view.force_range[i, 0] < force < view.force_range[i, 1]:
            slope = 0.0
        for k in range(view.moment_start[i], view.moment_start[i] + view.moment_length[i]):
            drag[view.moment_column[k]] -= view.moment[k] ** 2 * slope
