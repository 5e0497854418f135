"""What is hidden in which session: a fixed sequence per seed, so that a run can stop, go on, grow or be shared out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from tests.reality import ALIEN, CORE, EXTENDED, draw_effect, draw_together, measure_strength

Effects = dict[str, dict[str, float]]
FLYING = (*CORE, *EXTENDED)
"""Effects of the catalogue that are drawn; asymmetry of friction needs friction first and is not."""
DECK = ("single",) * 9 + ("two",) * 4 + ("three",) + ("alien",) * 2 + ("none",) * 4
"""Kinds of twenty sessions in a row, in a new order each time."""
FAINT_SHARE, FAINTEST = 0.2, 0.4
"""Share of single effects that are fainter than tests hide them, and their least strength: the diagnosis's standard
deviation from 32 s is about a tenth of strength 1, so these are 4 to 10 sigma."""
OUTLIER_SHARE = 0.25
"""Share of sessions in which 0.5 % of the motion capture's frames are far off."""


@dataclass(frozen=True)
class Plan:
    """One session to fly.

    Attributes:
        number: its place in the sequence of its seed.
        kind: `none`, `single`, `two`, `three` or `alien`.
        hidden: effect → parameter → value.
        rig: seed of the rig's tolerances and, with the flight's index, of the flights.
        outliers: whether the motion capture has outliers.
    """

    number: int
    kind: str
    hidden: Effects = field(default_factory=dict)
    rig: int = 0
    outliers: bool = False

    @property
    def known(self) -> frozenset[str]:
        """The hidden effects that the catalogue has."""
        return frozenset(self.hidden) - frozenset(ALIEN)

    @property
    def strength(self) -> float:
        """Strength of the faintest hidden effect: 1 is the least that tests hide; NaN without one."""
        return min((measure_strength(e, v) for e, v in self.hidden.items()), default=float("nan"))


def draw_plan(seed: int, number: int, effects: Sequence[str] = FLYING) -> Plan:
    """The session of that number, whatever else is drawn.

    Args:
        seed: of the sequence.
        number: place in it.
        effects: ids to hide; single ones take turns.
    """
    kind, turn = draw_kind(seed, number)
    rng = np.random.default_rng([seed, 2, number])
    hidden: Effects = {}
    if kind in ("single", "alien"):
        among = tuple(effects) if kind == "single" else tuple(ALIEN)
        around, place = divmod(turn, len(among))
        effect = str(np.random.default_rng([seed, 3, around]).permutation(among)[place])
        faint = FAINTEST if kind == "single" and rng.random() < FAINT_SHARE else None
        hidden = draw_effect(rng, (effect,), faint)
    elif kind in ("two", "three"):
        hidden = draw_together(rng, 2 if kind == "two" else 3, effects)
    return Plan(number, kind, hidden, int(rng.integers(2**31)), bool(rng.random() < OUTLIER_SHARE))


def draw_kind(seed: int, number: int) -> tuple[str, int]:
    """What the session of that number hides, and how many of the kind come before it."""
    block, card = divmod(number, len(DECK))
    deck = np.random.default_rng([seed, 1, block]).permutation(DECK)
    kind = str(deck[card])
    return kind, block * DECK.count(kind) + int((deck[:card] == kind).sum())


def draw_plans(seed: int, effects: Sequence[str] = FLYING, kinds: Sequence[str] = ()) -> Iterator[Plan]:
    """Sessions without end, only of some kinds where `kinds` names any."""
    for number in count():
        if not kinds or draw_kind(seed, number)[0] in kinds:
            yield draw_plan(seed, number, effects)
