"""The MuJoCo model of a twin: compiled from MJCF, checked, and what is read off it."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from vpptwin.effects import Effect
from vpptwin.effects.joint import HINGE_ACCELERATION, SLIDE_ACCELERATION
from vpptwin.engine.callback import WORDS, left_alone
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.actuation import BIASES, GAINS, simplify_actuators
from vpptwin.twin.robot.manifold import BALL, FREE
from vpptwin.twin.robot.parts import read_parts
from vpptwin.twin.robot.trial import MAX_BYTES, bound_memory, check_claims, check_size, try_model
from vpptwin.twin.robot.urdf import explain_urdf, read_urdf, specify_urdf, tell_drives

HEAVY = 1e6
"""Inertia of a joint that follows its log, as a multiple of what it carries: what its motion is off by, inverted."""

SLIDE, HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
INTEGRATORS = {
    int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_IMPLICIT),
    int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
}  # fmt: skip
"""Integrators that evaluate the forces once a step."""

Adapt = Callable[[mujoco.MjSpec, Path], None]
"""Writes a rig's own numbers into the specification that was read from a file."""


def compile_model(
    path: Path, adapt: Adapt = lambda spec, path: None, check: Callable[[mujoco.MjModel, Path], None] | None = None
) -> mujoco.MjModel:
    """Compile an MJCF, a URDF or a file of xacro.

    Args:
        path: of the file.
        adapt: writes numbers into it.
        check: refuses a model that lacks what a rig must have.

    Raises:
        InputError: if MuJoCo or `check` refuses it, or the model is one that a twin can't step (`check_engine`).
    """
    elements = read_parts(path)
    check_claims(path, elements)
    urdf = read_urdf(path)
    try_model(path, elements, MAX_BYTES, urdf)
    try:
        with bound_memory(), left_alone():  # a callback in Python would fail there
            model = specify_model(path, urdf, adapt).compile()
    except InputError:
        raise
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        told = InputError(f"{path}: MuJoCo says {error}", "an MJCF that compiles", "open it in MuJoCo's viewer")
        raise (None if urdf is None else explain_urdf(path, urdf, str(error))) or told from error
    if model.nv == 0:
        raise InputError(f"{path}: no joints", "an MJCF with at least one joint", "add one")
    for name in bytes(model.names).decode("utf-8", "replace").split("\0"):
        if not name.isprintable():  # it becomes names of effects, and stands in verdicts and pages
            raise InputError(f"{path}: the name {name!r}", "letters that can be shown", "rename it")
    if check is not None:
        check(model, path)
    check_size(model, path)
    check_engine(model, path)
    check_inertia(model, path)
    if urdf is not None:
        tell_drives(path, urdf)
    return model


def specify_model(path: Path, urdf: ET.Element | None, adapt: Adapt) -> mujoco.MjSpec:
    """Read a model, with a rig's own numbers, and with room for our marks.

    Args:
        path: of the file.
        urdf: what `read_urdf` made of it.
        adapt: sets those numbers.

    Raises:
        InputError: if it lacks what those numbers are for.
        ValueError: if MuJoCo refuses the file.
    """
    spec = mujoco.MjSpec.from_file(str(path)) if urdf is None else specify_urdf(urdf)
    adapt(spec, path)
    simplify_actuators(spec)
    for joint in spec.joints:
        if joint.type in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
            joint.parent.simple = 0  # whose centre of mass effects may move
    spec.nuserdata = WORDS  # marks our simulations to the compiled step
    return spec


