"""The rule by which sessions with something hidden pass or fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proving import sessions
from proving.drone import Wind
from proving.sessions import Effects, Flown, Session, Sessions, find_faults, measure_gust_mean
from tests.builders import VERDICT
from vpptwin.diagnosis.judgement.verdict import Cause, Estimate


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> list[Effects]:
    """What was hidden in every session that was flown; nothing flies or is diagnosed."""
    seen: list[Effects] = []

    def fly(name: str, hidden: Effects, *_: object) -> Effects:
        seen.append(hidden)
        return hidden

    monkeypatch.setattr(sessions, "fly_session", fly)
    monkeypatch.setattr(sessions, "diagnose_session", lambda hidden: make_session(hidden, {}))
    return seen


def draw(rng: np.random.Generator) -> Effects:
    """Something different every time."""
    return {"rail_x.coulomb": {"force": float(rng.random())}}


def test_a_missed_session_is_drawn_once_more(flown: list[Effects], tmp_path: Path) -> None:
    """The second has something else hidden, and decides."""
    campaign = Sessions({"rail": draw, "craft": draw}, tmp_path, "test")
    campaign.require("rail", lambda session: ["missed"] * (session.hidden == flown[0]))
    assert len(flown) == 2
    assert flown[1] != flown[0]
    campaign.require("craft", lambda session: ["missed"] * (session.hidden in flown[:2]))
    assert len(flown) == 3


def test_two_in_a_row_fail(flown: list[Effects], tmp_path: Path) -> None:
    """With both stories; where one try is allowed, with the first."""
    campaign = Sessions({"rail": draw, "craft": draw}, tmp_path, "test")
    with pytest.raises(pytest.fail.Exception) as failure:
        campaign.require("rail", lambda session: ["missed"])
    assert all(str(hidden) in str(failure.value) for hidden in flown)
    with pytest.raises(pytest.fail.Exception):
        campaign.require("craft", lambda session: ["missed"], tries=1)
    assert len(flown) == 3


def make_session(hidden: Effects, small: Effects, *causes: Cause) -> Session:
    """A session with that verdict."""
    verdict = replace(VERDICT, causes=list(causes), after=VERDICT.before)
    return Session(Flown(hidden, small, Wind(), 3, [], ""), verdict, f"{hidden}")


def test_small_deviations_are_no_faults() -> None:
    """One named first does not stand before what is hidden, and is no claim; without it there it is."""
    hidden, small = {"mocap.delay": {"delay": 0.01}}, {"rail.tilt": {"angle": 0.01}}
    causes = [
        Cause(effect, 0.99, {name: Estimate(0.01, "", 0.001, 0.0)}, 0.5, [], "")
        for effect, name in (("rail.tilt", "angle"), ("mocap.delay", "delay"))
    ]
    assert find_faults(make_session(hidden, small, *causes)) == []
    faults = find_faults(make_session(hidden, {}, *causes))
    assert faults == ["rail.tilt is named with confidence 0.99", "rail.tilt is named first"]


def test_gusts_may_look_like_a_force() -> None:
    """1 % of 4.41 N over 0.3 s: 14 % of it on average over 32 s, four times 6 mN; longer and stronger ones more."""
    assert measure_gust_mean("rail_x.bias", Wind()) == pytest.approx(0.0242, rel=0.01)
    assert measure_gust_mean("rotor.asymmetry", Wind()) == pytest.approx(0.0049, rel=0.02)
    assert measure_gust_mean("rail_z.bias", Wind("steps", 2.0, 1.2, (1.0, 0.5, 1.0))) == pytest.approx(0.0483, rel=0.01)
    assert measure_gust_mean("command.delay", Wind()) == 0.0
