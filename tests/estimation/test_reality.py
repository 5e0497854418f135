"""Estimates on flights of the independent simulation, against its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from proving.drone.flight import fly
from proving.drone.recording import Recording, write_mcap
from tests.estimation.synthetic import ANGLE_STD, POSITION_STD, expect_noise, expect_rate_noise
from vpptwin.estimation.initial import DRIFT_STD, estimate_states
from vpptwin.estimation.measurements import Measurements, read_measurements
from vpptwin.logs.read import read_flight
from vpptwin.robots.planar_drone.topics import SLOPE_STD
from vpptwin.twin import load_twin

SPEC = load_twin()
RIG = SPEC.model


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Three seconds in a nominal world with noisy sensors, mocap gaps included."""
    return fly({}, "aggressive", 3.0, seed=5, gusts=False, jitter=False)


@pytest.fixture(scope="module")
def measured(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Measurements:
    """The flight as its log gives it."""
    path: Path = write_mcap(recording, tmp_path_factory.mktemp("reality") / "flight.mcap")
    return read_measurements(SPEC, read_flight(path))


@pytest.mark.parametrize("causal", [True, False])
def test_estimates_are_as_good_as_sensors_allow(recording: Recording, measured: Measurements, causal: bool) -> None:
    """On an aggressive flight errors stay near those of the fit on a smooth motion, in spite of gaps in the poses."""
    times = np.arange(measured.start + 0.2, measured.end - 0.2, 0.037)
    pose, velocity = estimate_states(measured, times, RIG, causal)
    truth = {
        name: np.stack(
            [np.interp(times, recording.truth["time"], recording.truth[name][:, i]) for i in range(3)], axis=1
        )
        for name in ("position", "velocity")
    }
    errors = np.concatenate([pose - truth["position"], velocity - truth["velocity"]], axis=1)
    position, speed = expect_noise(POSITION_STD, SLOPE_STD, causal)
    angle, _ = expect_noise(ANGLE_STD, DRIFT_STD, causal)
    expected = np.array([position, position, angle, speed, speed, expect_rate_noise(causal)])
    # 70 instants that share samples: 35 %. Specific force turned by an angle that is off by 3 mrad/sqrt(20), 7 mm/s²
    # for 0.15 s: 1 mm/s, 0.1 mm. Torque that builds up by 1000 rad/s³ in 10 ms: 0.008 rad/s.
    assert (np.sqrt(np.mean(errors**2, axis=0)) < 1.35 * expected + [1e-4, 1e-4, 0, 1e-3, 1e-3, 0.008]).all()
    assert np.abs(truth["velocity"][:, 2]).max() > 1.0  # rad/s: it was aggressive
