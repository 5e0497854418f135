"""Friction on rigs that are not ours: it answers to whatever their actuators exert, as the engine will compute it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vpptwin.effects import Stage
from vpptwin.twin import Twin, load_twin

LIFT = """<mujoco><option {option}/><worldbody>
<body gravcomp="{gravcomp}"><joint name="lift" type="slide" axis="0 0 1" {joint}/><geom size="0.05" mass="1"/>
<body pos="0.3 0 0"><joint name="arm" type="hinge" axis="0 1 0"/>
<inertial pos="0.05 0 0" mass="0.2" diaginertia="2e-3 2e-3 2e-3"/></body></body></worldbody>
<tendon><fixed name="cable"><joint joint="lift" coef="1"/></fixed></tendon>
<actuator>{actuator}</actuator></mujoco>"""
TWIN = "model: lift.xml\nsignals: {joints: {lift: /joint_states, arm: /joint_states}}\n"
WEIGHT = 1.2 * 9.81
"""Of lift and arm [N]; all of it hangs on the lift."""
SPARE = 1.6
"""What the actuators leave to the friction of 2 N [N]."""
PLAIN = {"option": "", "gravcomp": "0", "joint": "", "actuator": '<motor joint="lift"/>'}
SERVO = '<position joint="lift" kp="100" kv="5"/>'
AFFINE = '<general joint="lift" gaintype="affine" gainprm="1 0.5 0.2" biastype="affine" biasprm="3 -2 -1" gear="2"/>'
RIGS: dict[str, tuple[dict[str, str], float]] = {
    "motor": ({}, WEIGHT - SPARE),
    "position servo": ({"actuator": SERVO}, (WEIGHT - SPARE) / 100),
    "affine gain and bias, geared": ({"actuator": AFFINE}, (WEIGHT - SPARE) / 2 - 3),
    "force range": ({"actuator": f'<motor joint="lift" forcerange="-1 {WEIGHT - SPARE}"/>'}, 50.0),
    "control range": ({"actuator": f'<motor joint="lift" ctrlrange="-1 {WEIGHT - SPARE}"/>'}, 50.0),
    "force range of the joint": ({"joint": f'actuatorfrcrange="-1 {WEIGHT - SPARE}"'}, 50.0),
    "gravity compensated": ({"gravcomp": "1"}, 0.2 * 9.81 - SPARE),
    "gravity compensated by actuators": ({"gravcomp": "1", "joint": 'actuatorgravcomp="true"'}, 0.2 * 9.81 - SPARE),
    "over a tendon": ({"actuator": '<motor tendon="cable"/>'}, WEIGHT - SPARE),
    "damper in the actuator": ({"actuator": '<motor joint="lift" damping="2"/>'}, WEIGHT - SPARE),
    "implicitfast": ({"option": 'integrator="implicitfast"', "actuator": SERVO}, (WEIGHT - SPARE) / 100),
    "implicit": ({"option": 'integrator="implicit"', "actuator": SERVO}, (WEIGHT - SPARE) / 100),
    "spring and damper": ({"joint": 'stiffness="20" springref="0.05" damping="3"'}, WEIGHT - 1.0 - SPARE),
    "friction in the MJCF": ({"joint": 'frictionloss="1.9"'}, WEIGHT - 3.0),
}
"""What differs from a plain motor, and the control that leaves SPARE to friction."""


def load_lift(folder: Path, changes: dict[str, str]) -> Twin:
    """A lift with an arm, dry friction in both: 2 N and 0.12 N m, of which the arm's weight takes 0.098."""
    (folder / "lift.xml").write_text(LIFT.format(**(PLAIN | changes)))
    (folder / "twin.yaml").write_text(TWIN)
    twin = Twin(load_twin(folder / "twin.yaml"), 1, active=["lift.coulomb", "arm.coulomb"], num_threads=1)
    twin.set_parameter("lift.coulomb", "force", 2.0)
    twin.set_parameter("arm.coulomb", "torque", 0.12)
    return twin


