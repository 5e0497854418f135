"""Fresh flights in every run: something hidden in rotors, servos or sensors, or an alien; and nothing hidden.

The diagnosis has to find what is there, say nothing where there is nothing, and say "unexplained" where the catalogue
has no name for it. tests/test_hidden_mechanics.py has the rest, so that two workers share them.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from proving.drone import ALIEN, Wind, draw_effect
from proving.sessions import (
    ACTUATION,
    ALIENS,
    FAMILIES,
    STRONG,
    Session,
    Sessions,
    find_claims,
    find_faults,
    judge_rig,
    mark_undrawn,
)
from vpptwin.diagnosis.criteria import CRITERIA


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Sessions:
    """The sessions of this file."""
    draws = {name: lambda rng, name=name: draw_effect(rng, FAMILIES[name]) for name in ACTUATION}
    draws |= {"none": lambda rng: {}, ALIENS: lambda rng: draw_effect(rng, tuple(ALIEN), least=STRONG)}
    return Sessions(draws, tmp_path_factory.mktemp("sessions"), "tests/test_hidden_effects.py")


@pytest.mark.slow
@pytest.mark.parametrize("family", mark_undrawn(ACTUATION))
def test_a_single_hidden_effect_is_named(sessions: Sessions, family: str) -> None:
    """One effect of a family, of any sign: named first or in the first cause's group, with its size, and it helps."""
    sessions.require(family, find_faults)


def test_with_none_hidden_nothing_is_named(sessions: Sessions) -> None:
    """A rig within its tolerances gives no cause, and nothing is left unexplained, whatever the gusts are."""

    def find(session: Session) -> list[str]:
        verdict = session.verdict
        said = [cause.effect for cause in verdict.causes]
        return said + ["unexplained"] * verdict.unexplained.significant + ["gap"] * verdict.gap

    sessions.require("none", find, tries=1)


@pytest.mark.slow
def test_a_storm_of_steps_is_no_effect(tmp_path: Path) -> None:
    """Gusts of 2.6 % of weight that jump, as in session 2 of seed 8100, double the error: no gap all the same."""
    wind = Wind("steps", 2.6218, 0.63752, (1.0758, 0.57882, 0.83992))
    verdict = judge_rig({}, 1519349823, wind, tmp_path)
    assert verdict.after.chi2 > 2.0
    assert not verdict.causes
    assert not verdict.unexplained.significant
    assert not verdict.gap


@pytest.mark.slow
def test_rotor_blades_that_chip_leave_something_unexplained(tmp_path: Path) -> None:
    """Thrust that rotor 1 loses at 10 s, as in session 2 of seed 8101, acts like no gust: it follows something."""
    chip = {"alien.chip": {"loss": 0.12945, "time": 10.369}}
    wind = Wind("steps", 0.45914, 0.40001, (0.55027, 1.1548, 1.0832))
    verdict = judge_rig(chip, 360012027, wind, tmp_path)
    assert verdict.unexplained.significant
    assert verdict.unexplained.depends_on
    assert all(cause.confidence <= CRITERIA.suggested for cause in verdict.causes)


@pytest.mark.parametrize("family", mark_undrawn((ALIENS,)))
def test_an_alien_is_unexplained(sessions: Sessions, family: str) -> None:
    """An effect that the catalogue lacks leaves something unexplained, and nothing is blamed for it with confidence."""

    def find(session: Session) -> list[str]:
        return find_claims(session) + ["nothing is unexplained"] * (not session.verdict.unexplained.significant)

    sessions.require(family, find)
