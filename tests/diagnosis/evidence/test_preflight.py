"""What a flight is found to show before anything is fitted."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.synthetic import AMPLITUDE, FREQUENCY, Sensors
from vpptwin.diagnosis.evidence.preflight import check_stream, describe_range, inspect_flight
from vpptwin.estimation.series import Lag, Measurements
from vpptwin.logs.streams.clocks import Clock
from vpptwin.twin import load_twin

SPEC = load_twin()


@pytest.fixture(scope="module")
def flight() -> Measurements:
    """20 s of sines in x, z and θ, blade pitches at their stop for a tenth of it."""
    measured = Sensors().measure(20.0)
    command = np.where(np.arange(len(measured.command.time)) % 10 == 0, 0.21, 0.1)
    clocks = {"/mocap/pose": Clock(0.008, 1e-3, 2e-4), "/imu/data": Clock(0.001, 1e-3, 5e-5)}
    return replace(
        measured,
        command=replace(measured.command, value=np.stack([command, 0.0 * command], axis=1)),
        lag=Lag(0.004, 2e-4),
        clocks=clocks,
    )


def test_excitation_is_measured(flight: Measurements) -> None:
    """Ranges, speeds, share of time moving and reversals are those of the motion; a line and JSON tell them."""
    found = inspect_flight(SPEC, flight)
    for axis, name in enumerate(("x", "z", "θ")):
        low, high = found.ranges[name]
        middle = 1.5 if axis == 1 else 0.0
        assert (low, high) == pytest.approx((middle - AMPLITUDE[axis], middle + AMPLITUDE[axis]), abs=0.02)
        assert found.ranges[f"{name} rate"][1] == pytest.approx(AMPLITUDE[axis] * FREQUENCY[axis], rel=0.06)
        assert found.reversals[name] == int(20.0 * FREQUENCY[axis] / np.pi + 0.5)  # twice a period
        assert found.moving[name] > 0.9
    assert found.inverted == 0.0
    assert found.saturated == {"blade pitch 1": pytest.approx(0.1), "blade pitch 2": 0.0}
    assert found.usable == 1.0
    # The line names rates, motion, limits and clocks, and the same comes as JSON.
    found = inspect_flight(SPEC, flight)
    line = found.describe()
    assert "\n" not in line
    parts = (
        "20.0 s, 100% of it usable",
        "poses 100 Hz",
        "θ rate 1000 Hz",
        "x moves 9",
        "between -0.50 and 0.50",
        "blade pitch 1 at its limits 10%",
        "motion capture 4.0 ms behind the gyro, growing by 0.2 ms/s",
    )
    for part in parts:
        assert part in line
    assert found.clock_drift == pytest.approx(1.5e-4)
    assert json.loads(json.dumps(found.as_dict()))["ranges"]["z"][0] == pytest.approx(1.2, abs=0.01)
    # Over several flights each quantity has the least and the greatest of all of them.
    higher = {**flight.positions, 1: replace(flight.positions[1], value=flight.positions[1].value + 1.0)}
    low, high = describe_range([flight, replace(flight, positions=higher)])["z"]
    assert (low, high) == pytest.approx((1.2, 2.8), abs=0.01)


def test_missing_samples_are_counted() -> None:
    """A hundred samples of which ten in a row are missing: 89 steps where 99 were due."""
    time = np.delete(np.arange(100) * 0.01, np.arange(40, 50))
    found = check_stream(time)
    assert found.missing == pytest.approx(10 / 99)
    assert found.longest_gap == pytest.approx(0.11)
    assert found.rate == pytest.approx(89 / 0.99)
