"""How good a joint's logged positions and velocities are, read off the samples."""

from __future__ import annotations

import re
from contextlib import nullcontext

import numpy as np
import pytest

from vpptwin.estimation.checks.units import vet_rates
from vpptwin.estimation.joints import POSITION_SHARE, compare_streams, read_track
from vpptwin.estimation.noise import estimate_noise, find_count
from vpptwin.estimation.series import align_rates, integrate
from vpptwin.logs.flight import Stream
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.manifold import turn_to_world

TIME = np.arange(4000) / 200.0
PATH = np.sin(TIME) + 0.3 * np.sin(2.7 * TIME)
SPEED = np.cos(TIME) + 0.81 * np.cos(2.7 * TIME)
RANGE = float(np.diff(np.percentile(PATH, [1.0, 99.0]))[0])
FLOOR = POSITION_SHARE * RANGE


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


COUNT = 2.0 * np.pi / 4096.0


@pytest.mark.parametrize(("path", "noise"), [(PATH, 0.0), (PATH * (PATH > 0.0), 0.0), (PATH, 0.3 * COUNT)])
def test_half_a_count_is_believed_of_an_encoder(path: np.ndarray, noise: float) -> None:
    """Of 4096 a turn, moving all the time, at rest half of it, or in a noise that the counts hide."""
    counted = COUNT * np.round((path + draw(max(noise, 1e-12))) / COUNT)
    assert find_count(counted) == pytest.approx(COUNT, rel=1e-4)
    assert estimate_noise(TIME, counted, POSITION_SHARE) == pytest.approx(0.5 * COUNT, rel=1e-4)


@pytest.mark.parametrize(
    "value",
    [PATH, PATH + draw(2e-3), np.round(PATH, 3), np.deg2rad(np.round(np.rad2deg(PATH), 1)), 30.0 * TIME + draw(1e-4)],
)
def test_no_counts_are_seen_in_anything_else(value: np.ndarray) -> None:
    """What is smooth, noisy, written with so many digits of radians or degrees, or goes at one speed."""
    assert find_count(value) == 0.0
    assert find_count(COUNT * np.round((PATH + draw(3.0 * COUNT)) / COUNT)) == 0.0


def test_a_wheel_errs_no_more_after_ten_turns() -> None:
    """A hinge is believed by a share of one turn at most, a slide by one of all its way."""
    stream = Stream(TIME, {"position": 30.0 * TIME + draw(1e-4)})
    of_wheel, of_slide = (read_track(stream, "wheel", rotary)[0].std for rotary in (True, False))
    assert of_wheel == pytest.approx(0.1 * POSITION_SHARE * 2.0 * np.pi)
    assert of_slide == pytest.approx(0.1 * POSITION_SHARE * 0.98 * 30.0 * np.ptp(TIME), rel=1e-3)


@pytest.mark.parametrize("smoothed", [PATH, PATH + np.convolve(draw(0.01), np.hanning(9) / 4.0, mode="same")])
def test_what_somebody_smoothed_is_not(smoothed: np.ndarray) -> None:
    """A noise-free signal, or a smooth mean of some samples: the share of its range."""
    low, high = np.percentile(smoothed, [1.0, 99.0])
    assert estimate_noise(TIME, smoothed, POSITION_SHARE) == pytest.approx(POSITION_SHARE * (high - low), rel=0.2)


def test_disagreement_is_what_is_believed() -> None:
    """Samples that contradict another stream are as good as both agree, no worse than their share of the range."""
    noisy = PATH + draw(0.05 * FLOOR)
    assert estimate_noise(TIME, noisy, POSITION_SHARE, 0.5 * FLOOR) == pytest.approx(0.5 * FLOOR)
    assert estimate_noise(TIME, noisy, POSITION_SHARE, 9.0 * FLOOR) == pytest.approx(FLOOR, rel=0.05)


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
    """But for white noise in both, of which 0.05 m/s over 46 samples makes 1.7 mm; without any nothing is known."""
    late, found = compare_streams(stream(SPEED + draw(0.05), PATH + draw(1e-3, 1)))
    assert late == 0.0
    assert found is not None
    assert found < 1.7e-3
    assert compare_streams(stream(None)) == (0.0, None)
    assert compare_streams(Stream(TIME[:40], {"position": PATH[:40], "velocity": -SPEED[:40]})) == (0.0, None)


