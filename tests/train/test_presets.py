"""Presets, and the help that lists them with every option."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from itertools import product

import pytest

from vpptwin.train.config import PRESETS, Ramp, TrainConfig, to_config, to_plain
from vpptwin.train.env.tasks import HOVER, TASKS
from vpptwin.train.learn.checkpoint import make_policy
from vpptwin.train.main import compose_config, describe_options, list_options, run_train


def test_the_papers_preset() -> None:
    """LSTM over five steps and two layers of 512 for the critic; rate 3e-4 falling to 9e-5 from 10 to 70 % of training.

    Difficulty rises from 10 to 50 % of training.
    """
    paper = compose_config(["preset=paper"])
    assert (paper.preset, paper.critic, paper.critic_lstm, paper.critic_memory) == ("paper", "lstm", 64, 5)
    assert (paper.hidden, paper.critic_hidden) == ([96, 64], [512, 512])
    assert paper.learning_rate == Ramp(3e-4, 9e-5, begin=0.1, finish=0.7)
    assert paper.curriculum.difficulty == Ramp(0.0, 1.0, begin=0.1, finish=0.5)
    assert paper.privileged
    assert paper.task.weights.near == 0.0
    ours = (paper.magnify, paper.advantage_groups, paper.average, paper.curriculum.nominal, paper.curriculum.again)
    assert ours == (False, 1, 0.0, 0.0, 0.0)
    assert paper.learn_exploration
    flip = compose_config(["task=flip", "preset=paper"])
    assert flip.task.target.expected
    assert flip.task.training_episode is None
    assert make_policy(paper).body[1].out_features == 96
    assert not make_policy(paper).body[0].share.any()


def test_a_preset_changes_what_it_lists_and_nothing_else() -> None:
    """Every other option keeps its default; the preset `fast` is the defaults."""
    default = to_config(to_plain(TrainConfig(task=HOVER)))
    assert compose_config([]) == compose_config(["preset=fast"]) == default
    paper, changed = compose_config(["preset=paper"]), {"preset", *PRESETS["paper"]}
    different = {name for name in vars(default) if getattr(paper, name) != getattr(default, name)}
    assert {"preset", "critic", "critic_hidden", "learning_rate"} <= different <= changed


@pytest.mark.parametrize(
    "override",
    [
        "critic=mlp",
        "critic_hidden=[32]",
        "learning_rate.start=5e-4",
        "total_steps=7",
        "torch_threads=1",
        "task.weights.near=0.3",
    ],
)
def test_an_override_wins_over_a_preset(override: str) -> None:
    """Before the preset or after it, what is said explicitly counts, and only that."""
    before, after = compose_config([override, "preset=paper"]), compose_config(["preset=paper", override])
    assert before == after
    name, value = override.split("=")
    paper = compose_config(["preset=paper"])
    if name == "task.weights.near":
        assert before.task.weights.near == 0.3
        assert replace(before, task=paper.task) == paper
    elif "." in name:
        assert before.learning_rate == replace(paper.learning_rate, start=5e-4)
        assert replace(before, learning_rate=paper.learning_rate) == paper
    else:
        assert str(getattr(before, name)) == value
        assert replace(before, **{name: getattr(paper, name)}) == paper


def test_a_preset_goes_with_every_task() -> None:
    """A task and a preset are chosen independently, and survive being saved."""
    for task, preset in product(TASKS, PRESETS):
        config = compose_config([f"task={task}", f"preset={preset}"])
        assert (config.task.name, config.critic) == (task, "lstm" if preset == "paper" else "mlp")
        assert to_config(to_plain(config)) == config


def test_the_last_of_two_presets_counts() -> None:
    """As with every option that is given twice."""
    assert compose_config(["preset=paper", "preset=fast"]) == compose_config([])


def test_help_covers_every_option() -> None:
    """Each option has its default and a line of help, on a line of readable width."""
    text = describe_options()
    options = text.split("\n\npreset=")[0].splitlines()
    for name in (name for name in list_options() if "." not in name):
        (line,) = [line for line in options if line.startswith(f"  {name}=")]
        assert len(line.split(None, 1)[1]) > 5, name
    assert max(map(len, text.splitlines())) <= 140


def test_help_lists_tasks_and_presets() -> None:
    """Every task and preset is named, with what the preset changes; the examples compose."""
    text = describe_options()
    for name in (*TASKS, *PRESETS):
        assert re.search(rf"\b{name}\b", text), name
    (changes,) = re.findall(r"^preset=paper changes (.+?)\n\n", text, flags=re.MULTILINE | re.DOTALL)
    for key in PRESETS["paper"]:
        assert re.search(rf"\b{key}[.=]", changes), key
    assert compose_config(changes.split()) == replace(compose_config(["preset=paper"]), preset="fast")
    examples = re.findall(r"[\w.]+=\S+", text.split("for example:")[1])
    assert len(examples) >= 5
    compose_config([example.strip("'") for example in examples])


def test_a_card_takes_8192_rigs() -> None:
    """The preset for one steps them there; without a card Warp's processor device does."""
    config = compose_config(["preset=card"])
    assert (config.on_device, config.num_envs, config.device) == (True, 8192, "cuda")
    small = compose_config(["preset=card", "device=cpu", "engine=warp", "num_envs=64", "total_steps=4096"])
    assert small.on_device
    assert small.num_envs * small.rollout == 1024


@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_is_printed_wherever_it_is_asked_for(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Beside options too, which are not looked at; nothing is trained."""
    with pytest.raises(SystemExit) as caught:
        run_train(["task=hover", flag, "nonsense"])
    assert caught.value.code == 0
    assert capsys.readouterr().out.strip() == describe_options()


@pytest.mark.parametrize(
    "code",
    [
        "import vpptwin.train.main as m; m.describe_options(); m.compose_config(['preset=paper'])",
        "import vpptwin.cli.main as m; [m.main(c.split()) for c in ('evaluate x', 'play --live x', 'train resume=x')]",
    ],
    ids=["help and overrides", "a checkpoint that is not there"],
)
def test_configuration_needs_no_torch(code: str) -> None:
    """Help, overrides and refusals come without loading torch, which takes seconds."""
    code = f"import sys; {code}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
