"""Twins read from YAML: what a good file gives, and one helpful line for each way of getting it wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.effects.rigs import CART_PENDULUM, CART_TWIN
from vpptwin.effects import CATALOGUE
from vpptwin.system.errors import InputError
from vpptwin.system.resources import models_dir
from vpptwin.twin import Twin, load_twin

DRONE = "model: rail_rig.xml\nvehicle: vehicle.yaml\n"
RAIL_RIG = (models_dir() / "rail_rig.xml").read_text()
VEHICLE = (models_dir() / "vehicle.yaml").read_text()
FREE_BODY = '<mujoco><worldbody><body>{joint}<geom size="0.1"/></body></worldbody>{rest}</mujoco>'
SLIDE = '<joint name="slide" type="slide"/>'
OWN = "model: own.xml\nsignals: {joints: {slide: /joint_states}}\n"

Writer = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Writer:
    """Write files into one folder, `name=content` with _ for the dot of .xml and .yaml; returns the twin's path."""

    def write_files(twin: str, **files: str) -> Path:
        for name, content in files.items():
            (tmp_path / name.replace("_xml", ".xml").replace("_yaml", ".yaml")).write_text(content)
        path = tmp_path / "twin.yaml"
        path.write_text(twin)
        return path

    return write_files


def test_nominal_has_nothing_switched_on() -> None:
    """`nominal` is the shipped rig with the shipped vehicle, the whole catalogue at hand and no effect on."""
    spec = load_twin("nominal")
    assert spec.effects == {}
    assert [effect.id for effect in spec.catalogue] == [effect.id for effect in CATALOGUE]
    assert spec.model_file.name == "rail_rig.xml"
    assert Twin(spec, 2).effects == {}


def test_twin_file_switches_effects_on(write: Writer) -> None:
    """Effects have the values of the file; parameters left out are at their off values."""
    path = write(
        DRONE + "effects:\n  rail_x.coulomb: {force: 0.3}\n  servo.lag: {}\n  air.drag: {k_d: 1}\n"
        "  rail_x.viscous: {damping: 0.7}\n"
    )
    spec = load_twin(path)
    assert spec.effects == {
        "rail_x.coulomb": {"force": 0.3},
        "servo.lag": {"time_constant": 0.020},
        "air.drag": {"k_d": 1.0},
        "rail_x.viscous": {"damping": 0.7},
    }
    twin = Twin(spec, 2)
    np.testing.assert_array_equal(twin.parameter("rail_x.coulomb", "force"), [0.3, 0.3])
    np.testing.assert_array_equal(twin.constant("dof_damping"), [[0.7, 0, 0]] * 2)


def test_vehicle_numbers_are_applied_over_the_model(write: Writer) -> None:
    """Masses, inertia, arm, travel, gravity and step come from the vehicle file, and off values with them."""
    changed = VEHICLE
    for old, new in (
        ("mass: 0.450", "mass: 0.5"),
        ("half_length: 0.200", "half_length: 0.3"),
        ("inertia: 0.0060", "inertia: 0.008"),
        ("carriage_mass: 0.080", "carriage_mass: 0.1"),
        ("slider_mass: 0.050", "slider_mass: 0.06"),
        ("travel_x: [-1.5, 1.5]", "travel_x: [-1.0, 1.2]"),
        ("gravity: 9.81", "gravity: 9.8"),
        ("time_constant: 0.020", "time_constant: 0.03"),
        ("inner_rate: 1000", "inner_rate: 2000"),
    ):
        assert old in changed
        changed = changed.replace(old, new, 1)
    spec = load_twin(write("model: rail_rig.xml\nvehicle: other.yaml\n", other_yaml=changed))
    model = spec.model
    assert model.body("craft").mass[0] == 0.5
    assert model.body("craft").inertia[1] == 0.008
    assert model.body("carriage").mass[0] == 0.1
    assert model.body("slider").mass[0] == 0.06
    np.testing.assert_array_equal(model.site("rotor_1").pos, [-0.3, 0, 0])
    np.testing.assert_array_equal(model.site("rotor_2").pos, [0.3, 0, 0])
    np.testing.assert_array_equal(model.joint("rail_x").range, [-1.0, 1.2])
    np.testing.assert_array_equal(model.opt.gravity, [0, 0, -9.8])
    assert model.opt.timestep == 0.0005
    assert next(e for e in spec.catalogue if e.id == "servo.lag").parameter("time_constant").off == 0.03


