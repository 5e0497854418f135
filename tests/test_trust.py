"""Code that a twin or a checkpoint names runs only with the user's word; else a line says which file it would be."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
import torch

from tests.test_own_effects import COGGING, LOGS, PAGE
from vpptwin.cli.main import main
from vpptwin.system.errors import InputError
from vpptwin.system.trust import trust
from vpptwin.train.config import to_config
from vpptwin.train.env.vpp_env import make_env
from vpptwin.train.evaluate.evaluate import Conditions, evaluate
from vpptwin.train.evaluate.live import LiveFlight
from vpptwin.train.learn.checkpoint import read_checkpoint


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a Python file that leaves a mark when it runs, and a twin and a checkpoint that name it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text(f"open('ran', 'w').close()\n{COGGING.read_text()}")
    (tmp_path / "twin.yaml").write_text("model: rail_rig.xml\nvehicle: vehicle.yaml\neffects_from: [evil.py]\n")
    content = read_checkpoint("flip")
    for name, changes in {"code.pt": {"effects": ["evil.py"]}, "twin.pt": {"twin": "twin.yaml"}}.items():
        torch.save({**content, "config": {**content["config"], **changes}}, tmp_path / name)
    return tmp_path


COMMANDS = (
    "effects --twin twin.yaml",
    f"compare {LOGS[0]} --twin twin.yaml",
    f"diagnose {LOGS[0]} --twin twin.yaml --out out",
    f"play {LOGS[0]} --twin twin.yaml --html page.html",
    f"plot {LOGS[0]} --twin twin.yaml --out plot.svg",
    f"identify {LOGS[0]} --parameters air.drag --twin twin.yaml --out fitted.yaml",
    "fly flip --twin twin.yaml --out flight.mcap",
    "evaluate flip --twin twin.yaml --tracks 2",
    "export flip --format c --twin twin.yaml",
    "train task=hover twin=twin.yaml",
    "export code.pt --format c",
    "export code.pt --format onnx",
    "export twin.pt --format c",
    "play --live code.pt",
    "play --live twin.pt",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_runs_code_that_data_names(hostile: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2, and a line with the file and the options; nothing ran, nothing was written."""
    before = sorted(path.name for path in hostile.iterdir())
    assert main(command.split()) == 2
    out, err = capsys.readouterr()
    assert out == "" or "--live" in command  # its page is served before the policy is read
    assert err.count("\n") == 1
    for part in ("names evil.py, Python code that would be run", "say `--effects evil.py`", "--trust"):
        assert part in err
    assert sorted(path.name for path in hostile.iterdir()) == before


def test_what_needs_no_effects_flies_without_them(hostile: Path) -> None:
    """A policy whose training had effects of its own flies in other twins, where they are not needed."""
    assert main(["fly", "code.pt", "--duration", "5", "--out", "flight.mcap"]) == 0
    assert not (hostile / "ran").exists()


@pytest.mark.parametrize("word", ["--effects evil.py", "--trust"])
def test_code_runs_with_the_users_word(hostile: Path, word: str) -> None:
    """By naming the file, or for every file that is named."""
    assert main(f"effects --twin twin.yaml {word}".split()) == 0
    assert (hostile / "ran").exists()
    (hostile / "ran").unlink()
    (hostile / "evil.py").write_text((hostile / "evil.py").read_text() + "\n# read anew\n")
    assert main(f"export code.pt --format c {word}".split()) == 0
    assert (hostile / "ran").exists()
    assert (hostile / "code_c").is_dir()


def test_the_word_for_one_file_is_none_for_another(hostile: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`--effects` of another file, or of another one of that name, allows nothing."""
    (hostile / "lib").mkdir()
    (hostile / "lib" / "evil.py").write_text(COGGING.read_text())
    assert main(["effects", "--twin", "twin.yaml", "--effects", "lib/evil.py"]) == 2
    assert "names evil.py, Python code" in capsys.readouterr().err
    assert not (hostile / "ran").exists()


def test_python_is_held_to_it_too(hostile: Path) -> None:
    """Configurations of checkpoints are data in `make_env`, `evaluate` and `LiveFlight`; `trust` is the word."""
    config = to_config(read_checkpoint("code.pt")["config"])
    refused = pytest.raises(InputError, match=r"names evil\.py, Python code")
    with refused:
        make_env(config)
    with refused:
        evaluate("code.pt", Conditions(tracks=1))
    with refused:
        LiveFlight("code.pt")
    assert not (hostile / "ran").exists()
    trust(["evil.py"])
    with pytest.raises(InputError, match="at least 1"):
        evaluate("code.pt", Conditions(tracks=0))
    LiveFlight("code.pt")
    assert (hostile / "ran").exists()


def test_the_documented_line_is_what_a_user_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line in docs/own_effects.md, with its paths."""
    line, _ = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)
    (tmp_path / "out" / "cogging").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    Path("cogging.py").write_text(COGGING.read_text())
    twin = "model: rail_rig.xml\nvehicle: vehicle.yaml\neffects_from: [../../cogging.py]\n"
    Path("out/cogging/twin.yaml").write_text(twin)
    assert main(["effects", "--twin", os.path.join("out", "cogging", "twin.yaml")]) == 2
    assert capsys.readouterr().err == line
