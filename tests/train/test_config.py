"""Overrides: what they set, what is refused and how; tasks and schedules as data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vpptwin.system.errors import InputError
from vpptwin.train.config import Ramp, TrainConfig, to_config, to_plain
from vpptwin.train.env.environments import find_device
from vpptwin.train.env.tasks import HOVER, Start
from vpptwin.train.env.vpp_env import make_env
from vpptwin.train.main import compose_config, run_train


def test_overrides_reach_every_level() -> None:
    """Options, numbers inside the task and numbers inside a ramp can be set; the rest keeps its default."""
    config = compose_config(
        ["task=hover", "num_envs=512", "task.episode=8", "task.start.x=[-0.1,0.2]", "exploration.end=0.2"]
    )
    assert (config.num_envs, config.task.episode, list(config.task.start.x)) == (512, 8.0, [-0.1, 0.2])
    assert config.exploration == replace(TrainConfig(task=HOVER).exploration, end=0.2)
    assert config.task.weights == HOVER.weights
    assert HOVER.episode == 5.0


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("randomize=all", ["all"]),
        ("randomize=[a.b,c.d]", ["a.b", "c.d"]),
        ("randomize=[]", []),
        ("seed=1", ["paper"]),
        ("loggers=csv", ["csv"]),
        ("loggers=[tensorboard,csv]", ["tensorboard", "csv"]),
        ("effects=my.py", ["my.py"]),
    ],
)
def test_lists_may_be_one_name(override: str, expected: list[str]) -> None:
    """`randomize=all` is short for `randomize=[all]`; unless told otherwise what the paper identifies is randomized."""
    name = override.split("=")[0]
    assert getattr(compose_config([override]), name if name != "seed" else "randomize") == expected


BAD_OVERRIDES = {
    "num_envs": ("num_env=4",), "did you mean hover?": ("task=hovr",), "did you mean paper?": ("preset=papr",),
    "learning_rate.start, learning_rate.end": ("learning_rate=nan",), "exploration.start": ("exploration=0.1",),
    "task.episode": ("task.episod=4",), "option": ("task.name=other", "+speed=1", "~task"), "key=value": ("seed",),
    "seed": ("seed=1,2",), "type": ("num_envs=many",), "above 0, or null": ("lipschitz=0", "lipschitz=nan"),
    "above 0": ("num_envs=0", "learning_rate.start=0", "critic_lstm=0", "exam_tracks=0", "task.target.turn_rate=0"),
    "0 or more": ("seed=-1", "noise=nan", "exam_every=-1"), "between 0 and 1": ("gamma=1.5", "task.gamma=-1"),
    "layer sizes": ("hidden=[96]", "critic_hidden=[]"), "cpu, cuda": ("device=gpu",), "1 to 1024": ("sim_threads=-1",),
    "device=cpu": ("device=cuda collector=ray",), "angles": ("task.target.dwell=[1,2]",),
    "window": ("task.episode=0.5",),
    "[low, high]": ("task.start.x=[1,-1]", "task.start.x=[1]", "task=wall-backtrack task.target.hold=[2,1]"),
    "fast, paper": ("preset=slow",), "VA, TA, PI, All": ("setup=VAT",), "mlp, lstm": ("critic=gru",),
    "csv, tensorboard": ("loggers=wandb", "loggers=[csv,wandb]"), "local, ray": ("collector=remote",),
    "below 1": ("average=1",),
    "from 0 to 1": ("curriculum.again=1.1", "curriculum.nominal=nan", "task.target.turns=1.5"),
    "from 0": ("task.target.quiet=-1",), "times above 0": ("task=wall-backtrack task.target.hold=[0,1]",),
    "more than 1": ("task.thrust_to_weight=1", "task.thrust_to_weight=nan"),
    "one of sensors, kalman": ("estimator=ekf",),
}  # fmt: skip
"""What each is refused with: a value or an option that would be accepted."""


@pytest.mark.parametrize(
    ("overrides", "expected"), [(bad, expected) for expected, each in BAD_OVERRIDES.items() for bad in each]
)
def test_bad_overrides(overrides: str, expected: str) -> None:
    """Each is refused in one line that says what would be accepted."""
    with pytest.raises(InputError) as caught:
        compose_config(overrides.split())
    assert "\n" not in str(caught.value)
    assert expected in f"{caught.value.expected} {caught.value.action}"


def test_few_simulations_need_no_other_minibatch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`num_envs=16` trains: 128 steps are one minibatch, where 1024 were asked for; it says what to do next."""
    folder = tmp_path / "run"
    given = [
        "task=hover",
        "num_envs=16",
        "rollout=8",
        "total_steps=128",
        "exam_every=0",
        "loggers=csv",
        "sim_threads=1",
    ]
    assert (run_train([*given, "progress=false", f"out={folder}"]) / "checkpoint.pt").is_file()
    assert compose_config(given).minibatch == 1024
    said = capsys.readouterr().err
    assert f"next: vpptwin evaluate {folder}\n" in said
    assert f"vpptwin play --live {folder}\n" in said


def test_a_configuration_without_a_task_hovers() -> None:
    """`make_env(TrainConfig())` gives the environment of the command without options, of a task of its own."""
    env = make_env(TrainConfig(num_envs=2, sim_threads=1))
    assert env.task == HOVER
    assert env.task is not HOVER
    assert env.rollout(3).batch_size == (2, 3)
    assert to_plain(TrainConfig()) == to_plain(compose_config([]))


def test_a_device_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is refused in one line before anything is written; on one that is, the index is told."""
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    for device in ("cuda", "cuda:3"):
        with pytest.raises(InputError, match=f"device={device}, and torch .* finds 0 CUDA devices") as caught:
            run_train(["task=hover", f"device={device}", f"out={tmp_path / 'run'}"])
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "run").exists()
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    found = [str(find_device(device)) for device in ("cpu", "cuda", "cuda:1")]
    assert found == ["cpu", "cuda:0", "cuda:1"]


def test_discount_is_the_tasks_unless_given() -> None:
    """The half roll off the wall has to be prepared longer than a flip."""
    assert compose_config(["task=flip"]).discount == 0.98
    assert compose_config(["task=wall-backtrack"]).discount == 0.99
    assert compose_config(["task=wall-backtrack", "gamma=0.9"]).discount == 0.9
    assert compose_config(["task=flip", "task.gamma=0.95"]).discount == 0.95


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


def test_configuration_defaults_are_not_shared() -> None:
    """Two configurations do not share their lists and ramps."""
    one, other = TrainConfig(task=HOVER), TrainConfig(task=HOVER)
    assert one.hidden is not other.hidden
    assert one.learning_rate is not other.learning_rate


def test_a_list_within_a_list_of_strings_is_refused() -> None:
    """As a checkpoint with a flipped bit had it: a line."""
    with pytest.raises(InputError, match=r"effects\.0=\[\]: input should be a valid string"):
        to_config({"effects": [[]]})
