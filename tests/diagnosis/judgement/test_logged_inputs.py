"""What an error of a torque sensor would look the same as, and inputs that do not explain what moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.diagnosis.rigs import CARTS, DECAYS, write_rig
from tests.quadrotor import fly, write_twin
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.judgement.logged_inputs import describe_input_error, describe_weak_inputs, list_inputs
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import read_measurements
from vpptwin.twin.model import compile_model
from vpptwin.twin.spec import load_twin

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
