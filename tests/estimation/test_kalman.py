"""The Kalman filter on flights of the independent simulation: consistent, closer than its sensors, sure in dropouts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2

from proving.drone.flight import FlightPlan, fly_many
from proving.drone.recording import Recording
from vpptwin.robots.planar_drone.kalman import BIAS_X, DEPTH, GIVE_UP, GYRO_BIAS, FilterNoise, KalmanFilter
from vpptwin.robots.planar_drone.vehicle import load_vehicle

VEHICLE = load_vehicle()
NOISE = FilterNoise.of_vehicle(VEHICLE)
DT, SETTLED = 0.001, 1.0
BIAS = 0.03  # rad/s, hidden in the gyro of the last flight
PLANS: list[FlightPlan] = [
    {"effects": {}, "manoeuvre": "flip", "duration": 8.0, "seed": 1},
    {"effects": {}, "manoeuvre": "aggressive", "duration": 8.0, "seed": 2},
    {"effects": {"gyro.bias": {"bias": BIAS}, "rail_x.coulomb": {"force": 0.3}}, "manoeuvre": "mixed",
     "duration": 8.0, "seed": 3},
]  # fmt: skip


@dataclass(frozen=True)
class Estimated:
    """What a filter made of a flight."""

    time: np.ndarray  # (n,) s
    error: np.ndarray  # of x, z, θ, v_x, v_z, q, (n, 6)
    surprise: np.ndarray  # normalized innovations squared, (m,)
    used: np.ndarray  # when each pose arrived, (m,) s
    filter: KalmanFilter  # at the end


def read(flight: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gyro (n,), accelerometer (n, 2), poses (m, 3), their stamps and arrivals (m,)."""
    imu, mocap = flight.topics["/imu/data"], flight.topics["/mocap/pose"]
    angle = 2.0 * np.arctan2(-mocap.columns["qy"], mocap.columns["qw"])
    pose = np.stack([mocap.columns["x"], mocap.columns["z"], angle], axis=1)
    accel = np.stack([imu.columns["ax"], imu.columns["az"]], axis=1)
    return -imu.columns["wy"], accel, pose, mocap.time, mocap.time + mocap.latency


def estimate(flight: Recording, dropout: tuple[float, float] | None = None) -> Estimated:
    """Run the filter as a flight computer would, poses as they arrive, late and out of step with the IMU."""
    gyro, accel, pose, stamp, arrival = read(flight)
    kalman = KalmanFilter(1, DT, VEHICLE.gravity, NOISE)
    shown = np.zeros((len(gyro), 6))
    surprise, used, j = [], [], 0
    for k in range(1, len(gyro)):
        kalman.predict(0.5 * (gyro[k - 1 : k] + gyro[k : k + 1]), 0.5 * (accel[k - 1 : k] + accel[k : k + 1]))
        while j < len(arrival) and arrival[j] <= k * DT:
            if dropout is None or not dropout[0] <= stamp[j] < dropout[1]:
                surprise.append(float(kalman.correct(pose[j : j + 1], k * DT - stamp[j])[0]))
                used.append(k * DT)
            j += 1
        shown[k] = *kalman.pose[0], *kalman.velocity[0]
    truth = np.concatenate([flight.truth["position"], flight.truth["velocity"]], axis=1)
    return Estimated(flight.truth["time"], shown - truth, np.array(surprise), np.array(used), kalman)


@pytest.fixture(scope="module")
def flights() -> list[Recording]:
    """Three flights with noise, late and jittering poses, dropouts, gusts, tolerances."""
    return fly_many(PLANS)


@pytest.fixture(scope="module")
def estimates(flights: list[Recording]) -> list[Estimated]:
    """What the filter makes of them."""
    return [estimate(flight) for flight in flights]


@pytest.mark.parametrize("index", range(len(PLANS)), ids=[plan["manoeuvre"] for plan in PLANS])
def test_innovations_are_as_large_as_the_filter_says(estimates: list[Estimated], index: int) -> None:
    """Their normalized squares have the mean of chi-squared of three degrees of freedom, within its 95 % band."""
    found = estimates[index]
    squares = found.surprise[(found.used > SETTLED) & np.isfinite(found.surprise)]
    count = len(squares)
    assert count > 600
    low, high = chi2.ppf([0.025, 0.975], 3 * count) / count
    assert low < squares.mean() < high
    assert 0.02 < (squares > chi2.ppf(0.95, 3)).mean() < 0.08


def test_it_knows_more_than_its_sensors(flights: list[Recording], estimates: list[Estimated]) -> None:
    """Position within a quarter of a millimetre, angle within 1 mrad, velocity 10 times closer than differences."""
    for flight, found in zip(flights, estimates):
        rms = np.sqrt((found.error[found.time > SETTLED] ** 2).mean(axis=0))
        assert (rms[:2] < 2.5e-4).all()
        assert rms[2] < 1e-3
        _, _, pose, stamp, _ = read(flight)
        near = np.diff(stamp) < 0.015
        speed = (np.diff(pose[:, :2], axis=0) / np.diff(stamp)[:, None])[near]
        true = np.stack([np.interp(stamp, flight.truth["time"], flight.truth["position"][:, i]) for i in range(2)], 1)
        wrong = speed - (np.diff(true, axis=0) / np.diff(stamp)[:, None])[near]
        assert (10.0 * rms[3:5] < np.sqrt((wrong**2).mean(axis=0))).all()


