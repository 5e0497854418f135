"""Overrides: what they set, what is refused and how; tasks and schedules as data."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from vpptwin.errors import InputError
from vpptwin.train.config import Ramp, TrainConfig, to_config, to_plain
from vpptwin.train.overrides import compose_config, describe_options, list_options
from vpptwin.train.tasks import HOVER, TASKS, Start, Target


def test_overrides_reach_every_level() -> None:
    """Options, numbers inside the task and numbers inside a ramp can be set; the rest keeps its default."""
    config = compose_config(
        ["task=hover", "num_envs=512", "task.episode=8", "task.start.x=[-0.1,0.2]", "exploration.end=0.2"]
    )
    assert (config.num_envs, config.task.episode, list(config.task.start.x)) == (512, 8.0, [-0.1, 0.2])
    assert config.exploration == Ramp(0.55, 0.2, finish=0.9)
    assert config.task.weights == HOVER.weights
    assert HOVER.episode == 5.0


@pytest.mark.parametrize(
    ("override", "expected"), [("randomize=all", ["all"]), ("randomize=[a.b,c.d]", ["a.b", "c.d"]), ("seed=1", [])]
)
def test_randomize_takes_a_list_or_one_name(override: str, expected: list[str]) -> None:
    """`randomize=all` is short for `randomize=[all]`."""
    assert compose_config([override]).randomize == expected


def test_configuration_survives_plain_data() -> None:
    """What is saved beside a run gives the same configuration back."""
    config = compose_config(["seed=7", "task.target.dwell=[1,2]", "task.target.angles=[0,3]"])
    assert to_config(to_plain(config)) == config


@pytest.mark.parametrize("task", TASKS)
def test_every_task_is_valid(task: str) -> None:
    """Every task of the list composes into a checked configuration."""
    assert compose_config([f"task={task}"]).task.name == task


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["num_env=4"], "num_envs"),
        (["task=hovr"], "hover"),
        (["task.episod=4"], "task.episode"),
        (["task.name=other"], "option"),
        (["+speed=1"], "option"),
        (["~task"], "option"),
        (["seed"], "key=value"),
        (["seed=1,2"], "seed"),
        (["num_envs=many"], "type"),
        (["num_envs=0"], "above 0"),
        (["seed=-1"], "0 or more"),
        (["noise=nan"], "0 or more"),
        (["gamma=1.5"], "between 0 and 1"),
        (["learning_rate.start=0"], "above 0"),
        (["hidden=[96]"], "layer sizes"),
        (["minibatch=100000"], "at most"),
        (["sim_threads=-1"], "1 to 1024"),
        (["task.start.x=[1,-1]"], "[low, high]"),
        (["task.start.x=[1]"], "[low, high]"),
        (["task.target.dwell=[1,2]"], "angles"),
        (["task.episode=0.5"], "window"),
    ],
)
def test_bad_overrides(overrides: list[str], expected: str) -> None:
    """Each is refused in one line that says what would be accepted."""
    with pytest.raises(InputError) as caught:
        compose_config(overrides)
    assert "\n" not in str(caught.value)
    assert expected in f"{caught.value.expected} {caught.value.action}"


def test_help_covers_every_option() -> None:
    """Each option has its default and a line of help, on a line of readable width."""
    text = describe_options()
    for name in (name for name in list_options() if "." not in name):
        (line,) = [line for line in text.splitlines() if line.strip().startswith(f"{name}=")]
        assert len(line.split(None, 1)[1]) > 5
    assert max(map(len, text.splitlines())) <= 140


def test_ramp_by_hand() -> None:
    """Constant to 10 %, halfway at 40 %, constant from 70 %."""
    ramp = Ramp(3e-4, 9e-5)
    values = [ramp.at(progress) for progress in (0.0, 0.1, 0.4, 0.7, 1.0)]
    np.testing.assert_allclose(values, [3e-4, 3e-4, 1.95e-4, 9e-5, 9e-5])


def test_start_is_drawn_around_the_target_angle() -> None:
    """Start angles are offsets from the target's, positions and velocities lie in their ranges."""
    target = np.tile([0.0, 1.0, np.pi], (500, 1))
    pose, velocity = Start(x=(-0.1, 0.1), theta=(-0.2, 0.2), rate=(1.0, 2.0)).draw(np.random.default_rng(0), target)
    assert (np.abs(pose[:, 0]) <= 0.1).all()
    assert (np.abs(pose[:, 2] - np.pi) <= 0.2).all()
    assert ((velocity[:, 2] >= 1.0) & (velocity[:, 2] <= 2.0)).all()
    assert np.ptp(pose[:, 2]) > 0.35


def test_other_angle_is_always_another() -> None:
    """A switch never draws the angle that is already asked for, and reaches all others."""
    target = Target(angles=[0.0, 3.0, -3.0])
    now = np.repeat([0.0, 3.0, -3.0], 50)
    drawn = target.draw_other_angle(np.random.default_rng(0), now)
    assert (drawn != now).all()
    assert len(set(zip(now, drawn))) == 6


def test_configuration_needs_no_torch() -> None:
    """Help and overrides come without loading torch, which takes seconds."""
    code = "import sys, vpptwin.train.main as m; m.describe_options(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_configuration_defaults_are_not_shared() -> None:
    """Two configurations do not share their lists and ramps."""
    one, other = TrainConfig(task=HOVER), TrainConfig(task=HOVER)
    assert one.hidden is not other.hidden
    assert one.learning_rate is not other.learning_rate
