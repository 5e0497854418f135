"""Flights: what they log is what the twin does, seen through its sensors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vpptwin.logs.channels import CHANNELS
from vpptwin.robots.planar_drone.pilot.command import Sortie, fly_log
from vpptwin.robots.planar_drone.pilot.flight import SimulatedFlights, fly
from vpptwin.robots.planar_drone.pilot.gusts import CARRIERS, GUST_TIME, GustProcess
from vpptwin.robots.planar_drone.pilot.library import LIBRARY
from vpptwin.robots.planar_drone.pilot.manoeuvre import find_manoeuvre
from vpptwin.robots.planar_drone.pilot.recording import record_streams
from vpptwin.robots.planar_drone.pilot.scripted import ScriptedPilot
from vpptwin.system.errors import InputError
from vpptwin.twin import Twin, load_twin
from vpptwin.twin.spec import EffectValues
from vpptwin.twin.state import TwinState

SPEC = load_twin()
DRONE = SPEC.vehicle
DURATION = 5.0


def steps(duration: float = DURATION) -> ScriptedPilot:
    """A pilot that jumps along x."""
    manoeuvre = find_manoeuvre(LIBRARY, "x_steps")
    return ScriptedPilot(DRONE, [manoeuvre.plan(DRONE, {"period": 1.2}, duration)])


def fly_steps(effects: EffectValues, seed: int = 1, gusts: bool = False) -> SimulatedFlights:
    """The same manoeuvre in a twin with effects."""
    pilot = steps()
    twin = Twin(SPEC.with_effects(effects), 1, active=CARRIERS if gusts else (), num_threads=1)
    return fly(twin, pilot, seed, GustProcess(SPEC, 1, pilot.ticks + 100, seed) if gusts else None)


@pytest.fixture(scope="module")
def nominal() -> SimulatedFlights:
    """A flight of the nominal twin."""
    return fly_steps({})


def test_all_topics_come_at_their_rates(nominal: SimulatedFlights) -> None:
    """Every topic of docs/logs.md but the thrust stand's, from time zero on, at the rates of the table."""
    streams = record_streams(nominal)
    assert set(streams) == set(CHANNELS) - {"/thrust_stand/wrench"}
    rates = {
        "/mocap/pose": 100,
        "/imu/data": 1000,
        "/cmd/rate_thrust": 100,
        "/rotor/command": 1000,
        "/rotor/state": 1000,
    }
    for topic, rate in rates.items():
        time = streams[topic].time
        assert time[0] == 0.0
        np.testing.assert_allclose(np.diff(time), 1.0 / rate, atol=1e-9)
        assert abs(len(time) - rate * DURATION) <= 1
    for topic, stream in streams.items():
        assert {column.name for column in CHANNELS[topic].columns} == set(stream.values)
        assert all(np.isfinite(values).all() for values in stream.values.values())


def test_setpoints_come_on_change(nominal: SimulatedFlights) -> None:
    """A target that stands still is published once."""
    setpoint = record_streams(nominal)["/setpoint/pose"]
    np.testing.assert_allclose(setpoint.time, [0.0, 1.0, 2.2, 3.4, 4.6])
    np.testing.assert_allclose(setpoint["x"], [0.0, 0.6, -0.6, 0.6, -0.6])


def test_readings_are_the_truth_with_the_sensors_noise(nominal: SimulatedFlights) -> None:
    """Poses, rates and rotor speeds scatter about the truth by what the vehicle's file says."""
    streams, lead = record_streams(nominal), nominal.lead[0]
    pose, rate, speed = nominal.pose[0, lead:], nominal.velocity[0, lead:-1, 2], nominal.speed[0, lead:-1]
    sensors = DRONE.sensors
    mocap = streams["/mocap/pose"]
    for i, (name, std) in enumerate((("x", 4e-4), ("z", 4e-4), ("theta", 3e-3))):
        assert (mocap[name] - pose[::10, i]).std() == pytest.approx(std, rel=0.15)
    assert (streams["/imu/data"]["rate"] - rate).std() == pytest.approx(sensors.imu.gyro_std, rel=0.05)
    assert (streams["/rotor/state"]["speed"] - speed).std() == pytest.approx(sensors.rotor.speed_std, rel=0.05)
    # Hovering before the first jump, specific force is gravity along body z.
    still = streams["/imu/data"].time < 0.9
    assert streams["/imu/data"]["accel_z"][still].mean() == pytest.approx(9.81, abs=0.05)
    assert streams["/imu/data"]["accel_x"][still].mean() == pytest.approx(0.0, abs=0.1)


def test_the_accelerometer_agrees_with_the_motion(nominal: SimulatedFlights) -> None:
    """Turned into the world's axes and summed up, it gives the change of velocity."""
    imu, lead = record_streams(nominal)["/imu/data"], nominal.lead[0]
    theta, velocity = nominal.pose[0, lead:-1, 2], nominal.velocity[0, lead:-1]
    a_x = imu["accel_x"] * np.cos(theta) - imu["accel_z"] * np.sin(theta)
    a_z = imu["accel_x"] * np.sin(theta) + imu["accel_z"] * np.cos(theta) - 9.81
    for i, acceleration in enumerate((a_x, a_z)):
        summed = velocity[0, i] + nominal.step * np.cumsum(acceleration)
        # 5000 samples with noise of 0.08 m/s²: 0.006 m/s at the end.
        assert np.abs(summed - velocity[:, i]).max() < 0.03


