"""From flights to a verdict: search for causes on some flights, judge them on others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from vpptwin.diagnosis.bench import Key
from vpptwin.diagnosis.flights import MAX_WINDOWS, build_bench, long_starts, split_flights, thin_out, window_length
from vpptwin.diagnosis.holdout import HORIZONS_S, HeldOut, improvement
from vpptwin.diagnosis.leftover import judge_leftover
from vpptwin.diagnosis.search import BAR, MAX_CAUSES, Fit, Search, Step
from vpptwin.diagnosis.suspects import Unknown, list_unknowns
from vpptwin.diagnosis.verdict import Cause, Estimate, Rival, Verdict
from vpptwin.diagnosis.wrench import WrenchPlot
from vpptwin.errors import InputError
from vpptwin.estimation.measurements import Measurements, read_measurements
from vpptwin.logs.flight import Flight
from vpptwin.twin.spec import TwinSpec

if TYPE_CHECKING:
    from vpptwin.diagnosis.preflight import Preflight

RIVAL_DROP = 18.0
"""A rival within this drop in cost of the named cause is reported with it (3 sigma, doubled for imperfect models)."""
TEMPER = 4.0
"""Cost differences are divided by this before they become probabilities: the noise is not exactly what is assumed."""
SIGMAS_HELD_OUT = 2.0
"""Standard errors by which a cause must improve the held-out windows."""
STRONG = 10.0 * BAR
"""Drop in cost on fitted windows beyond which one standard error is enough: a dozen held-out windows, a few of them
wild, cannot outvote that, but they must not speak against it."""
POWERLESS = 50.0
"""Whitened change of prediction, squared and summed, under which held-out windows cannot judge an effect at all; it is
then named on twice the evidence, unless they speak against it."""
TOLERANCES = 2.5
"""Build tolerances that a parameter must leave its nominal by before its effect is named."""

Stage = Callable[[str], None]


@dataclass(frozen=True)
class Diagnosis:
    """A verdict with what a report needs beyond it.

    Attributes:
        verdict: the verdict.
        values: parameters of the extended twin's new effects.
        ranking: effect → drop in cost when it was tried first of all, best first.
        search: the search, with the fitted windows.
        fit: its last fit.
        held_out: the judging windows.
        leftover_plot: the missing force that remains, against what it follows; None if nothing remains.
        preflight: what each log could show, in the order of the logs.
    """

    verdict: Verdict
    values: dict[Key, float]
    ranking: list[tuple[str, float]]
    search: Search
    fit: Fit
    held_out: HeldOut
    leftover_plot: WrenchPlot | None = None
    preflight: list[Preflight] = field(default_factory=list)


def diagnose(
    spec: TwinSpec,
    flights: Sequence[Flight],
    stage: Stage = lambda text: None,
    progress: Callable[[int], None] | None = None,
) -> Diagnosis:
    """Find what a twin gets wrong.

    Args:
        spec: the twin.
        flights: logs; with several, whole flights are held out.
        stage: told what is being done.
        progress: told how many inner steps were simulated.

    Raises:
        InputError: if a log is too short, lacks what the twin needs, or never moves.
    """
    # Thousands of small factorisations: BLAS threads cost more than they give, and steal the engine's cores.
    with threadpool_limits(limits=1, user_api="blas"):
        return search_and_judge(spec, flights, stage, progress)


def search_and_judge(
    spec: TwinSpec, flights: Sequence[Flight], stage: Stage, progress: Callable[[int], None] | None
) -> Diagnosis:
    """The work of `diagnose`."""
    measurements = [read_measurements(spec, flight) for flight in flights]
    check_moving(measurements)
    window = window_length(spec)
    split = split_flights(measurements, window)
    stage("linearising the twin about the flights")
    bench = build_bench(spec, measurements, thin_out(split.fitted, MAX_WINDOWS), window, False, progress)
    unknowns = list_unknowns(spec)
    search = Search(bench, unknowns)
    held_out = open_held_out(spec, measurements, split.held_out, progress)
    fit, steps = find_causes(search, held_out, stage)
    stage("checking rivals")
    rivals = {effect: find_rivals(search, fit, effect) for effect in sorted(fit.effects)}
    stage("judging on held-out windows")
    held_out.relinearise(fit.values)
    verdict = conclude(spec, flights, search, held_out, fit, rivals, steps)
    ranking = sorted(rank_first(steps, search), key=lambda item: -item[1])
    return Diagnosis(verdict, fit.values, ranking, search, fit, held_out)


def open_held_out(
    spec: TwinSpec,
    measurements: Sequence[Measurements],
    starts: list[np.ndarray],
    progress: Callable[[int], None] | None,
) -> HeldOut:
    """Benches of the held-out windows."""
    window = window_length(spec)
    short = build_bench(spec, measurements, thin_out(starts, MAX_WINDOWS // 2), window, True, progress)
    long = build_bench(spec, measurements, long_starts(starts, window), HORIZONS_S[-1], True, progress)
    return HeldOut(short, long)


def find_causes(search: Search, held_out: HeldOut, stage: Stage) -> tuple[Fit, list[Step]]:
    """Add the best suspect as long as it clears the bar, matters and improves held-out windows; then prune."""
    fit, steps = search.start, []
    barred: frozenset[str] = frozenset()
    while len(fit.effects) < MAX_CAUSES:
        named = ", ".join(sorted(fit.effects)) or "nothing yet"
        stage(f"trying suspects (named: {named})")
        step = search.extend(fit, barred=barred)
        steps.append(step)
        candidates = sorted(step.tried, key=step.drop, reverse=True)
        accepted = next((e for e in candidates if is_cause(search, held_out, step, e)), None)
        if accepted is None:
            break
        best = step.tried[accepted]
        fit = search.drop_superfluous(search.adopt(best.effects, best.values))
        barred |= step.before.effects - fit.effects
    return fit, steps


def is_cause(search: Search, held_out: HeldOut, step: Step, effect: str) -> bool:
    """Whether a suspect clears the bar, leaves its build tolerance and predicts held-out windows better."""
    tried = step.tried[effect]
    if step.drop(effect) < BAR:
        return False
    own = [u for u in search.unknowns if u.effect.id == effect]
    if all(abs(tried.values[u.key] - u.nominal) < TOLERANCES * u.parameter.tolerance for u in own):
        return False
    before, after = held_out.whitened(step.before.values), held_out.whitened(tried.values)
    gain, error = improvement((before**2).sum(axis=1), (after**2).sum(axis=1))
    if ((before - after) ** 2).sum() < POWERLESS:
        return step.drop(effect) > 2.0 * BAR and gain > -SIGMAS_HELD_OUT * error
    return gain > (1.0 if step.drop(effect) > STRONG else SIGMAS_HELD_OUT) * error


def find_rivals(search: Search, fit: Fit, effect: str) -> list[Rival]:
    """Effects that explain the fitted windows nearly as well in place of `effect`."""
    without = search.fit(fit.effects - {effect}, fit.values, fit.about)
    step = search.extend(search.complete(without), barred=frozenset({effect}))
    gaps = {name: step.tried[name].cost - fit.cost for name in step.tried}
    weights = {name: float(np.exp(-0.5 * max(gap, 0.0) / TEMPER)) for name, gap in gaps.items() if gap < RIVAL_DROP}
    total = 1.0 + sum(weights.values())
    return [Rival(name, weight / total) for name, weight in sorted(weights.items(), key=lambda item: -item[1])]


def conclude(
    spec: TwinSpec,
    flights: Sequence[Flight],
    search: Search,
    held_out: HeldOut,
    fit: Fit,
    rivals: dict[str, list[Rival]],
    steps: list[Step],
) -> Verdict:
    """Put the verdict together."""
    before, after = held_out.score({}), held_out.score(fit.values)
    excess = max(before.chi2 - 1.0, 1e-9)
    causes = []
    for effect in sorted(fit.effects):
        rest = {key: value for key, value in fit.values.items() if key[0] != effect}
        gain = (held_out.chi2(rest) - after.chi2) / excess
        drop = search.fit(fit.effects - {effect}, rest, fit.about).cost - fit.cost
        doubt = float(np.exp(-0.5 * min(max(drop - BAR, 0.0), 1400.0) / TEMPER))
        share = 1.0 - sum(r.confidence for r in rivals[effect])
        own = [u for u in search.unknowns if u.effect.id == effect]
        parameters = {u.parameter.name: estimate(u, fit) for u in own}
        confidence = min(share * (1.0 - 0.5 * doubt), 0.999)
        causes.append(Cause(effect, confidence, parameters, gain, rivals[effect], own[0].effect.summary))
    causes.sort(key=lambda cause: -cause.gain)
    unexplained = judge_leftover(held_out, fit, before, after)
    return Verdict(
        logs=[str(flight.path) for flight in flights],
        twin=spec.name,
        windows=len(search.bench.windows),
        held_out_windows=len(held_out.short.windows),
        before=before,
        after=after,
        gap=bool(causes) or unexplained.significant,
        causes=causes,
        unexplained=unexplained,
        warnings=[f"{flight.path.name}: {warning}" for flight in flights for warning in flight.warnings],
    )


def estimate(unknown: Unknown, fit: Fit) -> Estimate:
    """A fitted parameter with its unit and uncertainty."""
    value, std = fit.values[unknown.key], fit.std[unknown.key]
    return Estimate(float(value), unknown.parameter.unit, float(std), float(unknown.nominal))


def rank_first(steps: list[Step], search: Search) -> list[tuple[str, float]]:
    """Every suspect's drop in cost as the only cause: refitted where it was, by linearisation elsewhere."""
    first = steps[0]
    linear = dict(search.rank(first.before))
    return [(name, first.drop(name) if name in first.tried else drop) for name, drop in linear.items()]


def check_moving(measurements: Sequence[Measurements]) -> None:
    """Refuse flights on which nothing ever moves."""
    for flight in measurements:
        spread = max(float(np.ptp(series.value)) / series.std for series in flight.positions.values())
        if spread < 20.0:
            raise InputError(f"{flight.name}: nothing moves", "a flight with motion", "log a manoeuvre")
