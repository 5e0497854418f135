"""Starts that led to a failure are flown again in training."""

from __future__ import annotations

import numpy as np
import torch

from tests.train.conftest import plain_schedule, reset_rows, step, tiny_env
from vpptwin.train.config import Curriculum, Schedule
from vpptwin.train.env.base_env import EARLY_FAILURE
from vpptwin.train.env.episodes import MAX_STARTS, FailedStarts

FALL = torch.tensor([-1.0, 0.0])
"""Full thrust downwards: on the floor within half a second."""


def fail(starts: FailedStarts, first: int, count: int) -> None:
    """Keep starts whose targets, poses and velocities tell which they belong to."""
    number = np.arange(first, first + count, dtype=float)[:, None]
    starts.add(np.ones(count, bool), number + np.repeat([0.0, 1000.0, 2000.0], 3))


def test_the_latest_are_kept() -> None:
    """A full ring forgets its oldest; target, pose and velocity stay together."""
    starts = FailedStarts.empty()
    fail(starts, 0, 10)
    fail(starts, 10, MAX_STARTS)
    kept = np.sort(starts.target[:, 0])
    np.testing.assert_array_equal(kept, np.arange(10, MAX_STARTS + 10))
    np.testing.assert_array_equal(starts.pose, starts.target + 1000.0)
    np.testing.assert_array_equal(starts.velocity, starts.target + 2000.0)


def test_a_share_of_new_starts_is_replaced() -> None:
    """A quarter of 4000, by starts that are kept, each as likely; without any, or with a share of 0, none."""
    rng, starts = np.random.default_rng(0), FailedStarts.empty()
    new = tuple(np.full((4000, 3), -1.0) for _ in range(3))
    starts.replace(1.0, rng, *new)
    assert all((part == -1.0).all() for part in new)
    fail(starts, 0, 5)
    starts.replace(0.0, rng, *new)
    assert all((part == -1.0).all() for part in new)
    starts.replace(0.25, rng, *new)
    replaced = new[0][:, 0] >= 0.0
    assert abs(replaced.mean() - 0.25) < 0.03  # 4.4 standard deviations
    np.testing.assert_array_equal(new[1][replaced], new[0][replaced] + 1000.0)
    np.testing.assert_array_equal(new[2][replaced], new[0][replaced] + 2000.0)
    counts = np.bincount(new[0][replaced, 0].astype(int), minlength=5)
    assert counts.min() > 0.7 * counts.mean()


def test_failures_soon_after_a_start_are_put_down_to_it() -> None:
    """Driven into the floor after 0 s and after 1.2 s of hovering: the first starts are kept, the second not."""
    env = tiny_env(schedule=Schedule(Curriculum(enabled=False), 1000))
    env.reset()
    starts = env.episodes.started.copy()
    for _ in range(60):
        last = step(env, FALL)
        if last["terminated"].all():
            break
    assert env.episodes.age.max() <= EARLY_FAILURE
    kept = int(env.failed_starts.seen[0])
    assert kept >= 4  # those on the floor count again until they are reset
    np.testing.assert_array_equal(np.unique(env.failed_starts.pose[:kept], axis=0), np.unique(starts[:, 3:6], axis=0))
    env.failed_starts = FailedStarts.empty()
    last = reset_rows(env, [0, 1, 2, 3], last)
    env.episodes.age[:] = EARLY_FAILURE + 0.2
    for _ in range(60):
        if step(env, FALL)["terminated"].all():
            break
    assert env.failed_starts.seen[0] == 0


def test_episodes_begin_where_others_failed() -> None:
    """With a share of 1 every new episode has the start that failed; in the easy part and in flights none."""
    schedule = plain_schedule(100_000)
    schedule.curriculum.again = 1.0
    for flown, again in ((0, False), (90_000, True)):
        env = tiny_env("task=flip", schedule=schedule)
        env.flown = flown
        failed = np.array([[0.3, 1.2, 0.0]]), np.array([[-0.2, 1.0, 2.0]]), np.array([[0.5, -0.5, 3.0]])
        env.failed_starts.add(np.ones(1, bool), np.column_stack(failed))
        env.reset()
        same = np.allclose(env.state.qpos, failed[1]) and np.allclose(env.state.qvel, failed[2])
        assert same == again
        assert np.allclose(env.episodes.target, failed[0]) == again
    env = tiny_env("task=flip")
    env.failed_starts.add(np.ones(1, bool), np.column_stack(failed))
    env.reset()
    assert not np.allclose(env.state.qpos[:, 2], 2.0)
