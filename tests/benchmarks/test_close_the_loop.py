"""Closing the loop: what is hidden and what the oracle is told, the flights, and what the report makes of results.

The loop itself, with trainings too brief to learn, is behind `slow`.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from close_the_loop import main
from loop.flights import Suggested, fly_rig, log_flights, log_manoeuvre, predict
from loop.report import closed_share, draw_picture, error, format_table, misjudged, score, tell_gain
from loop.settings import LOW, SETTINGS, STUCK, draw_rig, tell_truth
from loop.steps import POLICIES, write_truth

from proving.drone import EFFECTS, true_size
from proving.drone.rig import load_nominal
from proving.policy_flights import load_flyer
from vpptwin.logs.read import read_flight
from vpptwin.system.errors import InputError
from vpptwin.twin import load_twin

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("setting", [*SETTINGS, STUCK], ids=lambda setting: setting.name)
def test_a_rig_follows_from_its_seed(setting: object) -> None:
    """Drawn within the setting's ranges, of effects that the independent simulation has, another for another seed."""
    rig = draw_rig(setting, 3)
    assert rig == draw_rig(setting, 3)
    assert rig.hidden != draw_rig(setting, 4).hidden
    for effect, values in rig.hidden.items():
        assert set(values) <= set(EFFECTS[effect])
        for name, value in values.items():
            low, high = setting.ranges[effect][name]
            assert low <= value <= high


@pytest.mark.parametrize("setting", [*SETTINGS, STUCK], ids=lambda setting: setting.name)
def test_the_oracle_is_told_the_truth(setting: object, tmp_path: Path) -> None:
    """Hidden values with the rig's own tolerances, in the catalogue's terms; the twin file loads."""
    rig = draw_rig(setting, 5)
    truth = tell_truth(rig)
    for effect, values in rig.hidden.items():
        for name, value in values.items():
            assert truth[effect][name] == pytest.approx(true_size(effect, name, value, rig.session))
    mass = load_nominal()["airframe"]["mass"]
    assert 0.0 < abs(truth["airframe.mass"]["mass"]) <= 0.005 * mass
    spec = load_twin(write_truth(rig, tmp_path / "truth.yaml"))
    assert spec.effects == truth


def test_flights_near_the_floor_stay_there() -> None:
    """The setting with the cushion of air asks for low targets, the others for those of training."""
    task = load_flyer("flip")[1]
    heights = {setting.name: draw_rig(setting, 0).choose_task(task).target.z for setting in SETTINGS}
    assert heights["delay"] == LOW
    assert tuple(heights["stiction"]) == tuple(heights["backlash"]) == tuple(task.target.z)


def test_the_twin_flies_the_flights_of_the_rig(tmp_path: Path) -> None:
    """Same starts and targets; in a twin of the truth the errors of a few flights agree, flight by flight, to a third.

    Gusts and noise differ, and the filter; on the nominal twin the lag of the servo is not seen.
    """
    policy, task = load_flyer("flip")
    rig = draw_rig(SETTINGS[1], 1)
    short = type(task)(**{**vars(task), "episode": 3.0})
    flown = fly_rig(policy, short, rig, 6, 2)
    guess = predict(policy, short, rig, write_truth(rig, tmp_path / "truth.yaml"), 6, 2)
    assert [f["inverted"] for f in flown["each"]] == [f["inverted"] for f in guess["each"]]
    both = [(a, b) for a, b in zip(flown["each"], guess["each"]) if not (a["failed"] or b["failed"])]
    assert len(both) >= 4
    here, there = (np.array([pair[i]["position_error"] for pair in both]) for i in (0, 1))
    assert np.median(np.abs(there / here - 1.0)) < 0.34


@pytest.mark.slow
def test_flights_become_logs(tmp_path: Path) -> None:
    """A policy's flight and a manoeuvre of the library, flown by the rig, are logs that can be read."""
    policy, task = load_flyer("flip")
    rig = draw_rig(SETTINGS[0], 1)
    (path,) = log_flights(policy, task, rig, 7, tmp_path, count=1, duration=3.0)
    assert len(read_flight(path).streams["/cmd/rate_thrust"].time) == 301
    assert Suggested("x_steps").duration == pytest.approx(20.0)
    position = read_flight(log_manoeuvre("x_steps", rig, 7, tmp_path, 5.0)).streams["/mocap/pose"]
    assert np.ptp(position["x"]) > 0.3


def fake_rig(seed: int, errors: dict[str, float], lost: int = 0) -> dict:
    """A result with ten flights of each policy, all with one error [m]; the nominal policy loses some."""

    def summarise(error: float, lost: int) -> dict:
        each = {"failed": [int(i < lost) for i in range(10)], "position_error": [error] * 10}
        known = {"mean": error, "median": error, "worst": error}
        share = 1.0 - lost / 10
        return {**each, "success_share": share, "upright_error_m": known, "inverted_error_m": known}

    policies = {
        name: {"flown": summarise(error, lost if name == "nominal" else 0), "predicted": summarise(0.9 * error, 0)}
        for name, error in errors.items()
    }
    cause = {"effect": "servo.lag", "confidence": 1.0, "parameters": {"time_constant": {"value": 0.04, "std": 0.001}}}
    diagnosis = {"causes": [cause], "first": ["servo.lag"], "suggested": None}
    about = {"setting": "stiction", "title": "rail stiction", "seed": seed, "session": 1}
    return {**about, "hidden": {"servo.lag": {"time_constant": 0.041}}, "diagnosis": diagnosis, "policies": policies}


