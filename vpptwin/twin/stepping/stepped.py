"""The model that simulations step: the twin's without what is only looked at and without work that comes to nothing.

Its bodies, joints, actuators and contacts are the twin's to the last bit, and so are its steps.
"""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

import mujoco
import numpy as np

from vpptwin.engine.callback import installed
from vpptwin.twin.robot.model import Adapt, specify_model
from vpptwin.twin.robot.urdf import read_urdf

LOOKS = ("geom_", "cam_", "light_", "bvh_", "name")
"""Fields of geoms, which are compared row by row, and of what no step goes by."""
PLACES = {"body_geomadr", "body_geomnum", "body_bvhadr", "body_bvhnum", "nbvh", "nbvhstatic", "ngeom", "nbuffer",
          "narena", "ncam", "nlight", "nnames", "nnames_map", "signature"}  # fmt: skip
"""Where geoms and names are kept, and how many there are."""
NAMED = {"geom_matid", "geom_dataid", "geom_user"}
"""Fields of geoms that no contact goes by but through shape and size."""
Disable = mujoco.mjtDisableBit


def strip_model(model: mujoco.MjModel, path: Path, adapt: Adapt) -> mujoco.MjModel:
    """The model without geoms that touch nothing, cameras and lights; `model` itself where that would change more.

    Args:
        model: of the twin.
        path: its MJCF.
        adapt: what was written into that.
    """
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    if touching.all() or model.geom_fluid[~touching].any():
        return model
    try:
        spec = specify_model(path, read_urdf(path), adapt)
        for geom in list(spec.geoms):
            if not geom.contype and not geom.conaffinity:
                spec.delete(geom)
        for seen in [*spec.cameras, *spec.lights]:
            spec.delete(seen)
        with installed(None):
            stripped = spec.compile()
    except (ValueError, OSError, mujoco.FatalError):
        return model
    stripped.dof_length[:] = model.dof_length  # what bodies would fall asleep by goes by all geoms
    return stripped if moves_alike(stripped, model, touching) else model


def moves_alike(stripped: mujoco.MjModel, model: mujoco.MjModel, touching: np.ndarray) -> bool:
    """Whether a stripped model has all that steps go by as the whole one has it.

    Args:
        stripped: without some geoms.
        model: the whole one.
        touching: which of its geoms are left, (ngeom,).
    """
    if stripped.ngeom != touching.sum() or stripped.stat.meaninertia != model.stat.meaninertia:
        return False
    pairs = [(getattr(stripped.opt, name), getattr(model.opt, name)) for name in public_names(model.opt)]
    for name in public_names(model):
        own, whole = getattr(stripped, name), getattr(model, name)
        if name.startswith("geom_") and name not in NAMED:
            pairs.append((own, whole[touching]))
        elif not name.startswith(LOOKS) and name not in PLACES:
            pairs.append((own, whole))
    return all(np.array_equal(own, whole) for own, whole in pairs if isinstance(whole, (int, float, np.ndarray)))


def public_names(thing: object) -> list[str]:
    """Names of what one of MuJoCo's structs holds."""
    return [name for name in dir(thing) if not name.startswith("_")]


def leave_out(model: mujoco.MjModel, written: Set[str]) -> None:
    """Switch off in a model the stages of a step that have nothing to do in it.

    Args:
        model: changed.
        written: fields that effects write.
    """
    springs = ("jnt_stiffness", "jnt_stiffnesspoly", "tendon_stiffness", "tendon_stiffnesspoly")
    rubbing = ("dof_frictionloss", "tendon_frictionloss")
    for flag, fields, none in (
        (Disable.mjDSBL_SPRING, springs, model.nflex == 0),
        (Disable.mjDSBL_FRICTIONLOSS, rubbing, True),
        (Disable.mjDSBL_EQUALITY, (), model.neq == 0),
    ):
        if none and written.isdisjoint(fields) and not any(np.any(getattr(model, name)) for name in fields):
            model.opt.disableflags |= int(flag)
