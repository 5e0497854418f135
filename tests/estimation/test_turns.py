"""Encoders that wrap within a joint's travel: measurement and target go on, on the turn that the joint is on."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from tests.estimation.test_units import swing
from vpptwin.diagnosis.judgement.diagnose import diagnose
from vpptwin.estimation.checks.turns import TURN, find_wraps, measure_counter, unwrap_turns
from vpptwin.estimation.checks.units import vet_joint
from vpptwin.estimation.measurements import Measurements, read_measurements
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.read import read_flight
from vpptwin.mapping.inspect import inspect_logs
from vpptwin.twin import TwinSpec, load_twin

MASS, REACH, ROTOR, STIFF, DAMP = 0.8, 0.25, 0.02, 14.0, 0.9  # kg, m, kg m², N m/rad, N m s/rad
STEP, EVERY = 2e-4, 50  # s, steps between samples
LIMITS = math.radians(-100.0), math.radians(120.0)
MJCF = """<mujoco model="crank"><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<worldbody><body name="crank"><joint name="crank" axis="0 -1 0" armature="%g" %s/>
<inertial pos="0 0 %g" mass="%g" diaginertia="1e-6 1e-6 1e-6"/></body></worldbody>
<actuator><position name="servo" joint="crank" kp="%g" kv="%g"/></actuator></mujoco>"""
TWIN = "model: crank.xml\nsignals: {joints: {crank: /joint_states}, actuators: {servo: /targets}}\n"


def write_crank(folder: Path, limited: bool = True) -> TwinSpec:
    """The twin of the crank, which has no friction."""
    limits = f'limited="true" range="{LIMITS[0]} {LIMITS[1]}"' if limited else ""
    (folder / "crank.xml").write_text(MJCF % (ROTOR, limits, -REACH, MASS, STIFF, DAMP))
    (folder / "twin.yaml").write_text(TWIN)
    return load_twin(folder / "twin.yaml")


@lru_cache
def turn_crank(dry: float, duration: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, position and target of a crank held by a servo, with dry friction [N m], by semi-implicit Euler steps."""
    rng = np.random.default_rng(seed)
    count, inertia = round(duration / STEP / EVERY), MASS * REACH**2 + ROTOR
    time = np.arange(count) * EVERY * STEP
    target = np.repeat(rng.uniform(LIMITS[0] + 0.2, LIMITS[1] - 0.2, count // 60 + 1), 60)[:count]
    target = np.convolve(np.pad(target, 30, mode="edge"), np.ones(61) / 61.0, mode="valid")
    position, q, v = np.empty(count), target[0], 0.0
    for i in range(count):
        position[i] = q
        for _ in range(EVERY):
            push = STIFF * (target[i] - q) - DAMP * v - 9.81 * MASS * REACH * math.sin(q)
            if v == 0.0 and abs(push) <= dry:
                continue
            ahead = v + STEP * (push - math.copysign(dry, v if v else push)) / inertia
            v = 0.0 if v * ahead < 0.0 else ahead
            q += STEP * v
    return time, position, target


def encode(angle: np.ndarray, bits: int, zero: float) -> np.ndarray:
    """What an encoder of so many bits says, 0 to a turn, whose zero is at an angle [rad]."""
    return np.rint((angle - zero) / TURN * 2**bits) % 2**bits * (TURN / 2**bits)


def log_crank(dry: float, duration: float, bits: int, zero: float, seed: int = 1) -> tuple[Flight, np.ndarray]:
    """A log with the target in the encoder's terms, whose angles are right but for whole turns; and the truth."""
    time, position, target = turn_crank(dry, duration, seed)
    seen, asked = (encode(angle, bits, zero) + zero for angle in (position, target))
    joints = {"/joint_states": {"crank": Stream(time, {"position": seen})},
              "/targets": {"servo": Stream(time, {"effort": asked})}}  # fmt: skip
    return Flight(Path("crank.mcap"), 0, {}, joints), position


def is_true(measured: Measurements, truth: np.ndarray, target: np.ndarray, bits: int) -> bool:
    """Whether position and target are what they were to a count."""
    count = 0.51 * TURN / 2**bits
    return bool(
        np.abs(measured.positions[0].value - truth).max() < count
        and np.abs(measured.command.value[:, 0] - target).max() < count
    )


@pytest.mark.parametrize(("bits", "zero"), [(12, 0.3), (14, -0.8), (10, 1.4), (12, 2.6), (12, 2.6 - TURN)])
def test_an_encoder_that_wraps_within_the_limits_goes_on(tmp_path: Path, bits: int, zero: float) -> None:
    """Wherever it wraps, both land on the turn within the limits, with a warning each; so does one a turn away."""
    spec, (flight, truth) = write_crank(tmp_path), log_crank(0.2, 6.0, bits, zero)
    measured = read_measurements(spec, flight)
    assert is_true(measured, truth, turn_crank(0.2, 6.0, 1)[2], bits)
    said = [w for w in measured.warnings if "turn" in w]
    if abs(zero) < 2.0:
        assert re.fullmatch(r"/joint_states crank: position jumps by a turn \d+ times, as .*: it goes on", said[0])
        assert re.fullmatch(r"servo: \d+ of 600 targets are taken whole turns from .*", said[1])
    else:
        assert len(said) == (2 if zero > 0.0 else 0)


def test_the_target_of_a_crank_without_limits_follows_its_position(tmp_path: Path) -> None:
    """No limits tell the turn, so that the first sample does, and the target lies near where the joint is."""
    spec, (flight, truth) = write_crank(tmp_path, limited=False), log_crank(0.2, 6.0, 12, 0.3)
    measured = read_measurements(spec, flight)
    turns = (measured.positions[0].value - truth) / TURN
    np.testing.assert_allclose(turns, round(turns[0]), atol=1e-3)
    assert np.abs(measured.command.value[:, 0] - measured.positions[0].value).max() < 0.5 * TURN


def test_a_target_that_asks_for_a_whole_turn_stays(tmp_path: Path) -> None:
    """A hinge without limits that is asked to turn once turns once."""
    spec, time = write_crank(tmp_path, limited=False), np.arange(0.0, 8.0, 0.01)
    target = np.where(time < 2.0, 0.0, TURN)
    position = TURN * np.clip((time - 2.0) / 3.0, 0.0, 1.0) + 1e-3 * np.sin(9.0 * time)
    joints = {"/joint_states": {"crank": Stream(time, {"position": position})},
              "/targets": {"servo": Stream(time, {"effort": target})}}  # fmt: skip
    measured = read_measurements(spec, Flight(Path("crank.mcap"), 0, {}, joints))
    np.testing.assert_array_equal(measured.command.value[:, 0], target)
    np.testing.assert_array_equal(measured.positions[0].value, position)


@pytest.mark.parametrize("slip", [0.4, 2.0, 3.5, 5.0, 5.8])
def test_a_belt_that_slips_by_less_than_a_turn_is_left_as_it_is(tmp_path: Path, slip: float) -> None:
    """By any angle that is no turn, of a joint with limits."""
    spec, (time, position, target) = write_crank(tmp_path), turn_crank(0.2, 6.0, 1)
    slipped = position + slip * ((time > 2.0) & (time < 4.0))
    joints = {"/joint_states": {"crank": Stream(time, {"position": slipped})},
              "/targets": {"servo": Stream(time, {"effort": target})}}  # fmt: skip
    measured = read_measurements(spec, Flight(Path("crank.mcap"), 0, {}, joints))
    np.testing.assert_array_equal(measured.positions[0].value, slipped)
    assert not [w for w in measured.warnings if "turn" in w]


@pytest.mark.parametrize("within", [1, 2])
def test_samples_within_a_jump_are_left_out(within: int) -> None:
    """A mean of the samples before and after, as a filter or resampling makes it, is on no turn at all."""
    time = np.arange(0.0, 6.0, 0.01)
    angle = 0.9 * np.sin(2.0 * time)
    logged = np.mod(angle, TURN)
    jumps = np.flatnonzero(find_wraps(time, logged, TURN))
    for at in jumps:
        logged[at + 1 : at + 1 + within] = np.linspace(logged[at], logged[at + within + 1], within + 2)[1:-1]
    found, (line,) = unwrap_turns(Stream(time, {"position": logged}), "arm", np.array([-1.5, 1.5]))
    assert len(found) == len(time) - within * len(jumps)
    np.testing.assert_allclose(found["position"], 0.9 * np.sin(2.0 * found.time), atol=1e-9)
    assert line.endswith(f"{within * len(jumps)} samples within a jump are left out")


def test_a_counter_of_a_slide_goes_on() -> None:
    """16 bits of 20 µm jump from end to end; a reading of 20 m now and then, and a slide without jumps, do not."""
    time = np.arange(0.0, 10.0, 0.01)
    place, turn = 1.1 + 0.6 * np.sin(1.3 * time) + 0.1 * time, 65536 * 2e-5
    logged = np.rint(place / 2e-5) * 2e-5 % turn
    found, (line,) = unwrap_turns(Stream(time, {"position": logged}), "rail", None, rotary=False)
    offset = found["position"] - place
    np.testing.assert_allclose(offset, offset[0], atol=2e-4)
    assert "rail: position jumps by a turn" in line
    wild = np.where(np.arange(len(time)) % 300 == 200, 20.0, place)
    for other in (place, wild):
        assert measure_counter(time, other) == 0.0


def test_inspect_finds_the_joint_and_its_target_behind_it(tmp_path: Path) -> None:
    """In degrees of an encoder of 11 bits: sure of both, without a doubt about ranges, and the twin reads them."""
    write_crank(tmp_path)
    flight, truth = log_crank(0.2, 6.0, 11, 0.5)
    seen, asked = flight.joints["/joint_states"]["crank"], flight.joints["/targets"]["servo"]["effort"]
    rows = np.degrees(np.stack([seen["position"], asked], axis=1))
    lines = [f"{t:.3f},{a:.6f},{b:.6f}" for t, (a, b) in zip(seen.time, rows, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["time,crank_deg,servo_target_deg", *lines]) + "\n")
    joint, servo = inspect_logs([tmp_path / "run.csv"], str(tmp_path / "crank.xml"), tmp_path / "found.yaml")
    assert joint.sure, joint.doubts
    assert servo.sure, servo.doubts
    assert any("jumps by a turn" in reason for reason in joint.reasons)
    spec = load_twin(tmp_path / "found.yaml")
    again = read_measurements(spec, read_flight(tmp_path / "run.csv", None, spec.robot.signals.entries))
    assert is_true(again, truth, turn_crank(0.2, 6.0, 1)[2], 11)


RAIL = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0" limited="true" range="-0.4 0.9"/>
<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody>
<actuator><position name="servo" joint="x" kp="900" kv="60"/></actuator></mujoco>"""


@pytest.mark.parametrize("zero", [0.1, -0.2])
def test_targets_of_a_slide_are_where_it_comes_in_the_end(tmp_path: Path, zero: float) -> None:
    """Steps of more than half of the counter's 0.98 m, between limits that are further apart than that."""
    (tmp_path / "rail.xml").write_text(RAIL)
    (tmp_path / "twin.yaml").write_text("model: rail.xml\nsignals: {joints: {x: /js}, actuators: {servo: /targets}}\n")
    time, place, q, v = np.arange(0.0, 12.0, 0.005), np.zeros(2400), 0.0, 0.0
    target = np.repeat(np.random.default_rng(0).uniform(-0.35, 0.85, 24), 100)
    for i, asked in enumerate(target):
        place[i] = q
        for _ in range(10):
            v += (450.0 * (asked - q) - 30.0 * v) * 5e-4
            q += v * 5e-4
    seen, asked = (np.rint((value - zero) / 1.5e-5) % 65536 * 1.5e-5 + zero for value in (place, target))
    joints = {"/js": {"x": Stream(time, {"position": seen})}, "/targets": {"servo": Stream(time, {"effort": asked})}}
    measured = read_measurements(load_twin(tmp_path / "twin.yaml"), Flight(Path("rail.mcap"), 0, {}, joints))
    np.testing.assert_allclose(measured.positions[0].value, place, atol=2e-5)
    np.testing.assert_allclose(measured.command.value[:, 0], target, atol=2e-5)


@pytest.mark.slow
def test_dry_friction_is_found_behind_an_encoder_that_wraps(tmp_path: Path) -> None:
    """0.3 N m in the crank, its encoder wrapping in mid travel: named, with its size."""
    flights = [replace(log_crank(0.3, 12.0, 13, 0.4, seed)[0], path=Path(f"run_{seed}.mcap")) for seed in (1, 2)]
    verdict = diagnose(write_crank(tmp_path), flights).verdict
    assert verdict.causes[0].effect == "crank.coulomb"
    assert verdict.causes[0].parameters["torque"].value == pytest.approx(0.3, rel=0.1)
    assert any("jumps by a turn" in warning for warning in verdict.warnings)


@pytest.mark.parametrize("low", [-np.pi, 0.0])
def test_angles_of_one_turn_go_on(low: float) -> None:
    """Wherever they jump, with encoder counts and noise; the count is told, and velocities fit what goes on."""
    stream = swing()
    turned = Stream(stream.time, {"position": 20.0 * stream["position"], "velocity": 20.0 * stream["velocity"]})
    logged = (turned["position"] - low) % (2.0 * np.pi) + low
    found, (line,) = unwrap_turns(Stream(stream.time, {**turned.values, "position": logged}), "arm")
    offset = found["position"] - turned["position"]
    np.testing.assert_allclose(offset, offset[0], atol=1e-9)
    assert int(re.search(r"a turn (\d+) times", line)[1]) == np.count_nonzero(np.abs(np.diff(logged)) > np.pi)
    assert vet_joint(found, "arm") == (found, [])


def test_degrees_are_no_angles_of_one_turn() -> None:
    """Quick swings over 2 rad in degrees: neither jumps by a turn nor radians."""
    time = swing().time[::10]
    fast = Stream(time, {"position": np.degrees(np.sin(12.0 * time))})
    found, (line,) = unwrap_turns(fast, "log arm")
    assert found is fast
    assert re.fullmatch(
        r"log arm: position moves \d+ times by more than half a turn from sample to sample; if these are degrees, say "
        r"`unit: deg`",
        line,
    )
    assert unwrap_turns(Stream(time, {"position": np.sin(12.0 * time)}), "arm")[1] == []


def test_what_jumps_by_no_turn_is_left_as_it_is() -> None:
    """A glitch of 4 rad, half a turn, and motion within one."""
    stream = swing()
    for jump in (4.0, 3.3, 0.0):
        position = stream["position"] + jump * (np.arange(len(stream)) == 1000)
        spiked = Stream(stream.time, stream.values | {"position": position})
        assert unwrap_turns(spiked, "arm") == (spiked, [])
