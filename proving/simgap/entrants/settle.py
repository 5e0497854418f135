"""From evidence to probabilities, alike for all entrants: a softmax with three numbers, tuned on public seeds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from proving.simgap.scores import NOTHING, UNKNOWN, complete_answer, score_log

FILE = Path(__file__).with_name("settings.json")
GRID = (
    (0.3, 1.0, 1.5, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0),  # temperature
    (-4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 9.0),  # of nothing
    (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0),  # of unknown
)
"""What is searched."""


@dataclass(frozen=True)
class Settings:
    """By what evidence is divided, and the evidence of `nothing` and of `unknown` after that."""

    temperature: float = 10.0
    nothing: float = 3.0
    unknown: float = 1.0


def read_settings(entrant: str) -> Settings:
    """As tuned on public seeds (settings.json); as they come where there are none."""
    found = json.loads(FILE.read_text()) if FILE.exists() else {}
    return Settings(**found.get(entrant, {}).get("settings", {}))


def settle(evidence: Mapping[str, float], settings: Settings) -> dict[str, float]:
    """Probabilities of causes, nothing and unknown, whose evidence counts beside the settings' own.

    Those below a thousandth are left out.
    """
    own = {NOTHING: settings.nothing, UNKNOWN: settings.unknown}
    names = [*(name for name in evidence if name not in own), *own]
    logits = np.array([evidence.get(name, 0.0) / settings.temperature + own.get(name, 0.0) for name in names])
    weights = np.exp(logits - logits.max())
    weights[weights < 1e-3 * weights.sum()] = 0.0
    return {name: float(w / weights.sum()) for name, w in zip(names, weights) if w > 0.0}


def tune(sessions: Sequence[tuple[Mapping[str, float], Sequence[str], str]]) -> tuple[Settings, float]:
    """The settings with the least mean log score over sessions (evidence, causes, truth), and that score."""

    def measure(settings: Settings) -> float:
        told = [(complete_answer(settle(e, settings), causes), truth) for e, causes, truth in sessions]
        return float(np.mean([score_log(answer, truth) for answer, truth in told]))

    scored = [(measure(s), s) for s in (Settings(*values) for values in product(*GRID))]
    best = min(scored, key=lambda one: one[0])
    return best[1], best[0]
