"""What an error of a torque sensor would look the same as, and inputs that do not explain what moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from proving.quadrotor import MASS, fly, write_twin
from tests.diagnosis.rigs import CARTS, DECAYS, write_rig
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.logged_inputs import (
    describe_input_error,
    describe_turned,
    describe_weak_inputs,
    list_inputs,
    read_session,
)
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.diagnosis.search.suspects import list_unknowns
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Flight, Stream
from vpptwin.report.twin_file import name_twin
from vpptwin.twin.robot.model import compile_model
from vpptwin.twin.spec import TwinSpec, load_twin

PAIR = """<mujoco>
  <worldbody>
    <body>
      <joint name="one" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body>
        <joint name="two" type="slide" axis="0 1 0"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="cable"><joint joint="one" coef="1"/><joint joint="two" coef="2"/></fixed></tendon>
  <actuator>
    <motor name="left" joint="one"/><motor name="right" joint="one"/><motor name="winch" tendon="cable"/>
  </actuator>
</mujoco>"""


def test_offset_and_gain_of_a_driven_joint(tmp_path: Path) -> None:
    """A constant force on a driven joint may be an offset of what was logged, a wrong gain a factor on it."""
    spec = load_twin(write_rig(CARTS, tmp_path))
    told = {e.id: describe_input_error(spec, e) for e in spec.catalogue}
    assert told["slide.bias"] == "slide.bias: an offset in the log of motor would look the same"
    assert told["motor.gain"].startswith("motor.gain: a log that shows the input of motor wrong by that factor")
    assert {effect for effect, said in told.items() if said} == {"slide.bias", "motor.gain"}


def test_nothing_is_said_where_nothing_drives(tmp_path: Path) -> None:
    """A free decay has no torque sensor, and our drone's blades are none."""
    for spec, effect in ((load_twin(write_rig(DECAYS, tmp_path)), "swing.bias"), (load_twin(), "rail_x.bias")):
        assert describe_input_error(spec, find_effect(spec.catalogue, effect)) == ""


@pytest.mark.parametrize(("joint", "inputs"), [("one", ["left", "right", "winch"]), ("two", ["winch"])])
def test_all_that_drive_a_joint_are_named(joint: str, inputs: list[str], tmp_path: Path) -> None:
    """Two motors on one joint, and a winch that pulls at both."""
    (tmp_path / "pair.xml").write_text(PAIR)
    assert list_inputs(compile_model(tmp_path / "pair.xml"), joint) == inputs


def test_inputs_that_do_not_explain_the_motion_are_told(tmp_path: Path) -> None:
    """A quadrotor's thrusts explain what lifts and turns it; those of another flight but its weight."""
    spec = load_twin(write_twin(tmp_path))
    measured = read_measurements(spec, fly({}, 8.0, 3))
    assert describe_weak_inputs(spec, [measured], CRITERIA) == []
    other = read_measurements(spec, fly({}, 8.0, 4)).command
    (said,) = describe_weak_inputs(spec, [replace(measured, command=other)], CRITERIA)
    assert all(f"% on quad {way}" in said for way in ("roll", "pitch"))
    assert "quad z" not in said


KNOWN = {"quad.inertia": {"x": 1.1}, "m1.gain": {"gain": 0.95}, "imu.bias": {"x": 0.01}}
"""Effects of a twin that logs which do not tell what turned it cannot show."""


def alias(flight: Flight, seed: int) -> Flight:
    """The flight with motors that follow a far faster loop than is logged: each sample catches it somewhere."""
    rng, motors = np.random.default_rng(seed), flight.joints["/motors"]
    caught = {
        n: Stream(m.time, {"effort": m["effort"] + 0.02 * rng.standard_normal(len(m))}) for n, m in motors.items()
    }
    return replace(flight, joints={"/motors": caught})


@pytest.mark.parametrize(
    "hidden",
    [
        {"quad.com": {"y": 0.002}},
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"m4.gain": {"gain": 0.85}}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_a_body_turns_as_its_motors_say(tmp_path: Path, hidden: dict) -> None:
    """Whatever is constant is no reason to let it turn as logged, such as a centre of mass that is off."""
    spec = load_twin(write_twin(tmp_path))
    assert read_session(spec, [fly(hidden, 8.0, 3)])[0] is spec


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """A quadrotor's twin with effects of which logs that do not tell what turned it show some."""
    spec = load_twin(write_twin(tmp_path_factory.mktemp("quadrotor")))
    return spec.with_effects({**spec.effects, **KNOWN})


@pytest.fixture(scope="module")
def turned(known: TwinSpec) -> TwinSpec:
    """What is read of it with a log whose motors are a third noise."""
    return read_session(known, [alias(fly({}, 8.0, 3), 1)])[0]


def test_a_body_turns_as_logged_where_inputs_do_not_tell_what_turned_it(known: TwinSpec, turned: TwinSpec) -> None:
    """Where it goes is left, and all motors together."""
    spec = known
    assert turned.robot.signals.turned == ("quad",)
    assert read_session(turned, [alias(fly({}, 8.0, 3), 1)])[0] is turned
    assert describe_turned(turned)[0].startswith("quad turns as logged")
    left, gone = ({u.effect.id for u in list_unknowns(s)} for s in (turned, spec))
    assert left < gone
    assert {name for e in turned.catalogue for name in e.look_alikes} <= gone
    assert {"quad.mass", "quad.wind", "m1+m2+m3+m4.gain"} < left
    assert not {"m1.gain", "quad.com", "quad.inertia", "quad.twist", "quad.misalignment", "imu.bias"} & left
    measured = read_measurements(turned, fly({}, 8.0, 3))
    assert (sorted(measured.positions), sorted(measured.velocities), list(measured.driven)) == ([0, 1, 2], [], [3])


@pytest.mark.slow
def test_weak_rotors_are_named_of_a_body_that_turns_as_logged(tmp_path: Path) -> None:
    """A fifth less thrust of all of them, or as much more weight, which are one there."""
    spec = load_twin(write_twin(tmp_path))
    found = diagnose(spec, [alias(fly({"m1+m2+m3+m4.gain": {"gain": 0.8}}, 9.0, 500 + i), i) for i in range(2)])
    (cause, *others) = found.verdict.causes
    assert not [other for other in others if other.confidence > 0.9]
    assert {cause.effect, *(r.effect for r in cause.also_explained_by)} >= {"m1+m2+m3+m4.gain", "quad.mass"}
    (strength,) = cause.parameters.values()
    least = 1.0 / (1.0 + strength.value / MASS) if cause.effect == "quad.mass" else strength.value
    assert least == pytest.approx(0.8, abs=0.02)
    assert "quad turns as logged" in found.verdict.warnings[0]
    assert found.held_out.short.spec.robot.signals.turned == ("quad",)


def test_a_twin_that_turns_as_logged_is_written_with_what_it_had(turned: TwinSpec, tmp_path: Path) -> None:
    """Effects that such logs cannot show too, and is read back."""
    (tmp_path / "again.yaml").write_text(yaml.safe_dump(name_twin(turned, tmp_path)))
    again = load_twin(tmp_path / "again.yaml")
    assert again.robot.signals.turned == ("quad",)
    assert again.effects == turned.effects
    assert all(again.effects[effect].items() >= values.items() for effect, values in KNOWN.items())
