"""The floor under prediction errors: what sensors alone make of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimation.synthetic import ANGLE_STD, GYRO_STD, POSITION_STD, Sensors
from vpptwin.diagnosis.evidence.noise import find_noise_floor, variance_of_bin
from vpptwin.estimation.measurements import Series


def test_slides_add_up_and_fast_samples_average() -> None:
    """Two slides make √2 of one; ten gyro samples in a bin of 10 ms leave 1/√10 of one's noise."""
    flight = Sensors().measure(2.0)
    units = ("m", "m", "rad")
    flight = replace(flight, positions={dof: replace(s, unit=units[dof]) for dof, s in flight.positions.items()})
    floor = find_noise_floor([flight, flight])
    assert floor.rmse["position_rmse_m"] == pytest.approx(np.sqrt(2.0) * POSITION_STD)
    assert floor.rmse["angle_rmse_rad"] == pytest.approx(ANGLE_STD)
    assert floor.rmse["θ rate"] == pytest.approx(GYRO_STD / np.sqrt(10.0))
    assert floor.units == {"θ rate": "rad/s"}
    assert floor.label == "sensor noise"


def test_a_guess_is_called_so() -> None:
    """Of other rigs the noise is guessed with caution: a good twin may go below it."""
    flight = Sensors(imu=False).measure(2.0)
    guessed = {dof: replace(s, white=False) for dof, s in flight.positions.items()}
    assert find_noise_floor([replace(flight, positions=guessed)]).label == "assumed noise"


def test_noise_that_is_not_white_does_not_average() -> None:
    """An estimator's error is alike from sample to sample."""
    time = np.arange(1000) / 1000.0
    assert variance_of_bin(Series("v", "m/s", time, time, 0.2, white=False)) == pytest.approx(0.04)
    assert variance_of_bin(Series("v", "m/s", time, time, 0.2)) == pytest.approx(0.004)
