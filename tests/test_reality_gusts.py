"""Gusts of the independent simulation are as strong and as lasting as a session draws them, whatever their kind."""

from __future__ import annotations

import numpy as np
import pytest

from proving.drone import Wind, draw_wind, fly, fly_many
from proving.drone.gusts import AXES, KINDS, SERIES, STRENGTHS, TIMES, Field, draw_gust
from proving.drone.rig import load_nominal

NOMINAL = load_nominal()
STEPS = 400_000  # ms: 400 s are 800 correlation times of 0.5 s


def correlate(series: np.ndarray, late: int) -> np.ndarray:
    """Correlation of the columns with themselves `late` steps on."""
    return (series[late:] * series[:-late]).mean(0) / (series**2).mean(0)


@pytest.mark.parametrize("kind", SERIES)
def test_strength_and_pace_are_as_drawn(kind: str) -> None:
    """Rms is the stated share of weight, in ten runs; alike after a tenth of the time, unlike after three times it."""
    wind = Wind(kind, 2.0, 0.5, (1.0, 0.5, 2.0))
    runs = [draw_gust(wind, np.random.default_rng(seed), STEPS // 10, NOMINAL) for seed in range(10)]
    # 2 % of 0.45 kg x 9.81 m/s^2 = 0.0883 N; half the arm 0.2 m.
    stated = 0.0883 * np.array([1.0, 0.5, 0.4])
    series = np.concatenate(runs)
    assert np.sqrt((series**2).mean(0)) == pytest.approx(stated, rel=0.15)
    # Linear near zero where the force jumps: exp(-0.1) = 0.90; the smooth kinds are closer to 1.
    assert (np.mean([correlate(run, 50) for run in runs], axis=0) > 0.85).all()
    assert (np.mean([correlate(run, 1500) for run in runs], axis=0) < 0.35).all()  # waves swing back


@pytest.mark.slow
def test_kinds_differ_in_more_than_name() -> None:
    """Bursts are rare and high (kurtosis over 4), waves bounded (below 3); smooth gusts have no kinks."""
    runs = {k: draw_gust(Wind(k, 1.0, 0.3), np.random.default_rng(1), STEPS, NOMINAL)[:, 0] for k in SERIES}
    peaked = {kind: (run**4).mean() / (run**2).mean() ** 2 for kind, run in runs.items()}
    assert peaked["bursts"] > 4.0
    assert peaked["waves"] < 3.0
    rough = {kind: np.abs(np.diff(run)).max() / run.std() for kind, run in runs.items()}
    assert rough["steps"] > 1.0
    assert max(rough["smooth"], rough["waves"], rough["bursts"]) < 0.05
    assert 0.2 < rough["ou"] < 1.0


def test_default_wind_is_what_it_was() -> None:
    """Ornstein-Uhlenbeck, 0.3 s, 1 % of weight: flights of before fly again."""
    series = draw_gust(Wind(), np.random.default_rng(3), 1000, NOMINAL)
    decay = np.exp(-0.001 / 0.3)
    kicks = np.random.default_rng(3).standard_normal((1000, 3)) * np.sqrt(1 - decay**2)
    first = kicks[0] / np.sqrt(1 - decay**2)
    scale = 0.01 * 0.45 * 9.81 * np.array([1.0, 1.0, 0.2])
    np.testing.assert_allclose(series[:2], np.array([first, decay * first + kicks[1]]) * scale, rtol=1e-12)


def test_a_field_is_a_matter_of_place() -> None:
    """The same place and time feel the same, a place 0.5 m off another force; on the mean it is as strong as stated."""
    flights = [{"seed": seed, "gusts": True, "wind": Wind("field", 1.0, 0.5)} for seed in range(60)]
    field = Field(flights, NOMINAL)
    here, there = np.zeros((3, 60)), np.repeat([[0.5], [0.0], [0.0]], 60, axis=1)
    felt = np.array([field.feel(time, here) for time in np.arange(0.0, 20.0, 0.5)])
    apart = np.array([field.feel(time, there) for time in np.arange(0.0, 20.0, 0.5)])
    assert np.sqrt((felt**2).mean((0, 2))) == pytest.approx(0.0441 * np.array([1.0, 1.0, 0.2]), rel=0.1)
    assert abs((felt * apart).mean() / (felt**2).mean()) < 0.5
    np.testing.assert_array_equal(field.feel(1.5, here), felt[3])


@pytest.mark.slow
def test_a_flight_feels_its_own_wind() -> None:
    """A flight in a field beside others in a batch flies as it does alone, and truth holds what it felt."""
    plans = [{"manoeuvre": "x_steps", "duration": 2.0, "seed": 4, "wind": Wind(kind, 3.0)} for kind in ("ou", "field")]
    _, blown = fly_many(plans)
    alone = fly({}, "x_steps", 2.0, 4, wind=Wind("field", 3.0))
    np.testing.assert_array_equal(alone.truth["position"], blown.truth["position"])
    assert blown.truth["gust"][:, 0].std() > 0.03
    with pytest.raises(ValueError, match="unknown gusts"):
        fly({}, "x_steps", 1.0, 4, wind=Wind("storm"))


def test_what_is_drawn_lies_within_its_bounds() -> None:
    """All kinds come, strengths over a decade, times from 0.1 to 1 s."""
    winds = [draw_wind(np.random.default_rng(seed)) for seed in range(300)]
    assert {wind.kind for wind in winds} == set(KINDS)
    for name, (low, high) in (("strength", STRENGTHS), ("time", TIMES)):
        sizes = np.array([getattr(wind, name) for wind in winds])
        assert low <= sizes.min() < 1.2 * low
        assert high / 1.2 < sizes.max() <= high
    assert all(AXES[0] <= factor <= AXES[1] for wind in winds for factor in wind.axes)
    assert max(draw_wind(np.random.default_rng(seed), most=1.5).strength for seed in range(50)) <= 1.5
