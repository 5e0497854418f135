"""The command line on the demo flights: what each command prints and writes."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from proving import leg
from proving.quadrotor import write_twin
from vpptwin import __version__
from vpptwin.cli import demo
from vpptwin.cli.main import main
from vpptwin.diagnosis.judgement.verdict import Estimate
from vpptwin.effects import CATALOGUE, find_effect
from vpptwin.logs import read_flight
from vpptwin.report.words import format_value
from vpptwin.twin import load_twin
from vpptwin.twin.robot.signals import Signals

ROOT = Path(__file__).resolve().parents[1]
FLIGHTS = ROOT / "demo" / "flights"
DIAGNOSED = {"one": [str(FLIGHTS / "mixed.mcap")], "all": [str(FLIGHTS / f"{name}.mcap") for name in demo.DIAGNOSED]}
"""Flights of the demo: one in every run, among the slow tests all, of which README tells."""
UNSEEN = FLIGHTS / "flip.mcap"
HORIZONS = [0.05, 0.1, 0.25, 0.5, 1.0]  # s, of every verdict
COMMANDS = ("effects", "diagnose", "compare", "history", "play", "fly", "identify", "train", "evaluate")


@dataclass(frozen=True)
class Run:
    """One run of `vpptwin diagnose` on flights of the demo."""

    logs: list[str]
    out: Path
    said: str
    progress: str

    @property
    def verdict(self) -> dict:
        """verdict.json, read by a parser that refuses NaN."""

        def refuse(constant: str) -> None:
            raise ValueError(f"{constant} is no JSON")

        return json.loads((self.out / "verdict.json").read_text(encoding="utf-8"), parse_constant=refuse)


@pytest.fixture(scope="module", params=["one", pytest.param("all", marks=pytest.mark.slow)])
def diagnosed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Flights of the demo diagnosed once, as a user does, into a folder that does not exist."""
    logs = DIAGNOSED[request.param]
    out = tmp_path_factory.mktemp("demo") / "new" / "out"
    command = [sys.executable, "-m", "vpptwin", "diagnose", *logs, "--twin", "nominal", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env={**os.environ, "COLUMNS": "160"})
    assert done.returncode == 0, done.stderr
    return Run(logs, out, done.stdout, done.stderr)


def test_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """`--version` prints name and version."""
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out.strip() == f"vpptwin {__version__}"


def run_help(*arguments: str) -> int | str | None:
    """Exit code of a command's `--help`; argparse exits, Hydra's help returns."""
    try:
        return main([*arguments, "--help"])
    except SystemExit as caught:
        return caught.code


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """`COMMAND --help` explains every argument and exits with 0; the overview lists the command."""
    assert run_help(command) == 0
    assert len(capsys.readouterr().out.splitlines()) > 5
    assert run_help() == 0
    assert re.search(rf"^  +{command} +\w+", capsys.readouterr().out, flags=re.MULTILINE)


def test_effects_lists_the_catalogue(capsys: pytest.CaptureFixture[str]) -> None:
    """One line a parameter, in the catalogue's order, with unit and bounds."""
    assert main(["effects"]) == 0
    lines = capsys.readouterr().out.splitlines()[1:]
    assert [line.split()[:2] for line in lines] == [[e.id, p.name] for e in CATALOGUE for p in e.parameters]
    mass = next(line for line in lines if line.startswith("airframe.mass"))
    assert re.split(r"  +", mass) == ["airframe.mass", "mass", "kg", "0", "-0.09 to 0.15", "a wrong mass of the craft"]
    # docs/effects.md is what `vpptwin effects --markdown` prints; its table is rectangular.
    assert main(["effects", "--markdown"]) == 0
    page = capsys.readouterr().out
    assert page == (ROOT / "docs" / "effects.md").read_text(encoding="utf-8"), (
        "run `vpptwin effects --markdown > docs/effects.md`"
    )
    table = [line for line in page.splitlines() if line.startswith("|")]
    assert len(table) == 2 + sum(len(effect.parameters) for effect in CATALOGUE)
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table}) == 1