def check_engine(model: mujoco.MjModel, path: Path) -> None:
    """Check that the model has no states that a twin's state does not hold, and steps and pushes as the twin expects.

    Raises:
        InputError: if it has or does not.
    """
    if mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_FULLPHYSICS)) != 1 + model.nq + model.nv:
        delayed = [i for i in range(len(model.actuator_delay)) if model.actuator_delay[i] or model.actuator_dyntype[i]]
        found = f"actuator {model.actuator(delayed[0]).name or delayed[0]}" if delayed else "a plugin or sensor"
        raise InputError(
            f"{path}: {found} with a state of its own",
            "actuators that act at once, through a lag (dyntype filter, filterexact), late (delay), or intvelocity",
            "leave out dyntype, actlimited or plugin",
        )
    unforeseen = {
        "flag actuation": model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION),
        "flag clampctrl": model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL),
        "actuatorgroupdisable": model.opt.disableactuator,
        "actuatorfrcrange of a tendon": model.tendon_actfrclimited.any(),
    }
    for setting, used in unforeseen.items():
        if used and model.nu:
            raise InputError(
                f"{path}: actuators limited or switched off by {setting}",
                "limits of controls, actuators or joints, as dry friction has to know their force beforehand",
                "leave it out, or the actuators",
            )
    if model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP):
        raise InputError(f"{path}: bodies that may sleep", "bodies that are simulated always", "leave out flag sleep")
    if int(model.opt.integrator) not in INTEGRATORS:
        found = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
        raise InputError(
            f"{path}: integrator {found}",
            "Euler, implicitfast or implicit, which compute forces once a step as actuators and friction need it",
            'set integrator="Euler"',
        )
    for i, kinds in enumerate(zip(model.actuator_gaintype, model.actuator_biastype)):
        plugged = model.actuator_plugin[i] >= 0
        if plugged or int(kinds[0]) not in GAINS or int(kinds[1]) not in BIASES:
            gain = mujoco.mjtGain(kinds[0]).name.removeprefix("mjGAIN_").lower()
            bias = mujoco.mjtBias(kinds[1]).name.removeprefix("mjBIAS_").lower()
            raise InputError(
                f"{path}: actuator {model.actuator(i).name or i} with "
                + ("a plugin" if plugged else f"gain {gain} and bias {bias}"),
                "gain fixed or affine and bias none or affine, such as motor, position and velocity",
                "replace it: dry friction has to know its force beforehand",
            )


def check_inertia(model: mujoco.MjModel, path: Path) -> None:
    """Refuse joints that move nothing, such as one whose axis is too long for its length to be a number.

    Raises:
        InputError: if there is one.
    """
    inertia = np.diag(inertia_at_rest(model))
    for dof in np.flatnonzero(~((inertia > 0.0) & np.isfinite(inertia)))[:1]:
        joint = int(model.dof_jntid[dof])
        raise InputError(
            f"{path}: joint {model.joint(joint).name or joint} moves an inertia of {inertia[dof]:g}",
            "bodies with mass below every joint, and axes of about unit length",
            "correct the joint or its bodies",
        )


def inertia_at_rest(model: mujoco.MjModel) -> np.ndarray:
    """Joint-space inertia in the reference pose, (nv, nv) kg, kg m²."""
    # M(q) of M q̈ + c = τ, by the composite-rigid-body algorithm (Featherstone 2008, chapter 6).
    data, inertia = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_makeM(model, data)
    mujoco.mj_fullM(model, data, inertia)
    return inertia


def describe_joints(model: mujoco.MjModel) -> list[tuple[str, bool, float]]:
    """Name, whether rotary, and a typical force or torque of every named joint with one degree of freedom.

    The typical force accelerates what the joint carries by SLIDE_ACCELERATION or HINGE_ACCELERATION: for bounds and
    first steps of a fit, nothing finer.
    """
    forces, simple = typical_forces(model), np.flatnonzero(np.isin(model.jnt_type, (SLIDE, HINGE)))
    named = [(model.joint(i).name, int(model.jnt_type[i]), float(forces[model.jnt_dofadr[i]])) for i in simple]
    return [(name, kind == HINGE, force) for name, kind, force in named if name]


def find_free(model: mujoco.MjModel) -> list[int]:
    """Indices of the free joints."""
    return [int(i) for i in np.flatnonzero(model.jnt_type == FREE)]


def find_floating(model: mujoco.MjModel) -> dict[str, int]:
    """Named bodies whose pose tells a joint's → the joint: a free one, or the ball joint by which a body hangs alone.

    What that hangs from must stand still.
    """
    found = {}
    for i in range(model.njnt):
        body = int(model.jnt_bodyid[i])
        alone = model.body_jntnum[body] == 1 and not model.body_weldid[model.body_parentid[body]]
        if model.jnt_type[i] == FREE or (model.jnt_type[i] == BALL and alone):
            found[model.body(body).name] = i
    return {name: joint for name, joint in found.items() if name}


ALIKE = 1e-3
"""Share by which a wheel's inertia may depend on where it is."""


def is_indifferent(model: mujoco.MjModel, joint: int) -> bool:
    """Whether it makes no difference where a hinge or slide is: to weight, inertia, actuators, springs, end stops."""
    if model.jnt_limited[joint] or model.jnt_stiffness[joint].any():
        return False
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    data.qvel[:] = rng.standard_normal(model.nv)
    mujoco.mj_integratePos(model, data.qpos, rng.standard_normal(model.nv), 1.0)
    seen: list[list[np.ndarray]] = []
    for _ in range(4):
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        seen.append([data.qfrc_bias.copy(), inertia, data.actuator_moment.copy()])
        data.qpos[model.jnt_qposadr[joint]] += rng.uniform(0.5, 2.0)
    return all(np.ptp(each, axis=0).max(initial=0.0) <= ALIKE * np.abs(each).max(initial=0.0) for each in zip(*seen))


