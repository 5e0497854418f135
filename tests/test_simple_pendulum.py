"""A real rig that is not ours: DFKI's torque-limited simple pendulum, measured, with examples/simple_pendulum."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from examples.simple_pendulum.by_hand import (
    SPANS,
    Log,
    find_pushes,
    fit_energy,
    fit_free_swing,
    fit_smoothed,
    fit_windows,
    read_log,
    rigid,
)
from examples.simple_pendulum.convert import convert
from tests.by_hand import SURE, check_causes
from vpptwin.cli.main import main
from vpptwin.logs import read_flight
from vpptwin.twin import load_twin

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/simple_pendulum"
TWIN = EXAMPLE / "pendulum.yaml"
ROOM = {
    "pendulum.coulomb": ("torque", 0.1, 0.35),
    "pendulum.viscous": ("damping", 0.0, 0.04),
    "pendulum.bias": ("force", -0.2, 0.2),
    "pendulum.inertia": ("inertia", -0.01, 0.01),
    "motor.gain": ("gain", 0.75, 1.1),
    "motor.delay": ("delay", 0.0, 0.02),
    "motor.lag": ("time_constant", 0.0, 0.02),
}
"""Per cause what the fit by hand leaves room for, generously: parameter, lowest, highest."""
NEVER = {"motor.rate_limit", "motor.saturation"}
"""Causes that these logs exclude: the torque was measured at the motor, after all that."""


@pytest.fixture(scope="module")
def folder(shared_data: Path) -> Path:
    """The logs."""
    return shared_data / "simple_pendulum"


@pytest.fixture(scope="module")
def logs(folder: Path) -> dict[str, Log]:
    """Logs by name."""
    return {name: read_log(folder, name) for name in SPANS}


@pytest.mark.parametrize(("twin", "log"), [("pendulum", "ilqr"), ("pendulum_1kg", "energy_shaping_1kg")])
def test_the_model_is_that_of_its_makers(twin: str, log: str) -> None:
    """A point mass at 0.5 m, hanging down at zero, without friction and rotor."""
    model = load_twin(EXAMPLE / f"{twin}.yaml").model
    inertia, weight = rigid(log)
    mass = float(model.body("rod").mass[0])
    assert mass * 0.25 == pytest.approx(inertia)
    assert mass * 0.5 * 9.81 == pytest.approx(weight)
    assert not np.any(model.dof_frictionloss)
    assert not np.any(model.dof_damping)


def test_converting_loses_nothing(folder: Path, tmp_path: Path) -> None:
    """Stamps, as irregular as they are, positions, velocities and torques come back as in the CSV."""
    csv = folder / "pd_swingup_failure.csv"
    table = np.genfromtxt(csv, delimiter=",", names=True)
    convert(csv, tmp_path / "log.mcap")
    flight = read_flight(tmp_path / "log.mcap")
    motion = flight.joints["/joint_states"]["pendulum"]
    assert motion.time == pytest.approx(table["time"], abs=1e-9)
    assert np.array_equal(motion["position"], table["position"])
    assert np.array_equal(motion["velocity"], table["velocity"])
    assert np.array_equal(flight.joints["/actuator_command"]["motor"]["effort"], table["torque"])


def test_somebody_pushed(logs: dict[str, Log]) -> None:
    """Energy comes that no motor gave: 12 J, 7 J, 1.3 J; ilqr loses 1.8 J too many."""
    pushes = {name: find_pushes(log, name) for name, log in logs.items()}
    assert [(round(time), round(joules)) for time, joules in pushes["energy_shaping"]] == [(16, 12)]
    assert max(joules for _, joules in pushes["energy_shaping_1kg"]) == pytest.approx(7.4, abs=0.5)
    assert max(joules for _, joules in pushes["pd_swingup_failure"]) == pytest.approx(1.3, abs=0.2)
    assert [round(joules, 1) for _, joules in pushes["ilqr"]] == [-1.8]
    assert pushes["pd_system_identification"] == []


@pytest.mark.parametrize("name", ["energy_shaping", "ilqr"])
def test_work_and_energy_give_gravity_and_friction(logs: dict[str, Log], name: str) -> None:
    """Untouched, the nominal weight within 10 % and 0.25 N m of dry friction explain 95 % of the work."""
    fit = fit_energy(logs[name], SPANS[name])
    assert fit.share > 0.95
    assert fit["G"] == pytest.approx(3.313, rel=0.1)
    assert fit["F"] == pytest.approx(0.245, abs=0.02)


def test_smoothed_motion_explains_little(logs: dict[str, Log]) -> None:
    """Differentiated, the same log explains a quarter of the torque, and a tenth of the weight."""
    fit = fit_smoothed(logs["energy_shaping"])
    assert fit.share < 0.3
    assert fit["G"] < 0.5


def test_the_heavier_bob_comes_out(logs: dict[str, Log]) -> None:
    """At least half again the weight of the light one, with the same friction; more than nominal, if anything."""
    light, heavy = (fit_energy(logs[name], SPANS[name]) for name in ("energy_shaping", "energy_shaping_1kg"))
    assert heavy.estimates["G"].low > 1.5 * light.estimates["G"].high
    assert heavy["F"] == pytest.approx(light["F"], abs=0.06)
    assert heavy["G"] / heavy["I"] == pytest.approx(light["G"] / light["I"], rel=0.03)
    assert heavy.share < 0.95


def test_free_swings_under_constant_torque(logs: dict[str, Log]) -> None:
    """Let go by hand: inertia with a rotor, dry and hardly any viscous friction, 0.88 of the torque (or a zero)."""
    fit = fit_free_swing(logs["pd_swingup_failure"])
    assert fit["I"] == pytest.approx(0.1689 + 0.0026, abs=0.0015)
    assert fit["F"] == pytest.approx(0.19, abs=0.03)
    assert fit["k"] == pytest.approx(0.882, abs=0.01)
    assert -0.01 < fit["b"] < 0.02
    assert fit.left[0][0] < 0.012


def test_damping_of_the_controller_is_none_of_the_pendulum(logs: dict[str, Log]) -> None:
    """0.35 N m s/rad, as in parameters.yaml, is excluded by every log that was not disturbed by aliased torque."""
    for name in ("energy_shaping", "ilqr", "pd_swingup_failure"):
        fit = fit_windows(logs[name], name, SPANS[name], ("I", "F", "b", "k"))
        assert fit.estimates["b"].high < 0.06, name


@pytest.fixture(scope="module")
def verdict(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """The verdict on energy_shaping, about 30 s."""
    out = tmp_path_factory.mktemp("simple")
    convert(folder / "energy_shaping.csv", out / "log.mcap")
    assert main(["diagnose", str(out / "log.mcap"), "--twin", str(TWIN), "--out", str(out / "out")]) == 0
    return json.loads((out / "out/verdict.json").read_text())


@pytest.mark.slow
def test_the_verdict_on_a_pendulum_that_was_pushed(verdict: dict) -> None:
    """Friction is there, with its size, and in a log in which somebody pushed it is suggested, not sure."""
    named = {cause["effect"]: cause for cause in verdict["causes"]}
    assert named["pendulum.coulomb"]["parameters"]["torque"]["value"] == pytest.approx(0.25, abs=0.08)
    assert named["pendulum.coulomb"]["confidence"] < SURE
    # No law of a joint or motor gives 12 J: there is a gap, something is left, and nothing excluded is sure.
    assert verdict["gap"]
    assert verdict["unexplained"]["significant"]
    check_causes(verdict, NEVER, ROOM)


@pytest.mark.slow
def test_gain_and_bias_are_told_as_one(folder: Path, tmp_path: Path) -> None:
    """Under a constant torque a gain and a constant torque are one number: neither is said without the other."""
    convert(folder / "pd_swingup_failure.csv", tmp_path / "log.mcap")
    assert main(["diagnose", str(tmp_path / "log.mcap"), "--twin", str(TWIN), "--out", str(tmp_path / "out")]) == 0
    found = json.loads((tmp_path / "out/verdict.json").read_text())
    check_causes(found, NEVER, ROOM)
    for cause in found["causes"]:
        if cause["effect"] in ("motor.gain", "pendulum.bias"):
            other = {"motor.gain": "pendulum.bias", "pendulum.bias": "motor.gain"}[cause["effect"]]
            assert other in {rival["effect"] for rival in cause["also_explained_by"]}