def find_blocks(language: str) -> list[str]:
    """The code blocks of a language in docs/twin.md."""
    text = (ROOT / "docs" / "twin.md").read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def test_the_documented_twins_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The drone of docs/twin.md loads, its quadrotor too; its cart gets the generic effects, with units."""
    drone, _, cart, quadrotor, legged = find_blocks("yaml")
    assert load_twin(write_twin(tmp_path)).robot.signals == Signals(**yaml.safe_load(quadrotor)["signals"])
    leg.write_twin(tmp_path)
    (tmp_path / "leg.yaml").write_text(legged)
    assert load_twin(tmp_path / "leg.yaml").robot.driven.tolist() == list(range(6))
    (tmp_path / "drone.yaml").write_text(drone)
    (tmp_path / "cart.yaml").write_text(cart)
    (tmp_path / "cart.xml").write_text(*find_blocks("xml"))
    assert load_twin(tmp_path / "drone.yaml").effects["airframe.mass"] == {"mass": 0.02}
    assert main(["effects", "--twin", str(tmp_path / "cart.yaml")]) == 0
    units = {tuple(line.split()[:2]): re.split(r"  +", line)[2] for line in capsys.readouterr().out.splitlines()[1:]}
    assert units["slide.coulomb", "force"] == "N"
    assert units["swing.coulomb", "torque"] == "N m"
    assert units["swing.viscous", "damping"] == "N m s/rad"
    assert units["motor.delay", "delay"] == "s"
    assert not any(effect.startswith(("rail", "airframe")) for effect, _ in units)


def test_the_documented_mistakes_are_told_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lines that docs/twin.md shows are what a user sees."""
    monkeypatch.chdir(tmp_path)
    rig = "model: rail_rig.xml\n"
    drone = rig + "vehicle: vehicle.yaml\n"
    mistakes = (
        drone + "effects: {rail_x.colomb: {force: 0.3}}",
        drone + "effects: {airframe.mass: {mass: -0.6}}",
        drone + "effects: {rail_x.coulomb: {mass: 0.3}}",
        drone + "efects: {}",
        rig + "signals: {joints: {slide: /joint_states}}",
        rig + "signals: {joints: {rail_x: /joint_states}, driven: {rail_z: /joint_states}}",
        rig,
    )
    (shown,) = find_blocks("text")
    for content, line in zip(mistakes, shown.splitlines(keepends=True), strict=True):
        Path("rig.yaml").write_text(content)
        assert main(["effects", "--twin", "rig.yaml"]) == 2
        assert capsys.readouterr().err == line


def check_numbers(values: object, count: int) -> None:
    """A list of finite numbers that are not negative."""
    assert isinstance(values, list)
    assert len(values) == count
    assert all(isinstance(value, float) and math.isfinite(value) and value >= 0.0 for value in values)


def check_score(score: dict) -> None:
    """`before` or `after`."""
    assert set(score) == {"position_rmse_m", "angle_rmse_rad", "chi2", "velocity_rmse"}
    check_numbers(score["position_rmse_m"], len(HORIZONS))
    check_numbers(score["angle_rmse_rad"], len(HORIZONS))
    for values in score["velocity_rmse"].values():
        check_numbers(values, len(HORIZONS))
    check_numbers([score["chi2"]], 1)


def check_cause(cause: dict) -> None:
    """An entry of `causes`, against the catalogue."""
    known = {"effect", "confidence", "parameters", "gain", "gain_interval", "also_explained_by"}
    assert known <= set(cause) <= known | {"kind", "kind_confidence", "log_odds"}
    effect = find_effect(CATALOGUE, cause["effect"])
    assert 0.0 < cause["confidence"] < 1.0
    assert cause["gain"] <= 1.0
    assert set(cause["parameters"]) == {p.name for p in effect.parameters}
    for name, entry in cause["parameters"].items():
        parameter = effect.parameter(name)
        assert set(entry) == {"value", "unit", "std", "nominal"}
        assert entry["unit"] == parameter.unit
        assert entry["nominal"] == parameter.off
        assert parameter.low <= entry["value"] <= parameter.high
        check_numbers([entry["std"]], 1)
    rivals = cause["also_explained_by"]
    assert all({"effect", "confidence", "sigma"} <= set(rival) for rival in rivals)
    assert all(find_effect(CATALOGUE, rival["effect"]) is not effect for rival in rivals)
    assert sum(rival["confidence"] for rival in rivals) + cause["confidence"] <= 1.0


def check_power(verdict: dict) -> None:
    """What was cleared, what could not be seen and what to fly next: every effect in one list at most."""
    named = [cause["effect"] for cause in verdict["causes"]]
    for suspect in verdict["cleared"]:
        assert set(suspect) == {"effect", "parameter", "low", "high", "unit"}
        assert suspect["low"] <= suspect["high"]
    for suspect in verdict["unseen"]:
        assert set(suspect) == {"effect", "reason"}
        assert suspect["reason"]
    listed = [*named, *(suspect["effect"] for suspect in (*verdict["cleared"], *verdict["unseen"]))]
    assert len(listed) == len(set(listed))
    if (experiment := verdict["experiment"]) is not None:
        assert set(experiment) == {"manoeuvre", "parameters", "separates", "sigma", "command"}
        assert experiment["manoeuvre"] == verdict["suggested_experiment"]
        assert experiment["sigma"] > 0.0
        assert experiment["command"].startswith("vpptwin fly ")


