"""What vpptwin did not write is not overwritten without --force; its own results are, as often as one likes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.diagnosis.made_up import FLIP, make_up
from vpptwin.cli.main import main
from vpptwin.robots.planar_drone.pilot import flight
from vpptwin.robots.planar_drone.pilot.flight import Pilot, SimulatedFlights
from vpptwin.twin import Twin

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
    "copy.mcap": ["convert", str(FLIP), "copy.mcap"],
    "layouts/plotjuggler.xml": ["layouts", "layouts"],
    "layouts/foxglove.json": ["layouts", "layouts"],
    "rail_rig_twin.yaml": ["inspect", str(FLIP), "--model", "rail_rig.xml"],
    "rail.yaml": ["inspect", str(FLIP), "--model", "rail_rig.xml", "--out", "rail.yaml"],
    "c/vpptwin.c": ["export", "flip", "--format", "c", "--out", "c"],
}
"""A file, and the command that writes it."""


FLOWN: list[SimulatedFlights] = []


def fly_once(twin: Twin, pilot: Pilot, *others: Any) -> SimulatedFlights:  # noqa: ANN401
    """The flight of `FLY`, which all tests share."""
    if not FLOWN:
        FLOWN.append(flight.fly(twin, pilot, *others))
    return FLOWN[0]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty folder; diagnoses are made up, and what flies flies once."""
    monkeypatch.chdir(tmp_path)
    make_up(monkeypatch)
    monkeypatch.setattr("vpptwin.robots.planar_drone.pilot.command.fly", fly_once)


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


@pytest.mark.parametrize("name", ["copy.mcap", "layouts/foxglove.json", "rail.yaml", "copy.json", "typical.xml"])
def test_links_that_lead_nowhere_are_somebodys(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Such as one to itself: a line, and --force puts a file in its place."""
    file, command = Path(name), WRITERS[name]
    file.parent.mkdir(exist_ok=True)
    file.symlink_to(file.name)
    assert main(command) == 2
    said = capsys.readouterr().err
    assert f"{file} is a link that leads nowhere" in said
    assert said.count("\n") == 1
    assert main([*command, "--force"]) == 0
    assert not file.is_symlink()
    assert file.is_file()


@pytest.mark.parametrize(
    ("name", "command"),
    [("actuator.html", ["identify", "none.mcap", "--out", "actuator.yaml"]),
     ("pictures/air.drag.png", ["effects", "--pictures", "pictures"]),
     pytest.param("run/config.yaml", ["train", "task=hover", "out=run"], marks=pytest.mark.slow)],  # brings torch
)  # fmt: skip
def test_files_beside_are_asked_for_too(name: str, command: Sequence[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever a command writes besides what it was told to, before any work."""
    Path(name).parent.mkdir(exist_ok=True)
    Path(name).write_text("mine")
    assert main(command) == 2
    assert f"{name} is there, and vpptwin did not write it" in capsys.readouterr().err
    assert Path(name).read_text() == "mine"


def test_a_twin_that_was_corrected_stays(capsys: pytest.CaptureFixture[str]) -> None:
    """What somebody changed in what `inspect` wrote is not guessed over; comments alone are."""
    command, twin = WRITERS["rail_rig_twin.yaml"], Path("rail_rig_twin.yaml")
    assert main(command) == 0
    written = twin.read_text()
    twin.write_text(f"# of today\n{written}")
    assert main(command) == 0
    assert twin.read_text() == written
    twin.write_text(f"{written}effects: {{}}\n")
    assert main(command) == 2
    assert "rail_rig_twin.yaml is there, and vpptwin did not write it, or it may" in capsys.readouterr().err
    # As `mktemp` leaves it.
    Path("flight.mcap").touch()
    assert main(FLY) == 0


@pytest.mark.parametrize("command", [["inspect"], ["compare"], ["plot"], ["diagnose", "--out", "out"]])
def test_an_input_that_is_a_link_to_itself_is_a_line(
    command: Sequence[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Of every command that reads logs."""
    Path("log.mcap").symlink_to("log.mcap")
    assert main([*command, "log.mcap"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
