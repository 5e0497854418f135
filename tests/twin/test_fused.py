"""Steps without MuJoCo in the loop against the same in MuJoCo's steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from proving import servo_arm
from tests.effects.rigs import Rig
from tests.twin.hover import assert_states, share_kernel
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.stepping.layout import agrees, read_layout

ROWS, STEPS = 6, 200
ROUNDING = 1e-11
"""Share of the largest value. 200 steps of 1e-16 each, which friction that stops a joint within a step (1/dt) and the
poles of what hangs upside down amplify by some 1e3."""


def draw_twin(rig: Rig, rng: np.random.Generator) -> Twin:
    """A twin with every effect on but those of contacts, at values drawn from the priors, half of them at off."""
    effects = [effect for effect in rig.spec.catalogue if not effect.touching]
    with share_kernel():
        twin = Twin(rig.spec, ROWS, active=[effect.id for effect in effects], num_threads=2)
    for effect in effects:
        for p in effect.parameters:
            twin.set_parameter(effect.id, p.name, np.where(rng.random(ROWS) < 0.5, p.off, p.draw(rng, ROWS)))
    return twin


@pytest.mark.parametrize("integrator", ["implicitfast", pytest.param("Euler", marks=pytest.mark.slow)])
def test_servos_equal_mujoco(tmp_path: Path, integrator: str) -> None:
    """An arm with position servos, their damping, limits of their force and a payload that differ by simulation."""
    file = servo_arm.write_twin(tmp_path)
    mjcf = tmp_path / "servo_arm.xml"
    text = mjcf.read_text()
    assert "implicitfast" in text
    mjcf.write_text(text.replace("implicitfast", integrator))
    spec, rng = load_twin(str(file)), np.random.default_rng(5)
    assert spec.model.actuator_biasprm[:, 2].all()
    active = {"forearm.payload": ("mass", 0.0, 0.2), "shoulder_servo.force_limit": ("limit", 0.1, 1.0)}
    twin = Twin(spec, ROWS, active=active, num_threads=2)
    for effect, (name, low, high) in active.items():
        twin.set_parameter(effect, name, rng.uniform(low, high, ROWS))
    start = twin.initial_state(qvel=rng.normal(size=(ROWS, 2)))
    commands = np.repeat(rng.uniform(-1.5, 1.5, (ROWS, STEPS // 10, 2)), 10, axis=1)
    found = twin.replay_commands(start, commands)
    assert twin._stepper is not None
    twin._stepper = None
    expected = twin.replay_commands(start, commands)
    np.testing.assert_allclose(found.qpos, expected.qpos, rtol=0, atol=ROUNDING)
    assert not np.array_equal(found.qpos, expected.qpos)


@pytest.mark.parametrize("name", ["replayed", "cart"])
def test_equals_mujoco(rigs: dict[str, Rig], name: str) -> None:
    """Equal but for rounding where nothing touches; where something does, MuJoCo's to the last bit."""
    rng, rig = np.random.default_rng(3), rigs[name]
    twin, nu, nv = draw_twin(rig, rng), rig.spec.model.nu, rig.spec.model.nv
    start = rig.start(twin, 3)
    if name == "replayed":
        start.qpos[0, 1], start.qvel[0, 1] = 0.3, -3.0  # to the floor
        start.qpos[1, 0], start.qvel[1, 0] = 1.45, 3.0  # to the end of the rail
        inputs = {"rotor_speed": rng.uniform(420, 520, (ROWS, STEPS, 2)), "throttle": np.full((ROWS, STEPS, 2), 0.5)}
    else:
        inputs = {}
    commands = np.repeat(rng.uniform(-0.05, 0.18, (ROWS, STEPS // 10, nu)), 10, axis=1)
    push = 0.1 * rng.normal(size=(ROWS, 7, nv))
    assert twin._stepper is not None
    found = twin.replay_commands(start, commands, disturbance=push, **inputs)
    twin._stepper = None
    expected = twin.replay_commands(start, commands, disturbance=push, **inputs)
    assert_states(found.state, expected.state, ROUNDING)
    np.testing.assert_allclose(found.qpos, expected.qpos, rtol=0, atol=ROUNDING)
    if name == "replayed":
        np.testing.assert_array_equal(found.qpos[:2], expected.qpos[:2])
        assert (expected.qpos[0, :, 1] < 0.215).any() or (expected.state.memory[0, 2:] != 0.0).any()
        assert not np.array_equal(found.qpos[2:], expected.qpos[2:])  # those were not stepped by MuJoCo


def test_policies_fly_as_in_mujoco(rigs: dict[str, Rig]) -> None:
    """Calls of ten steps, a policy's command each, every effect drawn; a craft that lands is MuJoCo's from then on."""
    rng, rig = np.random.default_rng(4), rigs["replayed"]
    twin = draw_twin(rig, rng)
    found = twin.initial_state(rng.uniform([-0.5, 0.8, -3.0], [0.5, 1.5, 3.0], (ROWS, 3)))
    found.qpos[0, 1], found.qvel[0, 1] = 0.3, -3.0
    twin._many = True
    expected, stepper = found.copy(), twin._stepper
    assert stepper is not None
    for _ in range(STEPS // 10):
        command = rng.uniform([0.0, -6.0], [5.0, 6.0], (ROWS, 2))
        twin._stepper = stepper
        twin.advance_policy(found, command)
        twin._stepper = None
        twin.advance_policy(expected, command)
    assert_states(found, expected, ROUNDING)
    assert (expected.memory[0, 2:] != 0.0).any()
    np.testing.assert_array_equal(found.qpos[0], expected.qpos[0])
    assert not np.array_equal(found.warmstart[1:], expected.warmstart[1:])  # those were not stepped by MuJoCo


def grow_tree(rng: np.random.Generator) -> str:
    """An MJCF of four to seven bodies, each on one of those before, with hinges, slides, springs and motors."""

    def numbers(size: int, scale: float = 0.3) -> str:
        return " ".join(f"{x:.4f}" for x in rng.normal(size=size) * scale)

    count = int(rng.integers(4, 8))
    children: dict[int, list[int]] = {i: [] for i in range(-1, count)}
    for i in range(count):
        children[int(rng.integers(-1, i))].append(i)

    def write(i: int) -> str:
        kinds = rng.choice(["hinge", "slide"], size=rng.integers(1, 3) if i % 3 else 1)
        joints = "".join(
            f'<joint name="j{i}{k}" type="{kind}" axis="{numbers(3, 1.0)}" pos="{numbers(3)}" '
            f'damping="{rng.uniform():.3f}" armature="{rng.uniform(0, 0.1):.3f}" stiffness="{rng.uniform():.3f}" '
            f'springref="{rng.normal():.3f}" ref="{0.2 * rng.normal():.3f}"/>'
            for k, kind in enumerate(kinds)
        )
        inertial = f'<inertial pos="{numbers(3)}" quat="{numbers(4, 1.0)}" mass="{rng.uniform(0.1, 2):.3f}" '
        inertial += 'diaginertia="0.02 0.03 0.04"/>'
        below = "".join(write(child) for child in children[i])
        site = f'<site name="s{i}" pos="{numbers(3)}" quat="{numbers(4, 1.0)}"/>'
        return f'<body pos="{numbers(3)}" quat="{numbers(4, 1.0)}">{joints}{inertial}{site}{below}</body>'

    bodies = "".join(write(i) for i in children[-1])
    motors = f'<motor joint="j00" gear="3"/><position joint="j00" kp="4"/><motor site="s1" gear="{numbers(6, 1.0)}"/>'
    option = f'<option gravity="{numbers(3, 9.0)}" integrator="Euler"/>'
    return f"<mujoco>{option}<worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"


@pytest.mark.parametrize("seed", range(8))
def test_trees_weigh_what_mujoco_says(seed: int) -> None:
    """Inertia, bias, moments of actuators, springs and damping of random trees; a wrong mass is found out."""
    model = mujoco.MjModel.from_xml_string(grow_tree(np.random.default_rng(seed)))
    layout = read_layout(model, set())
    assert layout is not None
    wrong = layout.numbers | {"body_mass": layout.numbers["body_mass"] * (1.0 + 1e-6)}
    assert not agrees(replace(layout, numbers=wrong), model)


PLAIN = {
    "option": '<option gravity="0 0 -9.81"/>', "joint": '<joint name="turn" axis="0 1 0"/>', "body": "",
    "geom": '<geom size="0.1" mass="1" contype="0" conaffinity="0"/>', "more": "",
    "actuator": '<motor joint="turn"/>',
}  # fmt: skip
OTHER = {
    "air": {"option": '<option density="1.2"/>'},
    "implicit": {"option": '<option integrator="implicit"/>'},
    "undamped Euler": {"option": '<option><flag eulerdamp="disable"/></option>'},
    "ball": {"joint": '<joint name="turn" type="ball"/>'},
    "gravity compensated": {"body": 'gravcomp="0.5"'},
    "tendon": {"more": '<tendon><fixed><joint joint="turn" coef="1"/></fixed></tendon>'},
    "equality": {"more": '<equality><joint joint1="turn"/></equality>'},
}


@pytest.mark.parametrize("name", ["plain", *OTHER])
def test_what_only_mujoco_steps(name: str) -> None:
    """A model with anything that the tree has not is left to MuJoCo."""
    part = PLAIN | OTHER.get(name, {})
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco>{part['option']}<worldbody><geom type='plane' size='1 1 1' pos='0 0 -0.5'/>"
        f"<body {part['body']}>{part['joint']}{part['geom']}</body></worldbody>"
        f"{part['more']}<actuator>{part['actuator']}</actuator></mujoco>"
    )
    layout = read_layout(model, set())
    assert (layout is not None) == (name == "plain")
    if name == "plain":
        assert read_layout(model, {"body_quat"}) is None  # an effect that the fused step knows nothing of
