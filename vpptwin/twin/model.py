"""The MuJoCo model of a twin: compiled from MJCF with the vehicle's numbers applied."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from functools import reduce
from pathlib import Path

import mujoco
import numpy as np

from vpptwin.effects import Effect, Site
from vpptwin.effects.joint import HINGE_ACCELERATION, SLIDE_ACCELERATION
from vpptwin.engine.callback import WORDS, installed
from vpptwin.errors import InputError
from vpptwin.vehicle import Vehicle

CRAFT_JOINTS = ("rail_x", "rail_z", "pitch")
"""Joints of the drone in the order of its generalized coordinates x, z, θ."""

HEAVY = 1e6
"""Inertia of a joint that follows its log, as a multiple of what it carries: what its motion is off by, inverted."""

SLIDE, HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
INTEGRATORS = {
    int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_IMPLICIT),
    int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
}  # fmt: skip
"""Integrators that evaluate the forces once a step."""
GAINS = {int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE)}
BIASES = {int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)}
"""Actuators whose force the compiled step foresees, as friction answers to it."""


def read_nominal(vehicle: Vehicle, key: str) -> float:
    """The vehicle's number at a dotted key, e.g. `servo.time_constant`."""
    value: object = reduce(getattr, key.split("."), vehicle)
    if not isinstance(value, float):
        raise KeyError(key)
    return value


def compile_model(path: Path, vehicle: Vehicle | None) -> mujoco.MjModel:
    """Compile an MJCF, with masses, inertia, geometry, travel and gravity from the vehicle where there is one.

    Raises:
        InputError: if MuJoCo refuses the file, a vehicle is given and the model is not of the drone, or the model is
            one that a twin can't step (`check_engine`).
    """
    try:
        spec = specify_model(path, vehicle)
        with installed(None):  # MuJoCo calls it while it compiles, and one in Python would fail there
            model = spec.compile()
    except InputError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(
            f"{path}: MuJoCo says {error}", "an MJCF that compiles", "open it in MuJoCo's viewer"
        ) from error
    if model.nv == 0:
        raise InputError(f"{path}: no joints", "an MJCF with at least one joint", "add one")
    if vehicle is not None:
        check_craft(model, path)
    check_engine(model, path)
    return model


def specify_model(path: Path, vehicle: Vehicle | None) -> mujoco.MjSpec:
    """Read an MJCF, with the numbers of a vehicle where there is one, and with room for our marks.

    Raises:
        InputError: if a vehicle is given and the model is not of the drone.
        ValueError: if MuJoCo refuses the file.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    if vehicle is not None:
        apply_vehicle(spec, vehicle, path)
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
            "actuators that act at once, such as motor and position",
            "leave out dyntype, delay or plugin; the effects lag and delay do what they did",
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
        if int(kinds[0]) not in GAINS or int(kinds[1]) not in BIASES:
            gain = mujoco.mjtGain(kinds[0]).name.removeprefix("mjGAIN_").lower()
            bias = mujoco.mjtBias(kinds[1]).name.removeprefix("mjBIAS_").lower()
            raise InputError(
                f"{path}: actuator {model.actuator(i).name or i} with gain {gain} and bias {bias}",
                "gain fixed or affine and bias none or affine, such as motor, position and velocity",
                "replace it: dry friction has to know its force beforehand",
            )


def check_craft(model: mujoco.MjModel, path: Path) -> None:
    """Check that the drone's joints come first, in the order of its coordinates, and that it has two rotors."""
    joints = tuple(model.joint(i).name for i in range(model.njnt))
    if joints[:3] != CRAFT_JOINTS:
        raise InputError(f"{path}: joints {', '.join(joints)}", "first rail_x, rail_z, pitch", "put them in this order")
    if model.nu != 2:
        raise InputError(f"{path}: {model.nu} actuators", "two, the thrusts of rotors 1 and 2", "see rail_rig.xml")


def apply_vehicle(spec: mujoco.MjSpec, vehicle: Vehicle, path: Path) -> None:
    """Write the vehicle's numbers into the specification of vpp_planar.xml, rail_rig.xml or a model like them."""
    joints = {joint.name: joint for joint in spec.joints}
    bodies = {body.name: body for body in spec.bodies}
    missing = [f"joint {name}" for name in CRAFT_JOINTS if name not in joints]
    if missing or "craft" not in bodies:
        found = missing[0] if missing else "body craft"
        raise InputError(
            f"{path}: no {found}", "joints rail_x, rail_z and pitch and a body craft", "leave out `vehicle`"
        )
    spec.option.gravity = [0.0, 0.0, -vehicle.gravity]
    spec.option.timestep = 1.0 / vehicle.control.inner_rate
    craft = bodies["craft"]
    craft.mass = vehicle.airframe.mass
    craft.inertia = [vehicle.airframe.inertia] * 3  # it turns about y alone; any inertia then makes a possible body
    for site in spec.sites:
        if site.name in ("rotor_1", "rotor_2"):
            side = -1.0 if site.name == "rotor_1" else 1.0
            site.pos = [side * vehicle.airframe.half_length, site.pos[1], site.pos[2]]
    if "carriage" in bodies and "slider" in bodies:
        bodies["carriage"].mass = vehicle.rig.carriage_mass
        bodies["slider"].mass = vehicle.rig.slider_mass
        joints["rail_x"].range = list(vehicle.rig.travel_x)
        joints["rail_z"].range = list(vehicle.rig.travel_z)


def inertia_at_rest(model: mujoco.MjModel) -> np.ndarray:
    """Joint-space inertia in the reference pose, (nv, nv) kg, kg m²."""
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
    inertia = inertia_at_rest(model)
    described = []
    for i in range(model.njnt):
        kind = int(model.jnt_type[i])
        if kind not in (SLIDE, HINGE) or not model.joint(i).name:
            continue
        rotary = kind == HINGE
        dof = model.jnt_dofadr[i]
        typical = HINGE_ACCELERATION if rotary else SLIDE_ACCELERATION
        described.append((model.joint(i).name, rotary, float(inertia[dof, dof]) * typical))
    return described


def hold_joints(model: mujoco.MjModel, joints: Iterable[str]) -> mujoco.MjModel:
    """A copy of the model in which these joints are so heavy that only the force meant to lead them moves them."""
    held, inertia = copy.copy(model), inertia_at_rest(model)
    for name in joints:
        dof = int(model.joint(name).dofadr[0])
        held.dof_armature[dof] += HEAVY * inertia[dof, dof]
    held.opt.tolerance /= HEAVY  # the solver takes it relative to the mean inertia
    mujoco.mj_setConst(held, mujoco.MjData(held))
    return held


def locate_effect(model: mujoco.MjModel, effect: Effect, drone: bool) -> Site:
    """Indices of the place in this model where an effect acts."""
    joints = {model.joint(i).name: int(model.jnt_dofadr[i]) for i in range(model.njnt)}
    actuators = {model.actuator(i).name: i for i in range(model.nu)}
    bodies = {model.body(i).name: i for i in range(model.nbody)}
    return Site(
        dof=joints.get(effect.target, -1),
        actuator=actuators.get(effect.target, -1),
        body=bodies.get(effect.target, bodies.get("craft", -1) if drone else -1),
    )


def missing_parts(model: mujoco.MjModel, effect: Effect) -> list[str]:
    """Joints and bodies that an effect needs and the model lacks."""
    names = {model.joint(i).name for i in range(model.njnt)} | {model.body(i).name for i in range(model.nbody)}
    return [name for name in effect.needs if name not in names]
