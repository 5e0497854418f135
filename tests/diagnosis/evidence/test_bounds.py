"""What a search may return is a twin: bounds by logs lie within those by what a rig can carry and its drives exert."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

from tests.builders import load_rig
from vpptwin.diagnosis.evidence.forces import scale_to
from vpptwin.diagnosis.search.suspects import list_sizes, list_unknowns
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.model import inertia_at_rest
from vpptwin.twin.robot.robot import Loads
from vpptwin.twin.spec import TwinSpec, load_twin

PENDULUM = """<mujoco><worldbody><body><joint name="swing" axis="0 1 0"/>
<inertial pos="0 0 -0.02" mass="0.004" diaginertia="2e-6 2e-6 1e-7"/></body></worldbody>
<actuator><motor name="swing_motor" joint="swing"/></actuator></mujoco>"""
ARM = """<mujoco><worldbody><body><joint name="joint_1" axis="0 0 1" armature="0.4"/>
<inertial pos="0 0 0.2" mass="14" diaginertia="0.3 0.3 0.2"/>
<body pos="0 0 0.4"><joint name="joint_2" axis="0 1 0" armature="0.4"/>
<inertial pos="0 0 0.2" mass="9" diaginertia="0.2 0.2 0.05"/>
<body name="wrist" pos="0 0 0.5"><joint name="joint_3" axis="1 0 0"/>
<inertial pos="0 0 0.01" mass="0.2" diaginertia="4e-5 4e-5 7e-5"/></body></body></body></worldbody><actuator>
<motor name="motor_1" joint="joint_1" ctrlrange="-140 140" ctrllimited="true"/>
<motor name="motor_2" joint="joint_2" ctrlrange="-120 120" ctrllimited="true"/>
<motor name="motor_3" joint="joint_3" ctrlrange="-12 12" ctrllimited="true"/></actuator></mujoco>"""
CART = """<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="30" diaginertia="1 1 1"/><body name="wheel" pos="0 0.3 0"><joint name="wheel" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.02 0.01"/></body></body></worldbody>
<actuator><position name="servo" joint="rail" kp="900" kv="40" forcerange="-400 400"/></actuator></mujoco>"""
QUAD = """<mujoco><worldbody><body name="quad"><freejoint/>
<inertial pos="0 0 0" mass="0.03" diaginertia="1.6e-5 1.6e-5 2.9e-5"/><site name="up" pos="0.05 0 0"/></body>
</worldbody><actuator><motor name="rotor" site="up" gear="0 0 1 0 0 0"/></actuator></mujoco>"""
RIGS = {"tiny pendulum": PENDULUM, "heavy arm": ARM, "cart with a wheel": CART, "quadrotor": QUAD}
TYPICAL = {"force": 3.0, "speed": 0.5, "travel": 0.6, "middle": 0.2, "control": 2.0}
"""Of a log of any rig, in SI units."""
LOGS: dict[str, dict[str, float]] = {
    "usual": {}, "slow and stiff": {"force": 60.0, "speed": 0.01}, "hardly moved": {"speed": 1e-3, "travel": 1e-3},
    "a wheel after an hour": {"travel": 4e3, "middle": 9e3, "speed": 300.0}, "counts": {"control": 6e4},
    "light touch": {"force": 1e-5, "control": 1e-5}, "another unit": {"force": 1e7, "speed": 1e4},
}  # fmt: skip


def load(mjcf: str) -> TwinSpec:
    """The twin of an MJCF whose joints are all logged."""
    return load_rig(mjcf, "{bodies: {quad: /pose}, actuators: {rotor: /commands}}" if mjcf is QUAD else "")


def scale_by(spec: TwinSpec, told: dict[str, float]) -> TwinSpec:
    """The twin as a diagnosis searches it, after a log of these scales."""
    dofs, inputs = np.ones(spec.model.nv), np.ones(spec.model.nu)
    scales = {name: value * (inputs if name == "control" else dofs) for name, value in (TYPICAL | told).items()}
    return scale_to(spec, Loads(carried=np.diag(inertia_at_rest(spec.model)), **scales))


@pytest.mark.parametrize("told", LOGS.values(), ids=LOGS)
@pytest.mark.parametrize("mjcf", RIGS.values(), ids=RIGS)
def test_what_a_search_may_return_is_a_twin(mjcf: str, told: dict[str, float]) -> None:
    """Every effect of any rig loads at either end of what is looked through after any log, and at its off value."""
    spec = load(mjcf)
    searched = scale_by(spec, told)
    assert {e.id for e in searched.catalogue} == {e.id for e in spec.catalogue}
    for side in ("low", "off", "high"):
        effects = {e.id: {p.name: float(getattr(p, side)) for p in e.parameters} for e in searched.catalogue}
        assert spec.with_effects(effects).effects == effects
        found = spec.model_file.with_name("found.yaml")
        content = yaml.safe_load(spec.model_file.with_name("rig.yaml").read_text()) | {"effects": effects}
        found.write_text(yaml.safe_dump(content))
        assert load_twin(found).effects == effects
    for parameter in (p for e in searched.catalogue for p in e.parameters):
        assert parameter.low <= parameter.off <= parameter.high
        assert np.isfinite([parameter.low, parameter.high]).all()


@pytest.mark.parametrize(("mjcf", "effect", "value"), [
    (ARM, "joint_3.viscous", 2.3), (ARM, "joint_3.coulomb", 4.0), (ARM, "joint_3.drag", 30.0),
    (ARM, "joint_3.inertia", 0.05), (ARM, "wrist.payload", 11.0), (ARM, "wrist.mass", 2.5), (ARM, "joint_3.bias", -9.0),
    (CART, "wheel.tight_spot", 1.5), (CART, "rail.fade", 40.0), (QUAD, "quad.wind", 1.2), (QUAD, "quad.twist", -0.03),
    (QUAD, "quad.drag", 4.0), (PENDULUM, "swing.viscous", 0.9), (PENDULUM, "swing.lugre", 3.0),
])  # fmt: skip
def test_bounds_follow_what_joints_carry(mjcf: str, effect: str, value: float) -> None:
    """A wrist that weighs nothing bears what its drive, or a tool on it, makes; so do slow joints and agile crafts."""
    spec = load(mjcf)
    name = next(e.parameters[0].name for e in spec.catalogue if e.id == effect)
    assert spec.with_effects({effect: {name: value}}).effects[effect][name] == value


def test_a_load_may_be_heavier_than_what_holds_it() -> None:
    """A flange of 0.2 kg on an arm of 23 kg: looked for up to twice that, or what 300 N m hold up; tried on the way."""
    searched = scale_by(load(ARM), {})
    (payload,) = (u for u in list_unknowns(searched) if u.key == ("wrist.payload", "mass"))
    assert payload.parameter.high == pytest.approx(2.0 * (14.0 + 9.0 + 0.2))
    assert [round(size / 0.2, 2) for size in list_sizes(payload, False)] == [0.05, 0.25, 1.25, 6.25, 31.25]
    strong = scale_by(load(ARM), {"force": 300.0})
    (stronger,) = (u for u in list_unknowns(strong) if u.key == ("wrist.payload", "mass"))
    assert stronger.parameter.high > 2.0 * payload.parameter.high


@pytest.mark.parametrize(("effect", "values", "expected"), [
    ("joint_3.viscous", {"damping": -0.1}, r"damping = -0.1 N m s/rad; expected 0 to"),
    ("joint_2.coulomb", {"torque": -1.0}, "torque = -1 N m; expected 0 to"),
    ("wrist.mass", {"mass": -0.2}, "mass = -0.2 kg; expected -0.16 to"),
    ("wrist.payload", {"mass": 2400.0}, "mass = 2400 kg; expected 0 to"),
    ("joint_2.viscous", {"damping": 1e9}, r"damping = 1e\+09 N m s/rad; expected 0 to"),
    ("joint_1.coulomb", {"torque": float("nan")}, "torque = nan N m; expected 0 to"),
    ("joint_1.inertia", {"inertia": float("inf")}, "inertia = inf kg m.2; expected"),
    ("joint_1.inertia", {"inertia": -1e6}, "expected -"),
    ("joint_2.fade", {"slope": -1.0}, "slope = -1 s/rad; expected 0 to"),
    ("motor_1.delay", {"delay": 40.0}, "delay = 40 s; expected 0 to 0.1"),
])  # fmt: skip
def test_what_no_rig_has_is_refused(effect: str, values: dict[str, float], expected: str) -> None:
    """A wrong sign, no number, another unit: with what was found and what may be."""
    spec = load(ARM)
    with pytest.raises(InputError, match=expected):
        spec.with_effects({effect: values})


def test_a_search_starts_from_what_the_twin_has() -> None:
    """A value beyond what a log asks for stays within the bounds of a search."""
    spec = load(PENDULUM).with_effects({"swing.bias": {"force": 1.5}})
    light = replace(spec, effects={})
    bounds = [
        next(p for e in scale_by(each, {"force": 0.01}).catalogue if e.id == "swing.bias" for p in e.parameters)
        for each in (light, spec)
    ]
    assert (bounds[0].high, bounds[1].high, bounds[1].low) == (pytest.approx(0.02), 1.5, pytest.approx(-0.02))
