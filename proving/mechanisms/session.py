"""Sessions, drawn: a rig of some family, what is hidden in it, how it is moved and measured. Pure data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .families import FAMILIES
from .hidden import KINDS as HIDDEN_KINDS
from .hidden import KINDS_OUTSIDE as HIDDEN_OUTSIDE
from .hidden import Hidden, draw_hidden
from .recording import Recorded, record
from .reference import KINDS
from .rig import Rig
from .sensors import Disturbance, Sensors, draw_disturbance, draw_sensors
from .trial import Motion

DECK = ("single",) * 9 + ("two",) * 4 + ("alien",) * 3 + ("none",) * 4
"""Kinds of twenty sessions in a row, in a new order each time."""
RATES = (100, 125, 200, 250, 500)
"""Samples a second."""
FORGOTTEN = 0.35
"""Share of strongly damped carts with something of the catalogue hidden whose MJCF has no damping at all."""
SMALL, SMALL_SHARE = 0.5, (0.0003, 0.004)
"""Share of sessions in which driven joints have a little friction that nobody asks for, of their typical force."""


@dataclass(frozen=True)
class Session:
    """One session, before it is recorded: pure data.

    Attributes:
        seed, number: that it follows from.
        kind: `none`, `single`, `two` or `alien`.
        rig: as its maker believes it to be.
        hidden: what is.
        small: friction that nobody asks for.
        forgotten: the MJCF lacks the damping of its first joint; that is what is hidden.
        motions: a log each.
        rate: samples a second.
        sensors, disturbance: of the rig.
    """

    seed: int
    number: int
    kind: str
    rig: Rig
    hidden: tuple[Hidden, ...]
    small: tuple[Hidden, ...]
    forgotten: bool
    motions: tuple[Motion, ...]
    rate: int
    sensors: Sensors
    disturbance: Disturbance

    @property
    def family(self) -> str:
        """Family of the rig."""
        return self.rig.family

    @property
    def told(self) -> Rig:
        """The rig of the MJCF."""
        if not self.forgotten:
            return self.rig
        return replace(self.rig, links=(replace(self.rig.links[0], damping=0.0), *self.rig.links[1:]))

    def record(self, folder: Path) -> Recorded:
        """Move the rig, write logs, MJCF and twin into a folder."""
        return record(self, folder)


def draw_session(seed: int, number: int, wanted: str = "") -> Session:
    """The session of that number, whatever else is drawn. Six in a row are of six families.

    One effect of a `wanted` kind is hidden where somebody asks for it.
    """
    kind, turn = ("single", wanted) if wanted else draw_kind(seed, number)
    around, place = divmod(number, len(FAMILIES))
    family = str(np.random.default_rng([seed, 2, around]).permutation(list(FAMILIES))[place])
    rng = np.random.default_rng([seed, 3, number])
    rig = FAMILIES[family](rng)
    hidden: list[Hidden] = []
    for _ in range({"none": 0, "two": 2}.get(kind, 1)):
        new = draw_hidden(rng, rig, kind == "alien", turn if not hidden else "")
        while new.effect in [h.effect for h in hidden]:
            new = draw_hidden(rng, rig)
        hidden.append(new)
    if kind == "alien" and not hidden[0].outside:
        kind = "single"
    forgotten = not wanted and family == "damped cart" and kind in ("single", "two") and rng.random() < FORGOTTEN
    if forgotten:
        damping = Hidden(f"{rig.joints[0]}.viscous", 0, 1.0)
        hidden = [damping, *[h for h in hidden if h.effect != damping.effect][: len(hidden) - 1]]
    small = []
    if rng.random() < SMALL:
        taken = {h.effect for h in hidden}
        small = [
            Hidden(f"{rig.joints[j]}.{law}", int(j), float(np.exp(rng.uniform(*np.log(SMALL_SHARE)))))
            for j in np.flatnonzero(rig.driven)
            for law in ("coulomb", "viscous")
            if f"{rig.joints[j]}.{law}" not in taken
        ]
    rate = int(rng.choice(RATES[:4] if family == "arm" else RATES))
    return Session(
        seed, number, kind, rig, tuple(hidden), tuple(small), forgotten, draw_motions(rng, rig), rate,
        draw_sensors(rng), draw_disturbance(rng),
    )  # fmt: skip


def draw_kind(seed: int, number: int) -> tuple[str, str]:
    """What the session of that number hides, and which kind of effect has its turn there, "" for none."""
    block, card = divmod(number, len(DECK))
    deck = np.random.default_rng([seed, 1, block]).permutation(DECK)
    kind = str(deck[card])
    pool = {"single": HIDDEN_KINDS, "alien": HIDDEN_OUTSIDE}.get(kind)
    if pool is None:
        return kind, ""
    around, place = divmod(block * DECK.count(kind) + int((deck[:card] == kind).sum()), len(pool))
    return kind, str(np.random.default_rng([seed, 7, around]).permutation(pool)[place])


def draw_motions(rng: np.random.Generator, rig: Rig) -> tuple[Motion, ...]:
    """What is done in each log of a session: one to three, 10 to 40 s; a minute together at most."""
    count = int(rng.choice([1, 2, 3], p=[0.4, 0.35, 0.25]))
    low, high = {"pendulum": (6.0, 20.0), "arm": (10.0, 20.0)}.get(rig.family, (10.0, 40.0))
    balanced = rig.family == "cart-pole" and rig.links[1].com[2] > 0.0
    motions = []
    for _ in range(count):
        style = "released" if not rig.drives else "balanced" if balanced else "tracked"
        if style == "tracked" and rig.family in ("carriage", "damped cart") and rng.random() < 0.25:
            style = "open"
        kind = str(rng.choice([k for k in KINDS if rig.family != "arm" or k not in ("dither", "chirp")]))
        duration = round(float(rng.uniform(low, min(high, max(60.0 / count, low)))), 1)
        motions.append(Motion(style, kind, duration, int(rng.integers(2**31))))
    return tuple(motions)
