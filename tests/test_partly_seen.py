"""Joints that a log does not show as it shows others: by their velocity alone, or late, through a camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.builders import load_rig
from vpptwin.cli.main import main
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.system.doubt import take_as_is
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.model import is_indifferent

WHEEL = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="pivot" axis="0 1 0" damping="0.001"/>
<inertial pos="0 0 -0.12" mass="0.25" diaginertia="0.0012 0.0012 0.00005"/>
<body pos="0 0 -0.2"><joint name="wheel" axis="0 1 0" damping="0.00005"/>
<inertial pos="0 0 0" mass="0.15" diaginertia="0.0001 0.0002 0.0001"/></body></body></worldbody>
<actuator><motor name="motor" joint="wheel"/></actuator></mujoco>"""
"""A pendulum that a reaction wheel at its end swings."""
BEAM = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="beam" axis="0 1 0" damping="0.05"/>
<geom type="box" size="0.25 0.02 0.005" mass="0.3" contype="0" conaffinity="0"/>
<body pos="0 0 0.025"><joint name="ball" type="slide" axis="1 0 0" armature="0.0256"/>
<geom size="0.02" mass="0.064" contype="0" conaffinity="0"/></body></body></worldbody>
<actuator><position name="servo" joint="beam" kp="8" kv="0.4"/></actuator></mujoco>"""
"""A ball that rolls on a beam; what turns as it rolls is its armature."""
OF_WHEEL = "joints: {pivot: {topic: log, position: pivot}, wheel: {topic: log, velocity: wheel_speed}}"
OF_BEAM = "joints: {beam: {topic: log, position: beam}, ball: {topic: log, position: {path: ball_cm, unit: cm}}}"
GRAVITY, STEP = 9.81, 0.001

Slope = Callable[[np.ndarray, float], np.ndarray]


def simulate(slope: Slope, control: Callable[[float, np.ndarray], float], seconds: float, hold: int) -> np.ndarray:
    """States (n, 4) every 1 ms, and the control held over `hold` of them beside: (n, 5), by Runge and Kutta."""
    state, rows, given = np.zeros(4), [], 0.0
    for k in range(round(seconds / STEP)):
        given = control(k * STEP, state) if k % hold == 0 else given
        rows.append([*state, given])
        one = slope(state, given)
        two = slope(state + 0.5 * STEP * one, given)
        three = slope(state + 0.5 * STEP * two, given)
        state = state + STEP / 6.0 * (one + 2.0 * two + 2.0 * three + slope(state + STEP * three, given))
    return np.array(rows)


def swing_wheel(seconds: float, seed: int, gain: float = 1.0, dry: float = 0.0) -> dict[str, np.ndarray]:
    """The pendulum's log at 100 Hz: its encoder, the wheel's tachometer, the torque that was asked for."""
    lever, total, inertia = 0.25 * 0.12 + 0.15 * 0.2, 0.25 * 0.12**2 + 0.0012 + 0.15 * 0.2**2, 0.0002
    rng = np.random.default_rng(seed)
    phase, rate = rng.uniform(0.0, 6.28, 6), rng.uniform(0.2, 2.0, 6)

    def slope(state: np.ndarray, given: float) -> np.ndarray:
        angle, turn, _, spin = state
        torque = gain * given - 5e-5 * spin - dry * np.tanh(spin / 0.3)
        faster = (-lever * GRAVITY * np.sin(angle) - 0.001 * turn - torque) / total
        return np.array([turn, faster, spin, torque / inertia - faster])

    rows = simulate(slope, lambda t, _: 0.03 * float(np.sin(6.28 * rate * t + phase).sum()), seconds, 10)[::10]
    noise = rng.standard_normal((2, len(rows)))
    return {
        "t": 0.01 * np.arange(len(rows)), "pivot": rows[:, 0] + 4e-4 * noise[0],
        "wheel_speed": rows[:, 3] + 0.3 * noise[1], "torque": rows[:, 4],
    }  # fmt: skip


def roll_ball(seconds: float, seed: int, late: float, push: float = 0.0) -> dict[str, np.ndarray]:
    """The beam's log at 50 Hz: its encoder, a ball seen so late [s] on a beam pushed so hard [N m], the target."""
    rng = np.random.default_rng(seed)
    goals = rng.uniform(-0.15, 0.15, 100)
    own, height = 0.3 * (0.5**2 + 0.01**2) / 12.0 + 0.4 * 0.064 * 0.02**2, 0.025

    def slope(state: np.ndarray, given: float) -> np.ndarray:
        place, angle, speed, turn = state
        torque = 8.0 * (given - angle) - 0.45 * turn + push
        mass = np.array([[0.064 + 0.0256, 0.064 * height], [0.064 * height, own + 0.064 * (place**2 + height**2)]])
        force = 0.064 * np.array([
            place * turn**2 + GRAVITY * np.sin(angle),
            torque / 0.064 - 2.0 * place * speed * turn + GRAVITY * (place * np.cos(angle) + height * np.sin(angle)),
        ])  # fmt: skip
        return np.array([speed, turn, *np.linalg.solve(mass, force)])

    def steer(time: float, state: np.ndarray) -> float:
        return float(np.clip(-1.2 * (state[0] - goals[int(time / 4.0)]) - 0.9 * state[2], -0.3, 0.3))

    rows = simulate(slope, steer, seconds, 20)
    seen = np.arange(0, len(rows), 20)
    ball = rows[np.maximum(seen - round(late / STEP), 0), 0] + 5e-4 * rng.standard_normal(len(seen))
    angle = np.round(rows[seen, 1] / 0.0015) * 0.0015
    return {"t": STEP * seen, "beam": angle, "ball_cm": 100.0 * ball, "target": rows[seen, 4]}


