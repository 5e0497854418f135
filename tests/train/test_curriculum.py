"""The curriculum: what difficulty does, when, and how an episode of one criterion differs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.train.conftest import EXAMINED, plain_schedule, read_log, reset_rows, see, step, tiny_env, truth
from vpptwin.train.config import Curriculum, Schedule
from vpptwin.train.env.base_env import EARLY_FAILURE, MAX_START_ANGLE
from vpptwin.train.env.episodes import MAX_STARTS, FailedStarts
from vpptwin.train.env.observe import wrap_angle
from vpptwin.train.env.reward import ANGLE, BOTH, POSITION, compute_reward
from vpptwin.train.env.vpp_env import VppEnv
from vpptwin.train.main import run_train
from vpptwin.twin.sensors import sensor_noise

SCHEDULE = plain_schedule(40_000)
EASY = replace(SCHEDULE, curriculum=replace(SCHEDULE.curriculum, single_below=0.0))
"""The same, every episode judged by everything."""


def env_at(progress: float, *overrides: str) -> VppEnv:
    """An environment of 400 drones after this share of training, its episodes just begun."""
    env = tiny_env("num_envs=400", *overrides, schedule=SCHEDULE)
    env.flown = round(progress * SCHEDULE.steps / 400)
    assert env.flown * 400 == round(progress * SCHEDULE.steps)
    env.reset()
    return env


def test_difficulty_by_hand() -> None:
    """0 for the first 10 % of training, half at 30 %, 1 from 50 % on."""
    levels = [SCHEDULE.difficulty_at(steps) for steps in (0, 3999, 4000, 12_000, 20_000, 40_000, 80_000)]
    np.testing.assert_allclose(levels, [0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0])


def test_difficulty_goes_by_the_steps_of_all_simulations() -> None:
    """Four drones that fly 25 steps have flown 100; without a curriculum difficulty is full."""
    env = tiny_env(schedule=plain_schedule(200))
    env.reset()
    for k in range(25):
        assert env.difficulty == plain_schedule(200).difficulty_at(4 * k)
        step(env)
    assert env.difficulty == 1.0
    assert tiny_env().difficulty == 1.0


@pytest.mark.parametrize(("progress", "single"), [(0.0, True), (0.24, True), (0.28, False), (1.0, False)])
def test_single_criteria_come_below_their_level(progress: float, single: bool) -> None:
    """Difficulty 0.4 is passed at 26 % of training: before it, episodes are judged by place or angle, then by both."""
    env = env_at(progress)
    kinds, counts = np.unique(env.episodes.criterion, return_counts=True)
    assert kinds.tolist() == ([POSITION, ANGLE] if single else [BOTH])
    if single:
        assert abs(counts[0] - 200) < 40  # as likely: four standard deviations of 400 coins
    assert not tiny_env().episodes.criterion.any()


def test_position_episodes_start_near_and_keep_their_target() -> None:
    """Judged by position, a flip starts within 0.3 rad of its target, which stays; judged by its angle, anywhere."""
    env = env_at(0.0, "task=flip", "task.target.turns=0.5")
    episodes = env.episodes
    place, angle = episodes.criterion == POSITION, episodes.criterion == ANGLE
    off = np.abs(wrap_angle(env.state.qpos[:, 2] - episodes.target[:, 2]))
    assert MAX_START_ANGLE == 0.3
    assert off[place].max() <= 0.3
    assert off[place].max() > 0.25
    assert off[angle].max() > 3.0
    assert set(np.abs(episodes.target[place, 2])) == {0.0, np.pi}
    assert np.isinf(episodes.switch[place]).all()
    # The first trigger comes 0.8 to 3 s after the start.
    assert ((episodes.switch[angle] >= 0.8) & (episodes.switch[angle] <= 3.0)).all()


def test_triggers_pass_position_episodes_by() -> None:
    """In flight the targets of position episodes never change, those of angle episodes do."""
    overrides = ("task=flip", "task.target.dwell=[0.05,0.1]", "task.target.turns=0.5", "desynchronize=true")
    env = env_at(0.0, *overrides, "task.target.quiet=0")
    target, place = env.episodes.target.copy(), env.episodes.criterion == POSITION
    for _ in range(12):
        step(env)
    assert (env.episodes.target[place] == target[place]).all()
    assert not env.episodes.stage[place].any()
    assert env.episodes.stage[~place].mean() > 0.9


def test_every_row_is_paid_by_its_criterion() -> None:
    """The environment's reward is that of the criterion each episode drew."""
    env = env_at(0.0)
    reward = step(env)["reward"][:, 0].numpy()
    delta = env.episodes.target - env.state.qpos
    state = (env.task.weights, delta, env.state.qvel, env.episodes.integral)
    for criterion in (POSITION, ANGLE):
        rows = env.episodes.criterion == criterion
        expected = compute_reward(*state, np.full(400, criterion))[rows]
        np.testing.assert_allclose(reward[rows], expected, rtol=1e-6)  # float32
        assert (np.abs(compute_reward(*state)[rows] - expected) > 1e-3).mean() > 0.9


