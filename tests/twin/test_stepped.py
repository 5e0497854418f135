"""The model that is stepped: the twin's to the last bit in all that moves, less what is only looked at."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest

from vpptwin.system.resources import find_model_file
from vpptwin.twin import TwinSpec, load_twin
from vpptwin.twin.spec import TwinFile, build_twin
from vpptwin.twin.stepping.stepped import leave_out

RIG = load_twin()


def load_free() -> TwinSpec:
    """The free craft."""
    file = TwinFile(model="vpp_planar.xml", vehicle="vehicle.yaml")
    return build_twin("free", file, find_model_file("vpp_planar.xml", RIG.model_file.parent).parent)


def fall(model: mujoco.MjModel, thrust: tuple[float, float], start: np.ndarray, steps: int) -> np.ndarray:
    """Positions, velocities and number of contacts after each step of a craft thrown, (steps, 2 nv + 1)."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = start, [4.0, 0.0, 3.0], thrust
    path = []
    for _ in range(steps):
        mujoco.mj_step(model, data)
        path.append([*data.qpos, *data.qvel, data.ncon])
    return np.array(path)


@pytest.mark.parametrize("spec", [RIG, load_free()], ids=["rig", "free"])
def test_steps_are_the_same_to_the_last_bit(spec: TwinSpec) -> None:
    """Thrown at the wall and the floor, a craft of the stripped model flies and bounces as one of the whole model."""
    stripped = copy.copy(spec.stepped)
    leave_out(stripped, set())
    assert stripped.ngeom < spec.model.ngeom
    assert (stripped.nlight, stripped.ncam) == (0, 0)
    whole = fall(spec.model, (1.0, 1.2), np.array([1.0, 1.0, 0.2]), 2000)
    np.testing.assert_array_equal(fall(stripped, (1.0, 1.2), np.array([1.0, 1.0, 0.2]), 2000), whole)
    assert (whole[:, -1].max() > 0) == (spec is RIG)


def test_bodies_and_joints_keep_their_places() -> None:
    """What effects address is where it was; the twin's own model keeps what is drawn."""
    assert RIG.stepped is RIG.stepped
    for name in ("body_mass", "body_inertia", "dof_damping", "jnt_range", "actuator_gear", "qpos0"):
        np.testing.assert_array_equal(getattr(RIG.stepped, name), getattr(RIG.model, name))
    assert [RIG.stepped.geom(i).name for i in range(RIG.stepped.ngeom)] == ["floor", "wall", "hull"]
    assert RIG.model.ngeom > 3


def test_a_model_changed_by_hand_is_stepped_whole() -> None:
    """Where the file would make another model than the twin holds, nothing is stripped."""
    changed = copy.copy(RIG.model)
    changed.dof_damping[0] = 0.5
    spec = RIG.with_robot(model=changed)
    assert spec.stepped is changed
    friction = copy.copy(RIG.model)
    friction.geom_friction[:, 0] = 0.1
    assert RIG.with_robot(model=friction).stepped is friction


def test_stages_with_something_to_do_stay() -> None:
    """A spring, or an effect that writes one, dry friction or an equality keep the stage of a step that serves them."""
    flags = mujoco.mjtDisableBit
    spring, rubbing = copy.copy(RIG.model), copy.copy(RIG.model)
    spring.jnt_stiffness[0], rubbing.dof_frictionloss[0] = 1.0, 1.0
    for model, written, kept in (
        (spring, set(), flags.mjDSBL_SPRING),
        (copy.copy(RIG.model), {"jnt_stiffness"}, flags.mjDSBL_SPRING),
        (rubbing, set(), flags.mjDSBL_FRICTIONLOSS),
    ):
        leave_out(model, written)
        assert not model.opt.disableflags & int(kept)
        assert model.opt.disableflags & int(flags.mjDSBL_EQUALITY)
