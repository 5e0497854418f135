"""Suspects in order, and what became of each."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.diagnosis.made_up import LEFT, make_diagnosis
from vpptwin.diagnosis.judgement.verdict import Cleared
from vpptwin.report.html.ranking import describe_cleared, rank_suspects


def test_suspects_are_ranked_with_their_fates() -> None:
    """Strongest first, whatever order they come in; drops below zero count as none; what nobody tried comes last.

    What is not identifiable has no bar, whatever it would explain alone.
    """
    verdict = replace(make_diagnosis().verdict, unexplained=LEFT)
    ranking = [("airframe.mass", -1.0), ("rail_x.coulomb", 50.0), ("rail_x.viscous", 20.0), ("rotor.drag", 5.0)]
    suspects = rank_suspects(ranking, verdict, {"rotor.drag": "a wrong drag torque"})
    first = {s.effect: (s.share, s.fate, s.told) for s in suspects if s.fate in ("named", "rival")}
    assert first == {
        "rail_x.coulomb": (1.0, "named", "named"),
        "rail_x.viscous": (0.4, "rival", "rival of a named cause"),
        "gyro.bias": (0.0, "named", "named"),
    }
    rest = {s.effect: s for s in suspects[2:]}
    drag = rest["rotor.drag"]
    assert (drag.meaning, drag.share, drag.told) == (
        "a wrong drag torque", 0.0, "not identifiable: no rotor speeds in the logs",
    )  # fmt: skip
    assert rest["airframe.mass"].fate == "cleared"
    assert rest["airframe.mass"].drop == 0.0
    assert rest["battery.sag"].fate == "unseen"


@pytest.mark.parametrize(
    ("suspect", "told"),
    [
        (Cleared("rail_z.bias", "force", -0.02, 0.01, "N"), "ruled out: between -0.02 and 0.01 N"),
        # A bare number would not say of what.
        (Cleared("rotor.thrust_gain", "gain", 0.987, 1.012, ""), "ruled out: gain between 0.987 and 1.012"),
        # Small times are in milliseconds; two digits of the width are kept.
        (Cleared("command.delay", "delay", 0.0, 0.0012, "s"), "ruled out: between 0 and 1.2 ms"),
        # What a servo could have done beyond what was asked of it, nobody knows.
        (Cleared("servo.rate_limit", "rate", 8.4, 1000.0, "rad/s"), "ruled out: above 8.4 rad/s"),
    ],
)
def test_bounds_of_what_is_cleared(suspect: Cleared, told: str) -> None:
    """In readable units, limits without their upper bound."""
    assert describe_cleared(suspect) == told
