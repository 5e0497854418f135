"""The benchmark of policies in the independent simulation: its table, its results file, and what it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import policy_in_reality
import pytest

from vpptwin.train.learn.checkpoint import make_policy, write_checkpoint
from vpptwin.train.main import compose_config

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    """An untrained policy for flips of a second."""
    path = tmp_path / "untrained.pt"
    config = compose_config(["task=flip", "task.episode=1.2"])
    write_checkpoint(path, config, make_policy(config), 0)
    return path


@pytest.mark.slow
def test_results_are_shown_and_written(checkpoint: Path, tmp_path: Path) -> None:
    """An untrained policy falls; every flight is in the file with what was hidden, and where it all comes from."""
    out = tmp_path / "out.json"
    command = [sys.executable, "benchmarks/policy_in_reality.py", str(checkpoint), "--flights", "3", "--seed", "4"]
    done = subprocess.run([*command, "--json", str(out)], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(out.read_text())
    assert (result["flights"], result["seed"], result["task"], result["hidden"]) == (3, 4, "flip", "paper")
    assert (result["success_share"], result["checkpoint"]["steps"]) == (0.0, 0)
    assert [flight["number"] for flight in result["each"]] == [0, 1, 2]
    assert all("servo.lag" in flight["effects"] for flight in result["each"])
    assert result["versions"]["numpy"]
    assert result["machine"]["cores"]
    assert f"| failed: floor, end of travel or speed limit | {100 * result['fail_rate']:.1f} % (" in done.stdout
    assert f"Seed 4, commit {str(result['commit'])[:7]}" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["nothing.pt"], "no checkpoint nothing.pt"),
        (["--thrust-to-weight", "0.5"], "task.thrust_to_weight=0.5"),
        (["--json", "/nowhere/x.json"], "cannot write"),
    ],
)
def test_bad_input_ends_in_a_line(
    arguments: list[str], found: str, checkpoint: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No such policy, rotors that cannot carry the craft, nowhere to write."""
    given = arguments if arguments[0].endswith(".pt") else [str(checkpoint), *arguments]
    assert policy_in_reality.main([*given, "--flights", "1"]) == 2
    assert found in capsys.readouterr().err.splitlines()[-1]
