"""The shipped policies, trained in the twin alone, fly in the independent simulation with effects hidden in it.

Wanted: at least 97 % of 200 flights. The 200 are those of a fixed seed, behind the `slow` marker. Every other run flies
a few of a fresh seed, which pytest prints first, and allows so many misses that a policy which is just good enough has
more with a probability below 1 in 500: fewer runs than that fail by bad luck.
"""

from __future__ import annotations

import os
from math import comb

import numpy as np
import pytest

from proving.policy_flights import Outcome, Sky, load_flyer, measure, meets_angles

POLICIES = ("flip", "wall-backtrack")
WANTED, OF = 0.97, 200  # share of flights
FEW = 20  # flights of every run; 40 of flip among the slow ones
LUCK = 2e-3  # probability that a policy of just that share fails a run
SEED = 1  # of the 200


def allow(flights: int) -> int:
    """Least k such that more than k misses have a probability below `LUCK` where each flight is missed with 3 %.

    For 40 flights P(misses > 5) = 0.12 %; a policy that misses 10, 20 or 30 % fails with 21, 84 or 99 %. For 20, of
    which 4 may be missed, with 4, 37 or 76 %.
    """
    missed = 1.0 - WANTED
    left, k = 1.0, -1
    while left > LUCK:
        k += 1
        left -= comb(flights, k) * missed**k * WANTED ** (flights - k)
    return k


def fly(name: str, flights: int, seed: int) -> list[Outcome]:
    """Flights in the whole sky: effects, gusts, noise, dropouts, tolerances."""
    policy, task = load_flyer(name)
    assert task.name == name
    return measure(policy, task, Sky(), flights, seed)


def tell(outcomes: list[Outcome], seed: int) -> str:
    """Which flights missed, for a failure's message."""
    missed = [o for o in outcomes if not o.success]
    lines = [f"{o.number}: {'failed' if o.failed else f'{o.position_error:.3f} m'}, {o.effects}" for o in missed]
    return "\n".join([f"{len(missed)} of {len(outcomes)} flights of seed {seed} missed", *lines])


def test_misses_allowed_by_hand() -> None:
    """One flight is missed with 0.03 > 0.002, so a miss is allowed; of 200 that are wanted 6, by luck twice that."""
    assert allow(1) == 1
    assert allow(40) == 5
    assert round(OF * (1.0 - WANTED)) == 6
    assert 6 < allow(OF) < 15


@pytest.mark.parametrize(
    ("name", "flights"),
    [("flip", FEW), *(pytest.param(*each, marks=pytest.mark.slow) for each in (("flip", 40), ("wall-backtrack", FEW)))],
)
def test_policy_flies_in_reality(name: str, flights: int) -> None:
    """A few flights of a fresh seed."""
    seed = int(os.environ["VPPTWIN_SEED"])
    outcomes = fly(name, flights, seed)
    assert sum(not o.success for o in outcomes) <= allow(flights), tell(outcomes, seed)


def test_an_angle_taken_away_has_to_have_been_met() -> None:
    """Within reach at some tick while it was asked for, that of the trigger too; what is asked for last is free."""
    asked = np.array([0.0, 0.0, 1.5, 1.5, 1.5, 0.0, 0.0])
    near, late = np.array([0.1, 0.0, 0.5, 1.0, 1.2, 1.4, 0.8]), np.array([0.1, 0.0, 0.2, 0.5, 0.8, 1.1, 1.4])
    assert meets_angles(asked, near, 0.2)
    assert not meets_angles(asked, late, 0.2)
    assert not meets_angles(asked, near + 0.3, 0.2)


@pytest.mark.slow
@pytest.mark.parametrize("name", POLICIES)
def test_policy_flies_in_reality_97_of_100_times(name: str) -> None:
    """200 flights, at least 194 of which end within 5 cm and 0.2 rad of the target, and no limit exceeded."""
    outcomes = fly(name, OF, SEED)
    assert sum(o.success for o in outcomes) >= WANTED * OF, tell(outcomes, SEED)
