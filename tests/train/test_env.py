"""The batched environment: specs, partial resets, ends of episodes, determinism, independence of rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from tests.train.conftest import HOVER, plain_schedule, reset_rows, step, tiny_config, tiny_env
from vpptwin.system.errors import InputError
from vpptwin.train.env.tasks import Limits
from vpptwin.train.env.vpp_env import make_env
from vpptwin.twin.health import MAX_FAULTS, find_diverged, replay_fault


@pytest.mark.parametrize(
    "overrides",
    [
        ("noise=1", "randomize=all"),
        ("task=flip", "setup=VA", "critic=lstm"),
        ("task=wall-backtrack", "paper_inputs=true", "privileged=false"),
    ],
)
def test_specs(overrides: tuple[str, ...]) -> None:
    """TorchRL's own check of shapes, types and reset behaviour passes."""
    check_env_specs(tiny_env(*overrides), seed=0)


def test_partial_reset_touches_only_its_rows() -> None:
    """Rows outside the mask keep state, integral, clock and observation; masked rows start afresh."""
    env = tiny_env("noise=1", "randomize=all")
    env.reset()
    for _ in range(5):
        last = step(env, HOVER)
    old_state, old_episodes = env.state.copy(), {k: v.copy() for k, v in vars(env.episodes).items()}
    old_sensors = env.sensors.take(np.array([0, 2]))
    fresh = reset_rows(env, [1, 3], last)
    for name, old in old_episodes.items():
        np.testing.assert_array_equal(getattr(env.episodes, name)[[0, 2]], old[[0, 2]], err_msg=name)
    np.testing.assert_array_equal(env.state.qpos[[0, 2]], old_state.qpos[[0, 2]])
    np.testing.assert_array_equal(env.state.rotor_speed[[0, 2]], old_state.rotor_speed[[0, 2]])
    for name, old in old_sensors.arrays().items():
        np.testing.assert_array_equal(env.sensors.arrays()[name][[0, 2]], old, err_msg=name)
    torch.testing.assert_close(fresh["observation"][[0, 2]], last["observation"][[0, 2]], rtol=0, atol=0)
    np.testing.assert_array_equal(env.episodes.elapsed[[1, 3]], 0.0)
    np.testing.assert_array_equal(env.state.time[[1, 3]], 0.0)
    assert (env.state.qpos[[1, 3]] != old_state.qpos[[1, 3]]).all()
    # A fresh integral is the first error alone.
    torch.testing.assert_close(fresh["observation"][[1, 3], 7:9], fresh["observation"][[1, 3], 0:2])


def test_integral_follows_the_recursion_in_flight() -> None:
    """The observed Γ obeys Γ_t = 0.9 Γ_{t-1} + Δp_t at every step."""
    env = tiny_env()
    previous = env.reset()["observation"][:, 7:9]
    for _ in range(10):
        now = step(env, HOVER)["observation"]
        torch.testing.assert_close(now[:, 7:9], 0.9 * previous + now[:, 0:2], rtol=1e-5, atol=1e-6)  # float32
        previous = now[:, 7:9]


def test_time_limit_truncates() -> None:
    """An episode that runs out of time is truncated, not terminated, at its length and not before."""
    env = tiny_env("task.episode=1", "task.success.window=0.5", "task.start.theta=[0,0]")
    env.reset()
    for k in range(100):
        last = step(env, HOVER)
        assert last["truncated"].all() == (k == 99)
    assert not last["terminated"].any()
    assert torch.equal(last["done"], last["truncated"])


@pytest.mark.parametrize(
    ("pose", "velocity"),
    [
        ((1.6, 1.2, 0.0), (0.0, 0.0, 0.0)),  # past the right end of the rail
        ((0.0, 0.23, 1.5), (0.0, 0.0, 0.0)),  # arm on end, 0.2 m long: its tip is 3 cm above the floor
        ((0.0, 1.2, 0.0), (9.0, 0.0, 0.0)),  # faster than 8 m/s
        ((0.0, 1.2, 0.0), (0.0, 0.0, 60.0)),  # spinning faster than 40 rad/s
    ],
)
def test_failures_terminate(pose: tuple[float, ...], velocity: tuple[float, ...]) -> None:
    """Leaving the travel, touching the floor and flying too fast end an episode as terminated, not truncated."""
    env = tiny_env()
    env.reset()
    qpos, qvel = env.state.qpos.copy(), env.state.qvel.copy()
    qpos[2], qvel[2] = pose, velocity
    env.state = replace(env.state, qpos=qpos, qvel=qvel)
    last = step(env, HOVER)
    assert last["terminated"][:, 0].tolist() == [False, False, True, False]
    assert not last["truncated"].any()


