"""Joints that follow their log: the others move as if the log's motion had been simulated, whatever caused it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.effects.rigs import CART_PENDULUM
from tests.twin.hover import share_kernel
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, TwinSpec, load_twin
from vpptwin.twin.robot.manifold import difference_poses
from vpptwin.twin.twin import Driven

JOINTS = ("slide", "swing")
ROWS, STEPS = 5, 800
THROWN = """<mujoco><option timestep="0.001"/><worldbody><body name="base"><freejoint/>
<geom type="box" size="0.1 0.05 0.03" mass="1"/><body pos="0.1 0 0"><joint name="elbow" axis="0 1 0.3"/>
<geom type="capsule" fromto="0 0 0 0.3 0.1 0" size="0.02" mass="0.4"/></body></body></worldbody>
<actuator><motor name="m" joint="elbow"/></actuator></mujoco>"""


def load_cart(folder: Path, joints: str, driven: str = "") -> TwinSpec:
    """The cart with a pendulum, with some joints simulated and some driven."""
    listed = [f"{kind}: {{{name}: /joint_states}}" for kind, name in (("joints", joints), ("driven", driven)) if name]
    if joints == "both":
        listed = ["joints: {slide: /joint_states, swing: /joint_states}"]
    (folder / "cart_pendulum.xml").write_text(CART_PENDULUM)
    path = folder / "twin.yaml"
    path.write_text(f"model: cart_pendulum.xml\nsignals: {{{', '.join(listed)}, actuators: {{motor: /commands}}}}\n")
    return load_twin(path)


@pytest.mark.parametrize(
    ("free", "driven"), [(0, 1), pytest.param(1, 0, marks=pytest.mark.slow)], ids=["swing driven", "slide driven"]
)
def test_free_joint_feels_a_driven_one(tmp_path: Path, free: int, driven: int) -> None:
    """Led along the track of a full simulation, with friction and a pull unknown to it, one joint moves the other."""
    rng = np.random.default_rng(1)
    commands = np.repeat(2.0 * rng.normal(size=(ROWS, STEPS // 40, 1)), 40, axis=1)
    start = np.stack([np.zeros(ROWS), rng.uniform(-1, 1, ROWS)], axis=1)
    hidden = (f"{JOINTS[driven]}.viscous", f"{JOINTS[driven]}.bias")
    with share_kernel():
        both = Twin(load_cart(tmp_path, "both"), ROWS, active=hidden, num_threads=1)
    both.set_parameter(hidden[0], "damping", 0.05)
    both.set_parameter(hidden[1], "force", 0.1)
    _, qpos, velocity, _ = both.replay_commands(both.initial_state(qpos=start), commands)
    pose = both.pose_at_time(qpos, velocity)
    full_pose = np.concatenate([start[:, None], pose], axis=1)
    full_velocity = np.concatenate([np.zeros((ROWS, 1, 2)), velocity], axis=1)
    led = Driven(np.array([driven]), full_pose[:, :-1], full_velocity[:, :-1])
    half = Twin(load_cart(tmp_path, JOINTS[free], JOINTS[driven]), ROWS, num_threads=1)
    applied = commands if free == 0 else np.zeros_like(commands)  # what acts on the driven joint need not be known
    _, led_qpos, led_velocity, _ = half.replay_commands(half.initial_state(qpos=start), applied, driven=led)
    led_pose = half.pose_at_time(led_qpos, led_velocity)
    # The driven joint is off by a millionth of the other forces on it; its last acceleration is taken from the one
    # before, hence one step less.
    np.testing.assert_allclose(led_pose[:, :-1, free], pose[:, :-1, free], rtol=0, atol=2e-5)
    np.testing.assert_allclose(led_velocity[:, :-1, free], velocity[:, :-1, free], rtol=0, atol=2e-4)
    np.testing.assert_allclose(led_pose[:, :-1, driven], pose[:, :-1, driven], rtol=0, atol=2e-5)
    assert np.ptp(pose[:, :, free], axis=1).min() > 0.05


def test_driven_joints_have_no_effects(tmp_path: Path) -> None:
    """Effects of a driven joint are not in the catalogue, and nothing is heavier in the spec's own model."""
    spec = load_cart(tmp_path, "slide", "swing")
    assert {effect.target for effect in spec.catalogue} == {"slide", "motor", "pole", ""}  # its mass, and the mount
    Twin(spec, 1)
    np.testing.assert_array_equal(spec.model.dof_armature, 0.0)


def test_friction_of_a_free_joint_holds_beside_a_driven_one(tmp_path: Path) -> None:
    """A cart with dry friction stands still under a pendulum led gently to and fro, below breakaway."""
    twin = Twin(load_cart(tmp_path, "slide", "swing"), 1, active=["slide.coulomb"], num_threads=1)
    twin.set_parameter("slide.coulomb", "force", 1.0)
    time = np.arange(2000) * twin.dt
    angle, speed = np.zeros((2, 1, 2000, 2))
    angle[..., 1] = 0.3 * np.sin(3.0 * time)
    speed[..., 1] = 0.9 * np.cos(3.0 * time)  # pulls with 0.2 kg * 0.3 m * 2.7 rad/s² = 0.16 N or so
    start = twin.initial_state(qvel=np.array([0.0, 0.9]))
    qpos = twin.replay_commands(start, np.zeros((1, 2000, 1)), driven=Driven(np.array([1]), angle, speed)).qpos
    assert np.abs(qpos[..., 0]).max() < 2e-5  # m in 2 s: creep of 0.1 mm in 10 s


def test_joint_under_both_is_refused(tmp_path: Path) -> None:
    """A joint is simulated or driven, not both."""
    with pytest.raises(InputError, match="'slide' under joints and driven"):
        load_cart(tmp_path, "slide", "slide")


@pytest.mark.slow
def test_a_base_that_flies_feels_a_driven_joint(tmp_path: Path) -> None:
    """Thrown, its arm swung by a torque: led along that swing instead, the base moves as it did, all six ways."""
    (tmp_path / "thrown.xml").write_text(THROWN)
    specs = []
    for joints in ("joints", "driven"):
        path = tmp_path / "twin.yaml"
        signals = f"bodies: {{base: /pose}}, {joints}: {{elbow: /joint_states}}, actuators: {{m: /commands}}"
        path.write_text(f"model: thrown.xml\nsignals: {{{signals}}}\n")
        specs.append(load_twin(path))
    rng, steps = np.random.default_rng(3), 400
    commands = np.repeat(0.3 * rng.standard_normal((1, steps // 40, 1)), 40, axis=1)
    velocity = rng.standard_normal((1, 7))
    whole, half = (Twin(spec, 1, num_threads=1) for spec in specs)
    _, qpos, qvel, _ = whole.replay_commands(whole.initial_state(qvel=velocity), commands)
    pose, zero = whole.pose_at_time(qpos, qvel), whole.pose_at_time(specs[0].model.qpos0[None], velocity)
    track = [np.concatenate([first[:, None], rest], axis=1)[:, :-1] for first, rest in ((zero, pose), (velocity, qvel))]
    led = Driven(specs[1].robot.driven, *track)
    after = half.replay_commands(half.initial_state(qvel=velocity), 0.0 * commands, driven=led)
    assert np.ptp(pose[..., 7]) > 0.3
    off = difference_poses(specs[0].model, pose, half.pose_at_time(after.qpos, after.qvel))[:, :-1]
    assert np.abs(off).max() < 2e-5
