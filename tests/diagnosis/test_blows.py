"""What blows tell of contacts: a hammer that an independent integrator swings against an anvil."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest

from vpptwin.diagnosis.judgement.blows import COMPLIANCE, LEAD, LENGTH, Findings, judge_blows, list_blows
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.measurements import read_measurements
from vpptwin.estimation.strikes import mark_strikes
from vpptwin.logs.flight import Flight
from vpptwin.logs.read import read_flight
from vpptwin.twin import TwinSpec, load_twin

ARM, RODS, HEAD, TIP, SOFTNESS, GRAVITY = 0.36, 0.05, 0.3, 0.4, 0.005, 9.81
INERTIA = RODS * ARM**2 / 3 + HEAD * TIP**2
WEIGHT = GRAVITY * (RODS * ARM / 2 + HEAD * TIP)
MASS, CENTRE = RODS + HEAD, WEIGHT / GRAVITY / (RODS + HEAD)
ABOUT = INERTIA - MASS * CENTRE**2
HAMMER = f"""<mujoco model="hammer"><option timestep="0.001" integrator="implicitfast"/>
<worldbody><geom name="anvil" type="box" pos="0.08 0 0.6" size="0.05 0.05 0.05" solref="{SOFTNESS} 1"/>
<body name="arm" pos="0 0 1"><joint name="swing" axis="0 1 0"/>
<inertial pos="0 0 -{CENTRE}" mass="{MASS}" diaginertia="{ABOUT} {ABOUT} 1e-4"/>
<geom name="head" type="sphere" pos="0 0 -{TIP}" size="0.03" solref="{SOFTNESS} 1"/></body></worldbody>
<actuator><motor name="drive" joint="swing"/></actuator></mujoco>"""
TWIN = """model: hammer.xml
signals:
  joints: {swing: {topic: log, position: swing}}
  actuators: {drive: {topic: log, effort: drive}}
"""
STEP, SAMPLE, HELD, NOISE = 5e-5, 0.005, 0.01, 3e-4
"""Seconds of the integrator, of the encoder and for which torques are held; noise of the encoder [rad]."""


@numba.njit(cache=False)
def swing(torque: np.ndarray, stiffness: float, damping: float, friction: float) -> np.ndarray:
    """Angles of the hammer, one a sample [rad]: a damped spring where it is in the anvil, by symplectic Euler.

    MuJoCo's contacts are by the mass that strikes: the spring is 1/SOFTNESS² and the damper 2/SOFTNESS of it.
    """
    held, every = round(HELD / STEP), round(SAMPLE / STEP)
    angle, rate = 0.05, 0.0
    found = np.empty(len(torque) * held // every)
    for i in range(len(torque) * held):
        if i % every == 0:
            found[i // every] = angle
        depth, closing, push = -TIP * np.sin(angle), -TIP * np.cos(angle) * rate, 0.0
        if depth > 0.0:
            spring = stiffness * depth / SOFTNESS**2 + 2.0 * damping * closing / SOFTNESS
            push = max(0.0, INERTIA / TIP**2 * spring)
        moment = torque[i // held] - WEIGHT * np.sin(angle) + push * TIP * np.cos(angle)
        rate += STEP * moment / INERTIA
        stop = STEP * friction / INERTIA
        rate = 0.0 if abs(rate) < stop else rate - np.sign(rate) * stop
        angle += STEP * rate
    return found


def log_hammer(folder: Path, seed: int, pause: float, duration: float, hidden: tuple[float, float, float]) -> Path:
    """A log as CSV: lifted by a torque, let fall or pushed on, every so many seconds."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, duration, HELD)
    torque, begin = 0.05 * np.sin(7.0 * time), 1.0
    while begin < duration:
        lifted = begin + rng.uniform(0.25, 0.5)
        torque[(time >= begin) & (time < lifted)] += rng.uniform(0.4, 0.8)
        torque[(time >= lifted) & (time < lifted + 0.5)] += rng.uniform(-0.2, 0.3)
        begin = lifted + pause * rng.uniform(0.9, 1.1)
    angle = swing(torque, *hidden)
    table = np.stack(
        [SAMPLE * np.arange(len(angle)), angle + rng.normal(0.0, NOISE, len(angle)), np.repeat(torque, 2)], 1
    )
    (folder / f"{seed}").mkdir(parents=True)
    log = folder / f"{seed}" / "log.csv"
    np.savetxt(log, table, fmt="%.6f", delimiter=",", header="time,swing,drive", comments="")
    return log


