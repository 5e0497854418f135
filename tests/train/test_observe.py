"""The observation and the reward, worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vpptwin.train.observe import OBSERVATION, accumulate_error, observation_size, observe
from vpptwin.train.reward import RewardWeights, compute_reward


def test_observation_by_hand() -> None:
    """Every input is where SPEC 6 puts it, with the sign of target minus state."""
    pose = np.array([[0.1, 1.2, 0.5]])
    velocity = np.array([[0.3, -0.4, 2.0]])
    target = np.array([[0.4, 1.0, math.pi]])
    integral = np.array([[0.7, -0.8]])
    # Δp = (0.4 - 0.1, 1.0 - 1.2); Δθ = π - 0.5, whose sine is sin 0.5 and cosine -cos 0.5; sin π = 0, cos π = -1.
    expected = [0.3, -0.2, 0.3, -0.4, math.sin(0.5), -math.cos(0.5), 2.0, 0.7, -0.8, 0.0, -1.0]
    seen = observe(pose, velocity, target, integral)
    assert seen.dtype == np.float32
    np.testing.assert_allclose(seen, [expected], atol=1e-6)  # float32
    assert seen.shape == (1, len(OBSERVATION)) == (1, observation_size())


def test_paper_inputs_are_the_first_nine() -> None:
    """The ablation is a prefix of the observation, so it differs in nothing but the target's angle."""
    rng = np.random.default_rng(0)
    arguments = [rng.standard_normal((5, k)) for k in (3, 3, 3, 2)]
    np.testing.assert_array_equal(observe(*arguments, paper_inputs=True), observe(*arguments)[:, :9])


def test_integral_recursion() -> None:
    """Γ_t = 0.9 Γ_{t-1} + Δp_t, which tends to ten times a constant error."""
    error = np.array([[0.2, -0.1]])
    first = accumulate_error(np.zeros((1, 2)), error)
    second = accumulate_error(first, error)
    np.testing.assert_allclose(first, [[0.2, -0.1]])
    np.testing.assert_allclose(second, [[0.38, -0.19]])  # 0.9 * 0.2 + 0.2
    for _ in range(300):
        second = accumulate_error(second, error)
    np.testing.assert_allclose(second, [[2.0, -1.0]], rtol=1e-9)  # 0.9^300 is 2e-14


def test_reward_by_hand() -> None:
    """The paper's sum, with r_v and r_ω carrying their own factor r_p."""
    weights = RewardWeights(position=0.8, orientation=0.7, velocity=0.2, rate=0.3, integral=0.1)
    delta = np.array([[0.3, -0.1, math.pi / 2]])
    velocity = np.array([[0.6, 0.8, 2.0]])
    integral = np.array([[1.0, -1.0]])
    # r_p = 1/(1 + 10 * 0.1) = 0.5; r_o = (1 + 0)/2; r_v = 0.5/(1 + 1); r_ω = 0.5/(1 + 4); r_i = 1/(1 + 2)
    # R = 0.8*0.5 + 0.5*(0.7*0.5 + 0.2*0.25 + 0.3*0.1) + 0.1/3 = 0.4 + 0.215 + 0.0333
    np.testing.assert_allclose(compute_reward(weights, delta, velocity, integral), [0.4 + 0.215 + 0.1 / 3.0])


def test_best_reward_is_rest_on_the_target() -> None:
    """At rest on the target every term is one; the paper's flip weights add up to 2.2."""
    weights = RewardWeights()
    rest = compute_reward(weights, np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2)))
    assert rest[0] == pytest.approx(weights.best) == pytest.approx(2.2)
