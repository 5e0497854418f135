"""`vpptwin fly`: its logs are read by every other command, and what cannot be flown is refused in a line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from vpptwin.cli.main import main
from vpptwin.logs.read import read_flight
from vpptwin.robots.planar_drone.pilot.library import LIBRARY

RUBBING = "model: rail_rig.xml\nvehicle: vehicle.yaml\neffects:\n  rail_x.coulomb: {force: 0.3}\n"
CART = "model: rig.xml\nsignals: {joints: {slide: /joint_states}}\n"
CART_XML = """<mujoco><worldbody><body><joint name="slide" type="slide"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a twin that rubs and 8 s of x steps flown in it, as a user does."""
    folder = tmp_path_factory.mktemp("flown")
    (folder / "rubbing.yaml").write_text(RUBBING)
    command = ["fly", "--pilot", "scripted", "--manoeuvre", "x_steps", "--set", "amplitude=0.5", "--set", "period=1.5"]
    out = ["--twin", str(folder / "rubbing.yaml"), "--duration", "8", "--seed", "4", "--out", str(folder / "x.mcap")]
    assert main([*command, *out]) == 0
    return folder


def test_only_the_twin_that_flew_predicts_the_flight(flown: Path, tmp_path: Path) -> None:
    """`compare` finds noise with the twin that has the friction, and far more with the nominal one."""
    chi2, millimetres = {}, {}
    for twin in ("nominal", str(flown / "rubbing.yaml")):
        written = tmp_path / "score.json"
        assert main(["compare", str(flown / "x.mcap"), "--twin", twin, "--json", str(written)]) == 0
        error = json.loads(written.read_text())["error"]
        chi2[twin], millimetres[twin] = error["chi2"], 1000 * error["position_rmse_m"][2]
    assert chi2[str(flown / "rubbing.yaml")] == pytest.approx(1.0, abs=0.1)
    assert chi2["nominal"] > 2.0
    assert millimetres["nominal"] > 3.0 * millimetres[str(flown / "rubbing.yaml")]


def test_a_log_tells_what_was_flown(flown: Path) -> None:
    """Twin, effects, manoeuvre, settings and seed travel in the log."""
    with (flown / "x.mcap").open("rb") as file:
        (record,) = [r for r in make_reader(file).iter_metadata() if r.name == "vpptwin"]
    told = dict(record.metadata)
    assert told["manoeuvre"] == "x_steps"
    assert told["settings"] == "amplitude=0.5 period=1.5 height=1.3"
    assert told["seed"] == "4"
    assert json.loads(told["effects"]) == {"rail_x.coulomb": {"force": 0.3}}


def test_a_log_reads_without_warnings(flown: Path) -> None:
    """Nothing about it has to be mended; it lasts as long as it was told to."""
    flight = read_flight(flown / "x.mcap")
    assert flight.warnings == ()
    assert flight.duration == pytest.approx(8.0, abs=0.02)
    assert np.ptp(flight.streams["/mocap/pose"]["x"]) > 0.8


def test_a_log_can_be_played(flown: Path, tmp_path: Path) -> None:
    """`play --html` draws it beside the twin."""
    page = tmp_path / "flight.html"
    arguments = ["play", str(flown / "x.mcap"), "--twin", str(flown / "rubbing.yaml"), "--html", str(page)]
    assert main(arguments) == 0
    assert page.stat().st_size > 10_000


def test_the_library_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    """Every manoeuvre with every setting, its default and its bounds."""
    assert main(["fly", "--list"]) == 0
    said = capsys.readouterr().out
    for manoeuvre in LIBRARY:
        assert f"{manoeuvre.name}: {manoeuvre.summary}" in said
        for s in manoeuvre.settings:
            assert f"--set {s.name}={s.default:g}  {s.low:g} to {s.high:g}" in said


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ("--manoeuvre waltz --out x.mcap", ("unknown manoeuvre 'waltz'", "hover, x_steps")),
        ("--manoeuvre x_steps --set amplitude=3 --out x.mcap", ("amplitude = 3 m", "0.05 to 1 m")),
        ("--manoeuvre x_steps --set size=3 --out x.mcap", ("no setting 'size'",)),
        ("--manoeuvre x_steps --set amplitude --out x.mcap", ("--set amplitude", "NAME=VALUE")),
        ("--manoeuvre x_steps --duration 2 --out x.mcap", ("a flight of 2 s", "5 to 600 s")),
        ("--manoeuvre x_steps --seed -1 --out x.mcap", ("--seed -1",)),
        ("--manoeuvre x_steps", ("no --out",)),
        ("--manoeuvre x_steps --out .", ("is a folder",)),
        ("--manoeuvre x_steps --out no/x.mcap", ("no folder no",)),
        ("--manoeuvre x_steps --twin cart.yaml --out x.mcap", ("cart.yaml is not the drone",)),
        ("--manoeuvre x_steps --twin none.yaml --out x.mcap", ("none.yaml",)),
        ("--out x.mcap", ("no --manoeuvre", "a checkpoint")),
        ("--pilot policy --out x.mcap", ("no checkpoint",)),
        ("ckpt --manoeuvre x_steps --out x.mcap", ("--manoeuvre for the policy",)),
        ("ckpt --pilot scripted --manoeuvre x_steps --out x.mcap", ("a checkpoint for the scripted pilot",)),
        ("--manoeuvre x_steps --task hover --out x.mcap", ("--task for the scripted pilot",)),
        ("ckpt --out x.mcap", ("no checkpoint ckpt",)),
        ("ckpt --task waltz --out x.mcap", ("unknown task 'waltz'", "hover")),
    ],
)
def test_what_cannot_be_flown_is_refused(
    arguments: str, parts: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Exit code 2, one line that names what is wrong and what was expected, nothing left behind."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.yaml").write_text(CART)
    (tmp_path / "rig.xml").write_text(CART_XML)
    assert main(["fly", *arguments.split()]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("vpptwin: ")
    assert err.count("\n") == 1
    assert "; expected " in err
    for part in parts:
        assert part in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cart.yaml", "rig.xml"]
