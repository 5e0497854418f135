"""The environments for Gymnasium: by its own checker, and against the TorchRL one that they wrap."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from vpptwin.train.env.environments import make_task_env

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import vpptwin.gym  # noqa: E402, F401  # registers


@pytest.mark.parametrize("task", ["hover", "flip", "wall-backtrack"])
def test_gymnasium_finds_nothing_wrong(task: str) -> None:
    """Spaces, seeds, signatures, rendering: not even a warning, but for the bounds that no state has."""
    env = gymnasium.make(f"vpptwin/{task}-v0", render_mode="rgb_array").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", message=".*(infinity|symmetric|spec).*")
        check_env(env)


def test_it_flies_what_torchrl_flies() -> None:
    """The same random numbers and actions give the same flights."""
    ours, theirs = gymnasium.make_vec("vpptwin/hover-v0", num_envs=3), make_task_env("hover", num_envs=3)
    seen, _ = ours.reset(seed=5)
    theirs.rng = np.random.default_rng(5)
    torch.testing.assert_close(torch.from_numpy(seen), theirs.reset()["observation"])
    for _ in range(5):
        action = np.full((3, 2), 0.3, np.float32)
        seen, reward, *_ = ours.step(action)
        after = theirs.step(TensorDict({"action": torch.from_numpy(action)}, [3]))["next"]
        np.testing.assert_array_equal(seen, after["observation"].numpy())
        np.testing.assert_array_equal(reward, after["reward"].numpy()[:, 0])


def test_those_that_end_begin_anew() -> None:
    """In the same step: what they ended with is told, what is shown belongs to the new flight."""
    env = gymnasium.make_vec("vpptwin/hover-v0", num_envs=4, noise=0.0)
    assert env.observation_space.contains(env.reset(seed=[1, 2])[0])
    action = np.zeros((4, 2), np.float32)
    action[0] = -1.0  # falls
    for _ in range(200):
        seen, reward, terminated, truncated, told = env.step(action)
        assert reward.shape == terminated.shape == truncated.shape == told["success"].shape == (4,)
        if terminated.any():
            break
    assert terminated[0]
    assert told["_final_obs"].tolist() == terminated.tolist()
    assert not np.allclose(told["final_obs"][0], seen[0])
    assert all(last is None for last in told["final_obs"][~terminated])


def test_a_seed_gives_the_same_flights() -> None:
    """Another one others."""
    env = gymnasium.make("vpptwin/flip-v0")
    first, again, other = (env.reset(seed=seed)[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