ERRORS = {"nominal": 0.05, "adaptive": 0.04, "randomized": 0.03, "extended": 0.012, "oracle": 0.01}


def test_what_is_closed_by_hand() -> None:
    """(50 - 12) / (50 - 10) = 95 %; with two of ten lost the nominal score is 0.2 * 500 + 0.8 * 50 = 140 mm."""
    plain, lossy = fake_rig(0, ERRORS), fake_rig(0, ERRORS, lost=2)
    assert closed_share([plain]) == pytest.approx(0.95)
    assert score(lossy["policies"]["nominal"]["flown"]) == pytest.approx(0.14)
    assert closed_share([lossy]) == pytest.approx((140 - 12) / (140 - 10))
    assert closed_share([plain, lossy]) == pytest.approx((95 - 12) / (95 - 10))
    assert tell_gain([plain]) == "closes 95% of the gap"
    del plain["policies"]["oracle"]
    assert tell_gain([plain]) == "brings 50.0 mm down to 12.0"
    # Lost flights count in the score only; 45 mm predicted for 50 flown is 10 % less.
    lossy = fake_rig(0, ERRORS, lost=2)
    assert error(lossy["policies"]["nominal"]["flown"]) == pytest.approx(0.05)
    assert misjudged(lossy, "nominal") == pytest.approx(-0.1)
    assert np.isnan(error(fake_rig(0, ERRORS, lost=10)["policies"]["nominal"]["flown"]))


def test_the_table_shows_medians_over_seeds() -> None:
    """Three seeds, the middle one is shown; every rig has its line of what was hidden and named."""
    rigs = [fake_rig(seed, {name: factor * e for name, e in ERRORS.items()}) for seed, factor in enumerate((1, 2, 9))]
    text = format_table(rigs)
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert len(rows) == 1 + len(POLICIES)
    assert "| 100.0% | 0.0 % (0.0 %) | 100.0 (90.0) | 100.0 (90.0) | 100.0 (90.0) |" in rows[1]
    assert text.count("closes 95% of the gap") == 3 + 1
    assert "predicts the error within 20% on 3 of 3 (median 10% off), the nominal one on 3 (10%)" in text
    assert "`servo.lag` time_constant 0.04 ± 0.001; suggested no manoeuvre" in text


def test_the_picture_has_a_dot_for_every_flight_of_the_loop(tmp_path: Path) -> None:
    """One panel a setting, titled; it is an SVG that follows the reader's screen."""
    picture = draw_picture([fake_rig(0, ERRORS), fake_rig(1, ERRORS)], tmp_path / "loop.svg").read_text()
    assert "rail stiction" in picture
    assert "prefers-color-scheme" in picture


@pytest.mark.parametrize("content", ["{", "[1]", '{"cases": []}'])
def test_a_report_of_what_is_no_result(tmp_path: Path, content: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A damaged or foreign file is a line and no traceback."""
    (tmp_path / "bad.json").write_text(content)
    assert main(["--report", str(tmp_path / "bad.json")]) == 2
    assert re.search(r"bad\.json: no results.*expected a file that --json wrote", capsys.readouterr().err)


def test_what_would_fail_after_an_hour_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No compiler, or a place for the results that there is none of."""
    assert main(["--json", str(tmp_path / "nowhere/loop.json"), "--folder", str(tmp_path)]) == 2
    assert "cannot write --json" in capsys.readouterr().err
    monkeypatch.setenv("PATH", "")
    assert main(["--folder", str(tmp_path)]) == 2
    assert "no gcc; expected a C compiler" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_unknown_manoeuvre_is_refused() -> None:
    """Whoever suggests one has it from the library."""
    with pytest.raises(InputError, match="unknown manoeuvre"):
        Suggested("loop the loop")


@pytest.mark.slow
def test_the_whole_loop(tmp_path: Path) -> None:
    """Trainings of 20 000 steps learn nothing, but every step of the loop runs and is kept: about ten minutes."""
    out = tmp_path / "loop.json"
    brief = ["--steps", "20000", "--flights", "4", "--folder", str(tmp_path / "runs"), "--json", str(out)]
    command = [sys.executable, str(ROOT / "benchmarks/close_the_loop.py"), "--seed", "0", *brief]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    rigs = json.loads(out.read_text())["rigs"]
    assert [rig["setting"] for rig in rigs] == [setting.name for setting in SETTINGS]
    assert all(set(rig["policies"]) == set(POLICIES) for rig in rigs)