def test_other_rigs_get_generic_effects(write: Writer) -> None:
    """Every named joint and actuator of another MJCF gets its own effects, with the units of its kind."""
    spec = load_twin(write(CART_TWIN, cart_pendulum_xml=CART_PENDULUM))
    units = {(e.id, p.name): p.unit for e in spec.catalogue for p in e.parameters}
    assert units["slide.coulomb", "force"] == "N"
    assert units["swing.coulomb", "torque"] == "N m"
    assert units["slide.viscous", "damping"] == "N s/m"
    assert units["swing.viscous", "damping"] == "N m s/rad"
    assert units["motor.delay", "delay"] == "s"
    assert spec.robot.rotorcraft is None
    with pytest.raises(InputError, match="not the drone"):
        _ = Twin(spec, 1).vehicle


def test_unnamed_actuators_have_no_effects(write: Writer) -> None:
    """What has no name in the MJCF can't be named as a cause, and does not stand in the way of what has one."""
    model = FREE_BODY.format(joint=SLIDE, rest='<actuator><motor joint="slide"/></actuator>')
    spec = load_twin(write(OWN, own_xml=model))
    assert {effect.target for effect in spec.catalogue} == {"slide"}
    assert Twin(spec, 1, active=[effect.id for effect in spec.catalogue]).constant("dof_damping").shape == (1, 1)


@pytest.mark.parametrize(
    ("joint", "named"),
    [('<joint name="arm"/>', "joint 'arm'"), ("<joint/>", "a joint without a name")],
    ids=["named", "unnamed"],
)
def test_joints_that_no_signal_names_are_refused(write: Writer, joint: str, named: str) -> None:
    """They would be simulated from nowhere: the log does not tell where they were."""
    model = FREE_BODY.format(joint=SLIDE + f'<geom size="0.1"/></body><body>{joint}', rest="")
    refuse(write(OWN, own_xml=model), f"signals leave out {named}; expected every joint .*`driven`.*remove the rest")
    if "arm" in joint:
        twin = load_twin(write(OWN.replace("}}", "}, driven: {arm: /joint_states}}"), own_xml=model))
        assert list(twin.robot.driven) == [1]


@pytest.mark.parametrize(
    ("effects", "found"),
    [
        pytest.param("rail_x.colomb: {force: 0.3}", r"'rail_x\.colomb'.*rail_x\.coulomb", id="misspelt effect"),
        pytest.param("friction: {}", r"unknown effect 'friction'.*`vpptwin effects`", id="unknown effect"),
        pytest.param("rail_x.coulomb: {force: -0.1}", r"force = -0\.1 N.*0 to 2 N", id="negative friction"),
        pytest.param("airframe.mass: {mass: -0.45}", r"mass = -0\.45 kg.*-0\.09 to 0\.15 kg", id="no mass left"),
        pytest.param("rotor.thrust_gain: {gain: 7}", r"gain = 7 .*0\.5 to 1\.5.*off is 1", id="above the bounds"),
        pytest.param("rail_x.coulomb: {torque: 0.1}", r"no parameter 'torque'.*force", id="unknown parameter"),
        pytest.param("rail_x.coulomb: {force: strong}", r"rail_x\.coulomb\.force = 'strong'.*number", id="no number"),
        pytest.param("rail_x.coulomb: {force: yes}", r"force = True.*number", id="yes"),
        pytest.param("rail_x.coulomb: {force: .nan}", r"force = nan N.*0 to 2 N", id="NaN"),
        pytest.param("rail_x.coulomb: {force: .inf}", r"force = inf N.*0 to 2 N", id="infinite"),
        pytest.param("rail_x.coulomb: 0.3", r"rail_x\.coulomb = 0\.3.*mapping", id="a number for a mapping"),
    ],
)
def test_bad_effects_are_refused(write: Writer, effects: str, found: str) -> None:
    """An effect that can't be switched on as written is named in one line, with what would be accepted."""
    refuse(write(f"{DRONE}effects:\n  {effects}\n"), found)


@pytest.mark.parametrize(
    ("twin", "found"),
    [
        pytest.param("", "no YAML mapping.*model, vehicle, effects", id="empty"),
        pytest.param("- model\n- vehicle\n", "no YAML mapping", id="a list"),
        pytest.param("model: [", "not YAML", id="no YAML"),
        pytest.param("vehicle: vehicle.yaml\n", "model", id="no model"),
        pytest.param(DRONE + "effect: {}\n", "effect", id="misspelt key"),
        pytest.param("model: absent.xml\nvehicle: vehicle.yaml\n", r"no file absent\.xml.*rail_rig\.xml", id="no MJCF"),
        pytest.param("model: rail_rig.xml\nvehicle: absent.yaml\n", r"no file absent\.yaml", id="no vehicle"),
        pytest.param("model: vehicle.yaml\nvehicle: vehicle.yaml\n", "MuJoCo says", id="a YAML for an MJCF"),
        pytest.param("model: rail_rig.xml\nvehicle: rail_rig.xml\n", "a vehicle YAML", id="an MJCF for a vehicle"),
        pytest.param("model: rail_rig.xml\n", "neither vehicle nor signals.*joints: {rail_x", id="neither"),
        pytest.param(DRONE + "signals: {joints: {slide: /a}}\n", "vehicle and signals.*one of them", id="both"),
        pytest.param(DRONE + "effects: [rail_x.coulomb]\n", r"effects = \['rail_x.coulomb'\].*mapping", id="effects"),
    ],
)
def test_bad_twin_files_are_refused(write: Writer, twin: str, found: str) -> None:
    """A file that is no twin is refused in one line that says what one looks like."""
    refuse(write(twin), found)


