"""The MJCF's own friction, damping and air: it sticks by MuJoCo's means, `typical` flies alike, `nominal` has none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.twin.hover import WEIGHT
from vpptwin.system.errors import InputError
from vpptwin.system.resources import models_dir
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.robot.losses import read_losses

RIG = models_dir() / "rail_rig.xml"
TWIN = "model: own.xml\nvehicle: vehicle.yaml\nlosses: mjcf\n"
START = np.array([0.0, 1.2, 0.3])
MASS = np.array([0.58, 0.50, 0.0060])
"""Carried along x [kg], along z [kg], about the hinge [kg m²]: vehicle.yaml."""
DRY = np.array([0.30, 0.20, 0.003])
"""Dry friction of the MJCF [N, N, N m]."""
REFERENCE, SOFT = 2.0 / (0.9999 * 0.004), (1.0 - 0.9999) / 0.9999
"""Rate at which MuJoCo's friction constraint brakes [1/s], 2 / (dmax timeconst), and its softness (1 - d) / d."""

POSE, VELOCITY = [0.188655698957, 1.1009492867, 0.296902597797], [0.25163283441, 0.25862730745, 0.839616533506]
"""Of `nominal` after 0.3 s of `test_nominal_is_as_it_was`, at commit 3a66b23: the MJCF had no losses then."""


@pytest.fixture
def raw() -> mujoco.MjModel:
    """The rig as MuJoCo's viewer opens it."""
    return mujoco.MjModel.from_xml_path(str(RIG))


def push_raw(model: mujoco.MjModel, velocity: Sequence[float], push: Sequence[float], steps: int) -> np.ndarray:
    """Where MuJoCo alone takes the rig from START under a generalized force, (steps, 2, 3): qpos and qvel."""
    data, way = mujoco.MjData(model), np.empty((steps, 2, 3))
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = START, velocity, push
    for row in way:
        mujoco.mj_step(model, data)
        row[:] = data.qpos, data.qvel
    return way


def push_twin(name: str, velocity: Sequence[float], push: Sequence[float], steps: int) -> np.ndarray:
    """The same in a twin, its rotors without thrust."""
    twin = Twin(load_twin(name), 1, num_threads=1)
    state = twin.initial_state(START, np.array(velocity))
    force = np.array(push, dtype=float)[None, None]
    replay = twin.replay_commands(state, np.zeros((1, steps, 2)), disturbance=force)
    return np.stack([replay[1][0], replay[2][0]], axis=1)


@pytest.mark.parametrize(
    ("velocity", "push", "seconds"),
    [
        pytest.param((1.0, 0.6, 6.0), (0.0, WEIGHT, 0.0), 1.0, id="free decay"),
        pytest.param((-0.2, 0.1, -1.0), (0.0, WEIGHT, 0.0), 3.0, id="decay to rest"),
        pytest.param((3.0, -1.0, 20.0), (-2.0, WEIGHT + 0.3, 0.0), 1.0, id="fast turn"),
        pytest.param((0.0, 0.0, 0.0), (0.24, WEIGHT - 0.16, 0.0024), 1.0, id="below breakaway"),
        pytest.param((0.0, 0.0, 0.0), (0.36, WEIGHT + 0.24, -0.0036), 1.0, id="beyond breakaway"),
        pytest.param((1.0, 2.0, -9.0), (0.0, 0.0, 0.0), 0.4, id="fall"),
    ],
)
def test_typical_flies_as_the_mjcf_does(
    raw: mujoco.MjModel, velocity: tuple[float, ...], push: tuple[float, ...], seconds: float
) -> None:
    """Decays and pushes of MuJoCo alone and of `typical` differ by what their frictions and their air differ by."""
    steps = round(seconds / raw.opt.timestep)
    alone, ours = push_raw(raw, velocity, push, steps), push_twin("typical", velocity, push, steps)
    apart = np.abs(alone - ours)[:, 0].max(axis=0)
    # Friction: a sliding joint feels the same force. MuJoCo's brakes softly below F / (m b) [m/s], at the rate b, and
    # so goes F / (m b²) farther before it rests (x: 2.1 µm), where ours rests within the step. Pushed by less than F it
    # creeps with (1 - d) / d P / (m b), P < F.
    bound = DRY / (MASS * REFERENCE**2) + SOFT * DRY / (MASS * REFERENCE) * seconds
    # A joint that is pushed back through zero: MuJoCo's friction turns when that is 1 / b = 2 ms away, ours when a step
    # is. Meanwhile they differ by 2 F: at most 2 F / (m b) in velocity (x: 2.1 mm/s), from there on.
    turned = (alone[:, 1].min(axis=0) < -1e-3) & (alone[:, 1].max(axis=0) > 1e-3)
    bound += turned * 2.0 * DRY / (MASS * REFERENCE) * seconds
    # Air: on a sphere of volume V that also turns acts the dragged mass density V / 2, with v × q; a twin has none.
    dragged = raw.opt.density * 2.0 / 3.0 * np.pi * 0.005**3
    fastest = np.abs(alone[:, 1]).max(axis=0)
    bound[:2] += 0.5 * seconds**2 * dragged * np.hypot(*fastest[:2]) * fastest[2] / MASS[:2]
    assert (apart < bound).all(), (apart, bound)
    assert bound[~turned].max() < 2e-5  # m, rad
    without = np.abs(alone - push_twin("nominal", velocity, push, steps))[:, 0].max(axis=0)
    assert (without > 10.0 * bound).all()  # it would not pass without its friction


