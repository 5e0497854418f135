"""The logs of the independent simulation are what docs/logs.md says, and hold what its sensors saw."""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from proving.drone import Recording, draw_effect, fly, fly_many, write_mcap
from proving.drone.demo import FLIGHTS, FOLDER, HIDDEN, SESSION
from proving.drone.rig import load_nominal

NOMINAL = load_nominal()
CALM = {"gusts": False, "jitter": False, "dropouts": False}


def read_log(path: Path) -> dict[str, list]:
    """Decoded messages by topic as (log time ns, stamp ns, message), by mcap_ros2 rather than by our own code."""
    found = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            stamp = content.header.stamp
            found[channel.topic].append((message.log_time, stamp.sec * 10**9 + stamp.nanosec, content))
    return found


LATE = {"delay": {"mocap.delay": {"delay": 0.0125}}} | {d: {"clock.drift": {"drift": d}} for d in (2e-3, -2e-3)}


@pytest.fixture(scope="module")
def flown() -> dict[str | float, Recording]:
    """Twenty seconds with everything switched on, and calm ones with each of these errors of the tracker's stamps."""
    plan = {"manoeuvre": "aggressive", "duration": 20.0}
    whole = {"effects": {"rail_x.coulomb": {"force": 0.3}}, "seed": 5, **plan}
    calm = [{"effects": effects, "seed": 8, **plan, **CALM} for effects in LATE.values()]
    return dict(zip(("whole", *LATE), fly_many([whole, *calm])))


@pytest.fixture(scope="module")
def aggressive(flown: dict[str | float, Recording]) -> Recording:
    """The flight with everything switched on."""
    return flown["whole"]


@pytest.fixture(scope="module")
def found(log: Path) -> dict[str, list]:
    """Its decoded messages."""
    return read_log(log)