def tells_mount(model: mujoco.MjModel) -> bool:
    """Whether a tilted mount is more than the wrong zero of an encoder or a constant force.

    It is where the first of several joints on a base turns about the vertical, or slides and carries a hinge.
    """
    first = int(model.jnt_bodyid[0])
    up = np.abs(model.opt.gravity) / max(float(np.linalg.norm(model.opt.gravity)), 1e-9)
    if model.njnt < 2 or not up.any() or {FREE, BALL} & set(model.jnt_type):
        return False
    if model.body_weldid[model.body_parentid[first]]:  # what carries it moves
        return False
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turns = int(model.jnt_type[0]) == HINGE
    return bool(abs(data.xaxis[0] @ up) > 0.7 if turns else HINGE in model.jnt_type)


def tell_rotary(model: mujoco.MjModel) -> np.ndarray:
    """Which degrees of freedom are angles, (nv,) bool."""
    rotary = np.array([model.jnt_type[joint] in (HINGE, BALL) for joint in model.dof_jntid])
    for joint in find_free(model):
        rotary[model.jnt_dofadr[joint] + 3 : model.jnt_dofadr[joint] + 6] = True
    return rotary


def typical_forces(model: mujoco.MjModel) -> np.ndarray:
    """Typical force or torque on every degree of freedom, (nv,) N, N m, as `describe_joints` has it."""
    typical = np.where(tell_rotary(model), HINGE_ACCELERATION, SLIDE_ACCELERATION)
    return np.asarray(np.diag(inertia_at_rest(model)) * typical)


def strongest_forces(model: mujoco.MjModel) -> np.ndarray:
    """What any joint of a degree of freedom's kind, or any limited drive, may exert at most, (nv,) N, N m.

    A wrist that weighs nothing bears what the arm before it, or a tool on it, does.
    """
    typical, rotary, gain = typical_forces(model), tell_rotary(model), model.actuator_gainprm[:, :1]
    limits = [
        np.where(np.array(limited, bool)[:, None], np.abs(given), 0.0).max(axis=1, initial=0.0)
        for limited, given in (
            (model.actuator_forcelimited, model.actuator_forcerange),
            (model.actuator_ctrllimited, gain * model.actuator_ctrlrange),
        )
    ]
    drives = float((np.abs(model.actuator_gear).max(axis=1, initial=0.0) * np.max(limits, axis=0)).max(initial=0.0))
    return np.array([max(typical[rotary == kind].max(), drives) for kind in rotary])


def hold_joints(model: mujoco.MjModel, dofs: np.ndarray) -> mujoco.MjModel:
    """A copy of the model whose degrees of freedom `dofs` are so heavy that only what is meant to lead moves them."""
    held = copy.copy(model)
    held.dof_armature[dofs] += HEAVY * np.diag(inertia_at_rest(model))[dofs]
    held.opt.tolerance /= HEAVY  # the solver takes it relative to the mean inertia
    mujoco.mj_setConst(held, mujoco.MjData(held))
    return held


def missing_parts(model: mujoco.MjModel, effect: Effect) -> list[str]:
    """Joints and bodies that an effect needs and the model lacks."""
    names = {model.joint(i).name for i in range(model.njnt)} | {model.body(i).name for i in range(model.nbody)}
    return [name for name in effect.needs if name not in names]


def find_meeting(model: mujoco.MjModel, geoms: np.ndarray | None = None) -> np.ndarray:
    """Between which of some geoms, by default all (G,), MuJoCo looks for contacts, (G, G) bool."""
    geoms = np.arange(model.ngeom) if geoms is None else geoms
    weld = np.asarray(model.body_weldid)[model.geom_bodyid[geoms]]
    parent = np.asarray(model.body_weldid)[np.asarray(model.body_parentid)[weld]]
    kin = ((weld[:, None] == parent) | (parent[:, None] == weld)) & (weld[:, None] > 0) & (weld > 0)
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        kin[:] = False
    answers = (model.geom_contype[geoms][:, None] & model.geom_conaffinity[geoms]) != 0
    return np.asarray((weld[:, None] != weld) & ~kin & (answers | answers.T))
