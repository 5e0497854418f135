"""`vpptwin play` on a demo flight and on bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.viz.page_reader import read_paths
from vpptwin.cli.main import main
from vpptwin.logs import FlightWriter

FLIP = Path(__file__).parents[2] / "demo/flights/flip.mcap"


def test_play_writes_a_page_with_the_twin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command prints the page's path; the page shows log and twin and says how the twin was driven."""
    page = tmp_path / "new folder" / "flip.html"
    assert main(["play", str(FLIP), "--twin", "nominal", "--restart", "0.25", "--html", str(page)]) == 0
    assert capsys.readouterr().out.strip() == str(page)
    assert {"/rig/log/craft/arm", "/rig/twin/craft/arm", "/rig/target/arm"} <= read_paths(page)
    assert "set back to the log every 0.25 s" in page.read_text()
    assert page.stat().st_size < 10e6


def test_play_without_twin_shows_the_log_alone(tmp_path: Path) -> None:
    """No --twin, no ghost."""
    page = tmp_path / "flip.html"
    assert main(["play", str(FLIP), "--html", str(page)]) == 0
    assert not any(path.startswith("/rig/twin") for path in read_paths(page))


def test_bad_input_is_one_line_and_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A restart of no length, an unwritable page, a log of another rig: exit code 2 and one line that helps."""
    joints = tmp_path / "arm.mcap"
    with FlightWriter(joints) as writer:
        for time in np.arange(0.0, 1.0, 0.01):
            writer.write_joints("/joint_states", time, {"elbow": {"position": time}})
    page = tmp_path / "page.html"
    for arguments, hint in (
        ([FLIP, "--twin", "nominal", "--restart", "0", "--html", page], "--free"),
        ([FLIP, "--html", FLIP / "page.html"], "cannot write"),
        ([joints, "--html", page], "--twin"),
        ([tmp_path / "none.mcap", "--html", page], "none.mcap"),
    ):
        assert main(["play", *map(str, arguments)]) == 2
        said = capsys.readouterr().err.strip()
        assert hint in said
        assert "\n" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["arm.mcap"]
