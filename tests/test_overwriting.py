"""What vpptwin did not write is not overwritten without --force; its own results are, as often as one likes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.diagnosis.made_up import FLIP, make_up
from vpptwin.cli import main

FLY = ["fly", "--manoeuvre", "x_steps", "--duration", "6", "--out", "flight.mcap"]
WRITERS = {
    "flight.mcap": FLY,
    "out/report.html": ["diagnose", str(FLIP), "--out", "out"],
    "out/twin.yaml": ["diagnose", str(FLIP), "--out", "out"],
    "copy.json": ["diagnose", str(FLIP), "--out", "out", "--json", "copy.json"],
    "score.json": ["compare", str(FLIP), "--json", "score.json"],
    "flip.png": ["plot", str(FLIP)],
    "flip.svg": ["plot", str(FLIP), "--out", "flip.svg"],
    "plotted.html": ["plot", str(FLIP), "--out", "plotted.html"],
    "played.html": ["play", str(FLIP), "--html", "played.html"],
    "typical.xml": ["export", "typical", "--format", "mjcf"],
    "typical_mjlab.py": ["export", "typical", "--format", "mjlab"],
    "c/vpptwin.c": ["export", "flip", "--format", "c", "--out", "c"],
}
"""A file, and the command that writes it."""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder; diagnoses are made up."""
    monkeypatch.chdir(tmp_path)
    make_up(monkeypatch)


@pytest.mark.parametrize(("name", "command"), WRITERS.items(), ids=WRITERS)
def test_one_rule(name: str, command: Sequence[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Somebody's file is refused in a line, before any work; --force overwrites it; then it may be done again."""
    file = Path(name)
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(b"mine, with vpptwin_msgs/msg/RateThrust" if file.suffix == ".mcap" else b"mine")
    before = file.read_bytes()
    assert main(command) == 2
    said = capsys.readouterr().err
    assert f"{file} is there, and vpptwin did not write it" in said
    assert "--force" in said
    assert said.count("\n") == 1
    assert file.read_bytes() == before
    assert main([*command, "--force"]) == 0
    assert file.read_bytes() != before
    assert main(command) == 0


def test_an_empty_file_is_nobodys() -> None:
    """As `mktemp` leaves it."""
    Path("flight.mcap").touch()
    assert main(FLY) == 0
