"""Channels held against each other: clocks that step where log times say nothing, and joints' velocities."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.made_up import FLIP
from vpptwin.estimation.checks.units import vet_joint
from vpptwin.estimation.series import Series
from vpptwin.logs.flight import Stream
from vpptwin.logs.read import read_flight
from vpptwin.robots.planar_drone.lag import find_step
from vpptwin.robots.planar_drone.vetting import find_clipped, find_stuck, is_noisy, vet_rotors
from vpptwin.twin import load_twin

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


def swing() -> Stream:
    """A joint at 500 Hz with the velocity of its position."""
    time = np.arange(0.0, 8.0, 0.002)
    rng = np.random.default_rng(3)
    position = 0.5 * np.sin(3.0 * time) + 0.2 * np.sin(7.0 * time) + 1e-4 * rng.standard_normal(len(time))
    velocity = 1.5 * np.cos(3.0 * time) + 1.4 * np.cos(7.0 * time) + 1e-2 * rng.standard_normal(len(time))
    return Stream(time, {"position": position, "velocity": velocity, "effort": 0.0 * time})


@pytest.mark.parametrize(
    ("factor", "said"),
    [(0.0, "velocity is 0 throughout"), (-1.0, "-1 times"), (57.3, "57.3 times"), (2.0, "2 times"), (0.5, "0.5 times")],
)
def test_velocities_that_are_not_of_the_positions_are_left_out(factor: float, said: str) -> None:
    """Dead, against the positions, in degrees, or of half the gear; the other columns stay."""
    stream = swing()
    vetted, (line,) = vet_joint(Stream(stream.time, {**stream.values, "velocity": factor * stream["velocity"]}), "arm")
    assert set(vetted.values) == {"position", "effort"}
    assert line.startswith("arm: velocity is ")
    assert said in line
    assert line.endswith(", left out")


@pytest.mark.parametrize("factor", [1.0, 0.8, 1.3])
def test_velocities_of_the_positions_stay(factor: float) -> None:
    """So do those that are off by what an effect may be, those of a joint that rests, and none at all."""
    stream = swing()
    scaled = Stream(stream.time, {**stream.values, "velocity": factor * stream["velocity"]})
    assert vet_joint(scaled, "arm") == (scaled, [])
    rest = Stream(stream.time, {name: 0.0 * data for name, data in stream.values.items()})
    assert vet_joint(rest, "arm") == (rest, [])
    alone = Stream(stream.time, {"position": stream["position"]})
    assert vet_joint(alone, "arm") == (alone, [])


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
