"""What of a twin MuJoCo can hold by itself, as attributes of an MJCF, and what it can't."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import mujoco
import numpy as np

from vpptwin.actuators.layer import NO_LIMIT, constants_dtype, nominal_constants
from vpptwin.effects import Effect, Stage
from vpptwin.effects.friction import apply_coulomb
from vpptwin.effects.joint import apply_bias, apply_spring
from vpptwin.twin.spec import TwinSpec

Place = tuple[str, str, str]
"""An element of an MJCF and its attribute: "joint", its name, "damping"."""
AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
BRAKE = 0.004
"""Time constant by which MuJoCo's friction brakes [s], 2 steps at least: stiff, so that what sticks hardly creeps."""
HARD = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Its `solimpfriction`, likewise."""
OF_BODIES = {"body_mass": "mass", "body_ipos": "pos", "body_iquat": "quat", "body_inertia": "diaginertia"}
OF_ACTUATORS = {
    "actuator.gain": "gainprm", "actuator.limit": "ctrlrange", "actuator.delay": "delay",
    "actuator.time_constant": "dynprm",
}  # fmt: skip
NOBODY_HAS = ("actuator.rate_limit", "actuator.gap", "actuator.dead_band", "actuator.sag")
"""Constants of ours that no actuator of MuJoCo has."""
OF_JOINTS = {"dof_damping": "damping", "dof_armature": "armature"}
OF_PLACES = {"qpos0": "ref", "qpos_spring": "springref"}


@dataclass
class Held:
    """What goes into an MJCF."""

    values: dict[Place, tuple[float, ...]] = field(default_factory=dict)  # place → numbers
    reasons: dict[Place, list[Effect]] = field(default_factory=dict)  # place → the effects that change it
    lost: list[tuple[Effect, str]] = field(default_factory=list)  # effects that MuJoCo has no word for, each with why

    @property
    def effects(self) -> list[Effect]:
        """Those that are held, each once."""
        return list({effect.id: effect for effects in self.reasons.values() for effect in effects}.values())

    def list_elements(self) -> dict[tuple[str, str], list[Effect]]:
        """Kind and name of each element that changes → the effects that change it."""
        elements: dict[tuple[str, str], list[Effect]] = {}
        for (element, name, _), effects in self.reasons.items():
            known = elements.setdefault((element, name), [])
            known += [effect for effect in effects if effect not in known]
        return elements

    def put(self, effect: Effect, element: str, name: str, **values: Sequence[float]) -> None:
        """Set attributes of an element, for an effect."""
        for attribute, numbers in values.items():
            place = element, name, attribute
            self.values[place] = tuple(map(float, numbers))
            self.reasons[place] = [*self.reasons.get(place, ()), effect]


def hold(spec: TwinSpec) -> Held:
    """What MuJoCo can hold of the effects that are switched on in a twin, those at their off values aside."""
    model, held = spec.model, Held()
    records = np.zeros(1, constants_dtype(model.nu, model.nv))
    nominal = nominal_constants(spec.robot.servo_lag, records)
    constants = {name: np.repeat(values[None], 1, axis=0) for name, values in nominal.items()}
    names = [model.actuator(i).name for i in range(model.nu)]
    on = [effect for effect in spec.catalogue if is_on(spec, effect)]
    # One on several alike is one on each.
    apart = [[e] if e.target else [replace(e, target=place, members=()) for place in e.places] for e in on]
    for effect in chain(*apart):
        values = {p.name: spec.value(effect, p.name) for p in effect.parameters}
        site = spec.robot.locate(effect)
        if effect.apply is apply_coulomb:
            own = held.values.get(("joint", effect.target, "frictionloss"), (model.dof_frictionloss[site.dof],))
            level = own[0] + next(iter(values.values()))
            brake = max(BRAKE, 2.0 * model.opt.timestep), 1.0
            held.put(effect, "joint", effect.target, frictionloss=(level,), solreffriction=brake, solimpfriction=HARD)
        elif effect.apply is apply_spring:
            hold_spring(held, model, effect, **values)
        elif effect.apply is apply_bias:
            hold_bias(held, model, effect, site.dof, values["force"])
        elif effect.stage is not Stage.CONSTANT:
            held.lost.append((effect, "a law that MuJoCo lacks"))
        elif any(name.startswith("actuator.") for name in effect.writes) and effect.target not in names:
            held.lost.append((effect, "ctrl is thrust there, not blade pitch"))
        elif any(name in NOBODY_HAS for name in effect.writes):
            held.lost.append((effect, "no actuator of MuJoCo has it"))
        elif any(name in records.dtype.names and not name.startswith("actuator.") for name in effect.writes):
            held.lost.append((effect, "of sensors and supply, which are no part of an MJCF"))
        else:
            for name in set(effect.writes) - set(constants):
                owner = model.opt if name.startswith("opt.") else model
                constants[name] = np.array(getattr(owner, name.removeprefix("opt.")))[None]
            effect.apply(constants, site, **{name: np.array([value]) for name, value in values.items()})
            hold_fields(held, effect, constants, spec)
    for i, name in enumerate(names):
        if any(("actuator", name, attribute) in held.reasons for attribute in OF_ACTUATORS.values()):
            hold_actuator(held, model, i, {key: float(constants[f"actuator.{key}"][0, i]) for key in
                                           ("gain", "limit", "delay", "time_constant")})  # fmt: skip
    return held


def is_on(spec: TwinSpec, effect: Effect) -> bool:
    """Whether an effect does anything: any of its strengths, which are alike in unit, is not at its off value."""
    unit = effect.parameters[0].unit
    return any(spec.value(effect, p.name) != p.off for p in effect.parameters if p.unit == unit)


def hold_fields(held: Held, effect: Effect, constants: Mapping[str, np.ndarray], spec: TwinSpec) -> None:
    """Fields of the model after an effect, of its joint, its body or the world."""
    model, site = spec.model, spec.robot.locate(effect)
    for name in effect.writes:
        if name in OF_JOINTS:
            more = np.trim_zeros(model.dof_dampingpoly[site.dof], "b") if name == "dof_damping" else ()
            held.put(effect, "joint", effect.target, **{OF_JOINTS[name]: (constants[name][0, site.dof], *more)})
        elif name in OF_PLACES:
            if ("joint", effect.target, OF_PLACES[name]) in held.values:
                held.lost.append((effect, "beside a spring, for the MJCF's own spring"))
            else:
                held.put(effect, "joint", effect.target, **{OF_PLACES[name]: (constants[name][0, site.place],)})
        elif name == "actuator_gainprm":
            held.put(effect, "actuator", effect.target, gainprm=list(constants[name][0, site.actuator, :3]))
        elif name == "actuator_biasprm":
            known = held.values.get(("actuator", effect.target, "biasprm"), model.actuator_biasprm[site.actuator])
            loop = constants[name][0, site.actuator, 1:3]  # a force on the joint may be in the first already
            held.put(effect, "actuator", effect.target, biasprm=(known[0], *loop))
        elif name == "actuator_forcerange":
            held.put(effect, "actuator", effect.target, forcerange=constants[name][0, site.actuator])
        elif name in OF_BODIES:
            value = tuple(np.atleast_1d(constants[name][0, site.body]))
            held.put(effect, "inertial", model.body(site.body).name, **{OF_BODIES[name]: value})
        elif name == "opt.gravity":
            held.put(effect, "option", "", gravity=constants[name][0])
        elif name.startswith("actuator."):
            held.reasons.setdefault(("actuator", effect.target, OF_ACTUATORS[name]), []).append(effect)
        else:
            held.lost.append((effect, f"{name} of a compiled model"))


def hold_spring(held: Held, model: mujoco.MjModel, effect: Effect, stiffness: float, rest: float) -> None:
    """A spring beside that of the joint: stiffnesses add up, the rest position is their weighted mean."""
    joint = int(model.joint(effect.target).id)
    if np.any(model.jnt_stiffnesspoly[joint]):
        held.lost.append((effect, "beside a spring that is a polynomial"))
        return
    own, at = float(model.jnt_stiffness[joint]), float(model.qpos_spring[model.jnt_qposadr[joint]])
    both = own + stiffness
    held.put(effect, "joint", effect.target, stiffness=(both,), springref=((own * at + stiffness * rest) / both,))


def hold_bias(held: Held, model: mujoco.MjModel, effect: Effect, dof: int, force: float) -> None:
    """A constant force as the bias of an actuator that acts on the joint."""
    for i in range(model.nu):
        acts = model.actuator_trntype[i] == JOINT and model.actuator_trnid[i, 0] == model.dof_jntid[dof]
        limited = model.actuator_forcelimited[i] or model.jnt_actfrclimited[model.dof_jntid[dof]]
        if acts and not limited and model.actuator_gear[i, 0]:
            bias = np.array(model.actuator_biasprm[i, :3]) * (model.actuator_biastype[i] == AFFINE)
            bias[0] += force / model.actuator_gear[i, 0]
            held.put(effect, "actuator", model.actuator(i).name, biastype=(AFFINE,), biasprm=bias)
            return
    held.lost.append((effect, "no actuator without a limit acts on the joint and could bear it"))


def hold_actuator(held: Held, model: mujoco.MjModel, i: int, constants: Mapping[str, float]) -> None:
    """Gain, limit, delay and lag of an actuator: MuJoCo limits the command, delays it, lags it, multiplies it."""
    name, gain, limit = model.actuator(i).name, constants["gain"], constants["limit"]
    put: dict[str, tuple[float, ...]] = {}
    if gain != 1.0:
        known = held.values.get(("actuator", name, "gainprm"), model.actuator_gainprm[i, :3])
        put["gainprm"] = tuple(gain * np.array(known))
    if model.actuator_ctrllimited[i] or limit < NO_LIMIT:
        low, high = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-np.inf, np.inf)
        put["ctrlrange"] = (max(low, -limit) / gain, min(high, limit) / gain)
    if constants["delay"] > 0.0:
        put |= {"delay": (constants["delay"],), "nsample": (np.ceil(constants["delay"] / model.opt.timestep) + 2,)}
    if constants["time_constant"] > 0.0:
        put["dynprm"] = (constants["time_constant"],)
    held.values |= {("actuator", name, attribute): tuple(map(float, values)) for attribute, values in put.items()}
