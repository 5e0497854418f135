"""docs/train.md: its commands and those of docs/cluster.md compose, its files exist, its Python runs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
import torch

from vpptwin.train.main import compose_config

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "train.md").read_text(encoding="utf-8")
CLUSTER = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "line", re.findall(r"^    (?:\w+=\S+ )?vpptwin train (.+)$", PAGE + CLUSTER, flags=re.MULTILINE)
)
def test_documented_overrides_compose(line: str) -> None:
    """Every `vpptwin train` line of the pages is a valid set of overrides."""
    compose_config(shlex.split(line))


def test_documented_files_exist(tiny_run: Path) -> None:
    """The table of what a run leaves is true, column names included."""
    section = PAGE.split("## What a run leaves")[1].split("\n## ")[0]
    table = dict(re.findall(r"^\| `([^`]+)` \| (.+) \|$", section, flags=re.MULTILINE))
    assert {"checkpoint.pt", "config.yaml", "log/scalars/*.csv"} <= set(table)
    for path in table:
        assert list(tiny_run.glob(path)), path
    for name in re.findall(r"`(\w+)`", table["log/scalars/*.csv"]):
        assert (tiny_run / "log" / "scalars" / f"{name}.csv").is_file(), name


def test_documented_python(tiny_run: Path) -> None:
    """The snippet gives a module with the shapes that it states."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    names: dict[str, torch.nn.Module] = {}
    exec(code.replace("runs/flip", str(tiny_run)), names)
    assert names["policy"](torch.zeros(5, 11)).shape == (5, 2)


def test_the_environment_in_a_script_of_ones_own(capsys: pytest.CaptureFixture[str]) -> None:
    """examples/own_training.py collects ten batches and updates on each; the value loss falls as the critic learns."""
    run_path(str(ROOT / "examples/own_training.py"))
    rows = re.findall(r"reward (\S+), value loss (\S+)", capsys.readouterr().out)
    reward, loss = np.array(rows, dtype=float).T
    assert len(reward) == 10
    assert (reward > 0.0).all()
    assert loss[-3:].mean() < loss[0]
