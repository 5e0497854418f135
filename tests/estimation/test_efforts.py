"""Efforts that are no forces: currents and other units are told from gains, loads, rotors and friction."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proving.hidden import write_log
from proving.mechanisms.recording import record as record_session
from proving.mechanisms.session import draw_session
from proving.torque_arm import Truth, swing_arm, write_arm
from tests.diagnosis.rigs import CARTS, record
from vpptwin.cli.main import main
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.checks.units import judge_efforts
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs.flight import Stream
from vpptwin.logs.read import read_flight
from vpptwin.mapping.inspect import inspect_logs
from vpptwin.twin import TwinSpec, load_twin

BELT = ((1.0, 0.0), (0.8, 1.0))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """The nominal arm."""
    return write_arm(tmp_path_factory.mktemp("torque_arm"))


def tell(spec: TwinSpec, truth: Truth, seed: int = 1) -> dict[str, float]:
    """Actuator → factor that is told."""
    return {
        each.actuator: each.factor
        for each in judge_efforts(spec, [read_measurements(spec, swing_arm(truth, 10.0, seed))])
    }


@pytest.mark.parametrize(
    "truth",
    [
        Truth(gain=(12.1, 9.3)), Truth(gain=(14.0, -6.0), coulomb=(0.6, 0.3), viscous=(0.3, 0.2)),
        Truth(gain=(1e-3, 1e-3)), Truth(gain=(0.0981, 0.0981)), Truth(gain=(8.0, 5.0), slow=4.0),
        Truth(gain=(10.0, 10.0), load=0.3),
    ],
)  # fmt: skip
def test_currents_and_other_units_are_told(arm: TwinSpec, truth: Truth) -> None:
    """Each with its factor: to what friction, filters and a load leave of it."""
    told = tell(arm, truth)
    for name, gain in zip(("m_shoulder", "m_elbow"), truth.gain, strict=True):
        assert told[name] == pytest.approx(gain, rel=0.4 if truth.load else 0.05)


@pytest.mark.parametrize(
    "truth",
    [
        Truth(), Truth(gain=(0.7, 1.3)), Truth(gain=(-1.0, 1.0)), Truth(gain=(2.5, 0.5)), Truth(load=2.4),
        Truth(load=0.8), Truth(heavier=(1.5, 2.0)), Truth(rotor=0.3), Truth(coulomb=(2.0, 0.6)),
        Truth(drive=((1.0, 1.0), (1.0, -1.0))), Truth(drive=BELT),
    ],
)  # fmt: skip
def test_gains_loads_rotors_and_other_drives_are_no_units(arm: TwinSpec, truth: Truth) -> None:
    """A diagnosis names those; a load may be three times what it hangs on."""
    assert tell(arm, truth) == {}


@pytest.mark.parametrize(("truth", "factors"), [(Truth(gain=(12.0, 7.0)), 2), (Truth(rotor=1.0), 0), (Truth(), 0)])
def test_an_arm_on_its_side_has_inertia_alone(tmp_path: Path, truth: Truth, factors: int) -> None:
    """Which a rotor adds to, but nothing takes from: more torque than logged is a unit, less is not."""
    assert len(tell(write_arm(tmp_path, 0.0), replace(truth, gravity=0.0))) == factors


def test_one_joint_of_two_in_another_unit(arm: TwinSpec) -> None:
    """The other one is none of it."""
    told = tell(arm, Truth(gain=(1.0, 15.0)))
    assert list(told) == ["m_elbow"]


def test_every_command_says_it_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`diagnose` and `compare` in their only line, with the scale that mends it; with that they run."""
    spec = write_arm(tmp_path)
    log = write_log(swing_arm(Truth(gain=(11.0, 8.0)), 8.0, 2), tmp_path / "run.mcap")
    for command in (["compare"], ["diagnose", "--out", str(tmp_path / "out")]):
        assert main([*command, str(log), "--twin", str(tmp_path / "twin.yaml")]) == 2
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("vpptwin: ")]
        assert line.startswith(
            "vpptwin: run.mcap: the effort of m_shoulder looks like current: torque is 11 times it (r = 0.99"
        )
        assert re.search(r"the effort of m_elbow looks like current: torque is (8|7\.9\d) times it", line)
        assert "`scale: 1" in line
    assert not (tmp_path / "out").exists()
    twin = (tmp_path / "twin.yaml").read_text()
    for name, scale in (("m_shoulder", 11.0), ("m_elbow", 8.0)):
        entry = f"{name}: {{topic: /efforts, effort: {{path: effort, scale: {scale}}}}}"
        twin = twin.replace(f"{name}: /efforts", entry)
    (tmp_path / "scaled.yaml").write_text(twin)
    scaled = load_twin(tmp_path / "scaled.yaml")
    flight = read_flight(log, None, scaled.robot.signals.entries)
    assert judge_efforts(scaled, [read_measurements(scaled, flight)]) == []
    found = judge_efforts(spec, [read_measurements(spec, read_flight(log))])
    np.testing.assert_allclose([each.scale for each in found], [11.0, 8.0], rtol=0.01)


