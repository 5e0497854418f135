"""A helicopter on a fork, which rotors at sites turn about two joints: what is wrong with both of them at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.effects import find_effect
from vpptwin.logs.read import read_flight
from vpptwin.system.doubt import take_as_is
from vpptwin.twin import Twin, TwinSpec, load_twin

XML = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="fork"><joint name="yaw" axis="0 0 1" damping="0.012"/>
<inertial pos="0 0 -0.1" mass="0.8" diaginertia="0.002 0.002 0.003"/>
<body name="beam"><joint name="pitch" axis="0 1 0" damping="0.007"/>
<inertial pos="0 0 -0.007" mass="1.15" diaginertia="0.002 0.0215 0.022"/>
<site name="front" pos="0.16 0 0"/><site name="rear" pos="-0.16 0 0"/></body></body></worldbody><actuator>
<general name="lift" site="front" gear="0 0 1 0 0 0.06" gainprm="0.007" dyntype="filterexact" dynprm="0.06"/>
<general name="tail" site="rear" gear="0 1 0 0 -0.05 0" gainprm="0.007" dyntype="filterexact" dynprm="0.06"/>
</actuator></mujoco>"""
TWIN = """model: heli.xml
signals:
  joints: {yaw: {topic: log, position: yaw}, pitch: {topic: log, position: pitch}}
  actuators: {lift: {topic: log, effort: lift}, tail: {topic: log, effort: tail}}
"""
STEP, SAMPLE = 0.002, 0.01


def load(folder: Path, signals: str = TWIN) -> TwinSpec:
    """The nominal twin."""
    (folder / "heli.xml").write_text(XML)
    (folder / "twin.yaml").write_text(signals)
    return load_twin(folder / "twin.yaml")


def slope(state: np.ndarray, given: np.ndarray, gain: float) -> np.ndarray:
    """Rates of (pitch, yaw, their rates, volts behind the lag of two rotors), (N, 6), in closed form."""
    angle, _, turn, spin, first, second = state.T
    sin, cos = np.sin(angle), np.cos(angle)
    lift, tail = 0.007 * gain * first, 0.007 * gain * second
    across, along, up = 0.002 + 1.15 * 0.007**2, 0.0215 + 1.15 * 0.007**2, 0.022
    change = 2.0 * (across - up) * sin * cos
    yaw = cos * (0.06 * lift - 0.16 * tail) - 0.012 * spin - change * turn * spin
    pitch = -0.16 * lift - 0.05 * tail - 0.007 * turn - 1.15 * 9.81 * 0.007 * sin + 0.5 * change * spin**2
    about = 0.003 + across * sin**2 + up * cos**2
    return np.stack([turn, spin, pitch / along, yaw / about, *((given - state[:, 4:]).T / 0.06)], axis=1)


def fly(folder: Path, gain: float = 1.0, late: float = 0.0, flights: int = 3, seconds: float = 22.0) -> list[Path]:
    """Logs at 100 Hz of a helicopter whose rotors have a gain and act late [s], by Runge and Kutta, with draughts."""
    rng, steps, held = np.random.default_rng(5), round(seconds / STEP), round(SAMPLE / STEP)
    time = STEP * np.arange(0, steps, held)
    rate, phase = rng.uniform(0.05, 1.5, (flights, 2, 6, 1)), rng.uniform(0.0, 6.28, (flights, 2, 6, 1))
    asked = np.round((4.0 * np.sin(6.28 * rate * time + phase)).sum(axis=2), 2)
    state, gust, rows = np.zeros((flights, 6)), np.zeros((flights, 2)), []
    for k in range(steps):
        rows.append(state)
        gust += -gust * STEP / 0.3 + 0.06 * np.sqrt(2.0 * STEP / 0.3) * rng.standard_normal(gust.shape)
        then = (k - round(late / STEP)) // held
        given = gust + (asked[:, :, then] if then >= 0 else 0.0)
        one = slope(state, given, gain)
        two = slope(state + 0.5 * STEP * one, given, gain)
        three = slope(state + 0.5 * STEP * two, given, gain)
        state = state + STEP / 6.0 * (one + 2.0 * two + 2.0 * three + slope(state + STEP * three, given, gain))
    angles = np.stack(rows)[::held, :, :2]
    angles = np.round(angles / 0.0018) * 0.0018
    logs = [folder / f"log{i}.csv" for i in range(flights)]
    for i, log in enumerate(logs):
        table = np.column_stack([time, angles[:, i], asked[i].T])
        np.savetxt(log, table, delimiter=",", header="t,pitch,yaw,lift,tail", comments="", fmt="%.7g")
    return logs


