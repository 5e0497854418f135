"""What is hidden in which session: a fixed sequence per seed, so that a run can stop, go on, grow or be shared out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np

from proving.drone import (
    ALIEN,
    ALIEN_KINDS,
    COMPANIONS,
    CORE,
    EXTENDED,
    FORMS,
    Wind,
    draw_effect,
    draw_small,
    draw_together,
    draw_wind,
    find_also,
    find_known,
    measure_strength,
    true_size,
)

Effects = dict[str, dict[str, float]]
FLYING = (*CORE, *EXTENDED, *COMPANIONS)
"""Effects of the catalogue that are drawn; asymmetry of friction comes with the friction that it needs."""
DECK = ("single",) * 8 + ("form",) * 2 + ("two",) * 3 + ("three",) + ("alien",) * 3 + ("none",) * 3
"""Kinds of twenty sessions in a row, in a new order each time."""
FAINT_SHARE, FAINTEST = 0.2, 0.4
"""Share of single effects that are fainter than tests hide them, and their least strength: the diagnosis's standard
deviation from 32 s is about a tenth of strength 1, so these are 4 to 10 sigma."""
OUTLIER_SHARE = 0.25
"""Share of sessions in which 0.5 % of the motion capture's frames are far off."""


THIRDS = (0.65, 1.39)
"""Of what is drawn between 0.3 and 3, evenly in its logarithm: gusts weaker, between, and stronger."""
ALONE = {"alien": tuple(ALIEN), "form": tuple(FORMS)}
"""Kinds that hide one effect each of a list of their own, in turns."""


@dataclass(frozen=True)
class Plan:
    """One session to fly.

    Attributes:
        number: its place in the sequence of its seed.
        kind: `none`, `single`, `form` (one effect whose law differs from ours), `two`, `three` or `alien`.
        hidden: effect → parameter → value.
        rig: seed of the rig's tolerances and, with the flight's index, of the flights.
        outliers: whether the motion capture has outliers.
        small: likewise, deviations fainter than strength 1 that nobody asks for: named or not, neither is wrong.
        wind: what gusts are like; by default as before they were drawn.
        knocks: whether flights knock at the wall.
    """

    number: int
    kind: str
    hidden: Effects = field(default_factory=dict)
    rig: int = 0
    outliers: bool = False
    small: Effects = field(default_factory=dict)
    wind: Wind = Wind()  # noqa: RUF009 (frozen)
    knocks: bool = False

    @property
    def known(self) -> frozenset[str]:
        """The hidden effects that the catalogue has; one of another form counts as its nearest."""
        return find_known(self.hidden)

    @property
    def neither(self) -> frozenset[str]:
        """Effects that need not be named and are not wrong if they are: small ones, parts of another form's law."""
        return (frozenset(self.small) | find_also(self.hidden)) - self.known

    @property
    def strength(self) -> float:
        """Strength of the faintest hidden effect: 1 is the least that tests hide; NaN without one."""
        return min((measure_strength(e, v) for e, v in self.hidden.items()), default=float("nan"))

    @property
    def family(self) -> str:
        """Of rigs that are not ours."""
        return ""

    @property
    def separable(self) -> bool | None:
        """Unknown before the true structure was fitted."""
        return None

    def find_truth(self, effect: str, parameter: str) -> float:
        """What the rig has of a hidden effect, its tolerance included."""
        return true_size(effect, parameter, self.hidden[effect][parameter], self.rig)

    @property
    def about(self) -> str:
        """What else there is to know about a session, in a few words."""
        strength = f"strength {self.strength:.2g}, " if self.hidden else ""
        small = f"small {self.small}, " if self.small else ""
        return f"{strength}{small}gusts {self.wind.kind} {self.wind.strength:.2g} % {self.wind.time:.2g} s"

    @property
    def gusts(self) -> str:
        """Kind of gusts."""
        return self.wind.kind

    @property
    def gust_strength(self) -> str:
        """Third of the gusts' strength."""
        names = "0.3 to 0.65 %", "0.65 to 1.39 %", "1.39 to 3 %"
        return names[int(np.searchsorted(THIRDS, self.wind.strength))] + " of weight"

    @property
    def gust_time(self) -> str:
        """Half of the gusts' correlation times, which are drawn evenly in their logarithm."""
        return "0.1 to 0.32 s" if self.wind.time < 0.316 else "0.32 to 1 s"

    @property
    def outside(self) -> str:
        """Kind of an effect that the catalogue lacks, "" for none."""
        return next((ALIEN_KINDS[e] for e in self.hidden if e in ALIEN_KINDS), "")

    @property
    def form(self) -> str:
        """The effect whose law differs from ours, "" for none."""
        return next((f"{e}, nearest {FORMS[e].nearest}" for e in self.hidden if e in FORMS), "")

    @property
    def jitter(self) -> str:
        """Whether there are small deviations beyond the rig's tolerances."""
        return "small deviations" if self.small else "tolerances only"

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Plan:
        """Read what `asdict` made."""
        return cls(**{**content, **({"wind": Wind.from_dict(content["wind"])} if "wind" in content else {})})


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
    if kind in ("single", *ALONE):
        among = ALONE.get(kind, tuple(effects))
        around, place = divmod(turn, len(among))
        effect = str(np.random.default_rng([seed, 3, around]).permutation(among)[place])
        faint = FAINTEST if kind == "single" and rng.random() < FAINT_SHARE else None
        hidden = draw_effect(rng, (effect,), faint)
    elif kind in ("two", "three"):
        hidden = draw_together(rng, 2 if kind == "two" else 3, effects)
    rig, outliers = int(rng.integers(2**31)), bool(rng.random() < OUTLIER_SHARE)
    small = draw_small(np.random.default_rng([seed, 4, number]), hidden, (*CORE, *EXTENDED))
    knocks = any(effect.startswith("contact.") for effect in effects)
    wind = draw_wind(np.random.default_rng([seed, 5, number]))
    return Plan(number, kind, hidden, rig, outliers, small, wind, knocks)


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