def read_hammer(tmp_path: Path, logs: list[Path]) -> tuple[TwinSpec, list[Flight]]:
    """The twin of the hammer, and logs as its flights."""
    (tmp_path / "hammer.xml").write_text(HAMMER)
    (tmp_path / "twin.yaml").write_text(TWIN)
    spec = load_twin(str(tmp_path / "twin.yaml"))
    return spec, [read_flight(log, None, spec.robot.signals.entries) for log in logs]


def judge(tmp_path: Path, hidden: tuple[float, float, float], most: int = 99) -> Findings:
    """What blows of two flights tell, the first of each."""
    logs = [log_hammer(tmp_path / "logs", seed, 4.0, 40.0, hidden) for seed in (1, 2)]
    spec, flights = read_hammer(tmp_path, logs)
    measured = [mark_strikes(spec.model, read_measurements(spec, flight)) for flight in flights]
    begins = [list_blows(flight, LEAD, LENGTH) for flight in measured]
    measured = [
        replace(flight, end=min(b[:most][-1] + LENGTH + 0.01, flight.end)) for flight, b in zip(measured, begins)
    ]
    return judge_blows(spec, measured, {}, lambda text: None)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [(2.0, 0.3, 0.0), (0.3, 0.6, 0.0)], ids=["bouncy", "soft"])
def test_a_contact_is_named_with_its_size(tmp_path: Path, hidden: tuple[float, float, float]) -> None:
    """Stiffness and damping within their own errors, which know of the twin's steps; others' blows are foretold."""
    (cause,) = judge(tmp_path, hidden).causes
    assert cause.effect == COMPLIANCE
    assert cause.confidence > 0.9
    assert cause.gain > 0.5
    for value, (name, found) in zip(hidden, cause.parameters.items()):
        assert abs(found.value - value) < 2.5 * found.std < 1.5 * value, name


@pytest.mark.slow
def test_of_a_right_contact_nothing_is_named(tmp_path: Path) -> None:
    """Steps of a millisecond leave errors of several times the noise, which are no cause."""
    found = judge(tmp_path, (1.0, 1.0, 0.0))
    assert not found.causes
    assert [cleared.effect for cleared in found.cleared] == [COMPLIANCE]
    assert "impacts, judged on their own, are off by" in found.told[0]


def test_few_blows_tell_nothing(tmp_path: Path) -> None:
    """Two of each flight are none for a test by signs."""
    found = judge(tmp_path, (2.0, 0.3, 0.0), 2)
    assert not found.causes
    assert {unseen.effect for unseen in found.unseen} == {COMPLIANCE, "contact.friction"}
    assert {unseen.reason for unseen in found.unseen} == {"4 separate impacts, 6 are needed"}


@pytest.mark.slow
def test_a_rig_that_strikes_all_the_time_has_its_contact_told_first(tmp_path: Path) -> None:
    """A blow every 0.8 s, friction of 20 mN m in the joint: without the contact the search took an offset for it."""
    logs = [log_hammer(tmp_path / "logs", seed, 0.5, 40.0, (2.0, 0.3, 0.02)) for seed in (1, 2, 3)]
    verdict = diagnose(*read_hammer(tmp_path, logs)).verdict
    causes = {cause.effect: cause for cause in verdict.causes}
    assert set(causes) == {COMPLIANCE, "swing.coulomb"}
    torque = causes["swing.coulomb"].parameters["torque"]
    assert abs(torque.value - 0.02) < 0.003
    assert verdict.after.chi2 < 0.1 * verdict.before.chi2