@pytest.mark.parametrize("rig", RIGS)
def test_a_lift_stands_still(tmp_path: Path, rig: str) -> None:
    """Held by its actuator and, for the last 1.6 N, by friction, a lift stays where it is; on 1 N more it moves."""
    changes, control = RIGS[rig]
    twin = load_lift(tmp_path, changes)
    # 1e-15 and less: rounding, as on our own rails; the engine's own integrators and clamps are foreseen exactly.
    _, qpos, qvel, _ = twin.replay_commands(twin.initial_state(), np.full((1, 3000, 1), control))
    assert np.abs(qpos).max() < 1e-12
    assert np.abs(qvel).max() < 1e-12
    moved = load_lift(tmp_path, changes)
    moved.set_parameter("lift.coulomb", "force", 1.0 if "MJCF" not in rig else 0.0)
    qpos = moved.replay_commands(moved.initial_state(), np.full((1, 1000, 1), control)).qpos
    assert qpos[0, -1, 0] < -0.004  # m in a second, where a servo pulls back; most fall by 0.2 m


def test_an_encoder_that_reads_too_much_shifts_its_readings_and_nothing_else(tmp_path: Path) -> None:
    """0.3 rad on the arm, which hangs on a spring of the MJCF: the same fall, 0.3 rad further on."""
    sprung = LIFT.replace('name="arm" type="hinge"', 'name="arm" type="hinge" stiffness="0.2" springref="0.1"')
    (tmp_path / "lift.xml").write_text(sprung.format(**PLAIN))
    (tmp_path / "twin.yaml").write_text(TWIN)
    twin = Twin(load_twin(tmp_path / "twin.yaml"), 2, active=["arm.offset"], num_threads=1)
    twin.set_parameter("arm.offset", "angle", np.array([0.0, 0.3]))
    start = twin.initial_state(qpos=np.array([[0.0, 0.2], [0.0, 0.5]]))
    qpos = twin.replay_commands(start, np.full((2, 500, 1), WEIGHT)).qpos
    assert np.ptp(qpos[0, :, 1]) > 0.3
    np.testing.assert_allclose(qpos[1] - qpos[0], np.tile([0.0, 0.3], (len(qpos[0]), 1)), atol=1e-9)


def test_every_generic_effect_at_once(tmp_path: Path) -> None:
    """All effects of two joints and an unnamed actuator together: they are there, and they do no harm."""
    (tmp_path / "lift.xml").write_text(LIFT.format(**PLAIN))
    (tmp_path / "twin.yaml").write_text(TWIN)
    spec = load_twin(tmp_path / "twin.yaml")
    assert {effect.target for effect in spec.catalogue} == {"lift", "arm", ""}  # the motor has no name, the mount none
    assert {effect.stage for effect in spec.catalogue} == {*Stage} - {Stage.THRUST}
    twin, rng = Twin(spec, 5, active=[e.id for e in spec.catalogue], num_threads=1), np.random.default_rng(1)
    for effect in spec.catalogue:
        for p in effect.parameters:
            twin.set_parameter(effect.id, p.name, p.draw(rng, 5))
    state = twin.replay_commands(twin.initial_state(), np.full((5, 500, 1), WEIGHT)).state
    assert state.finite().all()
    assert np.unique(state.qpos[:, 0]).size == 5


@pytest.mark.parametrize("order", [("hinge", "slide"), ("slide", "hinge")])
def test_rigs_that_share_names_do_not_share_parameters(tmp_path: Path, order: tuple[str, str]) -> None:
    """A hinge `j` and a slide `j` share machine code; dry friction is a torque on one, a force on the other, on both.

    By hand: 0.5 N on 1 kg, or 0.5 N m on 1 kg m², take 0.05 off 0.2 in 0.1 s.
    """
    for kind in order:
        body = f'<joint name="j" type="{kind}"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        option = '<option gravity="0 0 0" timestep="0.001"/>'
        (tmp_path / f"{kind}.xml").write_text(f"<mujoco>{option}<worldbody><body>{body}</body></worldbody></mujoco>")
        path = tmp_path / f"{kind}.yaml"
        path.write_text(f"model: {kind}.xml\nsignals: {{joints: {{j: /joint_states}}}}\n")
        twin = Twin(load_twin(path), 1, active=["j.coulomb"], num_threads=1)
        twin.set_parameter("j.coulomb", "torque" if kind == "hinge" else "force", 0.5)
        state = twin.initial_state()
        state.qvel[:] = 0.2
        qvel = twin.replay_commands(state, np.empty((1, 100, 0))).qvel
        assert qvel[0, -1, 0] == pytest.approx(0.15, abs=1e-3)
