"""Weather: gusts follow nothing, however strong, slow or sudden; a force that follows something is found among them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.judgement.leftover import predicted_share
from vpptwin.diagnosis.judgement.weather import FOLDS, Missing, Push, find_swing, fit_gusts, leave_behind

Draw = Callable[[int, float], np.ndarray]
TIME = np.tile(np.arange(160) / 10.0, 3)
"""Three flights of 16 s, a pulse every tenth of a second."""
FLIGHT = np.repeat(np.arange(3), 160)
PLACE = np.sin(2.0 * np.pi * TIME / 3.1 + FLIGHT)


def draw_walk(seed: int, memory: float) -> np.ndarray:
    """Ornstein-Uhlenbeck of variance 1 in every flight."""
    rng, decay = np.random.default_rng(seed), np.exp(-0.1 / memory)
    path = rng.standard_normal(480)
    for k in range(1, 480):
        if FLIGHT[k] == FLIGHT[k - 1]:
            path[k] = decay * path[k - 1] + np.sqrt(1.0 - decay**2) * path[k]
    return path


def draw_steps(seed: int, memory: float) -> np.ndarray:
    """Jumps to a new force, on average every `memory` s."""
    rng = np.random.default_rng(seed)
    jumps = np.cumsum(rng.random(480) < 0.1 / memory)
    return rng.standard_normal(jumps.max() + 1)[jumps]


def inspect(force: np.ndarray) -> Push:
    """What becomes of a force that may follow the place, the way come there, or the time."""
    quantities = {"place": PLACE, "way": leave_behind(PLACE, TIME, FLIGHT, 0.3), "time": TIME}
    return Missing(force[:, None], TIME, FLIGHT, quantities).inspect(0, CRITERIA)


@pytest.mark.parametrize("memory", [0.1, 0.3, 1.0])
def test_how_long_gusts_stay_alike_is_found(memory: float) -> None:
    """The three that are tried are a factor of three apart: 48 s tell them."""
    gusts = fit_gusts(3.0 * draw_walk(1, memory), TIME, FLIGHT, CRITERIA.longest_gust)
    assert gusts.memory == pytest.approx(memory)
    assert np.mean(gusts.innovations**2) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("draw", [draw_walk, draw_steps])
@pytest.mark.parametrize("memory", [0.1, 0.3, 0.9])
def test_gusts_follow_nothing(draw: Draw, memory: float) -> None:
    """Thrice what is assumed: no gale, and no quantity comes within a sigma of being taken for what pushes."""
    found = [inspect(3.0 * draw(seed, memory)) for seed in range(10)]
    assert max(push.sigma for push in found) < CRITERIA.followed - 1.0
    assert max(push.strength for push in found) < CRITERIA.gale


@pytest.mark.parametrize("draw", [draw_walk, draw_steps])
def test_a_force_that_follows_the_place_is_found_in_slow_gusts(draw: Draw) -> None:
    """A unit that changes sign with the place, under gusts three times as strong: a tenth of the variance."""
    push = inspect(3.0 * draw(2, 1.0) + np.sign(PLACE))
    assert push.sigma > CRITERIA.followed
    assert push.foretold > CRITERIA.push
    assert push.followed[0].label in ("place", "way")


def test_a_force_with_a_memory_is_found() -> None:
    """It lags behind the place, and so follows the way that was come, under gusts half as strong as itself."""
    force = 0.5 * draw_walk(3, 0.3) + np.tanh(8.0 * leave_behind(PLACE, TIME, FLIGHT, 0.3))
    assert inspect(force).followed[0].label == "way"
    assert inspect(force).sigma > CRITERIA.followed


def test_the_way_come_by_hand() -> None:
    """From 0 to 1 and there: 1/e of the way back is left after one memory, in each flight anew, in whatever order."""
    time, flight = np.array([2.0, 0.0, 1.0, 0.0]), np.array([0, 0, 0, 1])
    way = leave_behind(np.array([1.0, 0.0, 1.0, 5.0]), time, flight, 1.0)
    np.testing.assert_allclose(way, [np.exp(-2.0), 0.0, np.exp(-1.0), 0.0])
    # A force of zero has no strength and no innovations.
    push = inspect(np.zeros(480))
    assert (push.sigma, push.strength, push.foretold) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("swing", [1.5, 0.0])
def test_a_force_that_swings_by_itself_is_found(swing: float) -> None:
    """A sine of 1.5 beside noise of one, at 0.7 Hz, in two logs: 1.125 / 2.125 of the variance. Noise is no swing."""
    time, flight = np.tile(0.1 * np.arange(150), 2), np.repeat([3, 5], 150)
    force = np.random.default_rng(5).standard_normal(300)
    force += swing * np.sin(2.0 * np.pi * 0.7 * time + flight)
    label, phase = find_swing(force, time, flight)
    share = predicted_share(phase, force, np.arange(300) // 15 % FOLDS)
    if swing:
        assert float(label.split()[3]) == pytest.approx(0.7, abs=0.02)
        assert 0.4 < share < 0.6
    else:
        assert share < CRITERIA.structure