def check_verdict(verdict: dict) -> None:
    """verdict.json has the form of docs/diagnose.md, key by key."""
    keys = ("logs", "twin", "samples", "horizons_s", "before", "after", "gap", "causes", "unexplained")
    ours = ("misfit", "experiment", "cleared", "unseen", "improvement", "warnings", "stopped", "only", "decisions")
    assert set(verdict) == {*keys, "suggested_experiment", *ours}
    assert all(isinstance(log, str) for log in verdict["logs"])
    assert isinstance(verdict["twin"], str)
    assert set(verdict["samples"]) == {"windows", "held_out_windows"}
    assert all(isinstance(count, int) and count > 0 for count in verdict["samples"].values())
    assert verdict["horizons_s"] == HORIZONS
    check_score(verdict["before"])
    check_score(verdict["after"])
    assert isinstance(verdict["gap"], bool)
    for cause in verdict["causes"]:
        check_cause(cause)
    gains = [cause["gain"] for cause in verdict["causes"]]
    assert gains == sorted(gains, reverse=True)
    unexplained = verdict["unexplained"]
    assert set(unexplained) == {"significant", "share", "channel", "depends_on", "sigma", "force"}
    assert isinstance(unexplained["significant"], bool)
    assert 0.0 <= unexplained["share"] <= 1.0
    assert unexplained["channel"] is None or isinstance(unexplained["channel"], str)
    assert all(isinstance(quantity, str) for quantity in unexplained["depends_on"])
    assert verdict["suggested_experiment"] is None or isinstance(verdict["suggested_experiment"], str)
    check_power(verdict)
    for key, intervals in verdict["improvement"].items():
        assert key in verdict["before"] or key in verdict["before"]["velocity_rmse"]
        assert len(intervals) == len(HORIZONS)
        assert all(low <= high for low, high in intervals)
    assert all(isinstance(warning, str) and "\n" not in warning for warning in verdict["warnings"])


def test_diagnose_names_the_friction_of_the_demo(diagnosed: Run) -> None:
    """The demo rig hides 0.30 N of dry friction on the rail, on top of up to 0.01 N of its own."""
    check_verdict(diagnosed.verdict)
    assert diagnosed.verdict["logs"] == diagnosed.logs
    assert diagnosed.verdict["twin"] == "nominal"
    predictions = sorted(f"prediction_{Path(log).stem}.mcap" for log in diagnosed.logs)
    predictions = predictions if len(predictions) > 1 else ["prediction.mcap"]
    results = [*predictions, "report.html", "twin.yaml", "verdict.json"]
    assert sorted(file.name for file in diagnosed.out.iterdir()) == results
    # The demo rig hides 0.30 N of dry friction on the rail, on top of up to 0.01 N of its own.
    verdict = diagnosed.verdict
    assert verdict["gap"] is True
    (cause,) = verdict["causes"]
    assert cause["effect"] == "rail_x.coulomb"
    assert cause["parameters"]["force"]["value"] == pytest.approx(0.30, abs=0.03)
    assert verdict["after"]["chi2"] < verdict["before"]["chi2"]
    assert verdict["after"]["position_rmse_m"][2] < 0.6 * verdict["before"]["position_rmse_m"][2]


@pytest.mark.slow
@pytest.mark.parametrize("diagnosed", ["all"], indirect=True)
def test_readme_and_pictures_say_what_the_demo_says(diagnosed: Run) -> None:
    """Cause, errors before and after, and the sentence that pictures of the report carry."""
    (cause,), before, after = (diagnosed.verdict[key] for key in ("causes", "before", "after"))
    size = format_value(Estimate(**cause["parameters"]["force"]))
    assert not cause["also_explained_by"]
    told = [row for row in (ROOT / "README.md").read_text().splitlines() if row.endswith("| `make demo` |")]
    assert f"{cause['effect']}, {size}, no rival" in told[0]
    errors = [[1e3 * score["position_rmse_m"][i] for i in (1, 2, 3, 4)] for score in (before, after)]
    assert ", ".join(f"{format_short(b)} → {format_short(a)}" for b, a in zip(*errors)) + " mm" in told[1]
    headline = re.search(r"<title>(.*)</title>", (diagnosed.out / "report.html").read_text(encoding="utf-8"))
    assert headline is not None
    assert size in headline[1]
    for name in ("report", "force"):
        picture = Image.open(ROOT / f"docs/pictures/{name}.png")
        assert picture.info["Description"] == headline[1], "make demo && python -m tests.viz.pictures"


def format_short(error: float) -> str:
    """As the README has it: two digits, more where they are whole."""
    return f"{error:.0f}" if error >= 10.0 else f"{error:.1f}"


