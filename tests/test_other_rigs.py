"""Rigs that are not ours, simulated without MuJoCo: a cart with dry friction, a pendulum in honey, and a clean cart."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from vpptwin.cli import main
from vpptwin.logs.write import FlightWriter

STEP = 1e-4
"""Step of the independent simulation [s]: a twentieth of the twin's."""
LOG_EVERY = 50
"""Steps between samples and between changes of the command: 200 Hz."""
DURATION = 24.0
SECOND = 4
"""Index of 1 s among the horizons of SPEC 7."""
MASS, FRICTION = 2.0, 1.1  # kg, N
BOB, LENGTH, DAMPING = 0.3, 0.4, 0.03  # kg, m, N m s/rad

CART = """<mujoco>
  <default><joint solimpfriction="0.9999 0.9999 0.001 0.5 2" solreffriction="0.004 1"/></default>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="slide" gear="20"/></actuator>
</mujoco>"""
PENDULUM = """<mujoco>
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <worldbody>
    <body>
      <joint name="swing" type="hinge" axis="0 -1 0"/>
      <inertial pos="0 0 -0.4" mass="0.3" diaginertia="1e-6 1e-6 1e-6"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="swing" gear="1"/></actuator>
</mujoco>"""
TWIN = """model: rig.xml
signals:
  joints: {%s: /joint_states}
  actuators: {motor: /actuator_command}
"""

Track = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Position, velocity and control input at every sample, (n,) each."""


def drive_cart(friction: float, seed: int) -> Track:
    """A cart of 2 kg after steps of its reference, under a motor of 20 N and Karnopp's dry friction [N].

    At rest it stays exactly at rest below breakaway; where the velocity would cross zero it stops first.
    """
    rng = np.random.default_rng(seed)
    count = round(DURATION / STEP / LOG_EVERY)
    goals = np.repeat(rng.uniform(-0.5, 0.5, count // 240 + 1), 240)[:count]  # a new one every 1.2 s
    log = np.empty((count, 3))
    x, v = 0.0, 0.0
    for i in range(count):
        control = float(np.clip((25.0 * (goals[i] - x) - 9.0 * v) / 20.0, -0.5, 0.5))
        log[i] = x, v, control
        push = 20.0 * control
        for _ in range(LOG_EVERY):
            direction = push if v == 0.0 else v
            drag = min(friction, abs(push)) if v == 0.0 else friction
            ahead = v + STEP * (push - math.copysign(drag, direction)) / MASS
            if v * ahead < 0.0:
                x, v = x + 0.5 * STEP * v * v / (v - ahead), 0.0
            else:
                x, v = x + 0.5 * STEP * (v + ahead), ahead
    return log[:, 0], log[:, 1], log[:, 2]


def swing_pendulum(damping: float, seed: int) -> Track:
    """A bob of 0.3 kg on 0.4 m with viscous damping [N m s/rad], under torques held for 0.7 s, by Runge and Kutta."""
    rng = np.random.default_rng(seed)
    count = round(DURATION / STEP / LOG_EVERY)
    torques = np.repeat(rng.uniform(-0.6, 0.6, count // 140 + 1), 140)[:count]
    inertia, weight = BOB * LENGTH**2, BOB * 9.81 * LENGTH

    def slope(state: np.ndarray, torque: float) -> np.ndarray:
        return np.array([state[1], (torque - damping * state[1] - weight * np.sin(state[0])) / inertia])

    step = LOG_EVERY * STEP / 10.0
    log = np.empty((count, 3))
    state = np.zeros(2)
    for i, torque in enumerate(torques):
        log[i] = *state, torque
        for _ in range(10):
            a = slope(state, torque)
            b = slope(state + 0.5 * step * a, torque)
            c = slope(state + 0.5 * step * b, torque)
            d = slope(state + step * c, torque)
            state = state + step / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return log[:, 0], log[:, 1], log[:, 2]


@dataclass(frozen=True)
class Case:
    """One rig: its model, its joint, how it moves, its sensors' noise [m, m/s or rad, rad/s]."""

    model: str
    joint: str
    move: Callable[[float, int], Track]
    noise: tuple[float, float]


CARTS = Case(CART, "slide", drive_cart, (3e-4, 3e-3))
PENDULA = Case(PENDULUM, "swing", swing_pendulum, (1e-3, 2e-2))


