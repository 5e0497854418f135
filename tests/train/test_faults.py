"""Simulations that diverge: replaced, counted, written down."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.train.conftest import HOVER, step, tiny_config
from vpptwin.train.env.vpp_env import make_env
from vpptwin.twin.health import MAX_FAULTS, find_diverged, replay_fault


@pytest.mark.parametrize("way", ["action", "velocity", "state"])
def test_broken_simulation_is_replaced(tmp_path: Path, way: str) -> None:
    """A simulation that diverges is terminated, counted, written down and started afresh; the others do not notice."""
    config = tiny_config("num_envs=4", "minibatch=32", "desynchronize=false", "noise=0", "randomize=all", "critic=lstm")
    env, healthy = make_env(config, tmp_path / "faults"), make_env(config)
    env.reset()
    healthy.reset()
    action = HOVER.repeat(4, 1)
    broken = action.clone()
    if way == "action":
        broken[1, 0] = torch.nan
    else:
        env.state.qvel[1] = 1e200 if way == "velocity" else np.nan
    last, expected = step(env, broken), step(healthy, action)
    assert env.faults == 1
    assert last["terminated"][:, 0].tolist() == [False, True, False, False]
    assert last["reward"][1] == 0.0
    replay = replay_fault(tmp_path / "faults" / "fault-0001.npz")
    assert replay.equal
    assert find_diverged(replay.after).all()
    for _ in range(10):
        for key in ("observation", "critic_observation", "reward"):
            assert torch.isfinite(last[key]).all()
        for key in ("observation", "critic_observation", "reward", "terminated"):
            assert torch.equal(last[key][[0, 2, 3]], expected[key][[0, 2, 3]])
        last, expected = step(env, action), step(healthy, action)
    assert env.faults == 1


def test_faults_are_bounded_on_disk(tmp_path: Path) -> None:
    """Every fault is counted, the first ones are kept, and a run without any leaves no folder."""
    env = make_env(tiny_config("num_envs=16", "task.start.theta=[0,0]"), tmp_path / "faults")
    env.reset()
    step(env, HOVER)
    assert not (tmp_path / "faults").exists()
    for _ in range(3):
        assert torch.isfinite(step(env, torch.tensor([torch.nan, 0.0]))["observation"]).all()
    assert env.faults == 48
    assert len(list((tmp_path / "faults").iterdir())) == MAX_FAULTS
