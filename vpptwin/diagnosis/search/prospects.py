"""Before the search: which candidates these data can show, and how long the search will take."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Variation
from vpptwin.diagnosis.search.likelihood import measure_response
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.system.deadline import tell_time

SEARCHED = 4.0
"""A search takes this [s] times the root of a simulation's time [s], for every window and candidate that these data
show: fitted to nine rigs on two busy cores. Half of the time is algebra, which knows no simulation; a search that finds
many causes takes longer."""
ENOUGH = 30
"""Windows from which on more of them take hardly longer: of 24 logs on two busy cores 20 took half to twice that."""
MOST = 8
"""Candidates that are named in a line."""


@dataclass(frozen=True)
class Prospects:
    """What a search may find.

    Attributes:
        sigmas: effect → signal to noise of its typical size in all windows.
        apart: effect → what is left of that beside the other effect that is most like it.
        like: effect → that other effect.
        seen: sigma from which on an effect shows.
        seconds: that the search takes, by the time of these simulations [s].
    """

    sigmas: dict[str, float]
    apart: dict[str, float]
    like: dict[str, str]
    seen: float
    seconds: float

    @property
    def levels(self) -> dict[str, list[str]]:
        """`identifiable`, `weakly identifiable` and `not identifiable` → effects, what shows best first."""
        found: dict[str, list[str]] = {"identifiable": [], "weakly identifiable": [], "not identifiable": []}
        for effect, sigma in sorted(self.sigmas.items(), key=lambda pair: -pair[1]):
            level = "not" if sigma < self.seen else "weakly" if self.apart[effect] < self.seen else ""
            found[f"{level} identifiable".strip()].append(effect)
        return found

    def describe(self) -> list[str]:
        """A line for each level, and one for the time."""
        lines = []
        for level, effects in self.levels.items():
            told = [f"{e} (like {self.like[e]})" if level.startswith("weakly") else e for e in effects[:MOST]]
            told += [f"and {len(effects) - MOST} more"] if len(effects) > MOST else []
            lines += [f"{level} at their usual size: {', '.join(told)}"] if effects else []
        size = 60.0 if self.seconds >= 60.0 else 1.0
        took = tell_time(size * float(f"{self.seconds / size:.1g}"))
        return [*lines, f"the search will take about {took}, within a factor of two"]


def foresee(bench: Bench, scout: Bench, unknowns: Sequence[Unknown]) -> Prospects:
    """Simulate every candidate at its typical size in some windows, timed.

    What the starting state of a window explains is no signal; neither are limits, which only the search tells.

    Args:
        bench: all windows that are fitted.
        scout: some of them, or all.
        unknowns: parameters of the candidates.
    """
    strengths = {u.effect.id: u for u in reversed(unknowns) if not u.is_limit}
    varied = [Variation()]
    for unknown in strengths.values():
        moved = unknown.parameter.clip(np.array(unknown.nominal + unknown.step_from(unknown.nominal)))
        varied.append(Variation({unknown.key: float(moved)}))
    response = measure_response(scout, {}, pushed=False)  # what is compiled is compiled then
    began = time.perf_counter()
    predicted = scout.predict(varied)
    each = (time.perf_counter() - began) / (len(varied) * len(scout.windows))
    columns = np.where(scout.valid, predicted[1:] - predicted[0], 0.0)
    white = response.sensors.apply(columns).reshape(len(strengths), -1)
    white *= np.sqrt(len(bench.windows) / len(scout.windows))
    sizes = np.linalg.norm(white, axis=1)
    alike = white @ white.T / np.maximum(np.outer(sizes, sizes), 1e-300)
    np.fill_diagonal(alike, 0.0)
    names, nearest = list(strengths), np.argmax(np.abs(alike), axis=1) if len(strengths) else []
    apart = {name: float(sizes[i] * np.sqrt(max(1.0 - alike[i, nearest[i]] ** 2, 0.0))) for i, name in enumerate(names)}
    shown = np.count_nonzero(sizes >= bench.criteria.seen)
    return Prospects(
        dict(zip(names, sizes.tolist())), apart, {name: names[nearest[i]] for i, name in enumerate(names)},
        bench.criteria.seen, SEARCHED * float(np.sqrt(each)) * min(len(bench.windows), ENOUGH) * max(int(shown), 1),
    )  # fmt: skip
