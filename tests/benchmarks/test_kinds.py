"""The scorer of kinds of logs: what a verdict is worth beside the truth of a case."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import kinds
import pytest

from proving.kinds import Kind

CASE = Kind(
    Path("rig.xml"), None, [], {"hinge.coulomb.torque": 0.3, "hinge.viscous.damping": 0.1},
    frozenset({"hinge.coulomb", "hinge.stiction", "hinge.viscous"}), frozenset({"hinge.cogging"}), 0.5, "rad",
)  # fmt: skip
ERRORS = {"position_rmse_m": None, "angle_rmse_rad": [0.1, 0.2, 0.4]}


def make_verdict(
    *causes: tuple[str, float, dict[str, float]], value: float = 0.3, left: bool = False
) -> dict[str, Any]:
    """A verdict with these causes: id, confidence, rivals."""
    told = [
        {"effect": effect, "confidence": sure, "parameters": {"torque": {"value": value, "std": 0.01}},
         "also_explained_by": [{"effect": rival, "confidence": share} for rival, share in rivals.items()]}
        for effect, sure, rivals in causes
    ]  # fmt: skip
    after = ERRORS | {"angle_rmse_rad": [0.01, 0.02, 0.04]}
    return {"causes": told, "horizons_s": [0.1, 0.6, 1.0], "before": ERRORS, "after": after, "stopped": None,
            "unexplained": {"significant": left}, "misfit": None}  # fmt: skip


@pytest.mark.parametrize(
    ("causes", "first", "kind", "sure", "every", "wrong"),
    [
        ([], False, False, False, False, False),
        ([("hinge.coulomb", 0.9, {})], True, True, True, False, False),
        ([("hinge.stiction", 0.4, {"hinge.coulomb": 0.35})], False, True, True, False, False),
        ([("hinge.mass", 0.7, {"hinge.viscous": 0.2})], False, True, False, False, True),
        ([("hinge.cogging", 0.9, {}), ("hinge.coulomb", 0.3, {"hinge.viscous": 0.3})],
         False, False, False, True, False),
    ],
)  # fmt: skip
def test_a_verdict_is_scored(causes: list, first: bool, kind: bool, sure: bool, every: bool, wrong: bool) -> None:
    """By its first cause, its groups, the confidence of the right kind, and what is claimed and not there."""
    found = kinds.score(CASE, make_verdict(*causes))
    assert [found[mark] for mark in ("first", "kind", "sure", "all", "wrong")] == [first, kind, sure, every, wrong]
    assert found["error"] == (0.2, 0.02)
    assert found["silent"] is None


def test_an_interval_must_hold_the_truth() -> None:
    """1.645 standard deviations to either side."""
    for value, held in ((0.315, True), (0.32, False)):
        found = kinds.score(CASE, make_verdict(("hinge.coulomb", 0.9, {}), value=value))
        assert found["holds"] == {"hinge.coulomb.torque": held}


def test_where_nothing_is_wrong_silence_is_right() -> None:
    """Nothing named and nothing said to be left."""
    empty = Kind(Path("rig.xml"), None, [], {}, frozenset(), frozenset(), 0.5, "rad")
    assert kinds.score(empty, make_verdict())["silent"]
    assert not kinds.score(empty, make_verdict(left=True))["silent"]
    assert not kinds.score(empty, make_verdict(("hinge.mass", 0.2, {})))["silent"]


def test_the_table_counts_failures() -> None:
    """A diagnosis that failed has named nothing."""
    about = {
        "case": "decay_0",
        "kind_of_log": "decay",
        "truth": CASE.truth,
        "horizon_s": 0.5,
        "unit": "rad",
        "seconds": 3,
    }
    good = about | kinds.score(CASE, make_verdict(("hinge.coulomb", 0.9, {})))
    cases = [good, about | {"failed": "no verdict"}]
    assert "| decay | 2 | 1/2 | 1/2 | 1/2 | 0/2 | 0/1 | 1/1 | 10 % | - | 1 | 3 |" in kinds.format_table(cases)
    assert "FAILED no verdict" in kinds.tell_case(cases[1])


def test_a_refusal_with_the_right_scale_is_right() -> None:
    """Current in place of torque is refused with the factor, which is all that its owner needs."""
    case = Kind(Path("rig.xml"), None, [], {"m.gain.gain": 5.5}, frozenset({"m.gain"}), frozenset(), 0.5, "rad")
    about = {"case": "current_0", "truth": case.truth, "horizon_s": 0.5, "unit": "rad", "seconds": 3.0}
    found = kinds.score_refusal(case, "give `scale: 5.497` for m in the twin's signals")
    assert found is not None
    assert found["sure"]
    assert "refused with the right scales" in kinds.tell_case(about | found)
    assert kinds.score_refusal(case, "give `scale: 3.1` for m in the twin's signals") is None
    assert kinds.score_refusal(CASE, "no such file") is None
