"""Lag of an angle behind a gyro, found from what turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.synthetic import Sensors
from vpptwin.estimation.series import Series
from vpptwin.robots.planar_drone.lag import estimate_lag

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
