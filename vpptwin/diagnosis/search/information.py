"""Which flights tell of what: the flights that judge are those that the fit can best do without."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.flights import build_bench, list_starts
from vpptwin.diagnosis.evidence.runs import MakeTwin, Variation
from vpptwin.diagnosis.search.likelihood import measure_response
from vpptwin.diagnosis.search.suspects import Trial, Unknown, list_trials
from vpptwin.estimation.measurements import Measurements
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

SAMPLE = 16
"""Windows of every flight that are looked at."""


def measure_information(
    spec: TwinSpec, measurements: Sequence[Measurements], unknowns: tuple[Unknown, ...],
    progress: Callable[[int], None] | None, criteria: Criteria, make_twin: MakeTwin = Twin,
) -> np.ndarray:  # fmt: skip
    """Squared signal to noise with which every effect of a typical size shows in every flight, (flights, effects).

    Of rigs whose disturbances are assumed one column more says in which flights there is something to find.
    """
    window = spec.robot.window
    starts = list_starts(measurements, window)
    sample = [s[np.linspace(0, len(s) - 1, min(SAMPLE, len(s))).astype(int)] for s in starts]
    bench = build_bench(spec, measurements, sample, window, False, progress, criteria, make_twin=make_twin)
    effects = list(dict.fromkeys(u.effect.id for u in unknowns))
    variations, rows = [Variation()], []
    for unknown in unknowns:
        if not unknown.is_limit:
            moved = unknown.parameter.clip(np.array(unknown.nominal + unknown.step_from(unknown.nominal)))
            variations.append(Variation({unknown.key: float(moved)}))
            rows.append(effects.index(unknown.effect.id))
    shares = [1.0] * len(rows)
    strengths = {u.effect.id: u for u in reversed(unknowns)}
    for trial in list_trials(unknowns, bench):
        variations.append(Variation(trial.values))
        rows.append(effects.index(trial.effect))
        shares.append(1.0 if trial.limit else share_of_typical(strengths[trial.effect], trial))
    predicted = bench.predict(variations)
    signal = (np.where(bench.valid, predicted[1:] - predicted[0], 0.0) / bench.std) ** 2
    signal *= np.array(shares)[:, None, None] ** 2
    found = np.zeros((len(measurements), len(effects)))
    for flight, all_starts in enumerate(starts):
        mine = bench.windows.flight == flight
        share = len(all_starts) / max(mine.sum(), 1)
        for row, values in zip(rows, signal[:, mine].sum(axis=(1, 2)) * share):
            found[flight, row] = max(found[flight, row], values)
    if not bench.guessed:
        return found
    missed = measure_misfit(bench, bench.miss(predicted[0]), len(measurements))
    return np.column_stack([found, missed * criteria.half_seen * criteria.shown / max(missed.max(), 1e-300)])


def measure_misfit(bench: Bench, missed: np.ndarray, flights: int) -> np.ndarray:
    """Squares of what windows miss, (K, M), beyond noise and starting states, a window of every flight, (flights,)."""
    white = measure_response(bench, {}, pushed=False).sensors.apply(missed)
    beyond = (white**2).sum(axis=1) - bench.valid.sum(axis=1) + 2 * bench.windows.free_dofs
    number = np.bincount(bench.windows.flight, minlength=flights)
    total = np.bincount(bench.windows.flight, weights=beyond, minlength=flights)
    return np.maximum(total, 0.0) / np.maximum(number, 1)


def share_of_typical(strength: Unknown, trial: Trial) -> float:
    """A typical size as a share of that at which an effect is tried, 1 at most: a large one would show anywhere."""
    away = abs(trial.values[strength.key] - strength.nominal)
    return float(min(abs(strength.step_from(strength.nominal)) / away, 1.0)) if away > 0.0 else 0.0


def choose_judges(information: np.ndarray, criteria: Criteria) -> set[int]:
    """A third of the flights (at least one), chosen one by one so that what is left shows as many effects as possible.

    Of flights that the others can do without, those judge that show most themselves.

    Args:
        information: (flights, effects).
        criteria: what counts as seen, and what it is worth.
    """
    count = len(information)
    kept = set(range(count))
    for _ in range(max(count // 3, 1)):

        def seen_without(flight: int) -> float:
            left, own = information[sorted(kept - {flight})].sum(axis=0), information[flight]
            seen = [float((part / (part + criteria.half_seen)).sum()) for part in (left, own)]
            return seen[0] + criteria.judging_worth * seen[1]

        kept.discard(max(sorted(kept, reverse=True), key=seen_without))
    return set(range(count)) - kept
