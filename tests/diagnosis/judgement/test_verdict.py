"""verdict.json as docs/diagnose.md lays it out, written whole or not at all."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.builders import AFTER, BEFORE, CAUSE, FORCE, VERDICT
from vpptwin.diagnosis.judgement.holdout import Score
from vpptwin.diagnosis.judgement.verdict import Cleared, Experiment, Rival, Unseen, Verdict
from vpptwin.system.files import write_json, write_whole


def write_and_read(verdict: Verdict, folder: Path) -> dict:
    """Through the file and back, refusing what JSON does not know."""
    write_json(verdict.as_dict(), folder / "verdict.json")

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads((folder / "verdict.json").read_text(), parse_constant=refuse)


def test_verdict_has_every_key(tmp_path: Path) -> None:
    """Every key where it belongs, with what was put in; the sentence stays out."""
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
    left = {"significant": False, "share": 0.01, "channel": None, "depends_on": [], "sigma": 0.0, "force": None}
    assert content["unexplained"] == left
    assert content["suggested_experiment"] is None
    assert content["warnings"] == ["late"]
    # What was cleared, what could not be seen, what changed and what to fly next, key by key.
    experiment = Experiment("x_steps", {"size": 0.5}, ["rail_x.coulomb", "rail_x.viscous"], 9.3, "vpptwin fly")
    full = replace(
        VERDICT,
        cleared=[Cleared("air.drag", "area", 0.0, 0.01, "m²")],
        unseen=[Unseen("air.ground_effect", "never below 0.6 m")],
        improvement={"position_rmse_m": [(-0.5, -0.3)] * 5},
        experiment=experiment,
        causes=[replace(CAUSE, gain_interval=(0.5, 0.7), also_explained_by=[Rival("rail_x.viscous", 0.1, 2.4)])],
    )
    content = write_and_read(full, tmp_path)
    assert content["cleared"] == [{"effect": "air.drag", "parameter": "area", "low": 0.0, "high": 0.01, "unit": "m²"}]
    assert content["unseen"] == [{"effect": "air.ground_effect", "reason": "never below 0.6 m"}]
    assert content["improvement"] == {"position_rmse_m": [[-0.5, -0.3]] * 5}
    assert content["suggested_experiment"] == "x_steps"
    assert content["experiment"] == {
        "manoeuvre": "x_steps",
        "parameters": {"size": 0.5},
        "separates": ["rail_x.coulomb", "rail_x.viscous"],
        "sigma": 9.3,
        "command": "vpptwin fly",
    }
    (cause,) = content["causes"]
    assert cause["gain_interval"] == [0.5, 0.7]
    assert cause["also_explained_by"] == [{"effect": "rail_x.viscous", "confidence": 0.1, "sigma": 2.4}]


def test_what_few_verdicts_have_is_written_only_there(tmp_path: Path) -> None:
    """Sizes of rivals, weak causes and errors with them; the repr has what is named."""
    rival = Rival("rail_x.viscous", 0.1, 2.4, {"damping": replace(FORCE, unit="N s/m")}, "viscous friction", "damping")
    weak = replace(CAUSE, effect="rail_z.coulomb", confidence=0.09, weak=True)
    full = replace(VERDICT, causes=[replace(CAUSE, also_explained_by=[rival]), weak], suggested=AFTER)
    content = write_and_read(full, tmp_path)
    assert content["suggested"] == content["after"]
    (first, second), told = content["causes"], {"value": 0.3081, "unit": "N s/m", "std": 0.0123, "nominal": 0.0}
    assert first["also_explained_by"] == [
        {"effect": "rail_x.viscous", "confidence": 0.1, "sigma": 2.4, "parameters": {"damping": told}}
    ]
    assert (second["weak"], "weak" in first) == (True, False)
    assert repr(full) == (
        "Verdict(rail_x.coulomb 90 %; 0.5 s ahead position_rmse_m 0.01 → 0.004, angle_rmse_rad 0.04 → 0.02)"
    )


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
        write_whole(path, "half of it, then \ud800")
    assert json.loads(path.read_text()) == {"old": True}
    assert [file.name for file in tmp_path.iterdir()] == ["verdict.json"]
