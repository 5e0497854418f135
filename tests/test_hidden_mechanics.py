"""Fresh flights in every run with something hidden in rails, pivot or craft, and with two things hidden at once.

The diagnosis has to find what is there. tests/test_hidden_effects.py has the rest, so that two workers share them.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.reality import draw_effect, draw_together
from tests.sessions import (
    FAMILIES,
    STRONG,
    Effects,
    Flown,
    diagnose_session,
    find_faults,
    fly_sessions,
    read_seed,
)

SINGLES = ("rail", "guide and pivot", "craft")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Flown]:
    """The sessions of this file."""
    seed = read_seed()
    rng = np.random.default_rng([seed, 2])
    hidden: dict[str, Effects] = {name: draw_effect(rng, FAMILIES[name], least=STRONG) for name in SINGLES}
    every = [effect for family in FAMILIES.values() for effect in family]
    hidden["two"] = draw_together(rng, 2, every, least=STRONG)
    return fly_sessions(hidden, seed, tmp_path_factory.mktemp("sessions"), "tests/test_hidden_mechanics.py")


@pytest.mark.parametrize("family", SINGLES)
def test_a_single_hidden_effect_is_named(flown: dict[str, Flown], family: str) -> None:
    """One effect of a family, of any sign: named first or in the first cause's group, with its size, and it helps."""
    session = diagnose_session(flown[family])
    faults = find_faults(session)
    assert not faults, "\n".join([*faults, session.story])


def test_two_hidden_effects_are_both_named(flown: dict[str, Flown]) -> None:
    """Two effects at once that are no look-alikes: both named or in a group, the first named is one of them."""
    session = diagnose_session(flown["two"])
    faults = find_faults(session)
    assert not faults, "\n".join([*faults, session.story])
