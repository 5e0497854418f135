"""The independent simulation does what physics says, and its logs are what SPEC 3 says."""

from __future__ import annotations

import math
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tests.reality import CORE, EFFECTS, Recording, draw_effect, fly, fly_many, write_mcap
from tests.reality.demo import FLIGHTS, FOLDER, HIDDEN, SESSION
from tests.reality.effects import Effects
from tests.reality.plant import Plant
from tests.reality.rig import Rig, load_nominal
from tests.reality.rotor import NODES, SUBSTEPS, Servo

NOMINAL = load_nominal()
CALM = {"gusts": False, "jitter": False, "dropouts": False}


def glide(effects: Effects, state: list[float], thrust: float, duration: float) -> np.ndarray:
    """Positions and velocities (steps + 1, 6) under a constant force along body z, N, without moment."""
    plant = Plant(Rig([effects], [None]), np.array(state[:3])[:, None], np.array(state[3:])[:, None])
    thrusts = np.full((len(NODES), 2, 1), thrust / 2)
    path = [np.append(plant.position, plant.velocity)]
    for _ in range(round(duration * 1000)):
        plant.advance(thrusts, np.full_like(thrusts, 471.0), np.zeros((SUBSTEPS, 3, 1)))
        path.append(np.append(plant.position, plant.velocity))
    return np.array(path)


def read_log(path: Path) -> dict[str, list]:
    """Decoded messages by topic as (log time ns, stamp ns, message), by mcap_ros2 rather than by our own code."""
    found = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            stamp = content.header.stamp
            found[channel.topic].append((message.log_time, stamp.sec * 10**9 + stamp.nanosec, content))
    return found


@pytest.fixture(scope="module")
def aggressive() -> Recording:
    """Twenty seconds with everything switched on."""
    return fly({"rail_x.coulomb": {"force": 0.3}}, "aggressive", 20.0, 5)


@pytest.fixture(scope="module")
def found(log: Path) -> dict[str, list]:
    """Its decoded messages."""
    return read_log(log)


