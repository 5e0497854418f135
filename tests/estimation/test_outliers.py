"""Which samples count as outliers, and which wild ones are true."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.estimation.outliers import clean_series, find_frozen, find_spikes, find_strays, wrap_angle
from vpptwin.estimation.series import Series

TIME = np.arange(0.0, 4.0, 0.01)
STD = 0.003


def test_flips_and_bounces_stay() -> None:
    """A flip at 15 rad/s that begins and ends at 600 rad/s², and a bounce off the wall at 3 m/s, are no outliers."""
    rng = np.random.default_rng(0)
    rate = np.clip(np.minimum((TIME - 1.0) * 600.0, (1.45 - TIME) * 600.0), 0.0, 15.0)
    angle = np.cumsum(rate) * 0.01 + STD * rng.normal(size=len(TIME))
    assert not find_spikes(TIME, angle, STD, 600.0).any()
    bounce = 3.0 * np.abs(TIME - 2.004) + 4e-4 * rng.normal(size=len(TIME))
    assert not find_spikes(TIME, bounce, 4e-4, 100.0).any()
    place = np.stack([bounce, np.ones_like(TIME), angle], axis=1)
    assert not find_strays(TIME, place, np.array([4e-4, 4e-4, STD]), np.array([8.0, 8.0, 40.0]), turn=2).any()


@pytest.mark.parametrize("curvature", [600.0, None])
@pytest.mark.parametrize("wild", [[50], [0], [399], [50, 51], [50, 53, 57]])
def test_spikes_go(wild: list[int], curvature: float | None) -> None:
    """Single spikes are found with and without knowledge of the motion; ends of a log only with it."""
    value = np.sin(2.0 * TIME) + STD * np.random.default_rng(1).normal(size=len(TIME))
    value[wild] += 0.5
    found = np.flatnonzero(find_spikes(TIME, value, STD, curvature)).tolist()
    assert found == (wild if curvature or wild[0] == 50 else [])


def test_fast_vibration_is_noise() -> None:
    """An accelerometer that shakes with the rotors at 300 Hz keeps its samples, and still loses its spikes."""
    time = np.arange(0.0, 1.0, 0.001)
    value = 5.0 * np.sin(2.0 * np.pi * 300.0 * time) + 0.08 * np.random.default_rng(2).normal(size=1000)
    value[500] += 200.0
    assert np.flatnonzero(find_spikes(time, value, 0.08, 4e6)).tolist() == [500]


def test_motion_of_which_nothing_is_known_stays() -> None:
    """A pendulum at 3 Hz, seen 20 times a second after long rest, misses every line and is no outlier."""
    time = np.arange(0.0, 20.0, 0.05)
    value = np.where(time > 15.0, np.sin(2.0 * np.pi * 3.0 * (time - 15.0)), 0.0)
    value += 1e-3 * np.random.default_rng(3).normal(size=len(time))
    assert not find_spikes(time, value, 1e-3, None).any()


def test_strays_must_come_back() -> None:
    """0.2 s beside go; what stays away for longer has moved there; whole turns are no distance."""
    std, speed = np.array([4e-4, STD]), np.array([8.0, 40.0])
    value = np.stack([0.1 * TIME, np.sin(TIME)], axis=1)
    beside = value + [0.5, 0.0] * ((TIME >= 1.0) & (TIME < 1.2))[:, None]
    found = find_strays(TIME, beside, std, speed)
    np.testing.assert_array_equal(found, (TIME >= 1.0) & (TIME < 1.2))
    moved = value + [0.5, 0.0] * ((TIME >= 1.0) & (TIME < 1.5))[:, None]
    assert not find_strays(TIME, moved, std, speed).any()
    turned = value + [0.0, 2.0 * np.pi] * ((TIME >= 1.0) & (TIME < 1.2))[:, None]
    assert not find_strays(TIME, turned, std, speed, turn=1).any()
    first = value + [0.5, 0.0] * (TIME < 0.2)[:, None]
    np.testing.assert_array_equal(find_strays(TIME, first, std, speed), TIME < 0.2)


def test_only_a_tracker_that_missed_motion_was_frozen() -> None:
    """Repeats count when the pose jumps afterwards; a craft at rest in a log without noise may repeat for ever."""
    std = np.array([4e-4])
    moving = np.where(TIME < 3.0, np.minimum(TIME, 2.0), 2.0 + 2.0 * (TIME - 3.0) ** 2)[:, None]  # rests for a second
    assert not find_frozen(moving, std).any()
    stuck = moving.copy()
    stuck[100:120] = stuck[100]
    np.testing.assert_array_equal(np.flatnonzero(find_frozen(stuck, std)), np.arange(101, 120))


def test_angles_are_wrapped() -> None:
    """By whole turns into [-π, π)."""
    np.testing.assert_allclose(
        wrap_angle(np.array([0.1, 3.5, -3.5, 7.0])), [0.1, 3.5 - 2 * np.pi, 2 * np.pi - 3.5, 7.0 - 2 * np.pi]
    )


def test_what_a_slower_publisher_says_of_a_joint_goes() -> None:
    """Zeros among the positions of a joint that moves, as of a second publisher on its topic: all but those near it."""
    time = np.sort(np.concatenate([TIME, TIME[::20] + 0.003]))
    false = np.isin(time, TIME[::20] + 0.003)
    value = np.where(false, 0.0, 0.8 * np.sin(2.0 * time) + 1e-3 * np.random.default_rng(4).normal(size=len(time)))
    kept, told = clean_series(Series("arm", "rad", time, value, 1e-3, white=False), "arm")
    left = ~np.isin(time, kept.time)
    assert left[false & (np.abs(np.sin(2.0 * time)) > 0.2)].all()
    assert not left[~false].any()
    assert len(told) == 1
