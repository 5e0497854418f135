"""How far back starting states are read: by noise against motion, and never across what spoils them."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from vpptwin.estimation.gaps import usable_starts
from vpptwin.estimation.initial import estimate_states
from vpptwin.estimation.reach import FARTHEST, reach_back
from vpptwin.estimation.series import Measurements, Series

MODEL = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><body><joint type='slide'/><geom size='1'/></body></worldbody></mujoco>"
)
BALL = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><body><joint type='ball'/><geom size='1'/></body></worldbody></mujoco>"
)
TIME = np.arange(2000) / 100.0
TIMES = np.arange(0.5, 19.0, 0.037)


def measure(rate: float, noise: np.ndarray, rates: bool = False) -> Measurements:
    """A slide that swings to and fro by 1 m at a rate [rad/s], with noise (n,) m; its speed is logged, too, or not."""
    position = Series("x", "m", TIME, np.sin(rate * TIME) + noise, 0.003, white=False)
    speed = Series("x rate", "m/s", TIME, rate * np.cos(rate * TIME), 0.003, white=False)
    command = Series("control", "", TIME, np.zeros((len(TIME), 0)), 0.0)
    velocities = {0: speed} if rates else {}
    return Measurements("swing", {0: position}, velocities, None, command, None, (), 0.0, float(TIME[-1]))


def draw(std: float = 0.003) -> np.ndarray:
    """White noise, (n,)."""
    return std * np.random.default_rng(7).standard_normal(len(TIME))


def rms_speed_error(measurements: Measurements, rate: float) -> float:
    """Of causal estimates [m/s]."""
    error = estimate_states(measurements, TIMES, MODEL, True)[1][:, 0] - rate * np.cos(rate * TIMES)
    return float(np.sqrt(np.mean(error**2)))


def test_noise_of_slow_motion_is_averaged() -> None:
    """Eight samples of 3 mm make 0.17 m/s; what swings at 1 rad/s is read up to 0.3 s back, which halves that twice."""
    known, told = measure(1.0, draw()), reach_back(measure(1.0, draw()))
    assert told.positions[0].reach == pytest.approx(0.253, abs=1e-3)
    assert rms_speed_error(told, 1.0) < 0.25 * rms_speed_error(known, 1.0)


def test_what_jerks_is_read_from_close_by() -> None:
    """At 12 rad/s a parabola misses 1728 m/s³ of jerk by 1.1 m/s over 80 ms; 50 ms are the nearest that is tried."""
    known, told = measure(12.0, draw()), reach_back(measure(12.0, draw()))
    assert told.positions[0].reach == pytest.approx(0.05)
    assert rms_speed_error(told, 12.0) < 0.7 * rms_speed_error(known, 12.0)


@pytest.mark.parametrize(
    "measured",
    [
        pytest.param(measure(1.0, np.convolve(draw(), np.hanning(9) / 4.0, mode="same")), id="smoothed"),
        pytest.param(measure(1.0, draw(0.0)), id="without noise"),
        pytest.param(measure(1.0, draw(), rates=True), id="speeds logged"),
        pytest.param(replace(measure(1.0, draw()), end=0.5), id="too short"),
    ],
)
def test_else_nothing_is_told(measured: Measurements) -> None:
    """Noise that is alike for some samples shows no errors; a logged speed needs no positions."""
    assert reach_back(measured).positions[0].reach is None


def test_estimates_that_look_ahead_stay() -> None:
    """To every bit: samples on either side average noise by themselves."""
    known, told = measure(1.0, draw()), reach_back(measure(1.0, draw()))
    before, after = (np.stack(estimate_states(m, TIMES, MODEL, False)) for m in (known, told))
    np.testing.assert_array_equal(before, after)


def test_gaps_do_not_count() -> None:
    """Samples are lost for 0.1 s once a second: speeds after such gaps would speak for the farthest."""
    whole = measure(6.0, draw())
    kept = TIME % 1.0 >= 0.1
    series = replace(whole.positions[0], time=TIME[kept], value=whole.positions[0].value[kept])
    assert reach_back(replace(whole, positions={0: series})).positions[0].reach == pytest.approx(
        reach_back(whole).positions[0].reach
    )


def test_attitudes_are_read_alike() -> None:
    """A body that turns about its z axis at up to 1 rad/s, seen with 3 mrad of noise and no gyro."""
    angle, still = np.sin(TIME) + draw(), np.zeros(len(TIME))
    turned = [Series(name, "rad", TIME, value, 0.003, False) for name, value in zip("xyz", (still, still, angle))]
    attitude = np.stack([np.cos(0.5 * angle), still, still, np.sin(0.5 * angle)], axis=1)
    known = replace(
        measure(1.0, draw()), positions=dict(enumerate(turned)),
        attitudes={0: Series("attitude", "rad", TIME, attitude, 0.003, False)},
    )  # fmt: skip
    told = reach_back(known)
    assert told.attitudes[0].reach == told.positions[2].reach == pytest.approx(0.253, abs=1e-3)
    before, after = (
        np.sqrt(np.mean((estimate_states(m, TIMES, BALL, True)[1][:, 2] - np.cos(TIMES)) ** 2)) for m in (known, told)
    )
    assert after < 0.25 * before


def test_half_of_what_a_start_is_read_from_may_be_lost() -> None:
    """Of 80 ms: a gap of 30 ms does not spoil a start, one of 60 ms does until 80 ms after it."""
    whole = measure(12.0, draw(0.0))
    starts = np.arange(1.0, 3.0, 0.01) + 0.005
    for lost, bad in ((0.03, []), (0.06, starts[(starts > 1.95) & (starts < 2.06 + 0.08)])):
        kept = np.abs(TIME - 2.0 - 0.5 * lost) > 0.5 * lost - 1e-9
        series = replace(whole.positions[0], time=TIME[kept], value=whole.positions[0].value[kept])
        found = starts[~usable_starts(replace(whole, positions={0: series}), starts, 0.3)]
        np.testing.assert_array_equal(found, bad)


def test_starts_are_not_read_across_strikes() -> None:
    """Nor from before a flight begins; both as far back as they are read."""
    measured = replace(measure(1.0, draw()), start=1.0, strikes=np.array([[3.0, 3.1]]))
    measured = replace(measured, positions={0: replace(measured.positions[0], reach=FARTHEST)})
    starts = np.arange(1.0, 5.0, 0.01) + 0.005
    usable = starts[usable_starts(measured, starts, 0.3)]
    np.testing.assert_array_equal(usable, starts[(starts > 1.3) & ((starts < 2.7) | (starts > 3.4))])


def test_blows_do_not_count() -> None:
    """A swing that turns back at once, every second: with such kinks what is read from close by seems best."""
    bounced = np.abs(np.sin(np.pi * TIME)) - np.sin(TIME) + draw()
    kinked = measure(1.0, bounced)
    at = np.arange(1.0, 19.0)
    spans = np.stack([at - 0.03, at + 0.03], axis=1)
    known, told = (reach_back(m).positions[0].reach for m in (kinked, replace(kinked, blows=spans)))
    assert known is not None
    assert told is not None
    assert known < told