@pytest.fixture(scope="module")
def log(aggressive: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of that flight."""
    return write_mcap(aggressive, tmp_path_factory.mktemp("reality") / "aggressive.mcap")


def test_nothing_of_vpptwin_is_imported() -> None:
    """The simulation shares no physics with what it tests."""
    code = "import sys, tests.reality; print([m for m in sys.modules if m.split('.')[0] in ('vpptwin', 'mujoco')])"
    root = Path(__file__).resolve().parents[1]
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root, check=True)
    assert found.stdout.strip() == "[]"


def test_thrown_craft_follows_the_parabola() -> None:
    """Without thrust and effects the craft falls freely, spins evenly and keeps its energy."""
    path = glide({}, [-0.5, 1.0, 0.3, 0.6, 3.0, 4.0], 0.0, 0.5)
    time = np.arange(len(path)) * 0.001
    np.testing.assert_allclose(path[:, 0], -0.5 + 0.6 * time, atol=1e-12)
    np.testing.assert_allclose(path[:, 1], 1.0 + 3.0 * time - 4.905 * time**2, atol=1e-12)  # midpoint rule: exact
    np.testing.assert_allclose(path[:, 2], 0.3 + 4.0 * time, atol=1e-12)
    energy = 0.5 * 0.5 * path[:, 4] ** 2 + 0.5 * 9.81 * path[:, 1]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)


@pytest.mark.parametrize(
    ("effects", "terminal"),
    [
        ({"rail_z.viscous": {"damping": 10.0}}, 4.905 / 10.0),  # b v = m g, m = 0.45 + 0.05 kg
        ({"air.drag": {"k_d": 20.0}}, math.sqrt(4.905 / 20.0)),  # k_d v^2 = m g
        ({"rail_z.coulomb": {"force": 1.0}, "rail_z.viscous": {"damping": 10.0}}, 3.905 / 10.0),
    ],
)
def test_terminal_velocity(effects: Effects, terminal: float) -> None:
    """A falling craft reaches the speed at which its drag carries its weight."""
    path = glide(effects, [0.0, 2.0, 0.0, 0.0, 0.0, 0.0], 0.0, 1.5)
    assert path[-1, 4] == pytest.approx(-terminal, rel=1e-6)


@pytest.mark.parametrize("effect", [{"rail_x.coulomb": {"force": 0.3}}, {"rail_x.stiction": {"force": 0.3}}])
def test_below_breakaway_nothing_moves(effect: Effects) -> None:
    """A slider pushed with 97 % of breakaway stands exactly still, and creeps off at 103 %."""
    for share, stays in ((0.97, True), (1.03, False)):
        push = 0.3 * share
        angle = -math.atan2(push, 4.905)  # thrust carries the weight and pushes to the right
        path = glide(effect, [0.1, 1.0, angle, 0.0, 0.0, 0.0], math.hypot(push, 4.905), 1.0)
        assert (np.ptp(path[:, 0]) == 0.0) == stays


def test_friction_stops_a_slider_where_work_says() -> None:
    """Sliding at 1 m/s, 0.58 kg against 2 N stop after m v^2 / (2 F) = 0.145 m, for good."""
    path = glide({"rail_x.coulomb": {"force": 2.0}}, [-0.2, 1.0, 0.0, 1.0, 0.0, 0.0], 4.905, 0.6)
    assert path[-1, 0] + 0.2 == pytest.approx(0.145, abs=1e-6)
    assert path[int(0.58 / 2.0 * 1000) + 1, 3] == 0.0  # m v / F = 0.29 s


def test_servo_step_is_exact_between_milliseconds() -> None:
    """A command reaches the blade after exactly its delay, 7.3 ms, then with the lag of 35 ms."""
    effects = {"command.delay": {"delay": 0.0073}, "servo.lag": {"time_constant": 0.035}}
    servo = Servo(Rig([effects], [None]), np.zeros((2, 1)))
    pitch = np.array([servo.advance(np.full((2, 1), 0.1))[:, 0, 0] for _ in range(40)])
    time = np.arange(40)[:, None] * 0.001 + NODES
    expected = 0.1 * (1 - np.exp(-np.maximum(time - 0.0073, 0.0) / 0.035))
    np.testing.assert_allclose(pitch, expected, atol=1e-12)


def replay(effects: Effects, recording: Recording, start: int, steps: int) -> list[float]:
    """Replay recorded commands from the true state with a scalar RK4 at 0.1 ms; returns x, z, theta at the end."""
    rotor, motor = NOMINAL["rotor"], NOMINAL["motor"]
    lag = effects["servo.lag"]["time_constant"]
    delay, damping = effects["command.delay"]["delay"], effects["rail_x.viscous"]["damping"]
    drag = effects["air.drag"]["k_d"]
    columns = recording.topics["/rotor/command"].columns

    def slope(state: list[float], pitch: tuple, throttle: tuple) -> list[float]:
        _, _, theta, vx, vz, q, a1, a2, w1, w2 = state
        f1, f2 = rotor["k_t"] * w1 * a1, rotor["k_t"] * w2 * a2
        speed = math.hypot(vx, vz)
        rates = [vx, vz, q]
        rates.append((-(f1 + f2) * math.sin(theta) - damping * vx - drag * speed * vx) / 0.58)
        rates.append((((f1 + f2) * math.cos(theta) - drag * speed * vz) / 0.5) - 9.81)
        rates.append((f2 - f1) * 0.2 / 0.006)
        rates += [(u - a) / lag for u, a in zip(pitch, (a1, a2))]
        for w, a, u in ((w1, a1, throttle[0]), (w2, a2, throttle[1])):
            torque = (
                (u * motor["battery"] - w / motor["k_v"]) / motor["resistance"] - motor["no_load_current"]
            ) / 115.0
            load = rotor["k_d1"] * w**2 + rotor["k_d2"] * w**2 * a**2 + rotor["k_d3"] * w * abs(a)
            rates.append((torque - load) / rotor["inertia"])
        return rates

    truth, step = recording.truth, 1e-4
    state = [*truth["position"][start], *truth["velocity"][start]]
    state += [*truth["blade_pitch"][start], *truth["rotor_speed"][start]]
    for n in range(steps * 10):
        now = start + n // 10
        late = math.floor(start + n / 10 - delay * 1000 + 1e-9)
        pitch = columns["blade_pitch_1"][late], columns["blade_pitch_2"][late]
        throttle = columns["throttle_1"][now], columns["throttle_2"][now]
        k1 = slope(state, pitch, throttle)
        k2 = slope([s + step / 2 * k for s, k in zip(state, k1)], pitch, throttle)
        k3 = slope([s + step / 2 * k for s, k in zip(state, k2)], pitch, throttle)
        k4 = slope([s + step * k for s, k in zip(state, k3)], pitch, throttle)
        state = [s + step / 6 * (a + 2 * b + 2 * c + d) for s, a, b, c, d in zip(state, k1, k2, k3, k4)]
    return state[:3]


def test_recorded_commands_reproduce_the_flight() -> None:
    """Stamps mean what SPEC 2 says: the logged commands, replayed by another integrator, give the same flight."""
    effects = {
        "command.delay": {"delay": 0.0063},
        "servo.lag": {"time_constant": 0.03},
        "rail_x.viscous": {"damping": 0.5},
        "air.drag": {"k_d": 0.2},
    }
    recording = fly(effects, "aggressive", 2.5, 3, **CALM)
    moved = np.ptp(recording.truth["position"][1000:2300], axis=0)
    assert moved.max() > 0.3
    end = replay(effects, recording, 1000, 1000)
    # 0.25 ms midpoint against 0.1 ms RK4 over 1 s; half a millisecond of lag would show as some 1e-3.
    np.testing.assert_allclose(end, recording.truth["position"][2000], atol=3e-5)


def test_true_acceleration_is_the_slope_of_velocity(aggressive: Recording) -> None:
    """The accelerometer's truth belongs to its instant: neither half a sample early nor late."""
    velocity, accel = aggressive.truth["velocity"][:, :2], aggressive.truth["acceleration"][:, :2]
    slope = (velocity[2:] - velocity[:-2]) / 0.002
    smooth = np.abs(velocity[1:-1]).min(1) > 0.05  # away from stick and slip
    miss = np.abs(slope - accel[1:-1])[smooth]
    assert np.quantile(miss, 0.99) < 0.02  # m/s^2; the half sample would be 0.05 at the servo's pace


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


def test_mocap_delay_shows_in_the_log_in_full() -> None:
    """A pose stamped t is the true pose at t - delay, also for fractions of a millisecond."""
    recording = fly({"mocap.delay": {"delay": 0.0125}}, "aggressive", 6.0, 8, **CALM)
    pose, truth = recording.topics["/mocap/pose"], recording.truth
    late = pose.time > 0.02

    def miss(delay: float) -> float:
        there = np.interp(pose.time[late] - delay, truth["time"], truth["position"][:, 0])
        return float(np.square(pose.columns["x"][late] - there).mean())

    delays = np.arange(0.010, 0.015, 0.0001)
    assert delays[np.argmin([miss(d) for d in delays])] == pytest.approx(0.0125, abs=0.0003)


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


def test_inverted_hover_holds() -> None:
    """After a half flip the craft hangs upside down on negative blade pitch for over a second, then turns back."""
    truth = fly({}, "flip", 7.0, 4).truth
    start = np.flatnonzero(np.cos(truth["position"][:, 2]) < -0.97)[0]
    hold = slice(start + 600, start + 1600)
    assert (np.cos(truth["position"][hold, 2]) < -0.97).all()
    assert (truth["blade_pitch"][hold] < -0.05).all()
    assert np.abs(truth["velocity"][hold, :2]).max() < 0.5
    assert np.cos(truth["position"][-1, 2]) > 0.97


def test_every_hidden_effect_can_be_flown() -> None:
    """With each effect at the ends of its range the craft keeps off the end stops, the floor and the wall."""
    plans = [
        {
            "effects": {effect: {name: size.spans[end][end] for name, size in sizes.items()}},
            "manoeuvre": manoeuvre,
            "duration": 8.0,
            "seed": 40 + number,
        }
        for manoeuvre in ("aggressive", "mixed", "flip")
        for number, (effect, sizes) in enumerate(CORE.items())
        for end in (0, -1)
    ]
    for recording in fly_many(plans):
        x, z, _ = recording.truth["position"].T
        assert np.abs(x).max() < 1.4, recording.effects
        assert z.min() > 0.2, recording.effects
        assert z.max() < 2.4, recording.effects


def test_every_effect_changes_the_flight() -> None:
    """Each effect, flown with the same seed as a flight without, shows in at least one topic."""
    rng = np.random.default_rng(6)
    hidden = [{effect: {name: size.draw(rng) for name, size in sizes.items()}} for effect, sizes in EFFECTS.items()]
    for effects in hidden:
        if "alien.mass_drop" in effects:
            effects["alien.mass_drop"]["time"] = 2.0
    # Seed 52 turns upside down and passes low within its first 8.5 s.
    flights = [{"effects": e, "manoeuvre": "mixed", "duration": 8.5, "seed": 52} for e in [{}, *hidden]]
    plain, *others = fly_many(flights)
    for other in others:
        apart = [
            np.abs(other.topics[topic].columns[column] - plain.topics[topic].columns[column]).mean() / noise
            for topic, column, noise in (
                ("/mocap/pose", "x", 0.0004),
                ("/mocap/pose", "qy", 0.0015),
                ("/mocap/pose", "z", 0.0004),
                ("/rotor/state", "current_1", 0.05),
                ("/rotor/command", "throttle_1", 0.002),
            )
        ]
        assert max(apart) > 2.0, other.effects


def test_shipped_demo_flights_are_these(tmp_path: Path) -> None:
    """demo/flights hold what tests/reality/demo.py flies: same messages, each file under 3 MB."""
    for name, _, _, _ in FLIGHTS:
        assert (FOLDER / name).stat().st_size < 3e6
    name, manoeuvre, duration, seed = FLIGHTS[-1]
    fresh = read_log(write_mcap(fly(HIDDEN, manoeuvre, duration, seed, session=SESSION), tmp_path / name))
    shipped = read_log(FOLDER / name)
    assert {topic: len(rows) for topic, rows in fresh.items()} == {t: len(rows) for t, rows in shipped.items()}
    for (_, _, a), (_, _, b) in zip(fresh["/mocap/pose"], shipped["/mocap/pose"]):
        # Another processor's last bit of a sine may grow through the closed loop: no byte comparison.
        assert a.pose.position.x == pytest.approx(b.pose.position.x, abs=0.02)


def test_unknown_effects_are_refused() -> None:
    """A slip in an id or a parameter name must not fly a rig without the effect."""
    with pytest.raises(ValueError, match="unknown effect"):
        fly({"rail_x.colomb": {"force": 0.3}}, "hover", 1.0, 0)
    with pytest.raises(ValueError, match="no parameter"):
        fly({"rail_x.coulomb": {"friction": 0.3}}, "hover", 1.0, 0)
