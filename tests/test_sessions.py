"""The rule by which sessions with something hidden pass or fail."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests import sessions
from tests.sessions import Effects, Sessions


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> list[Effects]:
    """What was hidden in every session that was flown; nothing flies or is diagnosed."""
    seen: list[Effects] = []

    def fly(hidden: dict[str, Effects], *_: object) -> dict[str, Effects]:
        seen.extend(hidden.values())
        return hidden

    monkeypatch.setattr(sessions, "fly_sessions", fly)
    monkeypatch.setattr(sessions, "diagnose_session", lambda hidden: SimpleNamespace(hidden=hidden, story=f"{hidden}"))
    return seen


def draw(rng: np.random.Generator) -> Effects:
    """Something different every time."""
    return {"rail_x.coulomb": {"force": float(rng.random())}}


def test_a_missed_session_is_drawn_once_more(flown: list[Effects], tmp_path: Path) -> None:
    """The second has something else hidden, and decides."""
    Sessions({"rail": draw, "craft": draw}, tmp_path, "test").require(
        "rail", lambda session: ["missed"] * (session.hidden == flown[0])
    )
    assert len(flown) == 3
    assert flown[2] != flown[0]


def test_two_in_a_row_fail(flown: list[Effects], tmp_path: Path) -> None:
    """With both stories; where one try is allowed, with the first."""
    campaign = Sessions({"rail": draw}, tmp_path, "test")
    with pytest.raises(pytest.fail.Exception) as failure:
        campaign.require("rail", lambda session: ["missed"])
    assert all(str(hidden) in str(failure.value) for hidden in flown)
    with pytest.raises(pytest.fail.Exception):
        campaign.require("rail", lambda session: ["missed"], tries=1)
    assert len(flown) == 2