def write(folder: Path, name: str, columns: Mapping[str, np.ndarray]) -> Path:
    """A CSV."""
    folder.mkdir(exist_ok=True)
    head, table = ",".join(columns), np.stack(list(columns.values()), axis=1)
    np.savetxt(folder / name, table, delimiter=",", header=head, comments="", fmt="%.7g")
    return folder / name


@pytest.mark.slow
def test_a_wheel_is_where_its_velocity_leads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its position is the integral, gaps left out, worth what a bias would make of it; it is told, and drawn."""
    monkeypatch.chdir(tmp_path)
    columns = swing_wheel(6.0, 1)
    columns["wheel_speed"][200:203] = np.nan
    spec = load_rig(WHEEL, f"{{{OF_WHEEL}, actuators: {{motor: {{topic: log, effort: torque}}}}}}")
    log = write(tmp_path, "log.csv", columns)
    measured = read_measurements(spec, read_flight(log, signals=spec.robot.signals.entries))
    turned, speed = measured.positions[1], measured.velocities[1]
    known = np.isfinite(columns["wheel_speed"])
    led = np.interp(columns["t"], columns["t"][known], columns["wheel_speed"][known])
    led = np.cumsum(0.01 * led)
    assert np.abs(np.interp(columns["t"], turned.time, turned.value) - led).max() < 2.0
    assert turned.std == pytest.approx(speed.std)
    assert any("joint wheel: only its velocity is logged" in warning for warning in measured.warnings)
    assert main(["plot", "log.csv", "--twin", str(spec.model_file.with_name("rig.yaml")), "--out", "plot.svg"]) == 0
    assert "wheel position [rad]" in (tmp_path / "plot.svg").read_text()


def test_what_weight_pulls_has_to_be_seen() -> None:
    """A pendulum is no wheel, nor is what a spring pulls or an end stop keeps."""
    model = load_rig(WHEEL, f"{{{OF_WHEEL}}}").model
    assert [is_indifferent(model, joint) for joint in range(2)] == [False, True]
    for held in ('name="wheel" range="-9 9" limited="true"', 'name="wheel" stiffness="0.1"'):
        assert not is_indifferent(load_rig(WHEEL.replace('name="wheel"', held), f"{{{OF_WHEEL}}}").model, 1)


def test_an_actuator_may_be_logged_by_its_target(tmp_path: Path) -> None:
    """`position` alone is a servo's input; two columns without `effort` are refused."""
    log = write(tmp_path, "log.csv", roll_ball(8.0, 1, 0.0))
    inputs = []
    for named in ("effort: target", "position: target"):
        spec = load_rig(BEAM, f"{{{OF_BEAM}, actuators: {{servo: {{topic: log, {named}}}}}}}")
        inputs.append(read_measurements(spec, read_flight(log, signals=spec.robot.signals.entries)).command.value)
    assert np.array_equal(*inputs)
    spec = load_rig(BEAM, f"{{{OF_BEAM}, actuators: {{servo: {{topic: log, position: target, velocity: beam}}}}}}")
    with pytest.raises(InputError, match="has position and velocity of actuator 'servo'; expected `effort`"):
        read_measurements(spec, read_flight(log, signals=spec.robot.signals.entries))