@pytest.mark.parametrize("velocity", [1.1 * SPEED, SPEED + 0.05], ids=["gain", "bias"])
def test_velocities_that_do_not_are_told(velocity: np.ndarray) -> None:
    """A gain of 1.1 or a bias of 0.05 m/s over a quarter of a second: centimetres, and no lateness explains it."""
    late, found = compare_streams(stream(velocity))
    assert late == 0.0
    assert found is not None
    assert found > 5e-3


def low_pass(value: np.ndarray, time_constant: float) -> np.ndarray:
    """A first-order lag."""
    out, held, keep = np.empty_like(value), value[0], np.exp(-0.005 / time_constant)
    for i, x in enumerate(value):
        held = x + keep * (held - x)
        out[i] = held
    return out


def test_the_stream_that_lags_is_found() -> None:
    """A lag of 20 ms, or 60 ms late; what is left after it is moved is what noise makes, or half of less."""
    noise = draw(0.02)
    late, left = compare_streams(stream(low_pass(SPEED, 0.02) + noise))
    assert late == pytest.approx(0.02, abs=0.003)  # samples are 5 ms apart
    assert left is not None
    assert left < 1e-3
    late, left = compare_streams(stream(SPEED + noise, low_pass(PATH, 0.02)))
    assert late == pytest.approx(-0.02, abs=0.003)
    late, left = compare_streams(stream(np.roll(SPEED, 12)))
    assert late == pytest.approx(0.06, abs=0.005)


def test_what_lags_is_moved_and_the_other_believed() -> None:
    """Velocities 20 ms late: their stamps move, positions are as good as their white noise. And the other way round."""
    quiet = 0.3 * FLOOR
    for path, speed, moved in (
        (PATH, low_pass(SPEED, 0.02), (0.0, 0.02)),
        (low_pass(PATH, 0.02), SPEED, (0.02, 0.0)),
    ):
        joint = Stream(TIME, {"position": path + draw(quiet, 1), "velocity": speed + draw(1e-3)})
        position, velocity = read_track(joint, "slide", rotary=False)
        assert velocity is not None
        assert TIME[0] - position.time[0] == pytest.approx(moved[0], abs=0.003)
        assert TIME[0] - velocity.time[0] == pytest.approx(moved[1], abs=0.003)
        assert position.std < 0.5 * FLOOR


def test_how_a_gyro_is_mounted_is_no_noise() -> None:
    """Turned by 0.1 rad, 3 % too large, 0.02 rad/s off: aligned with attitudes it is off by its noise, 0.01 rad/s."""
    rates = np.stack([SPEED, np.cos(1.3 * TIME), 0.5 * np.sin(0.7 * TIME)], axis=1)
    mounted = turn_to_world(np.array([np.cos(0.05), 0.0, 0.0, np.sin(0.05)]), rates)
    noise = 0.01 * np.random.default_rng(3).standard_normal(rates.shape)
    turned = integrate(rates, TIME) + 2e-3 * np.random.default_rng(4).standard_normal(rates.shape)
    found = align_rates(TIME, turned, 1.03 * mounted + 0.02 + noise)
    assert np.std(mounted - rates) > 0.05
    assert np.std(found - rates) == pytest.approx(0.01, rel=0.1)
    np.testing.assert_array_equal(align_rates(TIME, turned, np.zeros_like(rates)), 0.0)


@pytest.mark.parametrize(
    ("factor", "told"),
    [(57.3, " times the turning of the attitudes and look like deg/s; expected"), (0.0175, "`unit: rad/s`"),
     (2.0, "which is no unit: a heading that wheels which slip have turned, or a gyro of another range"), (1.2, "")],
)  # fmt: skip
def test_a_gyro_in_another_unit_is_refused(factor: float, told: str) -> None:
    """Whichever way its axes lie; a scale that is an effect's passes, and so does what shows no such motion."""
    rates = np.stack([SPEED, np.cos(1.3 * TIME), 0.5 * np.sin(0.7 * TIME)], axis=1)
    turned = integrate(rates, TIME) + 2e-3 * np.random.default_rng(4).standard_normal(rates.shape)
    logged = factor * turn_to_world(np.array([0.5, 0.5, 0.5, 0.5]), rates)
    with pytest.raises(InputError, match=re.escape(told)) if told else nullcontext():
        vet_rates("log: rates of craft", TIME, turned, logged, align_rates(TIME, turned, logged))
    vet_rates("log: rates of craft", TIME[:1], turned[:1], logged[:1], logged[:1])  # of a single pose nothing is told
    noise = np.random.default_rng(5).standard_normal(rates.shape)
    vet_rates("log: rates of craft", TIME, turned, noise, align_rates(TIME, turned, noise))
