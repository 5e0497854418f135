"""verdict.json as SPEC 7 lays it out, written whole or not at all, and the sentences made of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from vpptwin.diagnosis.holdout import HORIZONS_S, Score
from vpptwin.diagnosis.summary import (
    describe_cause,
    describe_leftover,
    describe_rivals,
    format_value,
    headline,
    tabulate_errors,
)
from vpptwin.diagnosis.verdict import Cause, Estimate, Rival, Unexplained, Verdict, write_json, write_text

FORCE = Estimate(0.3081, "N", 0.0123, 0.0)
CAUSE = Cause(
    "rail_x.coulomb",
    0.9,
    {"force": FORCE},
    0.62,
    [Rival("rail_x.viscous", 0.06), Rival("air.drag", 0.04)],
    "dry friction on the horizontal rail",
)
BEFORE = Score([0.001, 0.002, 0.005, 0.01, 0.02], [0.01, 0.02, 0.03, 0.04, 0.05], {"θ rate": [1, 2, 3, 4, 5.0]}, 9.0)
AFTER = Score([0.001, 0.001, 0.002, 0.004, 0.0049], [0.01, 0.01, 0.01, 0.02, 0.02], {"θ rate": [1, 1, 1, 1, 2.0]}, 1.1)
NOTHING = Unexplained(False, 0.01, None, [])
VERDICT = Verdict(["a.mcap", "b.mcap"], "nominal", 80, 40, BEFORE, AFTER, True, [CAUSE], NOTHING, warnings=["late"])


def write_and_read(verdict: Verdict, folder: Path) -> dict:
    """Through the file and back, refusing what JSON does not know."""
    write_json(verdict.as_dict(), folder / "verdict.json")

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads((folder / "verdict.json").read_text(), parse_constant=refuse)


def test_verdict_has_the_keys_of_the_specification(tmp_path: Path) -> None:
    """Every key of SPEC 7 where it belongs, with what was put in; the sentence stays out."""
    content = write_and_read(VERDICT, tmp_path)
    assert content["logs"] == ["a.mcap", "b.mcap"]
    assert content["twin"] == "nominal"
    assert content["samples"] == {"windows": 80, "held_out_windows": 40}
    assert content["horizons_s"] == [0.05, 0.1, 0.25, 0.5, 1.0]
    for name, score in (("before", BEFORE), ("after", AFTER)):
        assert content[name]["position_rmse_m"] == score.position_rmse_m
        assert content[name]["angle_rmse_rad"] == score.angle_rmse_rad
        assert content[name]["chi2"] == score.chi2
    assert content["gap"] is True
    (cause,) = content["causes"]
    assert cause == {
        "effect": "rail_x.coulomb",
        "confidence": 0.9,
        "parameters": {"force": {"value": 0.3081, "unit": "N", "std": 0.0123, "nominal": 0.0}},
        "gain": 0.62,
        "gain_interval": None,
        "also_explained_by": [
            {"effect": "rail_x.viscous", "confidence": 0.06, "sigma": 0.0},
            {"effect": "air.drag", "confidence": 0.04, "sigma": 0.0},
        ],
    }
    left = {"significant": False, "share": 0.01, "channel": None, "depends_on": [], "sigma": 0.0}
    assert content["unexplained"] == left
    assert content["suggested_experiment"] is None
    assert content["warnings"] == ["late"]


def test_what_is_not_finite_becomes_null(tmp_path: Path) -> None:
    """NaN and infinity, however deep, are null; a rig without slides has null positions; the rest stays."""
    nan, inf = float("nan"), float("inf")
    score = Score(None, [nan, 0.02, inf, -inf, 0.05], {"swing rate": [nan] * 5}, nan)
    cause = replace(CAUSE, parameters={"force": replace(FORCE, std=inf)})
    content = write_and_read(replace(VERDICT, before=score, causes=[cause]), tmp_path)
    assert content["before"]["position_rmse_m"] is None
    assert content["before"]["angle_rmse_rad"] == [None, 0.02, None, None, 0.05]
    assert content["before"]["velocity_rmse"] == {"swing rate": [None] * 5}
    assert content["before"]["chi2"] is None
    assert content["causes"][0]["parameters"]["force"] == {"value": 0.3081, "unit": "N", "std": None, "nominal": 0.0}


def test_a_verdict_that_fails_leaves_the_old_one(tmp_path: Path) -> None:
    """What cannot be serialised, or not be encoded, leaves the old file as it was and nothing beside it."""
    path = tmp_path / "verdict.json"
    write_json({"old": True}, path)
    with pytest.raises(TypeError):
        write_json({"new": object()}, path)
    with pytest.raises(UnicodeEncodeError):
        write_text("half of it, then \ud800", path)
    assert json.loads(path.read_text()) == {"old": True}
    assert [file.name for file in tmp_path.iterdir()] == ["verdict.json"]


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.3081, 0.0123, "0.308 ± 0.012 N"),  # a leading 1 keeps two digits of the deviation
        (0.3081, 0.0423, "0.31 ± 0.04 N"),
        (-0.3081, 0.0073, "-0.308 ± 0.007 N"),
        (12.34, 3.2, "12 ± 3 N"),
        (1234.5, 250.0, "1234 ± 250 N"),
        (0.0123, 0.00096, "0.0123 ± 0.0010 N"),  # 0.00096 rounds to 0.001
        (0.123456, 0.0, "0.1235 N"),
        (0.123456, float("nan"), "0.1235 N"),
        (0.123456, float("inf"), "0.1235 N"),
    ],
)
def test_values_have_the_digits_that_mean_something(value: float, std: float, text: str) -> None:
    """Rounded to the deviation's first digit; without a deviation four digits."""
    assert format_value(Estimate(value, "N", std, 0.0)) == text


