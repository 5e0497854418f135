"""Attitudes and rates that are read otherwise than they were logged are refused with a line that mends them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from _pytest.mark import ParameterSet
from scipy.signal import savgol_filter

from proving import quadrotor
from proving.quadrotor import write_twin
from vpptwin.estimation.checks.orientation import ANGLES, QUATERNIONS, Convention, find_convention
from vpptwin.estimation.measurements import Measurements, read_measurements
from vpptwin.estimation.series import interpolate
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.read import read_flight
from vpptwin.logs.streams.samples import euler_to_quaternion
from vpptwin.system.errors import InputError
from vpptwin.twin import TwinSpec, load_twin
from vpptwin.twin.robot.manifold import multiply_attitudes, read_angles, rotate, turn_to_world

COLUMNS = {"attitude": ["a", "b", "c", "d"], "rate": ["gx", "gy", "gz"]}


def name(reading: Convention) -> str:
    """Short, for a test's."""
    return "".join("wxyz"[i] if sign > 0.0 else f"-{'wxyz'[i]}" for i, sign in zip(reading.order, reading.signs))


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> TwinSpec:
    """The nominal quadrotor."""
    return load_twin(write_twin(tmp_path_factory.mktemp("quadrotor")))


@cache
def fly(seed: int) -> Flight:
    """Ten seconds, flown once."""
    return quadrotor.fly({}, 10.0, seed)


def log(columns: Mapping[str, np.ndarray], seed: int = 3, rates: bool = True) -> Flight:
    """A flight with other attitudes or rates; without its IMU if need be."""
    flown = fly(seed)
    pose, imu = flown.spatial["/pose"], flown.spatial["/imu"]
    pose = Stream(pose.time, pose.values | {k: v for k, v in columns.items() if k == "attitude"})
    imu = Stream(imu.time, imu.values | {k: v for k, v in columns.items() if k == "rate"})
    return replace(flown, spatial={"/pose": pose, **({"/imu": imu} if rates else {})})


def misorder(attitude: np.ndarray, reading: Convention) -> np.ndarray:
    """Attitudes as a log has them that must be read so."""
    logged = np.empty_like(attitude)
    logged[:, reading.order] = attitude * reading.signs
    return logged


def mend(folder: Path, flown: Flight, error: InputError | None, entries: Mapping[str, object] = {}) -> Measurements:
    """What is read of the flight as one table, with the line of an error in the twin."""
    pose, imu = flown.spatial["/pose"], flown.spatial["/imu"]
    columns = {"time": pose.time} | dict(zip(("x", "y", "z"), pose["position"].T, strict=True))
    columns |= dict(zip(COLUMNS["attitude"], pose["attitude"].T, strict=False))
    columns |= dict(zip(COLUMNS["rate"], interpolate(pose.time, imu.time, imu["rate"]).T, strict=True))
    columns |= {f"m{i}": flown.joints["/motors"][f"m{i}"]["effort"][::5] for i in range(1, 5)}
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "flight.csv", table, delimiter=",", header=",".join(columns), comments="")
    told = dict(COLUMNS | dict(entries))
    if error is not None:
        told |= yaml.safe_load(error.action.split("`")[1])
    topic = {"topic": "flight"}
    signals = {
        "bodies": {"quad": {**topic, "position": ["x", "y", "z"], "attitude": told["attitude"]}},
        "sites": {"imu": {**topic, "rate": told["rate"]}},
        "actuators": {f"m{i}": {**topic, "effort": f"m{i}"} for i in range(1, 5)},
    }
    write_twin(folder)
    (folder / "twin.yaml").write_text(yaml.safe_dump({"model": "quadrotor.xml", "signals": signals}))
    twin = load_twin(folder / "twin.yaml")
    return read_measurements(twin, read_flight(folder / "flight.csv", signals=twin.robot.signals.entries))


def check_mended(folder: Path, flown: Flight, entries: Mapping[str, object] = {}, seed: int = 3) -> None:
    """A table is refused, and read as the truth with the line that the refusal gives."""
    truth = read_measurements(load_twin(write_twin(folder)), log({}, seed))
    with pytest.raises(InputError) as refused:
        mend(folder, flown, None, entries)
    read = mend(folder, flown, refused.value, entries)
    assert np.abs((read.attitudes[3].value * truth.attitudes[3].value).sum(axis=1)).min() > 1.0 - 1e-9
    for dof in (3, 4, 5):
        rate = np.interp(read.velocities[dof].time, truth.velocities[dof].time, truth.velocities[dof].value)
        assert np.sqrt(np.mean((read.velocities[dof].value - rate) ** 2)) < 0.08  # of 1.5 rad/s, logged at 100 Hz


