"""Fresh flights in every run with something hidden in rails, pivot or craft, and with two things hidden at once.

The diagnosis has to find what is there. tests/test_hidden_effects.py has the rest.
"""

from __future__ import annotations

import pytest

from tests.reality import draw_effect, draw_together
from tests.sessions import FAMILIES, STRONG, Sessions, find_faults, mark_undrawn

SINGLES = ("rail", "guide and pivot", "craft")


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Sessions:
    """The sessions of this file."""
    every = [effect for family in FAMILIES.values() for effect in family]
    draws = {name: lambda rng, name=name: draw_effect(rng, FAMILIES[name], least=STRONG) for name in SINGLES}
    draws["two"] = lambda rng: draw_together(rng, 2, every, least=STRONG)
    return Sessions(draws, tmp_path_factory.mktemp("sessions"), "tests/test_hidden_mechanics.py")


@pytest.mark.parametrize("family", mark_undrawn(SINGLES, 1))
def test_a_single_hidden_effect_is_named(sessions: Sessions, family: str) -> None:
    """One effect of a family, of any sign: named first or in the first cause's group, with its size, and it helps."""
    sessions.require(family, find_faults)


def test_two_hidden_effects_are_both_named(sessions: Sessions) -> None:
    """Two effects at once that are no look-alikes: both named or in a group, the first named is one of them."""
    sessions.require("two", find_faults)
