"""All suspects in order of what they explain, and what became of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vpptwin.diagnosis.judgement.verdict import Verdict


@dataclass(frozen=True)
class Suspect:
    """A suspect's line.

    Attributes:
        effect: id.
        drop: drop in misfit that it brings alone.
        share: of the strongest suspect's.
        fate: `named`, `rival`, `cleared`, `unseen` or nothing.
    """

    effect: str
    drop: float
    share: float
    fate: str


def rank_suspects(ranking: Sequence[tuple[str, float]], verdict: Verdict) -> list[Suspect]:
    """Suspects, strongest first."""
    fates = dict.fromkeys((suspect.effect for suspect in verdict.unseen), "unseen")
    fates |= dict.fromkeys((suspect.effect for suspect in verdict.cleared), "cleared")
    fates |= dict.fromkeys((r.effect for cause in verdict.causes for r in cause.also_explained_by), "rival")
    fates |= dict.fromkeys((cause.effect for cause in verdict.causes), "named")
    most = max((drop for _, drop in ranking), default=0.0)
    return [
        Suspect(effect, max(drop, 0.0), max(drop, 0.0) / most if most > 0.0 else 0.0, fates.get(effect, ""))
        for effect, drop in sorted(ranking, key=lambda entry: -entry[1])
    ]