@pytest.mark.parametrize(
    ("model", "found"),
    [
        pytest.param(RAIL_RIG[:-40], r"own\.xml: MuJoCo says", id="cut off"),
        pytest.param(RAIL_RIG.replace('mass="0.450"', 'mass="heavy"'), r"own\.xml: MuJoCo says", id="mass no number"),
        pytest.param(
            RAIL_RIG.replace('name="pitch"', 'name="theta"'), "no joint pitch.*leave out `vehicle`", id="joint"
        ),
        pytest.param(RAIL_RIG.replace('body name="craft"', 'body name="drone"'), "no body craft", id="body"),
        pytest.param(re.sub(r'<motor name="thrust_2".*?/>', "", RAIL_RIG), "1 actuators.*two", id="one rotor"),
        pytest.param(
            RAIL_RIG.replace('"rail_x"', '"?"').replace('"rail_z"', '"rail_x"').replace('"?"', '"rail_z"'),
            "joints rail_z, rail_x, pitch; expected first rail_x, rail_z, pitch",
            id="joints in another order",
        ),
    ],
)
def test_bad_models_of_the_drone_are_refused(write: Writer, model: str, found: str) -> None:
    """An MJCF that does not compile or is not of the drone is refused in one line, before anything is simulated."""
    refuse(write("model: own.xml\nvehicle: vehicle.yaml\n", own_xml=model), found)


@pytest.mark.parametrize(
    ("joint", "rest", "found"),
    [
        pytest.param('<freejoint name="slide"/>', "", "joint 'slide'.*names none", id="free"),
        pytest.param("", "", "no joints", id="no joint"),
        pytest.param('<joint name="sledge" type="slide"/>', "", "joint 'slide'.*sledge", id="other name"),
        pytest.param('<joint type="slide"/>', "", "joint 'slide'.*names none", id="no name"),
    ],
)
def test_bad_models_of_other_rigs_are_refused(write: Writer, joint: str, rest: str, found: str) -> None:
    """A rig that a twin can't follow is refused in one line that says what one can; tests/test_refusals.py has more."""
    refuse(write(OWN, own_xml=FREE_BODY.format(joint=joint, rest=rest)), found)


@pytest.mark.parametrize(
    ("signals", "found"),
    [
        pytest.param("{joints: {sledge: /joint_states}}", "joint 'sledge'.*slide, swing", id="unknown joint"),
        pytest.param(
            "{joints: {slide: /joint_states}, actuators: {engine: /actuator_command}}",
            "actuator 'engine'.*motor",
            id="unknown actuator",
        ),
        pytest.param("{joints: {}}", "signals without joints.*joints: {slide", id="no joints"),
        pytest.param("{}", "signals without joints", id="nothing"),
        pytest.param("{joints: [slide]}", "signals.joints", id="a list"),
    ],
)
def test_bad_signals_are_refused(write: Writer, signals: str, found: str) -> None:
    """Signals that name what the MJCF lacks, or nothing, are refused with the names there are."""
    refuse(write(f"model: cart_pendulum.xml\nsignals: {signals}\n", cart_pendulum_xml=CART_PENDULUM), found)


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("mass: 0.450", "mass: -0.450", r"airframe\.mass = -0\.45.*greater than 0"),
        ("inertia: 0.0060", "inertia: 0", r"airframe\.inertia = 0.*greater than 0"),
        ("travel_x: [-1.5, 1.5]", "travel_x: [1.5, -1.5]", r"rig\.travel_x"),
    ],
)
def test_bad_vehicles_are_refused(write: Writer, old: str, new: str, found: str) -> None:
    """A vehicle that can't exist is refused, the number named."""
    assert old in VEHICLE
    refuse(write("model: rail_rig.xml\nvehicle: own.yaml\n", own_yaml=VEHICLE.replace(old, new, 1)), found)