def test_blade_pitch_and_throttle_are_what_acted(nominal: SimulatedFlights) -> None:
    """The logged commands, replayed from the logged state, lead where the flight went."""
    lead = nominal.lead[0]
    twin = Twin(SPEC, 1, num_threads=1)
    pilot, command = steps(), nominal.command[0, :, None]
    state = twin.initial_state(pilot.target(0))
    for tick in range(nominal.lead[1]):
        twin.advance_policy(state, command[tick])
    span = slice(lead, lead + 500)
    replay = twin.replay_commands(state, nominal.blade_pitch[:, span], None, nominal.throttle[:, span])
    np.testing.assert_allclose(replay.qvel[0, :-1], nominal.velocity[0, lead + 1 : lead + 500], atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "values", "late"),
    [
        ("mocap.delay", {"delay": 0.03}, 0.03),
        ("clock.drift", {"drift": 0.005}, 0.0),
        pytest.param("clock.drift", {"drift": -0.005}, 0.0, marks=pytest.mark.slow),
    ],
)
def test_poses_come_as_late_as_the_twin_says(effect: str, values: dict[str, float], late: float) -> None:
    """A pose stamped t is that of t less delay and drift t; a slow clock's are taken after their stamp."""
    tracks = fly_steps({effect: values})
    mocap, lead = record_streams(tracks)["/mocap/pose"], tracks.lead[0]
    taken = mocap.time - late - values.get("drift", 0.0) * mocap.time
    known = tracks.step * (np.arange(tracks.pose.shape[1]) - lead)
    expected = np.interp(taken, known, tracks.pose[0, :, 0])
    assert (mocap["x"] - expected).std() < 6e-4
    assert taken.max() <= known[-1]


def test_sensors_errors_reach_log_and_pilot() -> None:
    """With a misaligned motion capture the log shows the angle, and the craft, which believes it, leans to hover."""
    tracks = fly_steps({"mocap.misalignment": {"angle": 0.05}, "gyro.bias": {"bias": 0.2}})
    streams, still = record_streams(tracks), slice(0, 900)
    theta = tracks.pose[0, tracks.lead[0] :, 2]
    assert (streams["/mocap/pose"]["theta"][:90] - theta[:900:10]).mean() == pytest.approx(0.05, abs=2e-3)
    rate = tracks.velocity[0, tracks.lead[0] :, 2]
    assert (streams["/imu/data"]["rate"][still] - rate[still]).mean() == pytest.approx(0.2, abs=5e-3)


def test_the_same_seed_gives_the_same_flight(nominal: SimulatedFlights) -> None:
    """Bit-equal again with the same seed, another one with another."""
    again, other = record_streams(fly_steps({})), record_streams(fly_steps({}, seed=2))
    for topic, stream in record_streams(nominal).items():
        for name, values in stream.values.items():
            np.testing.assert_array_equal(again[topic][name], values)
    assert (other["/imu/data"]["rate"] != again["/imu/data"]["rate"]).any()


def test_a_flight_does_not_depend_on_those_beside_it(nominal: SimulatedFlights) -> None:
    """Row 0 of two flights is the flight alone."""
    reference = find_manoeuvre(LIBRARY, "x_steps").plan(DRONE, {"period": 1.2}, DURATION)
    other = find_manoeuvre(LIBRARY, "flip").plan(DRONE, {}, DURATION)
    tracks = fly(Twin(SPEC, 2, num_threads=1), ScriptedPilot(DRONE, [reference, other]), seed=1)
    np.testing.assert_array_equal(tracks.pose[0], nominal.pose[0])
    np.testing.assert_array_equal(tracks.noise.fast[0], nominal.noise.fast[0])


def test_gusts_are_as_strong_and_as_long_as_they_say() -> None:
    """One per cent of the weight, the moment at the end of an arm, alike over 0.3 s; on top of a bias that is there."""
    blown = GustProcess(SPEC.with_effects({"rail_x.bias": {"force": 0.5}}), 40, 3000, seed=5)
    weight = 0.45 * 9.81
    np.testing.assert_allclose(blown.force.std(axis=(0, 1)), 0.01 * weight * np.array([1.0, 1.0, 0.2]), rtol=0.05)
    later = round(GUST_TIME * 100)
    alike = (blown.force[:, later:] * blown.force[:, :-later]).mean(axis=(0, 1)) / (blown.force**2).mean(axis=(0, 1))
    np.testing.assert_allclose(alike, np.exp(-1.0), atol=0.06)
    twin = Twin(SPEC.with_effects({"rail_x.bias": {"force": 0.5}}), 40, CARRIERS, num_threads=1)
    blown.blow(twin, 7)
    np.testing.assert_allclose(twin.parameter("rail_x.bias", "force"), 0.5 + blown.force[:, 7, 0])


def test_gusts_move_the_craft(nominal: SimulatedFlights) -> None:
    """The flight differs, by centimetres at most."""
    away = np.abs(fly_steps({}, gusts=True).pose[0, :, :2] - nominal.pose[0, :, :2]).max()
    assert 1e-3 < away < 0.15


def test_a_twin_that_diverges_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No log of nonsense is written."""
    advance = Twin.advance_policy

    def explode(self: Twin, state: TwinState, command: np.ndarray, duration: float = 0.01) -> None:
        advance(self, state, command, duration)
        if state.time[0] > 1.0:
            state.qvel[:] = np.nan

    monkeypatch.setattr(Twin, "advance_policy", explode)
    with pytest.raises(InputError, match=r"twin nominal diverges 1\.0\d s into the flight"):
        fly_log(steps(), Sortie(SPEC, tmp_path / "flight.mcap", 0, False, {}))
    assert list(tmp_path.iterdir()) == []
