"""`vpptwin evaluate`: what it flies, under which conditions, and what it reports."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from vpptwin.cli.main import main
from vpptwin.system.errors import InputError
from vpptwin.train.config import to_config
from vpptwin.train.env.randomize import PAPER_EFFECTS
from vpptwin.train.env.tasks import FLIP, WALL_BACKTRACK
from vpptwin.train.evaluate.evaluate import Conditions, configure_flights, describe, evaluate, run_evaluate
from vpptwin.train.learn.checkpoint import read_checkpoint

MEASURES = ("position_error_m", "upright_error_m", "angle_error_rad", "fail_rate", "success_share", "full_turns")


def test_evaluation_is_data(tiny_run: Path, tmp_path: Path) -> None:
    """The JSON carries the measures, the conditions and the commits, and repeats bit-equal for the same seed."""
    path = tmp_path / "out.json"
    given = Conditions("hover", 8, 5)
    result = run_evaluate(tiny_run, given, path)
    assert json.loads(path.read_text()) == result
    assert (result["tracks"], result["seed"], result["noise"]) == (8, 5, 1.0)
    assert result["checkpoint"]["steps"] == read_checkpoint(tiny_run)["steps"]
    assert set(result["randomized"]) == set(PAPER_EFFECTS)
    assert 0.0 < result["lipschitz"] <= 8.0
    again, other = evaluate(tiny_run, given), evaluate(tiny_run, Conditions("hover", 8, 6))
    assert [again[key] for key in MEASURES] == [result[key] for key in MEASURES]
    assert other["position_error_m"]["median"] != result["position_error_m"]["median"]
    error = result["position_error_m"]
    assert 0.0 < error["median"] <= error["worst"]
    assert result["upright_error_m"] == error
    assert result["inverted_error_m"] == {"median": None, "mean": None, "worst": None}


def test_without_conditions_it_is_the_task_of_training(tiny_run: Path) -> None:
    """A hundred flights of the task with its overrides, with noise, in twins randomized as the paper does."""
    result = evaluate(tiny_run)
    assert (result["task"], result["tracks"], result["window_s"]) == ("hover", 100, 0.2)
    assert set(result["randomized"]) == set(PAPER_EFFECTS)


def test_when_all_fail_there_is_no_error(tiny_run: Path, tmp_path: Path) -> None:
    """Flights that no policy survives leave nothing to average, and say so."""
    content = read_checkpoint(tiny_run)
    content["config"]["task"]["limits"]["rate"] = 1e-6
    doomed = tmp_path / "doomed.pt"
    torch.save(content, doomed)
    result = evaluate(doomed, Conditions(tracks=4))
    assert result["fail_rate"] == 1.0
    assert result["success_share"] == 0.0
    assert result["position_error_m"] == {"median": None, "mean": None, "worst": None}


def test_conditions_decide_what_is_flown(tiny_run: Path) -> None:
    """Task, seed, noise, twins and strength are those of evaluation; the rest is that of training."""
    trained = to_config(read_checkpoint(tiny_run)["config"])
    same = configure_flights(trained, Conditions("hover", 3, 7, noise=0.5, randomize=["air.drag"]))
    assert same.task == trained.task
    assert (same.num_envs, same.seed, same.noise, same.randomize) == (3, 7, 0.5, ["air.drag"])
    assert not same.desynchronize
    assert configure_flights(trained, Conditions("flip")).task == FLIP
    strong = configure_flights(trained, Conditions("wall-backtrack", thrust_to_weight=3.0))
    assert strong.task.thrust_to_weight == 3.0
    assert WALL_BACKTRACK.thrust_to_weight == 2.5
    assert (same.setup, same.estimator) == (trained.setup, "sensors")
    assert configure_flights(trained, Conditions(estimator="kalman")).estimator == "kalman"
    assert configure_flights(replace(trained, estimator="kalman"), Conditions()).estimator == "kalman"


def test_the_command_passes_conditions_on(tiny_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`vpptwin evaluate` prints what was flown: no effects with `--randomize none`, names and groups otherwise."""
    command = ["evaluate", str(tiny_run), "--tracks", "2", "--seed", "3", "--noise", "0.5"]
    for given, expected in (("none", []), ("air.drag,servo.lag", ["air.drag", "servo.lag"])):
        flown = ["--randomize", given, "--thrust-to-weight", "2", "--estimator", "kalman", "--json", "-"]
        assert main([*command, *flown]) == 0
        result = json.loads(capsys.readouterr().out)
        assert sorted(result["randomized"]) == expected
        assert (result["noise"], result["seed"], result["thrust_to_weight"]) == (0.5, 3, 2.0)
        assert result["estimator"] == "kalman"


def test_a_sentence_says_how_it_flew(tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Flights, failures, errors, conditions; all figures go where `--json` says."""
    told = tmp_path / "all.json"
    assert main(["evaluate", str(tiny_run), "--tracks", "3", "--randomize", "none", "--json", str(told)]) == 0
    said = capsys.readouterr().out
    result = json.loads(told.read_text())
    assert said.startswith(f"3 flights of hover in twin nominal: {round(3 * result['fail_rate'])} failed")
    assert "sensor noise × 1; nothing drawn" in said
    flip = {**result, "tracks": 200, "fail_rate": 0.005, "upright_error_m": {"mean": 0.0074}, "task": "flip"}
    flip |= {"inverted_error_m": {"mean": None}, "full_turns": {"asked": 64, "made": 60}}
    assert describe(flip).splitlines()[0] == (
        "200 flights of flip in twin nominal: 1 failed, 7.4 mm upright, 60 of 64 full turns made"
    )


@pytest.mark.parametrize(
    ("conditions", "name", "found"),
    [
        (Conditions("flap", 4), "out.json", "unknown task 'flap'"),
        (Conditions(tracks=0), "out.json", "tracks=0"),
        (Conditions(tracks=4, twin="nowhere.yaml"), "out.json", "nowhere.yaml"),
        (Conditions(tracks=4, randomize=["air.drog"]), "out.json", "air.drog"),
        (Conditions(tracks=4, thrust_to_weight=0.9), "out.json", "thrust_to_weight=0.9"),
        (Conditions(tracks=4, estimator="luenberger"), "out.json", "unknown estimator 'luenberger'"),
        (Conditions(tracks=4), "/proc/out.json", "cannot write"),
    ],
)
def test_bad_evaluations(tiny_run: Path, tmp_path: Path, conditions: Conditions, name: str, found: str) -> None:
    """Refused in one line that names what is wrong; nothing is written."""
    with pytest.raises(InputError, match=found) as caught:
        run_evaluate(tiny_run, conditions, tmp_path / name)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_what_is_no_number_is_null_in_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`NaN` is no JSON: standard output and file hold null in its place, and every parser takes them."""

    def refuse(word: str) -> None:
        raise AssertionError(word)

    monkeypatch.setattr(
        "vpptwin.train.evaluate.evaluate.evaluate", lambda *given: {"lipschitz": float("nan"), "n": [1.0, float("inf")]}
    )
    monkeypatch.setattr("vpptwin.train.evaluate.evaluate.describe", str)
    for target in ("-", str(tmp_path / "out.json")):
        assert main(["evaluate", "flip", "--json", target]) == 0
    for text in (capsys.readouterr().out.partition("{'")[0], (tmp_path / "out.json").read_text()):
        assert json.loads(text, parse_constant=refuse) == {"lipschitz": None, "n": [1.0, None]}