def test_what_rotors_have_in_common_is_suspected(tmp_path: Path) -> None:
    """Besides what each has: of both, tolerated no more than that, hard to tell from a mass; of one there is none."""
    spec = load(tmp_path)
    known = {effect.id: effect for effect in spec.catalogue}
    for kind in ("gain", "delay", "lag"):
        common = known[f"actuators.{kind}"]
        assert common.members == ("lift", "tail")
        assert [p.tolerance for p in common.parameters] == [0.0]
        assert {f"lift.{kind}", f"tail.{kind}"} <= set(known)
    assert "actuators.gain" in known["beam.mass"].look_alikes
    assert known["actuators.delay"].look_alikes == ("actuators.lag",)
    assert not [name for name in known if name in ("yaw.load", "pitch.load")]  # rotors have no gears
    alone = load(tmp_path, TWIN.replace(", tail: {topic: log, effort: tail}", ""))
    assert not [effect.id for effect in alone.catalogue if effect.id.startswith("actuators.")]


@pytest.mark.slow
def test_both_act_alike_and_beside_their_own(tmp_path: Path) -> None:
    """Gains multiply, delays add up, beyond what one alone may have."""
    spec = load(tmp_path)
    twin = Twin(spec, 2, active=["actuators.gain", "actuators.delay", "tail.gain", "tail.delay"], num_threads=1)
    twin.set_parameter("actuators.gain", "gain", np.array([1.0, 0.5]))
    twin.set_parameter("tail.gain", "gain", np.array([1.0, 0.8]))
    np.testing.assert_allclose(twin.constant("actuator.gain"), [[1.0, 1.0], [0.5, 0.4]])
    most = find_effect(spec.catalogue, "tail.delay").parameters[0].high
    for name in ("actuators.delay", "tail.delay"):
        twin.set_parameter(name, "delay", np.array([0.0, most]))
    np.testing.assert_allclose(twin.constant("actuator.delay"), [[0.0, 0.0], [most, 2.0 * most]])
    only = np.zeros((2, 200, 2))
    only[:, :, 1] = 10.0
    yaw = twin.replay_commands(twin.initial_state(), only).qpos[..., 0]
    first = (np.abs(yaw) > 0.0).argmax(axis=1)
    assert first[1] - first[0] == round(2.0 * most / STEP)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "named"),
    [
        ({"gain": 0.92}, "actuators.gain"), ({"gain": -1.0}, "actuators.gain"), ({"late": 0.04}, "actuators.delay"),
        ({}, ""),
    ],
)  # fmt: skip
def test_what_is_wrong_with_both_rotors_is_named(tmp_path: Path, hidden: dict[str, float], named: str) -> None:
    """Neither a mass with dampings, nor readings that are late; and nothing where nothing is hidden."""
    spec = load(tmp_path)
    logs = fly(tmp_path, **hidden)
    flights = [read_flight(log, signals=spec.robot.signals.entries) for log in logs]
    with take_as_is():  # commands of the other sign are refused otherwise
        causes = diagnose(spec, flights).verdict.causes
    assert [cause.effect for cause in causes] == [named] * bool(named)
    for cause, size in zip(causes, hidden.values()):
        (found,) = cause.parameters.values()
        assert cause.confidence > 0.9
        assert found.value == pytest.approx(size, abs=3.0 * found.std)
        assert found.std < 0.05 * abs(size)