def test_the_gyros_bias_is_found(estimates: list[Estimated]) -> None:
    """Within three of its own standard deviations, and within 3 mrad/s; where there is none, none."""
    for plan, found in zip(PLANS, estimates):
        hidden = plan["effects"].get("gyro.bias", {}).get("bias", 0.0)
        assert found.filter.biases[0, 0] == pytest.approx(hidden, abs=3e-3)
        assert abs(found.filter.biases[0, 0] - hidden) < 3.0 * found.filter.deviation[0, GYRO_BIAS]


def test_a_dropout_in_a_flip(flights: list[Recording]) -> None:
    """50 ms without poses while the craft turns fastest leave the angle within 0.05 rad; so does half a second."""
    flight = flights[0]
    fastest = float(flight.truth["time"][np.argmax(np.abs(flight.truth["velocity"][:, 2]))])
    assert np.abs(flight.truth["velocity"][:, 2]).max() > 5.0
    for length in (0.05, 0.5):
        found = estimate(flight, (fastest - 0.5 * length, fastest + 0.5 * length))
        around = np.abs(found.time - fastest) < length + 0.1
        assert np.abs(found.error[around, 2]).max() < 0.05
        assert np.abs(found.error[around, :2]).max() < 0.05


def hold(kalman: KalmanFilter, seconds: float, pose: np.ndarray | None) -> None:
    """Feed a craft at rest; a pose every 10 ms."""
    still = np.tile([0.0, VEHICLE.gravity], (len(kalman.pose), 1))
    for k in range(round(seconds / DT)):
        kalman.predict(np.zeros(len(still)), still)
        if pose is not None and k % 10 == 9:
            kalman.correct(pose)


def test_rest_stays_rest() -> None:
    """Without noise the estimate is the pose, a turn off or not, and a late pose changes nothing."""
    kalman = KalmanFilter(2, DT, VEHICLE.gravity, NOISE)
    pose = np.array([[0.3, 1.2, 0.0], [0.0, 1.0, 0.0]])
    hold(kalman, 0.5, pose)
    kalman.correct(pose + np.array([0.0, 0.0, 4.0 * np.pi]), age=0.005)
    np.testing.assert_allclose(kalman.pose, pose, atol=1e-9)
    np.testing.assert_allclose(kalman.velocity, 0.0, atol=1e-9)


def test_late_poses_count_where_they_belong() -> None:
    """A craft in steady motion whose poses come 80 ms late is known as well as if they came at once."""
    kalman, speed = KalmanFilter(1, DT, VEHICLE.gravity, NOISE), 1.5
    for k in range(1, 2001):
        kalman.predict(np.zeros(1), np.array([[0.0, VEHICLE.gravity]]))
        if k % 10 == 0 and k > 80:
            kalman.correct(np.array([[speed * (k * DT - 0.08), 1.0, 0.0]]), age=0.08)
    assert kalman.pose[0, 0] == pytest.approx(speed * 2.0, abs=1e-4)
    assert kalman.velocity[0, 0] == pytest.approx(speed, abs=1e-3)


def test_what_cannot_be_right_is_left_out_for_a_while() -> None:
    """A pose 30 cm off changes nothing; one older than the last neither; if all are there, the filter gives in."""
    kalman = KalmanFilter(1, DT, VEHICLE.gravity, NOISE)
    pose = np.array([[0.3, 1.2, 0.0]])
    hold(kalman, 0.5, pose)
    kalman.predict(np.zeros(1), np.array([[0.0, VEHICLE.gravity]]))
    before = kalman.pose
    assert kalman.correct(pose + 0.3)[0] > 1000.0
    np.testing.assert_array_equal(kalman.pose, before)
    assert np.isnan(kalman.correct(pose + 0.3, age=0.1)[0])
    for _ in range(GIVE_UP + 1):
        kalman.predict(np.zeros(1), np.array([[0.0, VEHICLE.gravity]]))
        kalman.correct(pose + 0.3)
    np.testing.assert_allclose(kalman.pose, pose + 0.3, atol=1e-6)
    assert np.isnan(kalman.correct(np.full((1, 3), np.nan))[0])


def test_long_without_a_pose() -> None:
    """A second without one is longer than samples are kept: it goes on by the IMU, and takes the next pose."""
    kalman = KalmanFilter(1, DT, VEHICLE.gravity, NOISE)
    pose = np.array([[0.3, 1.2, 0.1]])
    hold(kalman, 0.3, pose * [1.0, 1.0, 0.0])
    hold(kalman, 2.0 * DEPTH * DT, None)
    assert np.isfinite(kalman.pose).all()
    assert kalman.deviation[0, 0] > 0.001
    kalman.correct(pose * [1.0, 1.0, 0.0])
    np.testing.assert_allclose(kalman.pose[0, :2], pose[0, :2], atol=1e-3)


def test_filters_are_independent_and_can_be_saved() -> None:
    """A row that starts anew does so where it is told, the others as before; a restored filter goes on bit-equal."""
    pose = np.array([[0.3, 1.2, 0.0], [0.0, 1.0, 0.0]])
    kalman, other = (KalmanFilter(2, DT, VEHICLE.gravity, NOISE) for _ in range(2))
    hold(kalman, 0.2, pose)
    other.restore(kalman.save())
    hold(kalman, 0.2, pose)
    hold(other, 0.2, pose)
    np.testing.assert_array_equal(kalman.pose, other.pose)
    kept = kalman.deviation[0]
    kalman.start(np.array([1]), np.array([[1.0, 1.0, 0.0]]), np.zeros((1, 3)))
    assert kalman.pose[1, 0] == 1.0
    assert kalman.deviation[1, BIAS_X] == NOISE.accel_bias
    np.testing.assert_array_equal(kalman.deviation[0], kept)
