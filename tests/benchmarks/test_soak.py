"""benchmarks/soak.py finds nothing in a few commands of a fresh seed, and finds what ends badly."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
import soak


def test_a_few_commands_end_well(tmp_path: Path) -> None:
    """No traceback, no hang, no process, no file left behind."""
    (tmp_path / "out").mkdir()
    seed = int(os.environ.get("VPPTWIN_SEED", "1"))
    for number in range(5):
        name, problems = soak.run_one(np.random.default_rng([seed, number]), tmp_path)
        assert problems == [], name


def test_what_is_not_whole_is_told(tmp_path: Path) -> None:
    """Half a log, half a page, no JSON, a draft."""
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n half")
    (tmp_path / "a.html").write_text("<html>half")
    (tmp_path / "a.json").write_text('{"a": NaN')
    (tmp_path / ".a.json.123").write_text("")
    assert sorted(problem.split(":")[0] for problem in soak.judge_files(tmp_path)) == [
        "left behind", "no JSON", "not whole", "not whole",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("code", "said"), [(1, "Traceback (most recent call last)"), (2, "no line of ours"), (0, "\x1b[2J")]
)
def test_commands_that_end_badly_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, said: str
) -> None:
    """A traceback, another line than ours, control characters."""
    (tmp_path / "out").mkdir()
    (tmp_path / "vpptwin").mkdir()
    (tmp_path / "vpptwin" / "__init__.py").touch()
    (tmp_path / "vpptwin" / "__main__.py").write_text(
        f"import sys\nprint({said!r}, file=sys.stderr)\nsys.exit({code})\n"
    )
    monkeypatch.setattr(soak, "ROOT", tmp_path)
    monkeypatch.setattr(soak, "draw_command", lambda rng, folder: ["fly"])
    _, problems = soak.run_one(np.random.default_rng(1), tmp_path)  # which is not killed
    assert problems
