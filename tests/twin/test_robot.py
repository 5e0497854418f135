"""What a rig says of itself: commands that a force follows, disturbances, and who may be asked for a vehicle."""

from __future__ import annotations

import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest

from vpptwin.effects import find_effect
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin
from vpptwin.twin.robot.drives import is_driven, is_geared, step_inertia
from vpptwin.twin.robot.links import list_links
from vpptwin.twin.robot.model import tells_mount
from vpptwin.twin.robot.robot import GUST, GUST_TIME, Loads, Robot, Signals

ARM = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody>
  <body><joint name="j1" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/>
    <body pos="0.3 0 0"><joint name="j2" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/>
      <body pos="0.3 0 0"><joint name="j3" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body></body></body>
</worldbody>
<actuator><motor name="m1" joint="j1"/><motor name="m3" joint="j3"/></actuator></mujoco>
""")


@pytest.fixture
def arm() -> Robot:
    """Three hinges, of which two have a motor."""
    return Robot("arm", ARM, Signals(joints=dict.fromkeys(("j1", "j2", "j3"), "/joint_states")))


@pytest.mark.parametrize(
    ("effect", "dof", "shares", "label"),
    [
        ("m1.gain", 2, [1.0, 0.0], "command of m1"),
        ("j3.inertia", 2, [0.0, 1.0], "command of m3"),
        ("j2.inertia", 1, [0.5, 0.5], "mean command"),
    ],
)
def test_command_that_a_force_follows(arm: Robot, effect: str, dof: int, shares: list[float], label: str) -> None:
    """Of the accused actuator, else of the joint's own, else of all; the third joint of an arm is no drone's pitch."""
    found = arm.weigh_commands(find_effect(arm.list_effects(), effect), dof)
    np.testing.assert_array_equal(found[0], shares)
    assert found[1] == label


def test_commands_of_the_drone() -> None:
    """Both rotors lift, their difference turns."""
    robot = load_twin().robot
    mass = find_effect(robot.list_effects(), "airframe.mass")
    np.testing.assert_array_equal(robot.weigh_commands(mass, 1)[0], [0.5, 0.5])
    np.testing.assert_array_equal(robot.weigh_commands(mass, 2)[0], [-1.0, 1.0])


CRANE = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody>
  <body><joint name="yaw" axis="0 0 1"/><geom size="0.1" pos="0.2 0 0"/>
    <body><joint name="pitch" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/><site name="rotor" pos="0.3 0 0"/>
      <body pos="0.3 0 0"><joint name="load" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.2"/></body></body></body>
  <body pos="0 1 0"><joint name="reel" axis="0 1 0"/><geom size="0.1"/></body>
</worldbody>
<tendon><fixed name="rope"><joint joint="reel" coef="0.1"/></fixed></tendon>
<actuator><general name="thrust" site="rotor" gear="0 0 1 0 0 0"/><motor name="winch" tendon="rope"/></actuator>
</mujoco>
""")


def test_what_actuators_move_is_driven_wherever_they_act() -> None:
    """Through a site or a tendon, also with no arm in the first pose; what hangs below is not driven, nor geared."""
    joints = "yaw", "pitch", "load", "reel"
    assert [is_driven(CRANE, joint) for joint in joints] == [False, True, False, True]
    twisted = copy.copy(CRANE)
    twisted.actuator_gear[0] = np.eye(6)[3]  # a torque along the beam turns the yaw where the beam is not level
    assert [is_driven(twisted, joint) for joint in joints] == [True, False, False, True]
    assert not any(is_geared(CRANE, joint) for joint in joints)
    assert is_geared(ARM, "j3")
    assert not is_driven(ARM, "j2")


@pytest.mark.parametrize(
    ("topics", "driven", "late"),
    [
        ({"pitch": "a", "load": "a", "reel": "a"}, {}, ["load.delay"]),
        ({"yaw": "a", "load": "a"}, {}, []),
        ({"yaw": "a", "load": "a"}, {"reel": "a"}, ["yaw.delay", "load.delay"]),
        ({"yaw": "a", "load": "a"}, {"reel": "b"}, []),
    ],
)
def test_late_is_later_than_something(topics: dict[str, str], driven: dict[str, str], late: list[str]) -> None:
    """Where nothing on a topic is driven or leads, none of its joints is seen later than the others."""
    robot = Robot("crane", CRANE, Signals(joints=topics, driven=driven))
    assert [e.id for e in robot.list_misread()] == late


