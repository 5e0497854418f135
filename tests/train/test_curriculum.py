"""The curriculum: what difficulty does, when, and how an episode of one criterion differs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.train.conftest import EXAMINED, plain_schedule, read_log, see, step, tiny_env, truth
from vpptwin.train.config import Curriculum
from vpptwin.train.env.base_env import MAX_START_ANGLE
from vpptwin.train.env.observe import wrap_angle
from vpptwin.train.env.reward import ANGLE, BOTH, POSITION, compute_reward
from vpptwin.train.env.vpp_env import VppEnv
from vpptwin.train.main import run_train
from vpptwin.twin.sensors import sensor_noise

LESSON = plain_schedule(40_000)
EASY = replace(LESSON, curriculum=replace(LESSON.curriculum, single_below=0.0))
"""The same, every episode judged by everything."""


def env_at(progress: float, *overrides: str) -> VppEnv:
    """An environment of 400 drones after this share of training, its episodes just begun."""
    env = tiny_env("num_envs=400", *overrides, schedule=LESSON)
    env.flown = round(progress * LESSON.steps / 400)
    assert env.flown * 400 == round(progress * LESSON.steps)
    env.reset()
    return env


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
    schedule = replace(LESSON, curriculum=replace(LESSON.curriculum, nominal=0.2))
    env = tiny_env("num_envs=1000", "randomize=[airframe.mass,rail_x.coulomb]", schedule=schedule)
    env.flown = LESSON.steps
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
    """`training_episode` ends those of a curriculum, whose triggers may come up to the end; flights last as they did."""
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
