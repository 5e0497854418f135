"""Equalities of an MJCF: what gives is told, what follows is no suspect, and noise is no load, of contacts neither."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.builders import load_rig
from vpptwin.diagnosis.judgement.conclusion import describe_soft_couplings
from vpptwin.estimation.dynamics import invert
from vpptwin.twin.robot.drives import list_followers

FINGERS = """<mujoco><default><geom size="0.01" mass="0.2" contype="0"/><joint type="slide" axis="1 0 0"/></default>
<worldbody><body><joint name="left"/><geom/></body><body><joint name="right"/><geom/></body></worldbody>
<equality><joint joint1="right" joint2="left" %s/></equality></mujoco>"""

WHEEL = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 0.1"><joint type="slide" axis="1 0 0"/>
<joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/><geom type="sphere" size="0.1" mass="1"/></body></worldbody>
</mujoco>"""


@pytest.mark.parametrize(
    ("setting", "told"),
    [("", "equality 0 of the MJCF is soft (solimp up to 0.95)"),
     ('name="mimic" solimp="0.5 0.6 0.001"', "equality mimic of the MJCF is soft (solimp up to 0.6)"),
     ('solimp="0.9999 0.9999 0.001"', None), ('active="false"', None)],
)  # fmt: skip
def test_soft_couplings_are_told(setting: str, told: str | None) -> None:
    """With MuJoCo's own softness or more; not where it is rigid, or does nothing."""
    lines = describe_soft_couplings(mujoco.MjModel.from_xml_string(FINGERS % setting))
    assert [line.split(":")[0] for line in lines] == ([] if told is None else [told])


def test_what_follows_is_no_suspect() -> None:
    """Friction of the finger that follows is that of the one that leads; its encoder is its own."""
    robot = load_rig(FINGERS % "").robot
    hidden = [effect.id for effect in robot.list_effects() if robot.hides(effect) and not effect.touching]
    assert list_followers(robot.model) == ["right"]
    assert {"right.coulomb", "right.viscous", "right.inertia"} <= set(hidden)
    assert all(name.startswith("right.") for name in hidden)
    assert not {"right.rate_scale", "right.delay"} & set(hidden)


def test_noise_between_coupled_joints_is_no_load() -> None:
    """Fingers of 0.2 kg that part by 10 um, which the coupling answers with newtons: 1 m/s^2 takes 0.2 N of either."""
    model = mujoco.MjModel.from_xml_string(FINGERS % 'solimp="0.9999 0.9999 0.001" solref="0.004 1"')
    inertial, _, missing = invert(model, np.array([[0.0, 1e-5]]), np.zeros((1, 2)), np.ones((1, 2)), np.zeros((1, 0)))
    np.testing.assert_allclose(inertial, 0.2)
    np.testing.assert_allclose(missing, 0.2)


def test_noise_of_a_wheel_on_the_ground_is_no_load() -> None:
    """A ball that seems to slip by 10 mm/s, 10 um deep in the ground: what moves it is none of friction's newtons."""
    model = mujoco.MjModel.from_xml_string(WHEEL)
    pose, slips = np.array([[0.0, -1e-5, 0.0]]), np.array([[0.01, 0.0, 0.0]])
    inertial, _, missing = invert(model, pose, slips, np.zeros((1, 3)), np.zeros((1, 0)))
    np.testing.assert_allclose(inertial, 0.0)
    np.testing.assert_allclose(missing, [[0.0, 9.81, 0.0]], atol=1e-12)