def test_the_mjcf_sticks(raw: mujoco.MjModel) -> None:
    """With 80 % of breakaway on every joint MuJoCo alone creeps by 0.64 to 0.83 µm (µrad) in 10 s, as its softness."""
    way = push_raw(raw, np.zeros(3), 0.8 * DRY + [0.0, WEIGHT, 0.0], 10_000)
    crept = way[-1, 0] - START
    np.testing.assert_allclose(crept, 10.0 * SOFT * 0.8 * DRY / (MASS * REFERENCE), rtol=0.01)
    assert crept.max() < 1e-6  # 0.1 mm would be creep
    gone = push_raw(raw, np.zeros(3), 1.2 * DRY + [0.0, WEIGHT, 0.0], 100)[-1, 1]
    np.testing.assert_allclose(gone, 0.1 * 0.2 * DRY / MASS, rtol=0.02)  # 2 %: damping, 0.1 s over m / b = 5 s


def test_typical_has_what_the_mjcf_says(raw: mujoco.MjModel) -> None:
    """Its effects are read from rail_rig.xml; the model that it steps rubs no second time."""
    spec = load_twin("typical")
    assert spec.model_file == RIG.resolve()
    assert {name for name, values in spec.effects.items() if values} == {
        *(f"{joint}.{kind}" for joint in ("rail_x", "rail_z", "pitch") for kind in ("coulomb", "viscous")), "air.drag"
    }  # fmt: skip
    for dof, joint in enumerate(("rail_x", "rail_z", "pitch")):
        (force,) = spec.effects[f"{joint}.coulomb"].values()
        assert (force, spec.effects[f"{joint}.viscous"]["damping"]) == (raw.dof_frictionloss[dof], raw.dof_damping[dof])
    assert spec.effects["air.drag"]["k_d"] == pytest.approx(0.05, rel=1e-6)
    np.testing.assert_array_equal(Twin(spec, 1).constant("dof_damping"), [raw.dof_damping])
    assert not spec.model.dof_frictionloss.any()


def test_nominal_is_as_it_was() -> None:
    """What the MJCF has become does not reach `nominal`: numbers of before, and a glide without loss."""
    twin = Twin(load_twin(), 1, num_threads=1)
    state = twin.initial_state(np.array([0.0, 1.0, 0.2]), np.array([1.0, 0.5, 3.0]))
    for thrust, rate in ((5.0, 0.0), (6.0, -1.0), (4.0, 1.0)):
        state = twin.step_policy(state, np.array([[thrust, rate]]), 0.1)
    np.testing.assert_allclose(state.qpos[0], POSE, rtol=1e-9)
    np.testing.assert_allclose(state.qvel[0], VELOCITY, rtol=1e-9)
    glide = push_twin("nominal", (1.0, 0.0, 6.0), (0.0, WEIGHT, 0.0), 1000)
    np.testing.assert_allclose(glide[-1, 1], [1.0, 0.0, 6.0], atol=1e-12)
    assert load_twin().effects == {}


def test_effects_of_a_file_replace_those_of_the_mjcf(tmp_path: Path) -> None:
    """What a twin says itself wins over its MJCF; the rest is the MJCF's. Without `losses` its friction is off."""
    (tmp_path / "own.xml").write_text(RIG.read_text())
    twin = tmp_path / "twin.yaml"
    twin.write_text(TWIN + "effects: {rail_x.coulomb: {force: 0.5}, servo.lag: {time_constant: 0.03}}\n")
    effects = load_twin(twin).effects
    assert (effects["rail_x.coulomb"], effects["rail_z.coulomb"]) == ({"force": 0.5}, {"force": 0.2})
    assert effects["servo.lag"] == {"time_constant": 0.03}
    twin.write_text(TWIN.replace("mjcf", "none"))
    assert load_twin(twin).effects == {}


def test_an_mjcf_without_losses_gives_no_effects() -> None:
    """The free craft has none to read."""
    assert read_losses(models_dir() / "vpp_planar.xml", ("rail_x", "rail_z", "pitch"), "craft") == {}


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        pytest.param('damping="0.0005"', 'damping="0.0005 0.1 0"', "damping of joint pitch", id="polynomial"),
        pytest.param('fluidcoef="0 0 0 0 0"', "", "air that does more", id="drag on the rig"),
        pytest.param('class="still" type="box" pos="0 0.12 0" size="0.05', 'class="visual" type="box" size="0.05',
                     "air that does more", id="boxes of air"),
        pytest.param("530.516 0 0", "530.516 0 1", "air that does more", id="angular drag"),
        pytest.param('density="1.2"', 'density="1.2" viscosity="1e-5"', "air that does more", id="viscosity"),
    ],
)  # fmt: skip
def test_losses_without_an_effect_are_refused(tmp_path: Path, old: str, new: str, found: str) -> None:
    """What no effect of ours stands for is named in one line; without `losses` it is left out."""
    text = RIG.read_text()
    assert old in text
    (tmp_path / "own.xml").write_text(text.replace(old, new))
    twin = tmp_path / "twin.yaml"
    twin.write_text(TWIN)
    with pytest.raises(InputError, match=found) as error:
        load_twin(twin)
    assert "\n" not in str(error.value)
    twin.write_text(TWIN.replace("mjcf", "none"))
    assert load_twin(twin).effects == {}


def test_losses_of_other_rigs_need_no_word(tmp_path: Path) -> None:
    """Their MJCF's friction acts as it is, and `losses` is refused."""
    twin = tmp_path / "twin.yaml"
    twin.write_text("model: rail_rig.xml\nlosses: mjcf\nsignals: {joints: {rail_x: /a, rail_z: /a, pitch: /a}}\n")
    with pytest.raises(InputError, match="losses without vehicle"):
        load_twin(twin)
