"""What is measured of many flights at once: errors, failures, full turns, the score."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.train.conftest import tiny_env
from vpptwin.train.env.observe import ObservationTerms, wrap_angle
from vpptwin.train.evaluate.flights import Flights, count_turns, fly_tracks
from vpptwin.train.learn.networks import Policy

FULL = 2.0 * np.pi
GRACE = 30
"""Steps that a craft may be late."""


def ask_turn(way: float, steps: int = 300, begin: int = 50) -> tuple[np.ndarray, np.ndarray]:
    """A target that turns through 2π: its angle, and what it has still to turn through, (steps,) rad.

    The trigger comes in step `begin`; from the next one on it turns at 12 rad/s, 0.12 rad a step.
    """
    since = np.arange(steps) - begin
    turn = np.where(since < 0, 0.0, way * np.maximum(FULL - 0.12 * since, 0.0))
    angle = np.where(since < 0, 0.0, way * FULL - turn)
    return angle, turn


def count(theta: np.ndarray, turn: np.ndarray) -> tuple[int, int]:
    """Asked and made on one track."""
    return count_turns(theta[:, None], turn[:, None], GRACE)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_turns_that_are_made(way: float) -> None:
    """A craft that turns with its target, or up to 0.3 s behind it, and in the same direction, has made the turn."""
    angle, turn = ask_turn(way)
    assert count(angle, turn) == (1, 1)
    late = np.concatenate([np.zeros(25), angle[:-25]])
    assert count(late, turn) == (1, 1)
    # What counts is the way made, not where the craft stood: 0.4 rad off, and turns made before.
    assert count(angle + 0.4 + 3.0 * FULL, turn) == (1, 1)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_turns_that_are_not_made(way: float) -> None:
    """Staying, turning the other way, half a turn, stopping 0.7 rad short, going on, and 0.5 s late do not count."""
    angle, turn = ask_turn(way)
    for theta in (0.0 * angle, -angle, 0.5 * angle, angle * (1.0 - 0.7 / FULL), 2.0 * angle):
        assert count(theta, turn) == (1, 0)
    assert count(np.concatenate([np.zeros(50), angle[:-50]]), turn) == (1, 0)
    assert count(angle * (1.0 - 0.5 / FULL), turn) == (1, 1)


def test_turns_of_many_tracks() -> None:
    """Several turns on a track and several tracks add up; a turn that the flight's end cuts off is not counted."""
    one, turn = ask_turn(1.0)
    back, turn_back = ask_turn(-1.0)
    angles = np.concatenate([one, one[-1] + back])
    both = np.concatenate([turn, turn_back])
    still, none = np.zeros(600), np.zeros(600)
    theta = np.column_stack([angles, angles, still])
    assert count_turns(theta, np.column_stack([both, none, both]), GRACE) == (4, 2)
    assert count_turns(theta[:, :0], both[:, None][:, :0], GRACE) == (0, 0)
    cut, cut_turn = ask_turn(1.0, steps=80)
    assert cut_turn[-1] > 0.0
    assert count(cut, cut_turn) == (0, 0)


def test_a_turn_right_at_the_end_is_judged_by_the_last_step() -> None:
    """A target that arrives just before the end leaves less grace, not an error."""
    angle, turn = ask_turn(1.0, steps=105)
    assert turn[-2:].tolist() == [0.0, 0.0]
    assert count(angle, turn) == (1, 1)
    assert count(0.0 * angle, turn) == (1, 0)


def test_score_counts_a_lost_craft_as_a_large_error() -> None:
    """The mean of 0.1, 0.5 for a failure or a missed angle however near it ended, 0.5 for a metre off, and 0.2 m."""
    error = np.array([0.1, 0.01, 0.01, 1.0, 0.2])
    failed, missed, none = np.arange(5) == 1, np.arange(5) == 2, np.zeros(5, bool)
    flights = Flights(error, error, failed, missed, none, none, 0, 0)
    assert flights.score(0.5) == pytest.approx((0.1 + 0.5 + 0.5 + 0.5 + 0.2) / 5.0)


def test_flights_are_measured_step_by_step() -> None:
    """Errors are means over the last window of every flight, angles shortest ways; the policy does not explore."""
    overrides = ("task=flip", "task.episode=0.4", "task.success.window=0.15", "num_envs=12", "noise=1")
    torch.manual_seed(0)
    policy = Policy(ObservationTerms())
    flown = fly_tracks(tiny_env(*overrides), policy)
    env = tiny_env(*overrides)
    observation, place, angle, failed = env.reset()["observation"], [], [], np.zeros(12, bool)
    for _ in range(40):
        with torch.no_grad():
            action = policy(observation)
        last = env.step(TensorDict({"action": action}, batch_size=[12]))["next"]
        observation = last["observation"]
        delta = env.episodes.target - env.state.qpos
        place.append(np.hypot(delta[:, 0], delta[:, 1]))
        angle.append(np.abs(wrap_angle(delta[:, 2])))
        failed |= last["terminated"].numpy()[:, 0]
    np.testing.assert_allclose(flown.position_error, np.mean(place[-15:], axis=0))
    np.testing.assert_allclose(flown.angle_error, np.mean(angle[-15:], axis=0))
    np.testing.assert_array_equal(flown.failed, failed)
    np.testing.assert_array_equal(flown.inverted, env.episodes.target[:, 2] == np.pi)
    assert 0 < flown.inverted.sum() < 12


def test_success_takes_all_of_it() -> None:
    """Near enough, level enough, not failed and no angle missed: each of them alone undoes a success."""
    limits = ("task.success.position=1", "task.success.angle=3.1", "task.episode=0.3", "task.success.window=0.1")
    start = ("task.start.x=[-0.1,0.1]", "task.start.z=[1.2,1.3]", "task.target.x=[0,0]", "num_envs=12")
    policy = Policy(ObservationTerms())
    assert fly_tracks(tiny_env(*limits, *start), policy).success.all()
    for spoilt in ("task.success.position=0.001", "task.success.angle=0.001", "task.limits.rate=0.001"):
        assert not fly_tracks(tiny_env(*limits, *start, spoilt), policy).success.any(), spoilt
    triggered = ("task.target.angles=[0,1]", "task.target.dwell=[0.1,0.1]", "task.target.quiet=0")
    assert fly_tracks(tiny_env(*limits, *start, *triggered), policy).success.all()
    assert not fly_tracks(tiny_env(*limits, *start, *triggered, "task.success.reach=1e-6"), policy).success.any()
