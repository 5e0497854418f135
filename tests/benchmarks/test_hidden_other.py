"""The benchmark of other rigs counts right: rates worked by hand, results that are taken up again, crashes told."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from proving.mechanisms import draw_session
from proving.runner import mechanisms, other, scores
from proving.runner.case import Case, Finding, Named
from vpptwin.logs.flight import Flight
from vpptwin.twin import TwinSpec


def plan(number: int, kind: str, *effects: str, separable: bool = True, **more: Any) -> Any:  # noqa: ANN401
    """A made-up session: every effect of size 1, of which the rig has 1.1."""
    values = {effect: {"size": 1.0} for effect in effects}
    true = {effect: {"size": 1.1} for effect in effects}
    seen = dict.fromkeys(effects, 16.0)
    return mechanisms.MechanismPlan(number, kind, "carriage", values, true=true, seen=seen, separable=separable, **more)


def found(*causes: tuple, left: bool = False, gap: bool | None = None) -> Any:  # noqa: ANN401
    """A made-up verdict: causes as (effect, confidence, rivals)."""
    size = {"size": {"value": 1.0, "std": 0.07, "nominal": 0.0}}
    named = [Named(effect, confidence, 0.9, size, dict(rivals)) for effect, confidence, rivals in causes]
    return Finding(named, left, "", (9.0, 1.0), [], "", 5.0, bool(causes) or left if gap is None else gap, 800.0)


def table(cases: list) -> dict[str, str]:
    """Measure → result."""
    return {row.name: row.text for row in other.summarise(cases)}


def make_cases() -> list:
    """Ten sessions, one of each fate."""
    return [
        Case(plan(0, "single", "s.coulomb"), found(("s.coulomb", 0.99, {}))),
        Case(plan(1, "single", "s.coulomb"), found(("s.viscous", 0.95, {"s.coulomb": 2.0}))),
        Case(plan(2, "single", "s.bias"), found(("s.spring", 0.95, {}))),
        Case(plan(3, "single", "m.gain", separable=False, alike=["s.inertia"]), found(("s.inertia", 0.95, {}))),
        Case(plan(4, "two", "s.bias", "s.viscous"), found(("s.bias", 0.97, {}), ("s.viscous", 0.8, {}))),
        Case(plan(5, "none"), found()),
        Case(plan(6, "none", small={"s.coulomb": {"force": 0.1}}), found(("s.coulomb", 0.95, {}))),
        Case(plan(7, "alien", "outside:ripple"), found(("s.coulomb", 0.6, {}))),
        Case(plan(8, "alien", "outside:drag"), found(("s.viscous", 0.97, {}), gap=True)),
        Case(plan(9, "single", "s.bias"), None, error="ValueError: no"),
    ]


def test_rates_are_as_counted_by_hand() -> None:
    """Look-alikes and small deviations are no errors, silence and flags are what they say, crashes count as misses."""
    rows = table(make_cases())
    assert rows["one effect, identifiable: named first"] == "25.0 % (1 of 4)"
    assert rows["one effect, identifiable: named or in the group"] == "50.0 % (2 of 4)"
    assert rows["one effect: named first"] == "20.0 % (1 of 5)"
    assert rows["two effects, identifiable: both named"] == "100.0 % (1 of 1)"
    assert rows["confidently wrong"] == "12.5 % (1 of 8)"
    assert rows["nothing hidden: silent"] == "100.0 % (2 of 2)"
    assert rows["outside the catalogue: flagged"] == "50.0 % (1 of 2)"
    assert rows["outside the catalogue: misnamed with confidence"] == "50.0 % (1 of 2)"
    # Fitted 1.0 where the rig has 1.1: 1.645 x 0.07 = 0.115 holds it.
    assert rows["strength of named effects: inside the 90 % interval"] == "100.0 % (3 of 3)"
    assert rows["diagnosis failed"] == "10.0 % (1 of 10)"
    assert rows["memory of a diagnosis"] == "800 MB at most"
    # It counts nowhere.
    lost = Case(mechanisms.MechanismPlan(10, "unrecorded"), None, error="not recorded")
    rows = table([*make_cases(), lost])
    assert rows["diagnosis failed"] == "10.0 % (1 of 10)"
    assert rows["confidently wrong"] == "11.1 % (1 of 9)"
    # Scores and groups of the drone's sessions are those of these: detection of 5 of 8 with something hidden.
    rows = {row.name: row.text for row in scores.score(make_cases())}
    assert rows["detection rate: something hidden, something named or unexplained"] == "75.0 % (6 of 8)"
    assert "| carriage | 10 |" in scores.format_groups(make_cases(), "family", "rig")
    # A results file gives the same cases back, plans of other rigs among them.
    cases = make_cases()
    written = json.loads(json.dumps([case.as_dict() for case in cases]))
    assert [Case.from_dict(content) for content in written] == cases


def test_a_crash_is_a_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A diagnosis that raises gives a case with what was hidden, the exception and where it came from."""

    def fail(*_: object) -> None:
        raise ValueError("no such thing")

    monkeypatch.setattr(other, "diagnose", fail)
    number = next(n for n in range(99) if draw_session(5, n).family == "pendulum" and draw_session(5, n).hidden)
    case = other.run_session("other", 5, number, tmp_path)
    assert case.found is None
    assert case.error.startswith("ValueError: no such thing (test_hidden_other.py:")
    assert set(case.plan.hidden) == {h.effect for h in draw_session(5, number).hidden}
    assert case.plan.disturbance
    json.dumps(asdict(replace(case, commit="abc")))


