"""The reward, worked out by hand, by every criterion of the curriculum."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vpptwin.train.env.reward import ANGLE, BOTH, POSITION, RewardWeights, compute_reward
from vpptwin.train.env.tasks import TASKS, Task
from vpptwin.train.main import compose_config

WEIGHTS = RewardWeights(position=0.8, orientation=0.7, velocity=0.2, rate=0.3, integral=0.1, near=0.4, width=0.1)
DELTA = np.array([[0.3, -0.1, math.pi / 2]])
VELOCITY = np.array([[0.6, 0.8, 2.0]])
INTEGRAL = np.array([[1.0, -1.0]])
# r_p = 1/(1 + 10 * 0.1) = 0.5; r_o = (1 + 0)/2; r_v = 0.5/(1 + 1); r_ω = 0.5/(1 + 4); r_i = 1/(1 + 2)
# r_n = 0.5/(1 + 0.1/0.01)
CRITERIA = (BOTH, POSITION, ANGLE)
Weight = st.floats(0.05, 2.0)


def judge(weights: RewardWeights, criterion: int, *state: np.ndarray) -> np.ndarray:
    """Reward of a state when every episode is judged so."""
    return compute_reward(weights, *state, np.full(len(state[0]), criterion))


def draw_states(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random Δ, velocities and integrals, near and far."""
    rng = np.random.default_rng(0)
    size = 10.0 ** rng.uniform(-3.0, 1.0, (count, 1))
    return tuple(size * rng.standard_normal((count, k)) for k in (3, 3, 2))  # type: ignore[return-value]


def test_reward_by_hand() -> None:
    """The paper's sum, with r_v and r_ω carrying their own factor r_p, and what is paid near the target."""
    # R = 0.8*0.5 + 0.5*(0.7*0.5 + 0.2*0.25 + 0.3*0.1) + 0.1/3 + 0.4*0.5/11 = 0.4 + 0.215 + 0.0333 + 0.0182
    paper = replace(WEIGHTS, near=0.0)
    np.testing.assert_allclose(compute_reward(paper, DELTA, VELOCITY, INTEGRAL), [0.4 + 0.215 + 0.1 / 3.0])
    expected = [0.4 + 0.215 + 0.1 / 3.0 + 0.2 / 11.0]
    np.testing.assert_allclose(compute_reward(WEIGHTS, DELTA, VELOCITY, INTEGRAL), expected)
    np.testing.assert_allclose(judge(WEIGHTS, BOTH, DELTA, VELOCITY, INTEGRAL), expected)


def test_single_criteria_by_hand() -> None:
    """Position: the sum without w_o, at any angle, times 2.5/1.8. Angle: w_o r_o + w_ω / (1 + ω²), times 2.5/1."""
    # Position: 0.4 + 0.5*(0.2*0.25 + 0.3*0.1) + 0.0333 + 0.4/11; angle: 0.7*0.5 + 0.3*0.2 = 0.41.
    position = judge(WEIGHTS, POSITION, DELTA, VELOCITY, INTEGRAL)
    np.testing.assert_allclose(position, [(0.44 + 0.1 / 3.0 + 0.4 / 11.0) * 2.5 / 1.8])
    np.testing.assert_allclose(judge(WEIGHTS, ANGLE, DELTA, VELOCITY, INTEGRAL), [0.41 * 2.5])


def test_paper_weights_add_up() -> None:
    """The paper's flip weights are worth 2.2 at most, without what is ours; the paper's preset has just those."""
    assert RewardWeights(near=0.0).best == pytest.approx(2.2)
    weights = compose_config(["task=flip", "preset=paper"]).task.weights
    assert [weights.position, weights.orientation, weights.velocity, weights.rate] == [0.8, 0.8, 0.2, 0.2]
    assert (weights.integral, weights.near) == (0.2, 0.0)


def test_a_centimetre_near_the_target_counts() -> None:
    """From 2 cm to 1 cm the paper's reward rises by 0.3 % of the best, with ours by 2 %."""
    delta, rest = np.array([[0.02, 0.0, 0.0], [0.01, 0.0, 0.0]]), np.zeros((2, 3))
    for weights, low, high in ((RewardWeights(near=0.0), 0.002, 0.004), (RewardWeights(), 0.015, 0.025)):
        far, near = compute_reward(weights, delta, rest, np.zeros((2, 2))) / weights.best
        assert low < near - far < high


@given(
    st.builds(
        RewardWeights, position=Weight, orientation=Weight, velocity=Weight, rate=Weight, integral=Weight, near=Weight
    )
)
def test_the_best_is_rest_on_the_target(weights: RewardWeights) -> None:
    """By every criterion, rest on the target is worth the sum of the weights, and nothing is worth more or below 0."""
    states = draw_states(200)
    for criterion in CRITERIA:
        rest = judge(weights, criterion, np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2)))
        assert rest[0] == pytest.approx(weights.best)
        reward = judge(weights, criterion, *states)
        assert (reward >= 0.0).all()
        assert (reward <= weights.best * (1.0 + 1e-12)).all()


@pytest.mark.parametrize("task", TASKS.values(), ids=list(TASKS))
def test_criteria_are_worth_the_same_in_every_task(task: Task) -> None:
    """An episode judged by one criterion pays as much at best as one judged by both."""
    still = [np.zeros((3, k)) for k in (3, 3, 2)]
    np.testing.assert_allclose(compute_reward(task.weights, *still, np.array(CRITERIA)), task.weights.best)


def test_position_episodes_ignore_the_angle() -> None:
    """Judged by position, the reward is the same at any angle; otherwise it is not."""
    delta, velocity, integral = draw_states(100)
    turned = delta + np.array([0.0, 0.0, 1.0])
    here, there = (judge(WEIGHTS, POSITION, d, velocity, integral) for d in (delta, turned))
    np.testing.assert_array_equal(here, there)
    for criterion in (BOTH, ANGLE):
        changed = judge(WEIGHTS, criterion, delta, velocity, integral) != judge(
            WEIGHTS, criterion, turned, velocity, integral
        )
        assert changed.all()


def test_angle_episodes_ignore_the_place() -> None:
    """Judged by its angle, neither position nor linear velocity nor integral count, but the rate does."""
    delta, velocity, integral = draw_states(100)
    here = judge(WEIGHTS, ANGLE, delta, velocity, integral)
    away, fast, spinning = (np.array(change) for change in ((1.0, -1.0, 0.0), (2.0, 2.0, 0.0), (0.0, 0.0, 1.0)))
    moved = judge(WEIGHTS, ANGLE, delta + away, velocity + fast, integral + 3.0)
    np.testing.assert_array_equal(here, moved)
    assert (judge(WEIGHTS, ANGLE, delta, velocity + spinning, integral) != here).all()


def test_episodes_are_judged_one_by_one() -> None:
    """In a batch every row is paid by its own criterion."""
    states = draw_states(60)
    criteria = np.random.default_rng(1).choice(CRITERIA, 60)
    mixed = compute_reward(WEIGHTS, *states, criteria)
    for criterion in CRITERIA:
        rows = criteria == criterion
        assert rows.any()
        np.testing.assert_array_equal(mixed[rows], judge(WEIGHTS, criterion, *states)[rows])
