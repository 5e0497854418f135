"""All suspects in order of what they explain, and what became of each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vpptwin.diagnosis.judgement.verdict import Cleared, Verdict
from vpptwin.report.words import choose_unit

OPEN = 30.0
"""Ratio of bounds from which the upper one says nothing: of a limit that the logs never ran into."""


@dataclass(frozen=True)
class Suspect:
    """A suspect's line."""

    effect: str  # id
    meaning: str  # the same in words
    drop: float  # drop in misfit that it brings alone
    share: float  # of the strongest suspect's
    fate: str  # `named`, `weak`, `rival`, `cleared`, `unseen` or nothing
    told: str  # the fate in words


def rank_suspects(ranking: Sequence[tuple[str, float]], verdict: Verdict, meanings: Mapping[str, str]) -> list[Suspect]:
    """Suspects, strongest first, those that nobody tried last; meanings: effect id → summary of the catalogue."""
    fates = {s.effect: ("unseen", f"not identifiable: {s.reason}") for s in verdict.unseen}
    fates |= {suspect.effect: ("cleared", describe_cleared(suspect)) for suspect in verdict.cleared}
    for cause in verdict.named:
        fates |= {rival.effect: ("rival", "rival of a named cause") for rival in cause.also_explained_by}
    fates |= {cause.effect: ("named", "named") for cause in verdict.named}
    fates |= {cause.effect: ("weak", f"{100.0 * cause.confidence:.0f} % probable") for cause in verdict.weak}
    drops = dict.fromkeys(fates, 0.0) | {effect: max(drop, 0.0) for effect, drop in ranking}
    drops |= {suspect.effect: 0.0 for suspect in verdict.unseen}  # what stands out there are the others
    most = max(drops.values(), default=0.0)
    return [
        Suspect(
            effect, meanings.get(effect, ""), drop, drop / most if most > 0.0 else 0.0, *fates.get(effect, ("", ""))
        )
        for effect, drop in sorted(drops.items(), key=lambda entry: -entry[1])
    ]


def describe_cleared(suspect: Cleared) -> str:
    """Between which bounds the parameter of a cleared suspect lies."""
    unit, factor = choose_unit(suspect.unit, max(abs(suspect.low), abs(suspect.high)))
    parameter = "" if unit else f"{suspect.parameter} "
    low, high = factor * suspect.low, factor * suspect.high
    if low > 0.0 and high > OPEN * low:
        return f"ruled out: {parameter}above {low:.2g} {unit}".rstrip()
    digits = 1 - math.floor(math.log10(high - low)) if high > low else 3
    bounds = f"between {round(low, digits) + 0.0:g} and {round(high, digits) + 0.0:g}"  # no negative zero
    return f"ruled out: {parameter}{bounds} {unit}".rstrip()
