"""Hypotheses about a twin compared on windows of logs: what `inference` finds, for a bench."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.search.simulator import BenchSimulator, name_unknown
from vpptwin.diagnosis.search.suspects import Trial as Start
from vpptwin.diagnosis.search.suspects import Unknown as Suspect
from vpptwin.diagnosis.search.suspects import list_trials
from vpptwin.effects import Stage
from vpptwin.inference.fit import Fitter, Key, Trial, Unknown
from vpptwin.inference.select import Comparison, Searcher
from vpptwin.system.deadline import Deadline, Stopped

TEMPER = 2.0
"""By which log evidence is divided: no twin is exact (see docs/inference.md)."""
SCAN = np.geomspace(0.7, 70.0, 12)
"""Strengths, in typical sizes, at which dry friction is tried."""
ZERO = "qpos0"
"""What a wrong zero of an encoder changes in a twin."""
COLUMNS = 1.5
"""By how much higher the log odds are that a column of the log is not what it is said to be: a zero, a sign, a lag."""


def compare_hypotheses(
    bench: Bench, suspects: Sequence[Suspect], scout: Bench, deadline: Deadline | None = None,
    told: Callable[[frozenset[str]], None] = lambda effects: None,
    predict: Callable[[Mapping[Key, float]], float] = lambda values: 0.0, imposed: Sequence[str] | None = None,
) -> tuple[Comparison, Fitter, bool]:  # fmt: skip
    """Sets of effects fitted to a bench's windows with their posterior probabilities, and whether that was cut short.

    Args:
        bench: the windows, all that there are: none is held out.
        suspects: parameters of all effects that are candidates.
        scout: some of the windows, or all of them: on these candidates are screened.
        deadline: when to stop with what was found so far; None for never.
        told: called before every fit.
        predict: log weight that parameters gain by how well they predict.
        imposed: effects that are fitted whatever the evidence, and no others; None compares all.

    Raises:
        Stopped: before every candidate has been tried once.
    """
    fitter = open_fitter(bench, suspects, scout)
    effects = {suspect.effect.id: suspect.effect for suspect in suspects}
    usual = -float(np.log(max(len(effects), 2)))
    odds = {name: usual + (COLUMNS if name in bench.of_sensors or ZERO in effect.writes else 0.0)
            for name, effect in effects.items()}  # fmt: skip
    odds |= {name: float(np.log(p / (1.0 - p))) for name, p in bench.spec.priors.items() if name in odds and p > 0.0}
    prior = fitter.simulator.scale_prior
    comparison = Comparison(
        TEMPER, odds, lambda fit: predict(fit.values), lambda fit: prior.strain(fit.posterior.scales)
    )
    modifies = {name: effect.modifies for name, effect in effects.items() if effect.modifies}
    deadline = deadline or Deadline()

    def tell(tried: frozenset[str]) -> None:
        deadline.worth = any(len(each) > 1 for each in (*comparison.fits, tried))
        told(tried)

    searcher = Searcher(fitter, comparison, modifies, tell)
    if imposed is not None:
        searcher.impose(imposed)
        return comparison, fitter, False
    try:
        searcher.search()
    except Stopped:
        if not deadline.worth:
            raise
        return comparison, fitter, True
    return comparison, fitter, False


def open_fitter(bench: Bench, suspects: Sequence[Suspect], scout: Bench) -> Fitter:
    """Fits of all candidates to a bench's windows; see `compare_hypotheses`."""
    unknowns = {suspect.key: name_unknown(suspect, bench.criteria) for suspect in suspects}
    trials = [name_trial(start, unknowns) for start in list_trials(tuple(suspects), scout)] + scan_friction(suspects)
    whole = BenchSimulator(bench)
    few = whole if scout is bench else BenchSimulator(scout)
    return Fitter(whole, list(unknowns.values()), trials, few)


def scan_friction(suspects: Sequence[Suspect]) -> list[Trial]:
    """Laws of dry friction that the twin lacks, from weak to strong: where it sticks no slope tells how far to go."""
    found = []
    for suspect in suspects:
        effect, parameter = suspect.effect, suspect.parameter
        rubs = effect.stage is Stage.FRICTION and not effect.placed and suspect.nominal == parameter.off
        if rubs and parameter is effect.parameters[0]:
            values = parameter.clip(parameter.off + parameter.size * SCAN)
            found += [Trial(effect.id, {suspect.key: float(value)}) for value in np.unique(values)]
    return found


def name_trial(start: Start, unknowns: dict[tuple[str, str], Unknown]) -> Trial:
    """A place from which a fit may start, as `inference` asks for it."""
    strength = None if start.limit else unknowns[next(iter(start.values))]
    return Trial(start.effect, start.values, strength)