def test_values_without_unit() -> None:
    """A factor has none."""
    assert format_value(Estimate(0.95, "", 0.02, 1.0)) == "0.95 ± 0.02"


def test_the_sentence_names_cause_size_and_share() -> None:
    """In words, with the id and the size; a parameter whose off value is not zero says what the twin had."""
    sentence = describe_cause(CAUSE)
    assert sentence.startswith("Dry friction on the horizontal rail ")
    for part in ("rail_x.coulomb", "force 0.308 ± 0.012 N", "explains 62 % of the error."):
        assert part in sentence
    gain = Cause("rotor.thrust_gain", 0.9, {"gain": Estimate(0.95, "", 0.02, 1.0)}, 0.3, [], "thrust off by a factor")
    assert "gain 0.95 ± 0.02" in describe_cause(gain)
    assert "the twin has 1," in describe_cause(gain)
    assert headline(VERDICT) == sentence


def test_without_a_cause_the_headline_tells_two_cases_apart() -> None:
    """Nothing wrong, or wrong in a way that no effect explains."""
    fine = replace(VERDICT, causes=[], gap=False)
    odd = replace(VERDICT, causes=[], unexplained=Unexplained(True, 1.0, "x", ["rail_x position"]))
    assert "nothing is accused" in headline(fine)
    assert "no known effect explains" in headline(odd)
    assert "nothing is accused" not in headline(odd)


def test_rivals_and_leftover_in_words() -> None:
    """Rivals with their probabilities, what is left with its channel and what it follows."""
    assert describe_rivals(CAUSE).startswith("rail_x.coulomb: 90.0 % sure; ")
    assert describe_rivals(CAUSE).endswith("rail_x.viscous (6 %), air.drag (4 %)")
    assert "no other effect" in describe_rivals(replace(CAUSE, also_explained_by=[]))
    assert describe_leftover(VERDICT).startswith("Nothing")
    left = describe_leftover(replace(VERDICT, unexplained=Unexplained(True, 0.24, "x", ["rail_x position"])))
    for part in ("24 %", " x", "follows rail_x position"):
        assert part in left


def test_tables_are_in_millimetres_and_milliradians() -> None:
    """Three digits; no second column without a second score; no table of positions on a rig without slides."""
    position, angle, rate = tabulate_errors(BEFORE, AFTER)
    assert position.title == "position error [mm]"
    assert position.rows[-1] == ("1 s", "20", "4.9")
    assert angle.rows[0] == ("0.05 s", "10", "10")
    assert rate.rows[2] == ("0.25 s", "3", "1")
    assert len(position.rows) == len(HORIZONS_S)
    (only, *_) = tabulate_errors(replace(BEFORE, position_rmse_m=None), None)
    assert only.title == "angle error [mrad]"
    assert only.rows[4] == ("1 s", "50", "")