def test_diagnose_prints_what_a_reader_needs(diagnosed: Run) -> None:
    """The sentence with the cause first, errors before and after, and where the files lie; progress aside."""
    lines = diagnosed.said.strip().splitlines()
    assert re.match(
        r"Dry friction of 0\.\d+ ± 0\.\d+ N on the horizontal rail takes the error half a second ", lines[0]
    )
    for words in ("rail_x.coulomb  ", "% probable", "held-out chi²", "What remains is ", "noise", "before → after"):
        assert words in diagnosed.said
    for name in ("report.html", "verdict.json", "twin.yaml"):
        assert str(diagnosed.out / name) in diagnosed.said
    assert "diagnose" in diagnosed.progress
    assert "Traceback" not in diagnosed.progress


def test_the_report_needs_nothing_from_elsewhere(diagnosed: Run) -> None:
    """report.html has no script, style, font or picture from outside, links to files beside it, and names the cause."""
    page = (diagnosed.out / "report.html").read_text(encoding="utf-8")
    references = re.findall(r"""(?:src|href|data|action)\s*=\s*["']?([^"'\s>]+)""", page)
    beside = [r for r in references if not r.startswith(("#", "data:"))]
    assert all((diagnosed.out / r).is_file() for r in beside), beside
    assert "@import" not in page
    assert [u for u in re.findall(r"url\(([^)]*)\)", page) if not u.strip("\"'").startswith(("#", "data:"))] == []
    assert "rail_x.coulomb" in page
    assert page.count("<svg") >= 3


def test_the_extended_twin_predicts_better(diagnosed: Run, tmp_path: Path) -> None:
    """twin.yaml loads with the fitted values; `compare` on a flight that was not diagnosed finds a smaller error."""
    twin = load_twin(diagnosed.out / "twin.yaml")
    (cause,) = diagnosed.verdict["causes"]
    fitted = {name: entry["value"] for name, entry in cause["parameters"].items()}
    assert twin.effects == {cause["effect"]: pytest.approx(fitted, rel=1e-5)}
    scores = []
    for name in ("nominal", str(diagnosed.out / "twin.yaml")):
        assert main(["compare", str(UNSEEN), "--twin", name, "--json", str(tmp_path / "score.json")]) == 0
        scores.append(json.loads((tmp_path / "score.json").read_text())["error"])
    nominal, extended = scores
    assert extended["chi2"] < nominal["chi2"]
    assert extended["position_rmse_m"][2] < nominal["position_rmse_m"][2]


def test_compare_prints_and_writes_the_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A table over the horizon on stdout; --json holds the same figures, and its folder nothing else."""
    path = tmp_path / "score.json"
    assert main(["compare", str(UNSEEN), "--twin", "nominal", "--json", str(path)]) == 0
    written = json.loads(path.read_text())
    assert set(written) == {"logs", "twin", "samples", "horizons_s", "error", "warnings"}
    assert written["logs"] == [str(UNSEEN)]
    assert written["twin"] == "nominal"
    assert written["samples"]["windows"] > 20
    assert written["horizons_s"] == HORIZONS
    check_score(written["error"])
    said = capsys.readouterr().out
    assert f"whole-log chi² {written['error']['chi2']:.3g}" in said
    assert f"{1000 * written['error']['position_rmse_m'][2]:.3g}" in said
    assert [file.name for file in tmp_path.iterdir()] == ["score.json"]
    # `--json -` prints them and nothing else on stdout.
    assert main(["compare", str(UNSEEN), "--json", "-"]) == 0
    check_score(json.loads(capsys.readouterr().out)["error"])


def test_play_writes_a_page_of_a_twin_from_a_diagnosis(diagnosed: Run, tmp_path: Path) -> None:
    """`play --html` takes the extended twin as it takes nominal, and leaves one page."""
    page = tmp_path / "flip.html"
    assert main(["play", str(UNSEEN), "--twin", str(diagnosed.out / "twin.yaml"), "--html", str(page)]) == 0
    assert [file.name for file in tmp_path.iterdir()] == ["flip.html"]
    assert "twin.yaml" in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_demo_shows_the_wall(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The shipped policy reaches the vertical while that is asked for, and the page is there."""
    demo.show_wall(tmp_path)
    flight = read_flight(tmp_path / "wall.mcap")
    target, pose = flight.streams["/setpoint/pose"], flight.streams["/mocap/pose"]
    (up,) = np.flatnonzero(target["theta"] > 1.0)
    asked = (pose.time >= target.time[up]) & (pose.time <= target.time[up + 1])
    assert pose["theta"][asked].max() > math.radians(75.0)
    assert "wall.html" in capsys.readouterr().out
    assert (tmp_path / "wall.html").stat().st_size > 1e5
