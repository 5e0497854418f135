"""Channels of the drone that are stuck or clipped, and rotor speeds that the thrust denies."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.made_up import FLIP
from vpptwin.logs.flight import Stream
from vpptwin.logs.read import read_flight
from vpptwin.robots.planar_drone.vetting import find_clipped, find_stuck, is_noisy, vet_rotors
from vpptwin.twin import load_twin


def test_flat_peaks_and_long_repeats_are_found_to_the_sample() -> None:
    """Five equal samples at the greatest value, and a run of 0.2 s that a jump ends; shorter ones are chance."""
    rng = np.random.default_rng(4)
    time, noise = np.arange(0.0, 2.0, 0.001), 0.1 * rng.standard_normal(2000)
    value = 3.0 * np.sin(5.0 * time) + noise
    clipped = np.clip(value, -2.5, 2.5)
    np.testing.assert_array_equal(find_clipped(clipped), np.abs(value) >= 2.5)
    assert not find_clipped(value).any()
    held = value.copy()
    held[600:800] = held[600]
    held[1000:1050] = held[1000]
    expected = np.zeros(2000, dtype=bool)
    expected[600:800] = True
    np.testing.assert_array_equal(find_stuck(time, held, 0.1), expected)
    assert is_noisy(value, 0.1)
    assert not is_noisy(3.0 * np.sin(5.0 * time), 0.1)


VEHICLE = load_twin().vehicle
STREAMS = read_flight(FLIP).streams


def vet(speed: np.ndarray, governed: float = VEHICLE.rotor.speed, felt: bool = True) -> tuple[Stream | None, list[str]]:
    """What is left of a flight's rotor telemetry with these speeds, in a vehicle of such a governed speed."""
    rotor = STREAMS["/rotor/state"]
    vehicle = VEHICLE.model_copy(update={"rotor": VEHICLE.rotor.model_copy(update={"speed": governed})})
    imu = STREAMS["/imu/data"] if felt else None
    return vet_rotors(replace(rotor, values=rotor.values | {"speed": speed}), vehicle, imu, STREAMS["/rotor/command"])


SPEED = STREAMS["/rotor/state"]["speed"]


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ((0.0, 0.0), "0 times the governed"), ((2.0, 2.0), "2 times the governed"), ((0.5, 0.5), "0.5 times the"),
        ((1.0, 2.0), "2 times the governed"), ((0.65, 0.65), "0.6[56] times the thrust that is felt"),
        ((1.5, 1.5), "1.5 times the thrust that is felt"),
    ],
)  # fmt: skip
def test_rotor_speeds_that_the_thrust_denies_are_left_out(factors: tuple[float, float], said: str) -> None:
    """Zeros, one rotor or both at twice or half, and what only the accelerometer tells."""
    left, (line,) = vet(SPEED * factors)
    assert left is None
    assert re.search(said, line), line
    assert line.endswith("left out")


@pytest.mark.parametrize("factor", [1.0, 0.85, 1.25])
def test_rotor_speeds_that_an_effect_may_explain_stay(factor: float) -> None:
    """A wrong scale by less than a mass or a thrust map may be wrong by cannot be told, and is not claimed."""
    left, warnings = vet(factor * SPEED)
    assert left is not None
    assert warnings == []


def test_a_vehicle_whose_speed_is_wrong_is_told() -> None:
    """Where thrust agrees with the log the speeds stay, and the file is named; without an accelerometer they go."""
    left, (line,) = vet(SPEED, VEHICLE.rotor.speed / 2.0)
    assert left is not None
    assert line.endswith("and so is the thrust felt: correct rotor.speed of the vehicle")
    assert vet(SPEED, VEHICLE.rotor.speed / 2.0, felt=False)[0] is None


def test_rotor_speeds_that_count_backwards_are_turned() -> None:
    """A sign is a convention."""
    left, (line,) = vet(SPEED * (1.0, -1.0))
    assert left is not None
    np.testing.assert_array_equal(left["speed"], SPEED)
    assert line == "the speed of rotor 2 is negative, its sign is turned"


def test_rotor_speeds_that_do_not_change_are_left_out() -> None:
    """Throughout: the channel; for a second: the samples."""
    dead = SPEED.copy()
    dead[:, 0] = 470.0
    assert vet(dead) == (None, ["a rotor speed never changes, left out"])
    stuck = SPEED.copy()
    stuck[1000:2000, 1] = 430.0
    left, (line,) = vet(stuck)
    assert left is not None
    assert len(left) == len(SPEED) - 1000
    assert line == f"1000 of {len(SPEED)} samples repeat a value to the last digit, left out"
