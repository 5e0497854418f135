"""Errors of sensors taken back: what the sensors' laws make of a known motion, undone."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.estimation.correct import correct_measurements
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.twin.sensors import find_age, measure_coordinate, measure_rate, perfect_sensors, turn_rates

STAMPS = np.arange(0.0, 20.0, 0.01)
FLAWS = {
    "pose.delay": 0.012, "pose.drift": 1.5e-3, "pose.scale": 1.02, "pose.offset": 0.01, "rate.scale": 0.97,
    "rate.bias": 0.05, "rate.delay": -0.003, "rate.drift": -1e-3,
}  # fmt: skip


def locate(time: np.ndarray) -> list[np.ndarray]:
    """The true x, z [m] and θ [rad] at some time [s]."""
    return [np.sin(2.0 * time), 1.5 + 0.2 * np.cos(time), 0.6 * np.sin(3.0 * time)]


def turn(time: np.ndarray) -> np.ndarray:
    """The rate of that θ [rad/s]."""
    return 1.8 * np.cos(3.0 * time)


def flawed(flaws: dict[str, float], dofs: tuple[int, ...] = (0, 1, 2)) -> dict[str, np.ndarray]:
    """Constants of sensors, those of some degrees of freedom flawed."""
    sensors = perfect_sensors(1)
    for name, value in flaws.items():
        sensors[name][:, list(dofs)] = value
    return sensors


def measure(sensors: dict[str, np.ndarray]) -> Measurements:
    """What flawed sensors without noise say, each about the past that it shows, as its stamps have it."""
    positions = {}
    for dof in range(3):
        seen = STAMPS - find_age(sensors, "pose", dof, STAMPS)
        value = measure_coordinate(sensors, dof, locate(seen)[dof])
        positions[dof] = Series("xzθ"[dof], "m", STAMPS, value, 1e-3)
    gyro = Series(
        "θ rate", "rad/s", STAMPS, measure_rate(sensors, turn(STAMPS - find_age(sensors, "rate", 2, STAMPS))), 0.02
    )
    command = Series("command", "", STAMPS, np.zeros((len(STAMPS), 2)), 0.0)
    return Measurements("by hand", positions, {2: gyro}, None, command, None, (), 0.0, 20.0)


@pytest.mark.parametrize("flaws", [{name: value} for name, value in FLAWS.items()] + [FLAWS])
def test_what_is_corrected_is_the_truth(flaws: dict[str, float]) -> None:
    """Measured through every flaw alone and through all: each sample says where the craft was at its corrected time."""
    sensors = flawed(flaws)
    found = correct_measurements(measure(sensors), sensors)
    for dof, series in found.positions.items():
        np.testing.assert_allclose(series.value, locate(series.time)[dof], atol=1e-12)
        assert series.std == 1e-3
    np.testing.assert_allclose(found.velocities[2].value, turn(found.velocities[2].time), atol=1e-12)


def test_times_by_hand() -> None:
    """Stamped 10 s, 12 ms late and drifting by 1.5 ms a second: of 10 - 0.012 - 0.015 s."""
    sensors = flawed(FLAWS)
    found = correct_measurements(measure(sensors), sensors)
    assert found.positions[0].time[1000] == pytest.approx(9.973)


def test_each_has_errors_of_its_own() -> None:
    """Only what is said to be late is, and of a wrong scale."""
    sensors = flawed({"pose.delay": 0.05, "pose.scale": 1.1}, (0,))
    found = correct_measurements(measure(sensors), sensors)
    np.testing.assert_array_equal(found.positions[1].time, STAMPS)
    np.testing.assert_allclose(found.positions[1].value, locate(STAMPS)[1], atol=1e-12)
    np.testing.assert_allclose(found.positions[0].value, locate(STAMPS - 0.05)[0], atol=1e-12)


def test_without_errors_nothing_changes() -> None:
    """Perfect sensors give back the very flight."""
    flight = measure(perfect_sensors(1))
    assert correct_measurements(flight, perfect_sensors(1)) is flight


def test_rates_are_turned_back() -> None:
    """A gyro whose x axis points where the body's y does shows turns about y as about x; scale and bias go first."""
    sensors = perfect_sensors(1, 6)
    sensors["rate.turn"][:, 5], sensors["rate.bias"][:, 3:], sensors["rate.scale"][:, 4] = np.pi / 2.0, 0.1, 2.0
    shown = turn_rates(sensors, np.array([[0.0, 3.0, 1.0]]), 3)
    np.testing.assert_allclose(shown, [[3.0, 0.0, 1.0]], atol=1e-12)
    rates = {3 + i: Series("", "rad/s", np.zeros(1), measure_rate(sensors, shown[:, i], 3 + i), 0.1) for i in range(3)}
    still = Series("", "rad", np.zeros(1), np.array([[1.0, 0.0, 0.0, 0.0]]), 0.1)
    command = Series("command", "", np.zeros(1), np.zeros((1, 0)), 0.0)
    flight = Measurements("by hand", {}, rates, None, command, None, (), 0.0, 1.0, attitudes={3: still})
    back = correct_measurements(flight, sensors).velocities
    np.testing.assert_allclose([back[3 + i].value[0] for i in range(3)], [0.0, 3.0, 1.0], atol=1e-12)
