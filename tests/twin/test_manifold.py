"""Moving poses along their tangent and back, on rigs with quaternions too."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from vpptwin.twin.robot.manifold import difference_poses, integrate_pose

SLIDES = """<mujoco><worldbody><body><joint type="slide"/><joint type="hinge" axis="0 1 0"/><geom size="1"/></body>
</worldbody></mujoco>"""
FREE = """<mujoco><worldbody><body><freejoint/><geom size="1"/><body><joint type="ball"/><geom size="1"/></body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("xml", [SLIDES, FREE])
def test_there_and_back(xml: str) -> None:
    """The difference of a moved pose is the step, whatever the joints; batches broadcast, arguments stay."""
    model = mujoco.MjModel.from_xml_string(xml)
    rng = np.random.default_rng(3)
    step = 0.5 * rng.standard_normal((4, 3, model.nv))
    pose = integrate_pose(model, model.qpos0, rng.standard_normal((4, 1, model.nv)))
    before = pose.copy()
    moved = integrate_pose(model, pose, step)
    assert moved.shape == (4, 3, model.nq)
    np.testing.assert_array_equal(pose, before)
    # quaternions are normalised at every step: a few roundings of numbers of order one
    np.testing.assert_allclose(difference_poses(model, pose, moved), step, atol=1e-12)


def test_equals_mujoco_for_hinges_and_slides() -> None:
    """To the last bit, since the twin's poses at time and for the engine go through it."""
    model = mujoco.MjModel.from_xml_string(SLIDES)
    rng = np.random.default_rng(4)
    pose, step = rng.standard_normal((2, 100, model.nq))
    expected = pose.copy()
    for row, along in zip(expected, step):
        mujoco.mj_integratePos(model, row, along, 1.0)
    np.testing.assert_array_equal(integrate_pose(model, pose, step), expected)