@pytest.fixture(scope="module")
def log(aggressive: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of that flight."""
    return write_mcap(aggressive, tmp_path_factory.mktemp("reality") / "aggressive.mcap")


def test_log_has_the_topics_types_and_rates_of_spec(log: Path, found: dict[str, list]) -> None:
    """ROS 2 profile, zstd, embedded definitions; 1 kHz and 100 Hz; mocap recorded late; under 3 MB for 20 s."""
    assert log.stat().st_size < 3e6
    with log.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    kinds = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    assert kinds == {
        "/mocap/pose": "geometry_msgs/msg/PoseStamped",
        "/imu/data": "sensor_msgs/msg/Imu",
        "/cmd/rate_thrust": "vpptwin_msgs/msg/RateThrust",
        "/rotor/command": "vpptwin_msgs/msg/RotorCommand",
        "/rotor/state": "vpptwin_msgs/msg/RotorState",
        "/setpoint/pose": "geometry_msgs/msg/PoseStamped",
        "/battery": "sensor_msgs/msg/BatteryState",
    }
    for topic, step in (("/imu/data", 10**6), ("/rotor/command", 10**6), ("/cmd/rate_thrust", 10**7)):
        assert set(np.diff([stamp for _, stamp, _ in found[topic]])) == {step}
    mocap = np.array([(logged, stamp) for logged, stamp, _ in found["/mocap/pose"]])
    assert np.median(np.diff(mocap[:, 1])) == pytest.approx(1e7, rel=0.02)
    assert 1900 < len(mocap) <= 2000
    assert 7e6 < (mocap[:, 0] - mocap[:, 1]).mean() < 9e6
    assert len(found["/setpoint/pose"]) > 8


def test_logged_values_are_truth_and_noise(aggressive: Recording, found: dict[str, list]) -> None:
    """Decoded readings minus the true state at their stamps leave white noise of the size in vehicle.yaml."""
    truth, sensors = aggressive.truth, NOMINAL["sensors"]
    gyro = -np.array([m.angular_velocity.y for _, _, m in found["/imu/data"]])
    assert (gyro - truth["velocity"][:, 2]).std() == pytest.approx(sensors["imu"]["gyro_std"], rel=0.03)
    theta, accel = truth["position"][:, 2], truth["acceleration"]
    force_x = accel[:, 0] * np.cos(theta) + (accel[:, 1] + 9.81) * np.sin(theta)
    force_z = (accel[:, 1] + 9.81) * np.cos(theta) - accel[:, 0] * np.sin(theta)
    read = np.array([(m.linear_acceleration.x, m.linear_acceleration.z) for _, _, m in found["/imu/data"]])
    noise = read - np.stack([force_x, force_z], axis=1)
    assert noise.std(0) == pytest.approx([sensors["imu"]["accel_std"]] * 2, rel=0.03)
    assert np.abs(noise.mean(0)).max() < 0.003
    speed = np.array([m.speed for _, _, m in found["/rotor/state"]])
    assert (speed - truth["rotor_speed"]).std() == pytest.approx(sensors["rotor"]["speed_std"], rel=0.03)
    stamps = np.array([stamp - aggressive.start_ns for _, stamp, _ in found["/mocap/pose"]]) * 1e-9
    poses = [m.pose for _, _, m in found["/mocap/pose"]]
    x = np.array([pose.position.x for pose in poses]) - np.interp(stamps, truth["time"], truth["position"][:, 0])
    angle = np.array([-2 * math.atan2(pose.orientation.y, pose.orientation.w) for pose in poses])
    angle = np.angle(np.exp(1j * (angle - np.interp(stamps, truth["time"], theta))))
    # 0.2 ms of stamp jitter at up to 2.5 m/s add some 0.2 mm.
    assert 0.00038 < x.std() < 0.0006
    assert angle.std() == pytest.approx(sensors["mocap"]["angle_std"], rel=0.1)


def test_true_acceleration_is_the_slope_of_velocity(aggressive: Recording) -> None:
    """The accelerometer's truth belongs to its instant: neither half a sample early nor late."""
    velocity, accel = aggressive.truth["velocity"][:, :2], aggressive.truth["acceleration"][:, :2]
    slope = (velocity[2:] - velocity[:-2]) / 0.002
    smooth = np.abs(velocity[1:-1]).min(1) > 0.05  # away from stick and slip
    miss = np.abs(slope - accel[1:-1])[smooth]
    assert np.quantile(miss, 0.99) < 0.02  # m/s^2; the half sample would be 0.05 at the servo's pace


def test_mocap_delay_shows_in_the_log_in_full(flown: dict[str | float, Recording]) -> None:
    """A pose stamped t is the true pose at t - delay, also for fractions of a millisecond."""
    recording = flown["delay"]
    pose, truth = recording.topics["/mocap/pose"], recording.truth
    begun = pose.time > 0.02

    def miss(delay: float) -> float:
        there = np.interp(pose.time[begun] - delay, truth["time"], truth["position"][:, 0])
        return float(np.square(pose.columns["x"][begun] - there).mean())

    delays = np.arange(0.010, 0.015, 0.0001)
    assert delays[np.argmin([miss(d) for d in delays])] == pytest.approx(0.0125, abs=0.0003)


@pytest.mark.parametrize("drift", [2e-3, -2e-3])
def test_mocap_clock_drifts_against_the_onboard_clock(flown: dict[str | float, Recording], drift: float) -> None:
    """A pose stamped t by the mocap's clock is the true pose at t - drift t, and is recorded 8 ms after that."""
    recording = flown[drift]
    pose, truth = recording.topics["/mocap/pose"], recording.truth
    np.testing.assert_allclose(np.diff(pose.time), 0.01, atol=1e-12)  # by its own clock
    # Seen from aboard the frames come faster or slower; a fast clock stops at 20 s of its own.
    assert 19.95 < pose.time[-1] * (1 - drift) < 20.0
    recorded = pose.time + pose.latency - pose.time * (1 - drift)
    assert recorded.mean() == pytest.approx(0.008, abs=2e-4)
    there = np.interp(pose.time * (1 - drift), truth["time"], truth["position"][:, 0])
    assert (pose.columns["x"] - there).std() == pytest.approx(NOMINAL["sensors"]["mocap"]["position_std"], rel=0.1)
    apart = pose.columns["x"] - np.interp(pose.time, truth["time"], truth["position"][:, 0])
    assert np.abs(apart)[pose.time > 9.0].max() > 0.02


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    """A flight depends on its seed alone: not on the run, nor on the flights beside it in a batch."""
    plans = [
        {"effects": draw_effect(np.random.default_rng(k)), "manoeuvre": m, "duration": 2.0, "seed": k}
        for k, m in enumerate(("aggressive", "mixed", "figure"))
    ]
    logs = [write_mcap(r, tmp_path / f"{k}.mcap").read_bytes() for k, r in enumerate(fly_many(plans))]
    again = write_mcap(fly(plans[0]["effects"], "aggressive", 2.0, 0), tmp_path / "again.mcap").read_bytes()
    assert again == logs[0]
    assert len(set(logs)) == 3


@pytest.mark.slow
def test_shipped_demo_flights_are_these(tmp_path: Path) -> None:
    """demo/flights hold what proving/drone/demo.py flies: same messages, each file under 3 MB."""
    for name, _, _, _ in FLIGHTS:
        assert (FOLDER / name).stat().st_size < 3e6
    name, manoeuvre, duration, seed = FLIGHTS[-1]
    fresh = read_log(write_mcap(fly(HIDDEN, manoeuvre, duration, seed, session=SESSION), tmp_path / name))
    shipped = read_log(FOLDER / name)
    assert {topic: len(rows) for topic, rows in fresh.items()} == {t: len(rows) for t, rows in shipped.items()}
    for (_, _, a), (_, _, b) in zip(fresh["/mocap/pose"], shipped["/mocap/pose"]):
        # Another processor's last bit of a sine may grow through the closed loop: no byte comparison.
        assert a.pose.position.x == pytest.approx(b.pose.position.x, abs=0.02)
