"""Rigs that are not ours, simulated without MuJoCo: a cart with dry friction, a damped pendulum, and a clean cart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.diagnosis.rigs import (
    BOB,
    CARTS,
    DAMPING,
    FRICTION,
    LENGTH,
    LOG_EVERY,
    MASS,
    PENDULA,
    SERVOS,
    STEP,
    Case,
    drive_cart,
    record,
    swing_pendulum,
)
from vpptwin.cli.main import main

SECOND = 4
"""Index of 1 s among `horizons_s` of verdict.json (docs/diagnose.md)."""


def diagnose(log: Path, twin: Path, out: Path) -> dict:
    """Run the command that a user types; verdict.json."""
    assert main(["diagnose", str(log), "--twin", str(twin), "--out", str(out)]) == 0
    return json.loads((out / "verdict.json").read_text())


def diagnose_rig(case: Case, size: float, folder: Path) -> dict:
    """Move a rig, log it, diagnose it."""
    return diagnose(*record(case, size, folder, seed=1), folder / "out")


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


@pytest.mark.slow
def test_dry_friction_of_a_cart_is_named(tmp_path: Path) -> None:
    """A cart that sticks and slips: coulomb, not viscous; and the extended twin lacks nothing more.

    A twin to be diagnosed again may lie anywhere: the extended one names its model by a path relative to itself.
    """
    log, twin = record(CARTS, FRICTION, tmp_path, seed=1)
    verdict = diagnose(log, twin, tmp_path / "out")
    check_named(verdict, "slide.coulomb", "force", FRICTION)
    again = diagnose(log, tmp_path / "out/twin.yaml", tmp_path / "elsewhere/again")
    assert again["causes"] == []
    assert not again["gap"]
    np.testing.assert_allclose(again["before"]["position_rmse_m"], verdict["after"]["position_rmse_m"], rtol=1e-3)
    first, second = (yaml.safe_load((tmp_path / d / "twin.yaml").read_text()) for d in ("out", "elsewhere/again"))
    assert second["effects"] == first["effects"]
    assert (first["model"], second["model"]) == ("../rig.xml", "../../rig.xml")


@pytest.mark.slow
def test_damping_of_a_pendulum_is_named(tmp_path: Path) -> None:
    """A pendulum pushed to and fro by its motor: viscous, not coulomb."""
    check_named(diagnose_rig(PENDULA, DAMPING, tmp_path), "swing.viscous", "damping", DAMPING)


def test_a_soft_servo_is_named(tmp_path: Path) -> None:
    """Targets are its input, its own loop is part of the twin: it has 0.7 of the MJCF's stiffness."""
    verdict = diagnose_rig(SERVOS, 0.7, tmp_path)
    (cause,) = verdict["causes"]
    assert cause["effect"] == "motor.stiffness"
    assert cause["parameters"]["stiffness"]["value"] == pytest.approx(0.7, rel=0.03)
    assert verdict["after"]["chi2"] < 0.01 * verdict["before"]["chi2"]


@pytest.mark.slow
def test_a_servo_as_it_should_be_is_not_accused(tmp_path: Path) -> None:
    """Nothing is named and there is no gap."""
    verdict = diagnose_rig(SERVOS, 1.0, tmp_path)
    assert verdict["causes"] == []
    assert not verdict["gap"]


def test_a_cart_without_friction_is_not_accused(tmp_path: Path) -> None:
    """The twin is right: no cause, no gap, nothing unexplained, and the error before is the error after."""
    verdict = diagnose(*record(CARTS, 0.0, tmp_path, seed=1, part=0.5), tmp_path / "out")
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
