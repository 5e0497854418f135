"""Estimated states: as good as the noise allows, and blind to the future where they claim to be."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.estimation.synthetic import (
    ANGLE_STD,
    POSITION_STD,
    Sensors,
    expect_noise,
    expect_rate_noise,
    locate,
)
from vpptwin.estimation.initial import DRIFT_STD, HORIZON, choose_span, estimate_states
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.robots.planar_drone.topics import SLOPE_STD
from vpptwin.twin import load_twin

TIMES = 0.5 + 0.0731 * np.arange(40)
"""Instants that fall between samples as often as on them [s]."""
ENTIRE = 4.0
RIG = load_twin().model
WIDER = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><body>" + 4 * "<joint type='slide'/>" + "<geom size='1'/></body></worldbody></mujoco>"
)
"""The rig, and one with a degree of freedom more."""


@pytest.mark.parametrize("causal", [True, False])
def test_errors_are_what_the_noise_allows(causal: bool) -> None:
    """Over 320 instants of eight noisy flights the errors are those of the regularised fit, without offset."""
    errors = []
    for seed in range(8):
        pose, velocity = estimate_states(Sensors().measure(ENTIRE, seed), TIMES, RIG, causal)
        truth = locate(TIMES)
        errors.append((pose - truth[0], velocity - truth[1]))
    pose_error, velocity_error = (np.concatenate(part) for part in zip(*errors))
    position, speed = expect_noise(POSITION_STD, SLOPE_STD, causal)
    angle, _ = expect_noise(ANGLE_STD, DRIFT_STD, causal)
    rate = expect_rate_noise(causal) + 51 * 1e-4 / 12  # sines bend by 51 rad/s³ * (10 ms)²/12
    expected = np.array([position, position, angle, speed, speed, rate])
    error = np.concatenate([pose_error, velocity_error], axis=1)
    # What is left to the prior is not drawn from it, so the fit does better than its own covariance rather than worse;
    # the angle that turns the specific force is wrong by ANGLE_STD/sqrt(20), 7 mm/s² at most, in 0.15 s: 1 mm/s.
    assert (np.sqrt(np.mean(error**2, axis=0)) < 1.15 * expected + [0, 0, 0, 0.001, 0.001, 0]).all()
    assert (np.abs(np.mean(error, axis=0)) < 0.25 * expected + [0, 0, 0, 0.001, 0.001, 0.001]).all()
    assert expected[0] < 3e-4  # m: better than one sample, or these bounds would say nothing


@pytest.mark.parametrize("causal", [True, False])
def test_noise_free_flights_are_estimated_exactly(causal: bool) -> None:
    """Without noise a state is found to a fraction of a millimetre and some mm/s, between samples too."""
    measured = Sensors(noise=0.0).measure(ENTIRE)
    pose, velocity = estimate_states(measured, TIMES, RIG, causal)
    truth = locate(TIMES)
    # Trapezoid sums of the IMU, dt²/12 of a jerk below 40 m/s³, leave next to nothing; the angle used to turn the
    # specific force lags by a few samples of a vanishing offset.
    np.testing.assert_allclose(pose, truth[0], rtol=0, atol=2e-5)
    np.testing.assert_allclose(velocity[:, :2], truth[1][:, :2], rtol=0, atol=2e-4)
    np.testing.assert_allclose(velocity[:, 2], truth[1][:, 2], rtol=0, atol=51 * 1e-4 / 2)  # a line through 10 ms


@pytest.mark.parametrize("causal", [True, False])
def test_works_without_imu(causal: bool) -> None:
    """With motion capture alone a local parabola gives states, less sharp by the motion's jerk."""
    sensors = Sensors(imu=False)
    error = []
    for seed in range(8):
        pose, velocity = estimate_states(sensors.measure(ENTIRE, seed), TIMES, RIG, causal)
        truth = locate(TIMES)
        error.append(np.concatenate([pose - truth[0], velocity - truth[1]], axis=1))
    stds = (POSITION_STD, POSITION_STD, ANGLE_STD)
    noise = [expect_noise(std, 1e6, causal) for std in stds]
    # A parabola through 0.15 s (0.3 s) misses a cubic: jerk/6 T³/20 at its end, jerk/6 * 3/5 * T² in slope.
    jerk, reach = np.array([4.0, 8.1, 51.2]), HORIZON
    missed = np.concatenate([jerk / 6 * reach**3 / 20, jerk / 6 * 0.6 * reach**2])
    expected = np.array([n[0] for n in noise] + [n[1] for n in noise])
    assert (np.sqrt(np.mean(np.concatenate(error) ** 2, axis=0)) < 1.15 * np.hypot(expected, missed)).all()