def test_the_ends_of_the_rail_may_be_allowed() -> None:
    """In wall-backtrack the carriage may touch the end of the rail; the vertical guide's still are a failure."""
    env = tiny_env("task=wall-backtrack")
    env.reset()
    env.state.qpos[0], env.state.qvel[0] = (1.6, 1.2, 0.0), 0.0
    assert not step(env)["terminated"].any()
    assert env.state.qpos[0, 0] >= 1.5
    # Rail from -1.5 to 1.5 m, guide from 0.15 to 2.5 m.
    pose = np.array([[-1.5, 1.2, 0.0], [1.5, 1.2, 0.0], [0.0, 0.15, 0.0], [0.0, 2.5, 0.0], [1.49, 2.49, 0.0]])
    for ends, expected in ((False, [0, 0, 1, 1, 0]), (True, [1, 1, 1, 1, 0])):
        failed = Limits(ends=ends).exceeded(env.twin.vehicle, pose, np.zeros((5, 3)))
        assert failed.astype(int).tolist() == expected


def test_outputs_are_not_shared() -> None:
    """What a step returned stays as it was when the environment goes on."""
    env = tiny_env("noise=1", "critic=lstm")
    first = env.reset()
    kept = first.clone()
    second = step(env, HOVER)
    kept_second = second.clone()
    reset_rows(env, [0], step(env, HOVER))
    for now, before in ((first, kept), (second, kept_second)):
        for key in before.keys():  # noqa: SIM118 - a TensorDict iterates over rows
            assert torch.equal(now[key], before[key]), key


@pytest.mark.parametrize("overrides", [(), ("noise=1", "randomize=all", "desynchronize=true")])
def test_same_seed_same_flight(overrides: tuple[str, ...]) -> None:
    """A seed fixes starts, targets, noise and parameters; another seed changes them."""
    runs = []
    for seed in (3, 3, 4):
        env = tiny_env(*overrides, f"seed={seed}")
        torch.manual_seed(0)
        runs.append(env.rollout(30, break_when_any_done=False)["next", "observation"])
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])


def test_row_equals_single() -> None:
    """A drone of a batch flies bit-equal to the same drone alone."""
    many, one = tiny_env(), tiny_env("num_envs=1", "minibatch=8")
    many.reset()
    one.reset()
    one.state = many.state.take(np.array([2]))
    for name, value in vars(many.episodes).items():
        setattr(one.episodes, name, value[[2]].copy())
    torch.manual_seed(0)
    for _ in range(25):
        action = 2.0 * torch.rand(4, 2) - 1.0
        row = many.step(TensorDict({"action": action}, batch_size=[4]))["next"][2:3]
        single = one.step(TensorDict({"action": action[2:3]}, batch_size=[1]))["next"]
        for key in ("observation", "reward", "terminated", "truncated"):
            assert torch.equal(row[key], single[key]), key


def test_clocks_are_desynchronized() -> None:
    """With the option on, first episodes end at different times; without it all together."""
    together, spread = tiny_env(), tiny_env("desynchronize=true")
    together.reset()
    spread.reset()
    assert np.ptp(together.episodes.elapsed) == 0.0
    assert len(set(spread.episodes.elapsed)) == 4
    assert (spread.episodes.elapsed < spread.task.episode).all()


def test_a_snapshot_of_a_version_that_kept_less_is_refused() -> None:
    """What the effects of a simulation had come to can't be made up."""
    env = tiny_env()
    snapshot = env.take_snapshot()
    del snapshot["state"]["effects"]
    with pytest.raises(InputError, match="simulations lack effects; expected one of this version"):
        env.restore_snapshot(snapshot)


def test_snapshot_continues_bit_equal() -> None:
    """Put back amid a full turn and a curriculum an environment flies, measures and draws as the original.

    So do its curriculum and what a critic remembers.
    """
    overrides = ("task=flip", "task.target.turns=1", "task.target.dwell=[0.04,0.08]", "noise=1", "randomize=all")
    original, copy = (
        tiny_env(*overrides, "critic=lstm", f"seed={seed}", schedule=plain_schedule(100)) for seed in (0, 9)
    )
    original.flown = 10
    original.reset()
    for _ in range(8):
        step(original, HOVER)
    assert original.episodes.turn.any()
    copy.restore_snapshot(original.take_snapshot())
    assert torch.equal(copy.reset()["observation"], torch.from_numpy(original.episodes.observation))
    for _ in range(5):
        here, there = step(copy, HOVER), step(original, HOVER)
        for key in ("observation", "critic_observation", "reward"):
            assert torch.equal(here[key], there[key]), key
    here, there = reset_rows(copy, [1], here), reset_rows(original, [1], there)
    assert torch.equal(here["observation"], there["observation"])
    assert copy.difficulty == original.difficulty
    here, there = step(copy, HOVER), step(original, HOVER)
    for key in ("observation", "critic_observation", "reward"):
        assert torch.equal(here[key], there[key]), key


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