def test_a_scale_that_is_given_counts(tmp_path: Path) -> None:
    """What is to be written is the scale in all, and forces of a slide are forces."""
    log, _ = record(CARTS, 0.5, tmp_path, 3, part=0.5)
    path = tmp_path / "rig.yaml"
    entry = "motor: {topic: /actuator_command, effort: {path: effort, scale: 0.05}}"
    path.write_text(path.read_text().replace("motor: /actuator_command", entry))
    spec = load_twin(path)
    flight = read_flight(log, None, spec.robot.signals.entries)
    (far,) = judge_efforts(spec, [read_measurements(spec, flight)])
    assert far.scale == pytest.approx(1.0, rel=0.05)
    assert far.factor == pytest.approx(20.0, rel=0.05)
    assert str(far).startswith("the effort of motor looks like current: force is 19.6 times it (r = 0.99")


def test_inspect_doubts_it_with_the_scale(tmp_path: Path) -> None:
    """Of columns of a table, one in another unit; the other stays sure."""
    write_arm(tmp_path)
    flight = swing_arm(Truth(gain=(1.0, 13.0)), 8.0, 3)
    columns: dict[str, np.ndarray] = {}
    for name, stream in flight.joints["/joint_states"].items():
        columns |= {"time": stream.time, f"{name}_pos": stream["position"], f"{name}_vel": stream["velocity"]}
    columns |= {f"{name}_cmd_torque": stream["effort"] for name, stream in flight.joints["/efforts"].items()}
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True))
    (tmp_path / "run.csv").write_text(",".join(columns) + "\n" + rows + "\n")
    guesses = inspect_logs([tmp_path / "run.csv"], str(tmp_path / "torque_arm.xml"), tmp_path / "found.yaml")
    found = {guess.target: guess for guess in guesses}
    assert found["m_shoulder"].sure, found["m_shoulder"].doubts
    assert not found["m_elbow"].sure
    (doubt,) = found["m_elbow"].doubts
    assert doubt.startswith("the effort of m_elbow looks like current: torque is 1")
    assert "write scale: 1" in doubt
    assert f"DOUBT: {doubt}" in (tmp_path / "found.yaml").read_text()


@pytest.mark.parametrize(("factor", "unit"), [(12.0, ""), (1e-3, "mN m")])
def test_another_arm_with_hysteresis_and_gears(tmp_path: Path, factor: float, unit: str) -> None:
    """Drawn, with an effect in it that no catalogue has, and gains of its motors in the MJCF."""
    recorded = record_session(draw_session(4711, 10), tmp_path)
    spec, flight = load_twin(recorded.twin), read_flight(recorded.logs[0])
    (topic,) = set(spec.robot.signals.actuators.values())
    scaled = {name: Stream(s.time, {"effort": s["effort"] / factor}) for name, s in flight.joints[topic].items()}
    found = judge_efforts(spec, [read_measurements(spec, replace(flight, joints={**flight.joints, topic: scaled}))])
    assert [each.unit for each in found] == [unit, unit]
    np.testing.assert_allclose([each.scale for each in found], factor, rtol=0.25)
    assert judge_efforts(spec, [read_measurements(spec, flight)]) == []


@pytest.mark.slow
def test_a_gain_is_still_a_gain(arm: TwinSpec) -> None:
    """0.7 of the shoulder's torque, hidden where a unit would be refused."""
    verdict = diagnose(arm, [swing_arm(Truth(gain=(0.7, 1.0)), 12.0, seed) for seed in (5, 6)]).verdict
    assert verdict.causes[0].effect == "m_shoulder.gain"
    assert verdict.causes[0].parameters["gain"].value == pytest.approx(0.7, abs=0.03)


def test_efforts_that_say_nothing_are_not_judged(arm: TwinSpec) -> None:
    """Zeros, and noise that no motion follows."""
    flight, rng = swing_arm(Truth(), 8.0, 4), np.random.default_rng(1)
    for make in (np.zeros, lambda n: 0.01 * rng.standard_normal(n)):
        efforts = {n: Stream(s.time, {"effort": make(len(s))}) for n, s in flight.joints["/efforts"].items()}
        mute = replace(flight, joints={**flight.joints, "/efforts": efforts})
        assert judge_efforts(arm, [read_measurements(arm, mute)]) == []
