"""What an MJCF of the drone itself takes out of motion, friction, damping and air: removed, or read as effects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from vpptwin.system.errors import InputError
from vpptwin.twin.robot.model import compile_model

Effects = dict[str, dict[str, float]]
BLUNT, OTHERS = 1, slice(2, 6)
"""Drag coefficient of a sphere among a geom's numbers of MuJoCo's ellipsoid model of fluids, and the other ones."""
FIX = "say `losses: none`, or see drag in rail_rig.xml"


def take_out_losses(spec: mujoco.MjSpec, joints: Sequence[str]) -> None:
    """Remove from an MJCF what effects stand for: dry friction and damping of `joints`, and the air."""
    for joint in spec.joints:
        if joint.name in joints:
            joint.frictionloss, joint.damping = 0.0, np.zeros_like(joint.damping)
    spec.option.density = spec.option.viscosity = 0.0
    for geom in spec.geoms:
        geom.fluid_ellipsoid = 0.0


def read_losses(path: Path, joints: Sequence[str], body: str) -> Effects:
    """Effects that stand for the dry friction and damping of an MJCF's `joints` and the drag of its `body`.

    Raises:
        InputError: if it has losses that no effect of ours stands for.
    """
    model, effects = compile_model(path), Effects()
    for name in joints:
        dof = int(model.joint(name).dofadr[0])
        force = "torque" if model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_HINGE else "force"
        given = {"coulomb": {force: model.dof_frictionloss[dof]}, "viscous": {"damping": model.dof_damping[dof]}}
        if np.any(model.dof_dampingpoly[dof]):
            raise InputError(f"{path}: damping of joint {name} that is a polynomial", "a number", FIX)
        effects |= {f"{name}.{kind}": values for kind, values in given.items() if any(values.values())}
    drag = read_drag(model, path, int(model.body(body).id))
    return effects | ({"air.drag": {"k_d": drag}} if drag else {})


def read_drag(model: mujoco.MjModel, path: Path, craft: int) -> float:
    """k_d of the drag -k_d |v| v that MuJoCo's air exerts on the body `craft` [N s²/m²].

    Its drag on a sphere of radius r and blunt coefficient C is density C pi r² |v| v.

    Raises:
        InputError: if it exerts anything else on any body.
    """
    density, felt = model.opt.density, model.geom_fluid[:, 0] > 0.0
    if density == model.opt.viscosity == 0.0:
        return 0.0
    bare = set(np.flatnonzero(model.body_mass > 0.0)) - set(model.geom_bodyid[felt])
    drags = felt & (model.geom_fluid[:, BLUNT] != 0.0)
    spheres = (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE) & (model.geom_bodyid == craft)
    if bare or model.opt.viscosity or np.any(model.geom_fluid[felt, OTHERS]) or np.any(drags & ~spheres):
        expected = "no viscosity, and bodies whose geoms have fluidcoef 0 but for the first of spheres at the craft"
        raise InputError(f"{path}: air that does more than drag on {model.body(craft).name}", expected, FIX)
    return float(density * np.pi * (model.geom_fluid[drags, BLUNT] * model.geom_size[drags, 0] ** 2).sum())
