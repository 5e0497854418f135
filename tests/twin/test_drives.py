"""Joints whose drives are of one make: what they may have alike, how it acts, and how an MJCF holds it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from vpptwin.deploy.hold import hold
from vpptwin.deploy.mjcf import write_mjcf
from vpptwin.effects import find_effect
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.robot.drives import group_drives
from vpptwin.viz.scene.sketch import find_part

NAMES = ("one", "two", "three")
KINDS = ("coulomb", "viscous", "load")
LOOP = ("strength", "stiffness", "damping", "force_limit")


def write(folder: Path, drive: str = '<position name="{0}_servo" joint="{0}" kp="9" forcerange="-2 2"/>',
          driven: str = "", effects: str = "") -> Path:  # fmt: skip
    """The twin of an arm with three links of different weights."""
    links = "".join(
        f'<body pos="0 0 {-0.2 * (i > 0)}"><joint name="{name}" axis="0 1 0"/>'
        f'<geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.2" mass="{0.4 / (i + 1)}" contype="0" conaffinity="0"/>'
        for i, name in enumerate(NAMES)
    )
    drives = "".join(drive.format(name) for name in NAMES)
    (folder / "arm.xml").write_text(
        f'<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>{links}{"</body>" * 3}</worldbody>'
        f"<actuator>{drives}</actuator></mujoco>"
    )
    joints = ", ".join(f"{name}: /joint_states" for name in NAMES if name != driven)
    lines = [
        "model: arm.xml", "signals:", f"  joints: {{{joints}}}",
        *([f"  driven: {{{driven}: /joint_states}}"] if driven else []),
        f"  actuators: {{{', '.join(f'{name}_servo: /targets' for name in NAMES)}}}", f"effects: {{{effects}}}",
    ]  # fmt: skip
    (folder / "twin.yaml").write_text("\n".join(lines) + "\n")
    return folder / "twin.yaml"


def test_what_drives_of_one_make_have_alike_is_suspected(tmp_path: Path) -> None:
    """Beside what each has, tolerated no more than that, and first in the list."""
    known = {effect.id: effect for effect in load_twin(write(tmp_path)).catalogue}
    for kind in KINDS:
        assert known[f"joints.{kind}"].members == NAMES
        assert [p.tolerance for p in known[f"joints.{kind}"].parameters] == [0.0]
        assert list(known).index(f"joints.{kind}") < list(known).index(f"one.{kind}")
    for kind in ("stiffness", "force_limit"):
        assert known[f"actuators.{kind}"].members == tuple(f"{name}_servo" for name in NAMES)
        assert [p.tolerance for p in known[f"actuators.{kind}"].parameters] == [0.0]
    assert known["joints.load"].summary == "gear friction on all joints that grows with the load"


@pytest.mark.parametrize(
    ("drive", "driven"),
    [('<motor name="{0}_servo" joint="{0}"/>', ""),  # of which nothing is told
     ('<position name="{0}_servo" joint="{0}" kp="9" forcerange="-2 2"/>', "one")],
)  # fmt: skip
def test_of_whom_nothing_tells_that_they_are_alike(tmp_path: Path, drive: str, driven: str) -> None:
    """Motors without a limit, inertia or friction, and two servos, have but their own."""
    catalogue = load_twin(write(tmp_path, drive, driven)).catalogue
    assert not [effect.id for effect in catalogue if effect.members and effect.id.split(".")[1] in (*KINDS, *LOOP)]


def test_drives_of_another_make_are_left_out() -> None:
    """Three of four joints have one gear and one rotor; the fourth's rotor is heavier."""
    body = '<body><joint name="{0}" armature="{1}"/><geom size="0.1"/></body>'
    rotors = {"a": 0.01, "b": 0.02, "c": 0.01, "d": 0.01}
    text = "".join(body.format(name, rotor) for name, rotor in rotors.items())
    motors = "".join(f'<motor name="{name}_motor" joint="{name}" gear="5"/>' for name in rotors)
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{text}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    assert group_drives(model) == {("a", "c", "d"): ("a_motor", "c_motor", "d_motor")}


@pytest.mark.parametrize(
    ("kind", "name", "size"), [("coulomb", "torque", 0.2), ("viscous", "damping", 0.3), ("load", "mu", 0.3)]
)
def test_all_alike_move_as_each_with_its_own(tmp_path: Path, kind: str, name: str, size: float) -> None:
    """To the last bit; the nominal twin moves otherwise."""
    spec = load_twin(write(tmp_path))
    twin = Twin(spec, 3, active=[f"{each}.{kind}" for each in ("joints", *NAMES)], num_threads=1)
    twin.set_parameter(f"joints.{kind}", name, np.array([size, 0.0, 0.0]))
    for joint in NAMES:
        twin.set_parameter(f"{joint}.{kind}", name, np.array([0.0, size, 0.0]))
    targets = np.repeat(np.sin(0.02 * np.arange(300))[:, None] * [0.5, -0.8, 1.0], 3, axis=1).reshape(300, 3, 3)
    moved = twin.replay_commands(twin.initial_state(), np.moveaxis(targets, 2, 0)).qpos
    np.testing.assert_array_equal(moved[0], moved[1])
    assert np.abs(moved[0] - moved[2]).max() > 0.01


def test_an_mjcf_holds_it_for_each(tmp_path: Path) -> None:
    """Friction of all and of one add up; a sketch lights them all."""
    effects = "joints.coulomb: {torque: 0.2}, two.coulomb: {torque: 0.1}, joints.viscous: {damping: 0.3}"
    spec = load_twin(write(tmp_path, effects=effects))
    (tmp_path / "out.xml").write_text(write_mjcf(spec, hold(spec), tmp_path))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    np.testing.assert_allclose(model.dof_frictionloss, [0.2, 0.3, 0.2])
    np.testing.assert_allclose(model.dof_damping[:, 0] if model.dof_damping.ndim > 1 else model.dof_damping, 0.3)
    assert find_part(spec.robot, find_effect(spec.catalogue, "joints.coulomb")).joints == {0, 1, 2}


def test_servos_of_one_make_are_wrong_alike(tmp_path: Path) -> None:
    """Twice the stiffness and half the limit of all are those of each, on servos that damp too."""
    drive = '<position name="{0}_servo" joint="{0}" kp="9" kv="0.5" forcerange="-2 2"/>'
    spec = load_twin(write(tmp_path, drive))
    kinds = {"stiffness": 2.0, "damping": 3.0, "force_limit": 0.5}
    whole = Twin(spec, 1, active=[f"actuators.{kind}" for kind in kinds])
    each = Twin(spec, 1, active=[f"{name}_servo.{kind}" for name in NAMES for kind in kinds])
    for twin in (whole, each):
        for effect in twin.effects.values():
            twin.set_parameter(effect.id, effect.parameters[0].name, kinds[effect.id.split(".")[1]])
    for name in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"):
        np.testing.assert_array_equal(whole.constant(name), each.constant(name))
    assert whole.constant("actuator_gainprm")[0, :, 0] == pytest.approx(18.0)
    assert "actuators.strength" in {effect.id for effect in spec.catalogue}
