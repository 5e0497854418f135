"""How good a joint's logged positions and velocities are, read off the samples."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.estimation.joints import POSITION_SHARE, agree, estimate_noise
from vpptwin.logs.flight import Stream

TIME = np.arange(4000) / 200.0
PATH = np.sin(TIME) + 0.3 * np.sin(2.7 * TIME)
SPEED = np.cos(TIME) + 0.81 * np.cos(2.7 * TIME)
RANGE = float(np.diff(np.percentile(PATH, [1.0, 99.0]))[0])
FLOOR = POSITION_SHARE * RANGE
MEMORY = np.sqrt(10.0)
"""Errors of what was smoothed are alike over ten bins."""


def draw(std: float, seed: int = 0) -> np.ndarray:
    """White noise."""
    return std * np.random.default_rng(seed).standard_normal(len(TIME))


def test_white_noise_is_believed_as_bins_show_it() -> None:
    """At 200 Hz two samples make a bin: 1/√2 of the noise of one; 4000 third differences know it to some 3 %."""
    assert estimate_noise(TIME, PATH + draw(0.01), POSITION_SHARE) == pytest.approx(0.01 / np.sqrt(2.0), rel=0.1)
    # Far below the share of the range that is believed of an estimator.
    assert estimate_noise(TIME, PATH + draw(0.2 * FLOOR), POSITION_SHARE) < 0.2 * FLOOR


def test_nothing_is_believed_better_than_a_tenth_of_its_share() -> None:
    """Noise of a hundredth of it."""
    noisy = PATH + draw(0.01 * FLOOR)
    low, high = np.percentile(noisy, [1.0, 99.0])
    assert estimate_noise(TIME, noisy, POSITION_SHARE) == pytest.approx(0.1 * POSITION_SHARE * (high - low))


@pytest.mark.parametrize("smoothed", [PATH, PATH + np.convolve(draw(0.01), np.hanning(9) / 4.0, mode="same")])
def test_what_somebody_smoothed_is_not(smoothed: np.ndarray) -> None:
    """A noise-free signal, or a smooth mean of some samples: the share of its range, alike for ten bins."""
    low, high = np.percentile(smoothed, [1.0, 99.0])
    assert estimate_noise(TIME, smoothed, POSITION_SHARE) == pytest.approx(
        MEMORY * POSITION_SHARE * (high - low), rel=0.2
    )


def test_white_noise_on_an_estimators_error_is_not() -> None:
    """Samples that contradict another stream are not believed, however white their noise."""
    found = estimate_noise(TIME, PATH + draw(0.1 * FLOOR), POSITION_SHARE, agreed=False)
    assert found == pytest.approx(MEMORY * FLOOR, rel=0.05)


def test_jumps_do_not_hide_white_noise() -> None:
    """Twenty of a hundred sigma, which least squares would mistake for what is unlike white noise."""
    jumps = np.where(np.arange(len(TIME)) % 200 == 100, 1.0, 0.0)
    assert estimate_noise(TIME, PATH + draw(0.01) + jumps, POSITION_SHARE) == pytest.approx(
        0.01 / np.sqrt(2.0), rel=0.15
    )


def test_few_samples_tell_nothing() -> None:
    """49: the share of the range."""
    low, high = np.percentile(PATH[:49], [1.0, 99.0])
    assert estimate_noise(TIME[:49], PATH[:49], POSITION_SHARE) == pytest.approx(POSITION_SHARE * (high - low))


def stream(velocity: np.ndarray | None, position: np.ndarray = PATH) -> Stream:
    """A joint's samples."""
    return Stream(TIME, {"position": position} | ({} if velocity is None else {"velocity": velocity}))


def test_velocities_that_integrate_to_the_positions_agree() -> None:
    """But for white noise in both; where there are none, nothing contradicts."""
    assert agree(stream(SPEED + draw(0.05), PATH + draw(1e-3, 1)))
    assert agree(stream(None))
    assert agree(Stream(TIME[:40], {"position": PATH[:40], "velocity": -SPEED[:40]}))


@pytest.mark.parametrize("velocity", [1.1 * SPEED, SPEED + 0.05, np.roll(SPEED, 12)], ids=["gain", "bias", "late"])
def test_velocities_of_an_estimator_do_not(velocity: np.ndarray) -> None:
    """10 % too fast, 0.05 m/s off, or 60 ms late."""
    assert not agree(stream(velocity, PATH + draw(1e-4)))