def falsify(measured: Measurements, after: float) -> Measurements:
    """The same measurements up to an instant, nonsense later."""

    def spoil(series: Series) -> Series:
        value = np.array(series.value, dtype=float)
        late = series.time > after
        value[late] += np.random.default_rng(5).normal(size=value[late].shape) * 3.0
        return replace(series, value=value)

    def spoil_all(several: Iterable[tuple[int, Series]]) -> dict[int, Series]:
        return {dof: spoil(series) for dof, series in several}

    force = None if measured.specific_force is None else spoil(measured.specific_force)
    positions, velocities = spoil_all(measured.positions.items()), spoil_all(measured.velocities.items())
    return replace(measured, positions=positions, velocities=velocities, specific_force=force)


@pytest.mark.parametrize(
    "sensors",
    [
        pytest.param(Sensors(), id="stamps aligned"),
        pytest.param(Sensors(mocap_start=0.0037, imu_start=0.0004), id="stamps misaligned"),
        pytest.param(Sensors(mocap_rate=10.0), id="slow motion capture"),
        pytest.param(Sensors(mocap_rate=10.0, imu_rate=80.0), id="slow sensors"),
        pytest.param(Sensors(imu=False), id="no IMU"),
        pytest.param(Sensors(mocap_rate=8.0, imu=False), id="no IMU, slow motion capture"),
    ],
)
def test_causal_estimates_ignore_the_future(sensors: Sensors) -> None:
    """Whatever is measured after an instant, the causal estimate there keeps every bit; the other one moves."""
    measured = sensors.measure(2.0)
    for instant in (0.6, 0.8514, 1.2345):
        times = np.array([0.55, instant])
        other = falsify(measured, instant)
        before, after = (estimate_states(m, times, RIG, causal=True) for m in (measured, other))
        np.testing.assert_array_equal(np.stack(before), np.stack(after))
        before, after = (estimate_states(m, times, RIG, causal=False) for m in (measured, other))
        assert np.abs(np.stack(before) - np.stack(after))[:, 1].max() > 0.01


def test_estimates_do_not_depend_on_each_other() -> None:
    """An instant is estimated alike, to rounding, alone and among others; unmeasured degrees of freedom stay zero."""
    measured = Sensors().measure(2.0)
    pose, velocity = estimate_states(measured, TIMES[:10], WIDER, causal=True)
    alone = estimate_states(measured, TIMES[4:5], WIDER, causal=True)
    np.testing.assert_allclose(pose[4], alone[0][0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(velocity[4], alone[1][0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(pose[:, 3], 0.0)
    np.testing.assert_array_equal(velocity[:, 3], 0.0)


def test_logged_velocities_sharpen_the_estimate() -> None:
    """On a rig without IMU a logged velocity is used: the estimate's velocity gets as good as its average."""
    measured = Sensors(imu=False).measure(ENTIRE)
    time = measured.positions[0].time
    noise = np.random.default_rng(3).normal(size=len(time)) * 0.002
    rate = Series("x rate", "m/s", time, locate(time)[1][:, 0] + noise, 0.002)
    with_rate = replace(measured, velocities={0: rate})
    truth = locate(TIMES)[1][:, 0]
    without, sharper = (
        np.sqrt(np.mean((estimate_states(m, TIMES, RIG, causal=True)[1][:, 0] - truth) ** 2))
        for m in (measured, with_rate)
    )
    assert sharper < 0.5 * without
    assert sharper < 4.0 * HORIZON**2 / 12  # m/s, by which a line through the velocity misses a jerk of 4 m/s³


@pytest.mark.parametrize(
    ("frequency", "with_rate", "low", "high"), [(4.0, False, 4, 5), (4.0, True, 4, 5), (0.3, False, 12, 15)]
)
def test_the_log_tells_from_how_many_samples_a_state_is_read(
    frequency: float, with_rate: bool, low: int, high: int
) -> None:
    """Few where a joint is jerked about, of which eight are off by ten times the noise; many of a slow one."""
    rng, time, std, turn = np.random.default_rng(7), np.arange(0.0, 12.0, 0.01), 5e-4, 2.0 * np.pi * frequency
    angle = Series("arm", "rad", time, 0.3 * np.sin(turn * time) + std * rng.normal(size=time.size), std, white=False)
    speed = 0.3 * turn * np.cos(turn * time) + 0.02 * rng.normal(size=time.size)
    rate = Series("arm rate", "rad/s", time, speed, 0.02, white=False) if with_rate else None
    assert low <= round(choose_span(angle, rate) / 0.01) <= high
    assert choose_span(replace(angle, time=time[:60], value=angle.value[:60]), None) == 0.0