def test_a_diagnosis_that_takes_too_much_is_stopped() -> None:
    """Time and memory without end become exceptions, and the next one starts afresh."""
    with pytest.raises(TimeoutError, match="more than 1 s"), other.limited(seconds=1):
        time.sleep(5.0)
    with pytest.raises(MemoryError), other.limited():
        np.empty(2**34)
    with other.limited():
        assert len(np.ones(2**20)) == 2**20


def test_sessions_are_chosen_by_kind_number_and_shard() -> None:
    """The same sessions whichever way they are asked for."""
    choose = partial(other.choose_sessions, "other")
    first = choose(5, 10, [], None, "1/1")
    assert [s.number for s in first] == list(range(10))
    assert choose(5, 10, [], "3,7", "1/1") == [first[3], first[7]]
    assert choose(5, 10, [], None, "2/3") == first[1::3]
    assert {s.kind for s in choose(5, 4, ["alien"], None, "1/1")} == {"alien"}


@pytest.mark.parametrize(
    "rigs", [pytest.param("quadrotor", marks=pytest.mark.slow), "servo", pytest.param("leg", marks=pytest.mark.slow)]
)
def test_quadrotors_servos_and_legs_are_sessions_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rigs: str
) -> None:
    """Drawn from a seed, always the same, most of them with an effect that the twin can have; counted as any other."""
    drawn = other.choose_sessions(rigs, 5, 60, [], None, "1/1")
    hidden = [effect for session in drawn for effect in session.hidden]
    assert 40 <= len(hidden) <= 58
    assert len(set(hidden)) >= 8
    assert [s.hidden for s in other.choose_sessions(rigs, 5, 60, [], "3,7", "1/1")] == [
        drawn[3].hidden,
        drawn[7].hidden,
    ]

    def fail(spec: TwinSpec, flights: list[Flight]) -> None:
        known = {effect.id for effect in spec.catalogue}
        raise ValueError(f"{len(flights)} logs of {flights[0].duration:.0f} s, {set(hidden) - known}")

    monkeypatch.setattr(other, "diagnose", fail)
    case = other.run_session(rigs, 5, 3, tmp_path)
    told = "3 logs of 12 s" if rigs == "quadrotor" else "2 logs of 16 s"
    assert case.error.startswith(f"ValueError: {told}, set() (")
    assert case.plan.kind == drawn[3].kind
    assert json.loads(json.dumps(asdict(case)))["plan"]["hidden"] == drawn[3].hidden
