"""The observation, worked out by hand, in each of the paper's setups."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.train.conftest import step, tiny_env
from vpptwin.train.env.observe import OBSERVATION, SETUPS, ObservationTerms, accumulate_error, observe

POSE = np.array([[0.1, 1.2, 0.5]])
VELOCITY = np.array([[0.3, -0.4, 2.0]])
TARGET = np.array([[0.4, 1.0, 3.0]])
INTEGRAL = np.array([[0.7, -0.8]])
PLACE = (0.3, -0.2, 0.3, -0.4)
"""Δp = (0.4 - 0.1, 1.0 - 1.2), then the velocity."""
SINES = (math.sin(2.5), math.cos(2.5))
"""Of Δθ = 3.0 - 0.5."""
SHOWN = {
    "VA": (*PLACE, 2.5, 2.0, 3.0),
    "TA": (*PLACE, *SINES, 2.0, math.sin(3.0), math.cos(3.0)),
    "PI": (*PLACE, 2.5, 2.0, 0.7, -0.8, 3.0),
    "All": (*PLACE, *SINES, 2.0, 0.7, -0.8, math.sin(3.0), math.cos(3.0)),
}
"""What each setup shows of the state above."""
PAPERS = {"VA": 6, "TA": 7, "PI": 8, "All": 9}
"""Inputs without the target's angle, as the paper counts them."""


@pytest.mark.parametrize("setup", SETUPS)
def test_setups_by_hand(setup: str) -> None:
    """Every input is where its name says, with the sign of target minus state."""
    observation = ObservationTerms(setup)
    seen = observe(POSE, VELOCITY, TARGET, INTEGRAL, observation)
    assert seen.dtype == np.float32
    np.testing.assert_allclose(seen, [SHOWN[setup]], atol=1e-6)  # float32
    values = dict(zip(OBSERVATION, SHOWN["All"])) | {"delta_theta": 2.5, "target_theta": 3.0}
    np.testing.assert_allclose(seen[0], [values[name] for name in observation.names], atol=1e-6)


@pytest.mark.parametrize("setup", SETUPS)
def test_the_papers_inputs_come_first(setup: str) -> None:
    """Without the target's angle a setup is a prefix of itself with it, so the ablation differs in nothing else."""
    without, count = ObservationTerms(setup, target_angle=False), PAPERS[setup]
    rng = np.random.default_rng(0)
    arguments = [rng.standard_normal((5, k)) for k in (3, 3, 3, 2)]
    assert without.names == ObservationTerms(setup).names[:count]
    np.testing.assert_array_equal(observe(*arguments, without), observe(*arguments, ObservationTerms(setup))[:, :count])


@pytest.mark.parametrize("setup", ["VA", "PI"])
def test_angles_in_radians_stay_within_half_a_turn(setup: str) -> None:
    """However often the craft has turned, Δθ and the target's angle are the same angles within ±π."""
    rng = np.random.default_rng(0)
    pose, target = rng.uniform(-30.0, 30.0, (2, 400, 3))
    observation = ObservationTerms(setup)
    seen = observe(pose, np.zeros((400, 3)), target, np.zeros((400, 2)), observation)
    for name, angle in (("delta_theta", target[:, 2] - pose[:, 2]), ("target_theta", target[:, 2])):
        shown = seen[:, observation.names.index(name)].astype(float)
        assert (np.abs(shown) <= np.float32(np.pi)).all()
        np.testing.assert_allclose(np.exp(1j * shown), np.exp(1j * angle), atol=1e-6)  # float32
    turn = np.array([0.0, 0.0, 2.0 * np.pi])
    turned = observe(pose + turn, np.zeros((400, 3)), target - 2.0 * turn, np.zeros((400, 2)), observation)
    np.testing.assert_allclose(turned, seen, atol=1e-5)  # float32


@pytest.mark.parametrize("setup", SETUPS)
@pytest.mark.parametrize("paper_inputs", [False, True])
def test_the_environment_shows_the_setup(setup: str, paper_inputs: bool) -> None:
    """`setup` and `paper_inputs` decide what an environment gives out, at resets and steps."""
    env = tiny_env(f"setup={setup}", f"paper_inputs={paper_inputs}")
    first = env.reset()["observation"]
    assert first.shape == (4, len(SHOWN[setup]) if not paper_inputs else PAPERS[setup])
    assert env.observation_spec["observation"].shape == first.shape
    seen = step(env)["observation"]
    expected = observe(
        env.state.qpos, env.state.qvel, env.episodes.target, env.episodes.integral, env.config.observation
    )
    assert torch.equal(seen, torch.from_numpy(expected))
    assert env.config.observation == ObservationTerms(setup, not paper_inputs)


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