def test_the_first_lesson_is_the_nominal_twin() -> None:
    """At difficulty 0 sensors are perfect and every parameter is at its off value, though all is switched on."""
    env = env_at(0.05, "noise=1", "randomize=all")
    keys = [(effect.id, p) for effect in env.twin.effects.values() for p in effect.parameters]
    assert len(keys) > 40
    for effect, parameter in keys:
        np.testing.assert_array_equal(env.twin.parameter(effect, parameter.name), parameter.off)
    step(env)
    np.testing.assert_allclose(see(env), truth(env), atol=2e-6)  # the observation is float32


@pytest.mark.parametrize(("progress", "difficulty"), [(0.3, 0.5), (0.5, 1.0)])
def test_noise_and_randomization_grow_with_difficulty(progress: float, difficulty: float) -> None:
    """The spread of noise and of parameters around off is what it is at full difficulty, times the difficulty."""
    env = env_at(progress, "noise=1", "randomize=[airframe.mass]")
    assert env.difficulty == pytest.approx(difficulty)
    # 400 draws: a deviation is known to 3.5 %; four of these are allowed.
    expected = difficulty * np.concatenate(sensor_noise(env.twin.vehicle))
    np.testing.assert_allclose((see(env) - truth(env)).std(axis=0), expected, rtol=0.14)
    parameter = env.twin.effects["airframe.mass"].parameters[0]
    drawn = env.twin.parameter("airframe.mass", "mass") - parameter.off
    assert drawn.std() == pytest.approx(difficulty * parameter.prior.b, rel=0.14)


def test_some_episodes_are_flown_in_the_nominal_twin() -> None:
    """A share of them, whatever the difficulty, is at the off value of everything; outside of training none is."""
    schedule = replace(SCHEDULE, curriculum=replace(SCHEDULE.curriculum, nominal=0.2))
    env = tiny_env("num_envs=1000", "randomize=[airframe.mass,rail_x.coulomb]", schedule=schedule)
    env.flown = SCHEDULE.steps
    env.reset()
    assert env.difficulty == 1.0
    friction, mass = env.twin.parameter("rail_x.coulomb", "force"), env.twin.parameter("airframe.mass", "mass")
    # 1000 coins: the share is known to 1.3 %; four of these are allowed.
    assert np.mean(friction == 0.0) == pytest.approx(0.2, abs=0.052)
    off = next(p.off for p in env.twin.effects["airframe.mass"].parameters)
    np.testing.assert_array_equal(mass == off, friction == 0.0)
    plain = tiny_env("num_envs=1000", "randomize=[rail_x.coulomb]")
    plain.reset()
    assert (plain.twin.parameter("rail_x.coulomb", "force") > 0.0).all()


def test_episodes_of_training_may_be_shorter() -> None:
    """`training_episode` ends those of a curriculum, with triggers up to the end; flights last as they did."""
    overrides = ("task=flip", "task.training_episode=0.3", "task.episode=1", "task.success.window=0.2")
    triggers = ("task.target.dwell=[0.05,0.1]", "task.target.quiet=0.8")
    trained, flown = tiny_env(*overrides, *triggers, schedule=EASY), tiny_env(*overrides, *triggers)
    last = {}
    for env, steps in ((trained, 30), (flown, 100)):
        env.reset()
        came = np.zeros(4)
        for k in range(1, steps + 1):
            before = env.episodes.stage.copy()
            assert step(env)["truncated"].any() == (k == steps)
            came[env.episodes.stage > before] = 0.01 * k
        last[env] = came
    assert (last[trained] >= 0.19).all()
    assert (last[flown] <= 0.21).all()
    assert (last[flown] > 0.0).all()


def test_a_run_follows_its_lesson(tiny_run: Path, tmp_path: Path) -> None:
    """The logged difficulty is the schedule's; without a curriculum it is 1 from the start."""
    steps, level = read_log(tiny_run, "difficulty").T
    ramp = Curriculum().difficulty
    np.testing.assert_allclose(level, [ramp.at(k / 1024) for k in steps], rtol=1e-6)  # float32
    assert level[0] < 1.0
    assert level[-1] == 1.0
    plain = run_train([*EXAMINED, "total_steps=256", "exam_every=0", "curriculum.enabled=false", f"out={tmp_path}"])
    assert read_log(plain, "difficulty")[:, 1].tolist() == [1.0, 1.0]


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


def test_a_snapshot_holds_them() -> None:
    """A resumed run flies the same starts again."""
    schedule = Schedule(Curriculum(again=0.5), 1000, repeats=0.1)
    env, other = tiny_env(schedule=schedule), tiny_env(schedule=schedule)
    env.reset()
    fail(env.failed_starts, 0, 3)
    other.restore_snapshot(env.take_snapshot())
    for name, value in vars(env.failed_starts).items():
        np.testing.assert_array_equal(getattr(other.failed_starts, name), value)
