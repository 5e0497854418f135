"""Before a search: what shows, what looks alike, what does not show."""

from __future__ import annotations

from pathlib import Path

import pytest

from proving.kinds import write_kind
from vpptwin.cli.main import main
from vpptwin.diagnosis.search.prospects import Prospects

FOUND = Prospects(
    {"a": 40.0, "b": 30.0, "c": 1.0}, {"a": 20.0, "b": 2.0, "c": 0.5}, {"a": "b", "b": "a", "c": "a"}, 4.0, 93.0
)


def test_levels() -> None:
    """By signal to noise alone, and beside the effect that is most like it."""
    assert FOUND.levels == {"identifiable": ["a"], "weakly identifiable": ["b"], "not identifiable": ["c"]}
    lines = FOUND.describe()
    assert lines[1] == "weakly identifiable at their usual size: b (like a)"
    assert lines[-1] == "the search will take about 2 min, within a factor of two"


def test_a_diagnosis_says_them_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On standard error, before anything is found."""
    case = write_kind("sweep", 1, tmp_path)
    given = [str(case.logs[0]), "--twin", str(case.twin), "--out", str(tmp_path / "out")]
    assert main(["diagnose", *given, "--only", "slide.viscous,motor.gain"]) == 0
    told = capsys.readouterr().err
    assert "vpptwin: identifiable at their usual size: " in told
    assert "slide.viscous" in told
    assert "vpptwin: the search will take about" in told
