"""Fresh flights in every run with something hidden in rotors, servos or sensors, with nothing hidden, with an alien.

The diagnosis has to find what is there, say nothing where there is nothing, and say "unexplained" where the catalogue
has no name for it. tests/test_hidden_mechanics.py has the rest.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.reality import ALIEN, draw_effect
from tests.sessions import (
    FAMILIES,
    STRONG,
    Effects,
    Flown,
    diagnose_session,
    find_claims,
    find_faults,
    fly_sessions,
    read_seed,
)

SINGLES = ("rotors", "servo and timing", "sensors")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Flown]:
    """The sessions of this file."""
    seed = read_seed()
    rng = np.random.default_rng([seed, 1])
    hidden: dict[str, Effects] = {name: draw_effect(rng, FAMILIES[name], least=STRONG) for name in SINGLES}
    hidden |= {"none": {}, "alien": draw_effect(rng, tuple(ALIEN), least=STRONG)}
    return fly_sessions(hidden, seed, tmp_path_factory.mktemp("sessions"), "tests/test_hidden_effects.py")


@pytest.mark.parametrize("family", SINGLES)
def test_a_single_hidden_effect_is_named(flown: dict[str, Flown], family: str) -> None:
    """One effect of a family, of any sign: named first or in the first cause's group, with its size, and it helps."""
    session = diagnose_session(flown[family])
    faults = find_faults(session)
    assert not faults, "\n".join([*faults, session.story])


def test_with_none_hidden_nothing_is_named(flown: dict[str, Flown]) -> None:
    """A rig within its tolerances gives no cause, no gap, nothing unexplained."""
    session = diagnose_session(flown["none"])
    assert session.verdict.causes == [], session.story
    assert session.verdict.gap is False, session.story
    assert session.verdict.unexplained.significant is False, session.story


def test_an_alien_is_unexplained(flown: dict[str, Flown]) -> None:
    """An effect that the catalogue lacks leaves something unexplained, and nothing is blamed for it with confidence."""
    session = diagnose_session(flown["alien"])
    assert session.verdict.unexplained.significant, session.story
    assert not find_claims(session), session.story