def test_disturbances(arm: Robot) -> None:
    """Gusts of a hundredth of the drone's weight outlast a pulse; elsewhere they are a guess, on every joint.

    What logs say of the force that moves a joint takes the place of what its weight says, and the drone's stay: pushes
    of 0.2 % of it, which may be found to be as strong as that force itself, and alike over 0.2 s.
    """
    drone = load_twin().robot
    weight = drone.vehicle.airframe.mass * drone.vehicle.gravity
    np.testing.assert_allclose(drone.disturbance.std[:2], 0.01 * weight)
    assert drone.disturbance.known
    assert drone.disturbance.memory > 0.0
    loads = Loads(np.array([10.0, 5.0, 1.0]), *np.ones((4, 3)), np.empty(0))
    assert drone.scale(loads) is drone
    scaled = arm.scale(loads)
    np.testing.assert_allclose(scaled.disturbance.std, [0.02, 0.01, 0.002])
    for guessed in (arm.disturbance, scaled.disturbance):
        assert (guessed.std > 0.0).all()
        assert guessed.memory == GUST_TIME == 0.2
        assert guessed.most * GUST == pytest.approx(1.0)
        assert not guessed.known


def test_only_the_drone_has_a_vehicle(arm: Robot) -> None:
    """Whoever needs one is told what was found, what was expected and what to do."""
    with pytest.raises(InputError, match=r"arm is not the drone; .*names a vehicle"):
        _ = arm.vehicle
    with pytest.raises(KeyError):
        arm.nominal("servo.time_constant")
    assert load_twin().robot.nominal("servo.time_constant") == 0.02


def test_nobody_asks_for_a_rigs_kind() -> None:
    """Of a rig its features are asked, and only the reader of twin files knows that a vehicle makes a drone."""
    package = Path(__file__).resolve().parents[2] / "vpptwin"
    asking = {str(f.relative_to(package)) for f in package.rglob("*.py") if "vehicle is " in f.read_text()}
    assert asking == {"twin/spec.py"}


URDF = """<robot name="arm"><link name="base"/>
<joint name="hip" type="revolute"><parent link="base"/><child link="leg"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="{effort}" velocity="9"/></joint>
<link name="leg"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


@pytest.mark.parametrize("effort", [12.0, 0.0])
def test_what_a_urdf_may_exert_drives_it(tmp_path: Path, effort: float) -> None:
    """A motor of the joint's name, as strong as the joint may; none where nothing drives it."""
    (tmp_path / "leg.urdf").write_text(URDF.format(effort=effort))
    inputs = ", actuators: {hip: /joint_states}" if effort else ""
    (tmp_path / "leg.yaml").write_text(f"model: leg.urdf\nsignals: {{joints: {{hip: /joint_states}}{inputs}}}\n")
    spec = load_twin(tmp_path / "leg.yaml")
    model, data = spec.model, mujoco.MjData(spec.model)
    assert [model.actuator(i).name for i in range(model.nu)] == ["hip"] * bool(effort)
    assert ("hip.gain" in {effect.id for effect in spec.catalogue}) == bool(effort)
    for given, exerted in ((3.0, 3.0), (50.0, 12.0)):
        data.ctrl[:] = given
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_actuator, exerted if effort else 0.0)