def test_missing_twin_is_refused(tmp_path: Path) -> None:
    """A path that leads nowhere, to a folder or to a binary is refused in one line that names `nominal`."""
    (tmp_path / "binary.yaml").write_bytes(bytes(range(256)))
    for name in ("absent.yaml", ".", "binary.yaml"):
        refuse(tmp_path / name, "no readable twin.*`nominal`, `typical`, `strong` or a twin YAML")


@pytest.mark.parametrize(
    ("effect", "lacking"),
    [
        ("rail_x.jamming: {mu: 0.01}", "carriage and slider"),
        ("rail_z.jamming: {mu: 0.1}", "carriage and slider"),
        ("carriage.mass: {mass: 0.1}", "carriage"),
    ],
)
def test_effects_of_the_rig_are_refused_on_the_free_craft(write: Writer, effect: str, lacking: str) -> None:
    """What the free craft lacks can't jam or be too heavy: one line says what is missing, in a file or given later."""
    drone = "model: vpp_planar.xml\nvehicle: vehicle.yaml\n"
    refuse(write(f"{drone}effects:\n  {effect}\n"), f"on a model without {lacking}.*rail_rig")
    spec = load_twin(write(drone))
    with pytest.raises(InputError, match=f"without {lacking}"):
        spec.with_effects(yaml.safe_load(effect))
    name = effect.split(":")[0]
    assert name not in {e.id for e in spec.catalogue}
    with pytest.raises(KeyError, match=f"no effect {name}"):
        Twin(spec, 1, active=[name])


@pytest.mark.parametrize(
    ("joint", "effect", "found"),
    [
        pytest.param(SLIDE, "slide.jamming: {mu: 0.1}", "unknown effect 'slide.jamming'.*slide\\.", id="not generic"),
        pytest.param(SLIDE, "rail_x.jamming: {mu: 0.1}", "without carriage and slider", id="the drone's"),
        pytest.param(
            SLIDE + '<geom size="0.1"/></body><body><joint type="slide"/>', "joint1.coulomb: {force: 0.1}",
            "leave out a joint without a name", id="unnamed joint",
        ),
        pytest.param(
            SLIDE + '<geom size="0.1"/></body><body><freejoint name="ball"/>', "ball.coulomb: {force: 0.1}",
            "leave out a free body without a name.*under `bodies`", id="free joint",
        ),
    ],
)  # fmt: skip
def test_generic_effects_are_refused_where_none_can_be(write: Writer, joint: str, effect: str, found: str) -> None:
    """An effect on a joint that has no name or too many freedoms, or one that no such joint has, is refused."""
    refuse(write(OWN + f"effects:\n  {effect}\n", own_xml=FREE_BODY.format(joint=joint, rest="")), found)


def test_effects_given_to_a_spec_are_checked() -> None:
    """`with_effects` refuses what a file would be refused for, and leaves the spec it was asked on as it was."""
    spec = load_twin()
    with pytest.raises(InputError, match="force = 3 N"):
        spec.with_effects({"rail_x.coulomb": {"force": 3.0}})
    changed = spec.with_effects({"rail_x.coulomb": {"force": 0.3}})
    assert (spec.effects, changed.effects) == ({}, {"rail_x.coulomb": {"force": 0.3}})
    assert changed.value(changed.catalogue[0], "force") == 0.3
    assert spec.value(spec.catalogue[0], "force") == 0.0


def test_unknown_effect_or_parameter_of_a_twin_raises() -> None:
    """Switching on or setting what is not there raises, with what is."""
    spec = load_twin()
    with pytest.raises(KeyError, match="no effect rail_y"):
        Twin(spec, 1, active=["rail_y.coulomb"])
    twin = Twin(spec, 1, active=["rail_x.coulomb"])
    with pytest.raises(KeyError, match=r"not switched on.*rail_x\.coulomb\.force"):
        twin.set_parameter("rail_z.coulomb", "force", 0.1)


def refuse(path: Path, found: str) -> str:
    """Loading raises InputError with a single line that matches `found`; what it says to be expected."""
    with pytest.raises(InputError, match=f"(?s){found}") as caught:
        load_twin(path)
    line = str(caught.value)
    assert "\n" not in line
    assert "; expected " in line
    assert caught.value.action
    return caught.value.expected


def test_model_is_looked_up_beside_the_file(tmp_path: Path) -> None:
    """A model file beside the twin wins over the shipped one of the same name."""
    (tmp_path / "rail_rig.xml").write_text(RAIL_RIG.replace('model="rail_rig"', 'model="mine"'))
    path = tmp_path / "twin.yaml"
    path.write_text(DRONE)
    assert load_twin(path).model_file == tmp_path / "rail_rig.xml"
    assert load_twin().model_file == (models_dir() / "rail_rig.xml").resolve()