def test_only_what_nothing_drives_may_be_seen_late() -> None:
    """A delay of what an actuator moves is the actuator's; of a joint on a topic of its own it is the topic's."""
    spec = load_rig(BEAM, f"{{{OF_BEAM}, actuators: {{servo: {{topic: log, effort: target}}}}}}")
    assert {e.id for e in spec.catalogue if "pose.delay" in e.writes} == {"ball.delay"}
    spec = load_rig(BEAM, "{joints: {beam: /joint_states, ball: /camera}, actuators: {servo: /joint_states}}")
    assert {e.id for e in spec.catalogue if "pose.delay" in e.writes} == {"camera.delay"}


@pytest.mark.slow
def test_a_late_camera_is_named(tmp_path: Path) -> None:
    """60 ms, beside a constant torque on the beam."""
    spec = load_rig(BEAM, f"{{{OF_BEAM}, actuators: {{servo: {{topic: log, effort: target}}}}}}")
    logs = [write(tmp_path / f"{i}", "log.csv", roll_ball(40.0, i, 0.06, 0.16)) for i in range(2)]
    flights = [read_flight(log, signals=spec.robot.signals.entries) for log in logs]
    found = {cause.effect: cause for cause in diagnose(spec, flights).verdict.causes}
    late = found["ball.delay"].parameters["delay"]
    assert late.std < 0.005
    assert late.value == pytest.approx(0.06, abs=3.0 * late.std)
    assert found["beam.bias"].parameters["force"].value == pytest.approx(0.16, rel=0.05)


@pytest.mark.slow
def test_a_weak_motor_is_told_from_a_wheel_that_rubs(tmp_path: Path) -> None:
    """Of a wheel of which nothing but its velocity is known."""
    spec = load_rig(WHEEL, f"{{{OF_WHEEL}, actuators: {{motor: {{topic: log, effort: torque}}}}}}")
    logs = [write(tmp_path / f"{i}", "log.csv", swing_wheel(25.0, i, 0.88, 0.004)) for i in range(3)]
    flights = [read_flight(log, signals=spec.robot.signals.entries) for log in logs]
    causes = diagnose(spec, flights).verdict.causes
    found = {cause.effect: next(iter(cause.parameters.values())).value for cause in causes}
    assert found == {"motor.gain": pytest.approx(0.88, rel=0.02), "wheel.coulomb": pytest.approx(0.004, rel=0.1)}
    assert all(cause.confidence > 0.9 for cause in causes)


@pytest.mark.slow
@pytest.mark.parametrize(("causes", "rubs"), [(["motor.gain"], 0.0), (None, 0.004)])
def test_a_log_of_the_other_sign_is_named(tmp_path: Path, causes: list[str] | None, rubs: float) -> None:
    """Torques logged against the joint's axis, taken as they are: a gain of -1, beside which the rest is told."""
    spec = load_rig(WHEEL, f"{{{OF_WHEEL}, actuators: {{motor: {{topic: log, effort: torque}}}}}}")
    logs = [write(tmp_path / f"{i}", "log.csv", swing_wheel(12.0, i, -1.0, rubs)) for i in range(2)]
    flights = [read_flight(log, signals=spec.robot.signals.entries) for log in logs]
    with take_as_is():
        found = {cause.effect: cause for cause in diagnose(spec, flights, causes=causes).verdict.causes}
    assert set(found) == {"motor.gain"} | ({"wheel.coulomb"} if rubs else set())
    assert found["motor.gain"].parameters["gain"].value == pytest.approx(-1.0, abs=0.03)