GIMBAL = """<mujoco><worldbody>
  <body name="yoke" pos="0 0 0.3"><joint name="yaw" axis="0 0 1"/>
    <inertial pos="0 0 0.02" mass="0.4" diaginertia="1e-3 1e-3 1e-3"/>
    <body name="camera" pos="0 0 0.06"><joint name="pitch" axis="0 1 0"/>
      <inertial pos="0.001 0 0" mass="0.8" diaginertia="2e-3 3e-3 2e-3"/><site name="lens" pos="0.3 0 0"/></body></body>
</worldbody></mujoco>"""
PLANAR = """<mujoco><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.3"/>
    <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.3"/></body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("base", "tells"),
    [
        ("", True),
        ("<freejoint/>", False),
        ("<joint type='slide' axis='1 0 0'/>", True),
    ],
    ids=["fixed", "free", "slide"],
)
def test_a_mount_may_be_a_body_that_is_fixed(base: str, tells: bool) -> None:
    """A base between the world and the turret is the mount; one that moves is a joint of its own."""
    turret = "<body><joint axis='0 0 1'/><geom size='0.1'/><body><joint axis='0 1 0'/><geom size='0.1'/></body></body>"
    text = f"<mujoco><worldbody><body>{base}<geom size='0.1'/>{turret}</body></worldbody></mujoco>"
    assert tells_mount(mujoco.MjModel.from_xml_string(text)) == tells


@pytest.mark.parametrize(
    ("mjcf", "ways", "reach"),
    [(GIMBAL, {"yoke": "", "camera": "xyz"}, 0.15), (PLANAR, {"upper": "xz", "lower": "xz"}, 0.155)],
    ids=["gimbal", "planar"],
)
def test_along_which_axes_a_centre_of_mass_shows(mjcf: str, ways: dict[str, str], reach: float) -> None:
    """Not where but one joint's inertia feels it, nor along axes that all joints turn about; a link is half its span.

    The camera's balanced body reaches to its lens; its centre moves at a lever that its hinge's typical torque tells.
    """
    robot = Robot("rig", mujoco.MjModel.from_xml_string(mjcf))
    links = {link.name: link for link in list_links(robot.model, robot.forces, robot.driven, ())}
    assert {name: link.ways for name, link in links.items()} == ways
    ids = {effect.id: effect for effect in robot.list_effects()}
    for name, axes in ways.items():
        assert (f"{name}.com" in ids) == bool(axes)
        assert not axes or "".join(p.name for p in ids[f"{name}.com"].parameters) == axes
    last = list(links.values())[-1]
    assert last.reach == pytest.approx(reach)
    weight = 9.81 * last.mass
    assert last.lever == pytest.approx(min(robot.forces[-1] / weight, reach))
    light = robot.scale(Loads(*(np.full(2, x) for x in (0.01 * weight, 1.0, 1.0, 0.0, 1.0)), np.zeros(0)))
    com = next(e for e in light.list_effects() if e.id == f"{last.name}.com")
    assert com.parameters[0].size == pytest.approx(0.05 * 0.01)
    assert {f"{last.hinge}.bias", f"{last.name}.mass", f"{last.name}.payload"} <= set(com.look_alikes)


def test_a_balanced_body_keeps_its_own_centre_where_it_turns_any_way() -> None:
    """On a ball joint `b.com` is the one of bodies that turn freely, once."""
    mjcf = PLANAR.replace('<joint name="elbow" axis="0 1 0"/>', '<joint name="elbow" type="ball"/>')
    ids = [effect.id for effect in Robot("rig", mujoco.MjModel.from_xml_string(mjcf)).list_effects()]
    assert ids.count("lower.com") == 1
    assert "upper.com" in ids


@pytest.mark.parametrize(("integrator", "seen"), [("implicitfast", 0.06), ("Euler", -0.02)])
def test_steps_seem_to_change_inertia(integrator: str, seen: float) -> None:
    """Half a step of what damps a slide is most: 2 kg, 10 N s/m, a servo of 5 at a gear of 2, 4 ms; Euler is both."""
    text = (
        '<mujoco><option timestep="0.004" integrator="%s" gravity="0 0 0"/><worldbody><body><joint type="slide" '
        'damping="10"/><geom size="0.1" mass="2"/></body></worldbody><actuator><velocity joint="j" kv="5" gear="2"/>'
        "</actuator></mujoco>"
    )
    model = mujoco.MjModel.from_xml_string(text.replace("<joint", '<joint name="j"') % integrator)
    np.testing.assert_allclose(step_inertia(model), 0.06)
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    mujoco.mj_step(model, data)
    assert -30.0 * 0.004 / np.log(data.qvel[0]) == pytest.approx(2.0 + seen, abs=2e-3)