def diagnose(case: Case, size: float, folder: Path, seed: int) -> dict:
    """Move the rig, log it, diagnose it with the command that a user types; verdict.json."""
    position, velocity, control = case.move(size, seed)
    rng = np.random.default_rng(seed + 1000)
    position = position + case.noise[0] * rng.standard_normal(len(position))
    velocity = velocity + case.noise[1] * rng.standard_normal(len(velocity))
    folder.mkdir(exist_ok=True)
    with FlightWriter(folder / "log.mcap") as writer:
        for i, (q, v, u) in enumerate(zip(position, velocity, control)):
            time = i * LOG_EVERY * STEP
            writer.write_joints("/joint_states", time, {case.joint: {"position": q, "velocity": v}})
            writer.write_joints("/actuator_command", time, {"motor": {"effort": u}})
    (folder / "rig.xml").write_text(case.model)
    (folder / "rig.yaml").write_text(TWIN % case.joint)
    out = folder / "out"
    assert main(["diagnose", str(folder / "log.mcap"), "--twin", str(folder / "rig.yaml"), "--out", str(out)]) == 0
    return json.loads((out / "verdict.json").read_text())


def check_named(verdict: dict, effect: str, parameter: str, truth: float) -> None:
    """The effect is named first and alone, its size is right within 15 %, errors at 1 s fall to under a quarter."""
    (first,) = verdict["causes"]
    assert first["effect"] == effect
    assert first["also_explained_by"] == []
    assert first["parameters"][parameter]["value"] == pytest.approx(truth, rel=0.15)
    rate = f"{effect.split('.')[0]} rate"
    before, after = verdict["before"], verdict["after"]
    assert after["velocity_rmse"][rate][SECOND] < 0.25 * before["velocity_rmse"][rate][SECOND]
    key = "angle_rmse_rad" if before["position_rmse_m"] is None else "position_rmse_m"
    assert after[key][SECOND] < 0.25 * before[key][SECOND]
    assert after["chi2"] < 0.1 * before["chi2"]
    assert not verdict["unexplained"]["significant"]


def test_dry_friction_of_a_cart_is_named(tmp_path: Path) -> None:
    """A cart that sticks and slips: coulomb, not viscous, 1.1 N of the motor's 10."""
    check_named(diagnose(CARTS, FRICTION, tmp_path, seed=1), "slide.coulomb", "force", FRICTION)


def test_damping_of_a_pendulum_is_named(tmp_path: Path) -> None:
    """A pendulum that swings up to half a turn: viscous, not coulomb."""
    check_named(diagnose(PENDULA, DAMPING, tmp_path, seed=1), "swing.viscous", "damping", DAMPING)


def test_a_cart_without_friction_is_not_accused(tmp_path: Path) -> None:
    """The twin is right: no cause, no gap, nothing unexplained, and the error before is the error after."""
    verdict = diagnose(CARTS, 0.0, tmp_path, seed=1)
    assert verdict["causes"] == []
    assert not verdict["gap"]
    assert not verdict["unexplained"]["significant"]
    assert verdict["before"] == verdict["after"]


def test_the_independent_cart_obeys_newton_and_sticks() -> None:
    """By hand: what the motor's work and the friction's leave is the kinetic energy; and the cart rests exactly."""
    position, velocity, control = drive_cart(FRICTION, seed=2)
    push, moved = 20.0 * control[:-1], np.diff(position)
    work = np.cumsum(push * moved) - FRICTION * np.cumsum(np.abs(moved))
    kinetic = 0.5 * MASS * velocity[1:] ** 2
    # Motion that turns around between two samples is counted too short: a few thousandths of a joule a stop.
    np.testing.assert_allclose(work, kinetic, atol=0.02)
    assert kinetic.max() > 0.3
    resting = (velocity[:-1] == 0.0) & (velocity[1:] == 0.0)
    assert 0.05 < resting.mean() < 0.9
    assert np.abs(push[resting]).max() <= FRICTION
    assert (moved[resting] == 0.0).all()


def test_the_independent_pendulum_loses_what_damping_takes() -> None:
    """By hand: kinetic and potential energy change by the torque's work less the integral of damping times rate²."""
    angle, rate, torque = swing_pendulum(DAMPING, seed=2)
    energy = 0.5 * BOB * LENGTH**2 * rate**2 + BOB * 9.81 * LENGTH * (1.0 - np.cos(angle))
    lost = DAMPING * np.cumsum(0.5 * (rate[1:] ** 2 + rate[:-1] ** 2)) * LOG_EVERY * STEP
    # The trapezoid over 5 ms of a rate that swings at 1 Hz is good to a few 1e-4 of the loss.
    np.testing.assert_allclose(energy[1:] - energy[0], np.cumsum(torque[:-1] * np.diff(angle)) - lost, atol=2e-3)
    assert energy.max() > 0.5
