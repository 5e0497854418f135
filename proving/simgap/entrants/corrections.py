"""The nominal model with causes of some size in it: what MJCF can say, forces along the way, distorted commands."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

STEP = 0.002
"""Of simulations [s]."""
QUIET = 0.05
"""Speed, as a share of its rms, below which friction has no sign."""
RESISTING = ("coulomb", "stiction", "viscous", "drag", "bias", "spring", "load")
DRIVES = ("gain", "delay", "lag", "backlash", "rate_limit", "saturation")
"""Kinds that are a force along a joint, and those that distort a command."""


@dataclass(frozen=True)
class Correction:
    """A cause with a size, and for those of two numbers the other one (the rest of a spring)."""

    cause: str
    size: float
    other: float = 0.0

    @property
    def place(self) -> str:
        """The joint, actuator or body."""
        return self.cause.split(".")[0]

    @property
    def kind(self) -> str:
        """Its law."""
        return kind_of(self.cause)

    @property
    def axis(self) -> int:
        """0, 1 or 2, of what has one."""
        return "xyz".index(self.cause[-1]) if ":" in self.cause else 0


def kind_of(cause: str) -> str:
    """The law of a cause, by its id: PLACE.KIND, or PLACE.KIND:AXIS."""
    return re.split("[.:]", cause)[1]


def find_dof(model: mujoco.MjModel, place: str) -> int:
    """The degree of freedom of a joint, or of the joint that an actuator drives."""
    try:
        return int(model.joint(place).dofadr[0])
    except KeyError:
        return int(model.jnt_dofadr[model.actuator(place).trnid[0]])


def correct_model(mjcf: str, corrections: Sequence[Correction]) -> mujoco.MjModel:
    """The model with what of the corrections MJCF can say."""
    spec = mujoco.MjSpec.from_string(mjcf)
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for c in corrections:
        if c.kind == "com":
            spec.body(c.place).ipos[c.axis] += c.size
    model = spec.compile()
    for c in corrections:
        if c.kind in ("coulomb", "viscous", "inertia", "spring"):
            j = find_dof(model, c.place)
            if c.kind == "coulomb":
                model.dof_frictionloss[j] = max(model.dof_frictionloss[j] + c.size, 0.0)
            elif c.kind == "viscous":
                model.dof_damping[j] = max(model.dof_damping[j] + c.size, 0.0)
            elif c.kind == "inertia":
                model.dof_armature[j] = max(model.dof_armature[j] + c.size, -0.5 * float(model.dof_M0[j]))
            else:
                model.jnt_stiffness[model.joint(c.place).id] = c.size
                model.qpos_spring[model.jnt_qposadr[model.joint(c.place).id]] = c.other
        elif c.kind == "stiffness":
            i = model.actuator(c.place).id
            model.actuator_gainprm[i, 0] *= c.size
            model.actuator_biasprm[i, 1] *= c.size
        elif c.kind == "force_limit":
            model.actuator_forcerange[model.actuator(c.place).id] *= c.size
        elif c.kind == "mass":
            body = model.body(c.place).id
            model.body_inertia[body] *= 1.0 + c.size / model.body_mass[body]
            model.body_mass[body] += c.size
        elif c.kind == "payload":
            body = model.body(c.place).id
            model.body_mass[body] += c.size
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def find_steady(model: mujoco.MjModel, corrections: Sequence[Correction]) -> tuple[np.ndarray, np.ndarray]:
    """Forces that do not change, (nv,), and what encoders read too much, (nq,)."""
    force, shift = np.zeros(model.nv), np.zeros(model.nq)
    for c in corrections:
        if c.kind == "bias":
            force[find_dof(model, c.place)] += c.size
        elif c.kind in ("wind", "twist"):
            force[c.axis + 3 * (c.kind == "twist")] += c.size
        elif c.kind == "offset":
            shift[int(model.joint(c.place).qposadr[0])] += c.size
    return force, shift


def vary_forces(
    model: mujoco.MjModel, data: mujoco.MjData, corrections: Sequence[Correction], base: np.ndarray,
    applied: np.ndarray, free: bool,
) -> None:  # fmt: skip
    """Forces that change along the way, for the next step."""
    model.dof_frictionloss[:] = base
    data.qfrc_applied[:] = applied
    for c in corrections:
        if c.kind == "drag" and free:
            data.qfrc_applied[:3] -= c.size * data.qvel[:3]
            continue
        if c.kind == "wind":
            continue
        j = find_dof(model, c.place)
        if c.kind == "stiction":
            model.dof_frictionloss[j] += c.size * np.exp(-((data.qvel[j] / max(c.other, 1e-6)) ** 2))
        elif c.kind == "load":
            model.dof_frictionloss[j] += c.size * abs(data.qfrc_actuator[j])
        elif c.kind == "drag":
            data.qfrc_applied[j] -= c.size * abs(data.qvel[j]) * data.qvel[j]


def find_push(kind: str, q: np.ndarray, v: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Force along a joint that a cause of `RESISTING` of size one adds, (n,), from its motion and drive force."""
    speed = np.sqrt(np.mean(v**2)) + 1e-12
    sign = np.tanh(v / (QUIET * speed))
    pushes = {
        "coulomb": -sign, "stiction": -sign * np.exp(-((10.0 * v / speed) ** 2)), "viscous": -v, "drag": -np.abs(v) * v,
        "bias": np.ones_like(v), "spring": -(q - q.mean()), "load": -np.abs(drive) * sign,
    }  # fmt: skip
    return pushes[kind]


def distort_all(model: mujoco.MjModel, u: np.ndarray, corrections: Sequence[Correction]) -> np.ndarray:
    """Commands (n, nu) at `STEP` as the actuators have them."""
    u = u.copy()
    for c in corrections:
        for name in c.place.split("+") if c.kind in DRIVES else ():
            i = model.actuator(name).id
            u[:, i] = distort(u[:, i], c.kind, c.size)
    return u


def distort(u: np.ndarray, kind: str, size: float) -> np.ndarray:
    """A command (n,) at `STEP` after a drive with one fault."""
    if kind == "gain":
        return size * u
    if kind == "delay":
        rows = np.arange(len(u)) - max(size, 0.0) / STEP
        return np.interp(rows, np.arange(len(u)), u)
    if kind == "saturation":
        return np.clip(u, -abs(size), abs(size))
    out, held = np.empty_like(u), u[0]
    keep = np.exp(-STEP / max(size, 1e-6)) if kind == "lag" else 0.0
    for k, wanted in enumerate(u):
        if kind == "lag":
            held = wanted + (held - wanted) * keep
        elif kind == "backlash":
            held = min(max(held, wanted - 0.5 * abs(size)), wanted + 0.5 * abs(size))
        else:
            held += min(max(wanted - held, -abs(size) * STEP), abs(size) * STEP)
        out[k] = held
    return out