def some(readings: Sequence[Convention], often: int) -> list[ParameterSet]:
    """Parameters of a test: some in every run, all others `slow`."""
    return [pytest.param(r, id=name(r), marks=[pytest.mark.slow] * (i >= often)) for i, r in enumerate(readings)]


@pytest.mark.parametrize("reading", some(QUATERNIONS, 3))
def test_quaternions_in_another_order_or_sense_are_refused(tmp_path: Path, reading: Convention) -> None:
    """Whichever cyclic order and sense, by the gyro or the motors' push; the line in the message mends it."""
    flown = log({})
    attitude = flown.spatial["/pose"]["attitude"]
    flipped = attitude * np.where(np.arange(len(attitude)) % 7 < 3, 1.0, -1.0)[:, None]  # q and -q are one
    check_mended(tmp_path, log({"attitude": misorder(flipped, reading)}))


@pytest.mark.parametrize("reading", some(QUATERNIONS, 3))
def test_without_a_gyro_what_pushes_tells_the_order(spec: TwinSpec, reading: Convention) -> None:
    """A craft goes where its motors push it."""
    bare = spec.with_robot(signals=spec.robot.signals.model_copy(update={"sites": {}}))
    attitude = log({}).spatial["/pose"]["attitude"]
    read_measurements(bare, log({}, rates=False))
    with pytest.raises(InputError, match=r"fit the push of its actuators.*; write `attitude: "):
        read_measurements(bare, log({"attitude": misorder(attitude, reading)}, rates=False))


@pytest.mark.parametrize("reading", QUATERNIONS[:4], ids=name)
def test_without_motors_an_accelerometer_tells_the_order(spec: TwinSpec, reading: Convention) -> None:
    """What it feels is what bends the track, and the weight; a gyro that shows nothing but noise does not say no."""
    flown = log({})
    pose = flown.spatial["/pose"]
    track = savgol_filter(pose["position"], 25, 3, axis=0)
    bent = savgol_filter(pose["position"], 25, 3, deriv=2, delta=0.01, axis=0)
    felt = turn_to_world(pose["attitude"] * [1.0, -1.0, -1.0, -1.0], bent + np.array([0.0, 0.0, 9.81]))
    noise = 0.01 * np.random.default_rng(1).standard_normal(felt.shape)
    imu = Stream(pose.time, {"rate": noise, "acceleration": felt})
    bare = spec.with_robot(signals=spec.robot.signals.model_copy(update={"actuators": {}}))
    for attitude in (pose["attitude"], misorder(pose["attitude"], reading)):
        wrong = replace(
            flown, spatial={"/pose": Stream(pose.time, {"position": track, "attitude": attitude}), "/imu": imu}
        )
        if attitude is pose["attitude"]:
            assert read_measurements(bare, wrong).attitudes
        else:
            with pytest.raises(InputError, match=r"fit the accelerometer \("):
                read_measurements(bare, wrong)


def test_a_brick_that_tumbles_about_an_axis_has_its_rates_in_the_world() -> None:
    """Thrown for 2.5 s, by Euler's equations: rates about the world's axes are no attitude in another order."""
    inertia, step, spin = np.array([0.02, 0.035, 0.05]), 1e-3, np.array([3.0, 0.4, 0.7])
    attitude, track, rates = np.array([1.0, 0.0, 0.0, 0.0]), [], []
    for _ in range(2500):
        half = spin - 0.5 * step * np.cross(spin, inertia * spin) / inertia
        attitude, spin = rotate(attitude, step * half), spin - step * np.cross(half, inertia * half) / inertia
        track.append(attitude)
        rates.append(spin)
    rng, time, turned = np.random.default_rng(2), step * np.arange(2500)[::5], np.array(track)[::5]
    seen = rotate(turned, 2e-3 * rng.standard_normal((500, 3)))
    body = np.array(rates)[::5] + 0.01 * rng.standard_normal((500, 3))
    assert find_convention((time, seen), (time, body)) is None
    found = find_convention((time, seen), (time, turn_to_world(turned, body)))
    assert found is not None
    assert (found.of, found.frame) == ("frame", "world")
    assert find_convention((time, seen), (time, turn_to_world(turned, body)), "world") is None


@pytest.mark.parametrize("reading", some([each for each in ANGLES if np.prod(each.signs) < 0.0], 2))
def test_angles_of_the_other_sign_are_refused(tmp_path: Path, reading: Convention) -> None:
    """Pitch of a Crazyflie has it: roll, pitch, yaw as logged turn otherwise than the gyro."""
    angles = reading.read(read_angles(log({}).spatial["/pose"]["attitude"]))
    check_mended(tmp_path, log({"attitude": angles}), {"attitude": ["a", "b", "c"]})


