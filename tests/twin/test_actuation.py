"""Actuators that are more than a force do in a twin what they do in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Flight, Stream
from vpptwin.twin import Twin, TwinSpec, load_twin
from vpptwin.twin.robot.actuation import integrate_input
from vpptwin.twin.robot.model import compile_model

ARM = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body><joint name="swing" axis="0 1 0"/>
<geom size="0.05" pos="0 0 -0.3" mass="1"/></body></worldbody><actuator>{}</actuator></mujoco>"""
INTEGRATED = '<intvelocity name="m" joint="swing" kp="5" kv="1" gear="2" actrange="-0.2 0.1" ctrlrange="-2 2"/>'
TWIN = "model: arm.xml\nsignals: {joints: {swing: /joint_states}, actuators: {m: /motors}}\n"


def write_arm(folder: Path, actuator: str) -> tuple[TwinSpec, mujoco.MjModel]:
    """The twin of an arm, and what MuJoCo alone makes of its MJCF."""
    (folder / "arm.xml").write_text(ARM.format(actuator))
    (folder / "twin.yaml").write_text(TWIN)
    return load_twin(folder / "twin.yaml"), mujoco.MjModel.from_xml_path(str(folder / "arm.xml"))


def draw_inputs(steps: int, size: float) -> np.ndarray:
    """Inputs held for 50 steps each, (steps,)."""
    return np.repeat(np.random.default_rng(1).uniform(-size, size, steps // 50), 50)


@pytest.mark.parametrize(
    ("actuator", "switched_on"),
    [
        ('<position name="m" joint="swing" kp="5" kv="0.3" timeconst="0.03"/>', {"m.lag": {"time_constant": 0.03}}),
        ('<general name="m" joint="swing" dyntype="filter" dynprm="0.05"/>', {"m.lag": {"time_constant": 0.05}}),
        ('<motor name="m" joint="swing" delay="0.01" nsample="20"/>', {"m.delay": {"delay": 0.01}}),
        ('<motor name="m" joint="swing"/>', {}),
    ],
)
def test_lags_and_delays_are_effects(tmp_path: Path, actuator: str, switched_on: dict) -> None:
    """Switched on with the MJCF's numbers, unless the twin says otherwise."""
    assert write_arm(tmp_path, actuator)[0].effects == switched_on
    for name, values in switched_on.items():
        other = {key: 0.5 * value for key, value in values.items()}
        (tmp_path / "twin.yaml").write_text(f"{TWIN}effects: {{{name}: {other}}}\n".replace("'", ""))
        assert load_twin(tmp_path / "twin.yaml").effects == {name: other}


def test_a_lagging_servo_moves_as_in_mujoco(tmp_path: Path) -> None:
    """A second under steps of its target: within what half a step of the lag makes."""
    spec, model = write_arm(tmp_path, '<position name="m" joint="swing" kp="5" kv="0.3" timeconst="0.03"/>')
    inputs, data = draw_inputs(1000, 1.0), mujoco.MjData(model)
    moved = []
    for target in inputs:
        data.ctrl[:] = target
        mujoco.mj_step(model, data)
        moved.append(data.qpos[0])
    twin = Twin(spec, 1)
    found = twin.replay_commands(twin.initial_state(), inputs[None, :, None]).qpos[0, :, 0]
    assert np.ptp(moved) > 0.3
    np.testing.assert_allclose(found, moved, atol=5e-3)


def test_a_dc_motor_is_a_gain_and_a_damping(tmp_path: Path) -> None:
    """Its force equals MuJoCo's at any voltage and speed."""
    spec, model = write_arm(tmp_path, '<dcmotor name="m" joint="swing" motorconst="0.05" resistance="2" gear="30"/>')
    for volts, speed in ((6.0, 0.0), (-4.0, 3.0), (0.0, -2.0)):
        forces = []
        for each in (model, spec.model):
            data = mujoco.MjData(each)
            data.ctrl[:], data.qvel[:] = volts, speed
            mujoco.mj_forward(each, data)
            forces.append(data.qfrc_actuator[0])
        assert forces[1] == pytest.approx(forces[0], rel=1e-12)


def test_speeds_are_integrated_as_mujoco_integrates_them(tmp_path: Path) -> None:
    """Within both limits; the log's inputs become targets that begin where the joint was."""
    spec, model = write_arm(tmp_path, INTEGRATED)
    inputs, data, acts = draw_inputs(2000, 4.0), mujoco.MjData(model), [0.0]
    for speed in inputs:
        data.ctrl[:] = speed
        mujoco.mj_step(model, data)
        acts.append(data.act[0])
    assert (min(acts), max(acts)) == (-0.2, 0.1)
    time = 0.001 * np.arange(2000)
    means = 0.5 * (np.array(acts[1:]) + acts[:-1])
    found = integrate_input(spec.model.actuator_dynprm[0], time, inputs, 0.0)
    np.testing.assert_allclose(found[:-1], means[:-1], atol=1e-12)
    joints = {"/joint_states": {"swing": Stream(time, {"position": np.full(2000, 0.04)})},
              "/motors": {"m": Stream(time, {"effort": np.zeros(2000)})}}  # fmt: skip
    flight = Flight(Path("log.mcap"), 0, {}, joints)
    np.testing.assert_allclose(read_measurements(spec, flight).command.value, 0.08)
    assert not compile_model(tmp_path / "arm.xml").actuator_ctrllimited.any()
