"""Lag of an angle behind a gyro, and steps of its clock, found from what turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.synthetic import Sensors
from vpptwin.estimation.series import Series
from vpptwin.robots.planar_drone.lag import estimate_lag, find_step

FLIGHT = Sensors().measure(40.0)
ANGLE, RATE = FLIGHT.positions[2], FLIGHT.velocities[2]
RNG = np.random.default_rng(0)


def wander(seconds: float) -> tuple[Series, Series]:
    """An angle and its rate that never repeat."""
    time = np.arange(0.0, seconds, 0.001)
    rate = np.convolve(RNG.normal(size=len(time)), np.hanning(300), mode="same") / 4.0
    turned = np.cumsum(rate) * 0.001
    seen = time[::10]
    angle = turned[::10] + 0.003 * RNG.normal(size=len(seen))
    return Series("θ", "rad", seen, angle, 0.003), Series("θ rate", "rad/s", time, rate, 0.02)


@pytest.mark.parametrize(("start", "drift"), [(0.0, 0.0), (0.012, 0.0), (-1.3, 0.0), (0.004, 5e-4), (0.1, -5e-3)])
def test_lag_and_drift_are_found(start: float, drift: float) -> None:
    """To a millisecond, whatever it is, and its growth to a few percent."""
    angle, rate = wander(40.0)
    lag = estimate_lag(replace(angle, time=angle.time * (1.0 + drift) + start), rate)
    assert lag is not None
    assert lag.start == pytest.approx(start, abs=2e-3)
    assert lag.drift == pytest.approx(drift, rel=0.05, abs=1e-4)


def test_nothing_is_found_where_nothing_turns() -> None:
    """Noise alone, or two motions that have nothing to do with each other, give no lag."""
    still = replace(ANGLE, value=0.003 * RNG.normal(size=len(ANGLE.time)))
    assert estimate_lag(still, RATE) is None
    angle, _ = wander(40.0)
    _, other = wander(40.0)
    assert estimate_lag(angle, other) is None


LENGTH = 24.0


def turn(seed: int = 1) -> tuple[Series, Series]:
    """An angle at 100 Hz and its rate at 1 kHz, of a craft that turns irregularly, with noise [rad, rad/s]."""
    rng = np.random.default_rng(seed)
    fast, slow = np.arange(0.0, LENGTH, 0.001), np.arange(0.0, LENGTH, 0.01)
    waves = [(rng.uniform(0.2, 0.6), rng.uniform(1.0, 9.0), rng.uniform(0.0, 6.0)) for _ in range(6)]
    angle = sum(a * np.sin(w * slow + p) for a, w, p in waves) + 1e-3 * rng.standard_normal(len(slow))
    rate = sum(a * w * np.cos(w * fast + p) for a, w, p in waves) + 1e-2 * rng.standard_normal(len(fast))
    return Series("θ", "rad", slow, np.asarray(angle), 1e-3), Series("θ rate", "rad/s", fast, np.asarray(rate), 1e-2)


@pytest.mark.parametrize("by", [0.3, -0.3, 0.15])
@pytest.mark.parametrize("at", [9.0, 13.0])
def test_a_clock_that_steps_shows_in_the_lag(by: float, at: float) -> None:
    """Time to a stretch and size to a hundredth of a second, whatever the log times say."""
    angle, rate = turn()
    stepped = Series("θ", "rad", angle.time + np.where(angle.time > at, by, 0.0), angle.value, angle.std)
    order = np.argsort(stepped.time, kind="stable")
    found = find_step(Series("θ", "rad", stepped.time[order], stepped.value[order], angle.std), rate)
    assert found is not None
    assert found[0] == pytest.approx(at, abs=4.0)
    assert found[1] == pytest.approx(by, abs=0.02)


@pytest.mark.parametrize(("late", "drift"), [(0.0, 0.0), (0.03, 0.0), (0.01, 2e-3), (0.0, -2e-3)])
def test_clocks_that_are_late_or_drift_do_not_step(late: float, drift: float) -> None:
    """A delay and 2 ms/s between clocks are suspects of the diagnosis, not faults of the log."""
    angle, rate = turn()
    assert find_step(Series("θ", "rad", angle.time * (1.0 + drift) + late, angle.value, angle.std), rate) is None


def test_little_turning_tells_of_no_step() -> None:
    """Noise against noise."""
    angle, rate = turn()
    rng = np.random.default_rng(2)
    quiet = Series("θ", "rad", angle.time, 1e-3 * rng.standard_normal(len(angle.time)), 1e-3)
    assert find_step(quiet, Series("θ rate", "rad/s", rate.time, 0.0 * rate.value, 1e-2)) is None