@pytest.mark.parametrize("frame", ["world", "euler"])
def test_rates_about_other_axes_are_refused_and_can_be_mapped(tmp_path: Path, frame: str) -> None:
    """Those of motion capture about the world's axes, and slopes of roll, pitch and yaw; said rightly they do."""
    flown = log({}, 5)
    pose, imu = flown.spatial["/pose"], flown.spatial["/imu"]
    attitude = interpolate(imu.time, pose.time, pose["attitude"])
    rate = turn_to_world(attitude, imu["rate"])
    if frame == "euler":
        (roll, pitch, _), (x, y, z) = read_angles(attitude).T, imu["rate"].T
        yawed = (y * np.sin(roll) + z * np.cos(roll)) / np.cos(pitch)
        rate = np.column_stack([x + yawed * np.sin(pitch), y * np.cos(roll) - z * np.sin(roll), yawed])
    turned = log({"rate": rate}, 5)
    check_mended(tmp_path, turned, seed=5)
    said = {"rate": {"path": COLUMNS["rate"], "frame": frame}}
    with pytest.raises(InputError, match="only if they are about the body's axes"):
        mend(tmp_path, flown, None, said)


@pytest.mark.parametrize(
    "wrong", [Convention("rate", (0, 1, 2), (1.0, -1.0, 1.0)), Convention("rate", (1, 0, 2), 3 * (1.0,))]
)
def test_a_mirrored_gyro_is_refused(tmp_path: Path, wrong: Convention) -> None:
    """An axis turned round, or two swapped: no mount does that."""
    check_mended(tmp_path, log({"rate": wrong.read(log({}).spatial["/imu"]["rate"])}))


def test_a_gyro_may_be_mounted_any_way(spec: TwinSpec) -> None:
    """Turned axes are no other order, and attitudes that are late are none either."""
    flown = log({})
    turned = turn_to_world(np.array([[0.5, 0.5, 0.5, 0.5]]), flown.spatial["/imu"]["rate"])
    late = replace(flown.spatial["/pose"], time=flown.spatial["/pose"].time + 0.08)
    for spatial in ({"/imu": Stream(flown.spatial["/imu"].time, {"rate": turned})}, {"/pose": late}):
        assert read_measurements(spec, replace(flown, spatial={**flown.spatial, **spatial})).velocities


def test_what_hardly_turns_is_not_judged(spec: TwinSpec) -> None:
    """About one axis every order looks alike; nothing false is said."""
    flown = log({})
    pose = flown.spatial["/pose"]
    yaw = np.column_stack([0.0 * pose.time, 0.0 * pose.time, np.sin(pose.time)])
    rate = np.column_stack([0.0 * yaw[:, :2], np.cos(pose.time)])
    spatial = {"/pose": Stream(pose.time, pose.values | {"attitude": euler_to_quaternion(yaw)}),
               "/imu": Stream(pose.time, {"rate": rate})}  # fmt: skip
    bare = spec.with_robot(signals=spec.robot.signals.model_copy(update={"actuators": {}}))
    assert read_measurements(bare, replace(flown, spatial=spatial)).attitudes


def test_a_heading_that_turns_too_far_is_no_unit(spec: TwinSpec) -> None:
    """Of wheels that slip, six times: no scale is asked for, and no unit named."""
    rate = log({}).spatial["/imu"]["rate"] / 6.0
    with pytest.raises(InputError, match=r"0.167 times the turning of the attitudes, which is no unit") as refused:
        read_measurements(spec, log({"rate": rate}))
    assert "`unit:" not in str(refused.value)


POST = np.array([0.85, 0.2, 0.1, 0.0]) / np.linalg.norm([0.85, 0.2, 0.1])
SWING = f"""<mujoco><worldbody><body pos="0 0 2" quat="{" ".join(map(str, POST))}"><body name="rod">
<joint name="hip" type="ball"/><inertial pos="0 0 -0.3" mass="0.8" diaginertia="0.02 0.03 0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.6" size="0.01" mass="0"/><site name="imu"/>
</body></body></worldbody></mujoco>"""


def swing() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A rod that hangs by a ball joint: times, attitudes in the world, rates about its axes, by steps of 1 ms."""
    centre, attitude, spin = np.array([0.0, 0.0, -0.3]), np.array([0.9, 0.36, 0.2, 0.14]), np.array([0.5, 1.5, 2.0])
    inertia = np.diag([0.02, 0.03, 0.01]) + 0.8 * np.diag([0.09, 0.09, 0.0])
    track, rates = [], []

    def turn(attitude: np.ndarray, spin: np.ndarray) -> np.ndarray:
        weight = 0.8 * turn_to_world(attitude * [1.0, -1.0, -1.0, -1.0], np.array([0.0, 0.0, -9.81]))
        return np.linalg.solve(inertia, np.cross(centre, weight) - np.cross(spin, inertia @ spin))

    for _ in range(6000):
        half = spin + 5e-4 * turn(attitude, spin)
        middle = rotate(attitude, 5e-4 * spin)
        attitude, spin = rotate(attitude, 1e-3 * half), spin + 1e-3 * turn(middle, half)
        track.append(attitude)
        rates.append(spin)
    rng = np.random.default_rng(3)
    seen = rotate(np.array(track)[::10], 2e-3 * rng.standard_normal((600, 3)))
    return 1e-2 * np.arange(600), seen, np.array(rates)[::10] + 0.01 * rng.standard_normal((600, 3))


def test_what_hangs_by_a_ball_joint_is_told_too(tmp_path: Path) -> None:
    """Attitudes from a parent that is tilted, w last, or rates about the world's axes: refused, and mended."""
    time, seen, rates = swing()
    logged = multiply_attitudes(POST * [1.0, -1.0, -1.0, -1.0], seen)
    (tmp_path / "rod.xml").write_text(SWING)

    def read(attitude: np.ndarray, rate: np.ndarray, order: str, frame: str) -> Measurements:
        table = np.column_stack([time, attitude, rate])
        np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time,a,b,c,d,gx,gy,gz", comments="")
        joint = f"{{hip: {{topic: log, attitude: {order}}}}}"
        site = f"{{imu: {{topic: log, rate: {{path: [gx, gy, gz], frame: {frame}}}}}}}"
        (tmp_path / "t.yaml").write_text(f"model: rod.xml\nsignals: {{joints: {joint}, sites: {site}}}\n")
        twin = load_twin(tmp_path / "t.yaml")
        return read_measurements(twin, read_flight(tmp_path / "log.csv", signals=twin.robot.signals.entries))

    last, world = np.roll(logged, -1, axis=1), turn_to_world(seen, rates)
    with pytest.raises(InputError, match=r"write `attitude: \[d, a, b, c\]` for hip"):
        read(last, rates, "[a, b, c, d]", "body")
    with pytest.raises(InputError, match=r"frame: world}` for imu"):
        read(logged, world, "[a, b, c, d]", "body")
    for found in (read(last, rates, "[d, a, b, c]", "body"), read(logged, world, "[a, b, c, d]", "world")):
        assert np.abs((found.attitudes[0].value * logged).sum(axis=1)).min() > 1.0 - 1e-9
        turned = np.column_stack([found.velocities[dof].value for dof in range(3)])
        np.testing.assert_allclose(turned, rates, atol=0.02)


def test_a_body_may_have_rates_of_its_own(tmp_path: Path) -> None:
    """Without an IMU in the model, about the world's axes, as motion capture has them."""
    flown = log({})
    pose, imu = flown.spatial["/pose"], flown.spatial["/imu"]
    rate = turn_to_world(interpolate(imu.time, pose.time, pose["attitude"]), imu["rate"])
    mend_as = {"rate": {"path": COLUMNS["rate"], "frame": "world"}}
    mend(tmp_path, replace(flown, spatial={"/pose": pose, "/imu": Stream(imu.time, {"rate": rate})}), None, mend_as)
    content = yaml.safe_load((tmp_path / "twin.yaml").read_text())
    content["signals"]["bodies"]["quad"]["rate"] = content["signals"].pop("sites")["imu"]["rate"]
    (tmp_path / "twin.yaml").write_text(yaml.safe_dump(content))
    twin = load_twin(tmp_path / "twin.yaml")
    read = read_measurements(twin, read_flight(tmp_path / "flight.csv", signals=twin.robot.signals.entries))
    for dof in (3, 4, 5):
        truth = np.interp(read.velocities[dof].time, imu.time, imu["rate"][:, dof - 3])
        assert np.sqrt(np.mean((read.velocities[dof].value - truth) ** 2)) < 0.03
    frameless = yaml.safe_dump(content).replace("world", "moon")
    (tmp_path / "twin.yaml").write_text(frameless)
    with pytest.raises(InputError, match="frame"):
        load_twin(tmp_path / "twin.yaml")
