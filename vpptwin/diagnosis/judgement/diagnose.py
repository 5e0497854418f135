"""From logs to a verdict: search for causes on some data, judge them on held-out data."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

from threadpoolctl import threadpool_limits

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.preflight import Preflight, inspect_flight
from vpptwin.diagnosis.evidence.runs import Key, MakeTwin
from vpptwin.diagnosis.judgement.blows import Findings, judge_blows
from vpptwin.diagnosis.judgement.case import judge_twin
from vpptwin.diagnosis.judgement.conclusion import conclude, tell_cause
from vpptwin.diagnosis.judgement.holdout import HeldOut, Score
from vpptwin.diagnosis.judgement.inferred import select_inferred
from vpptwin.diagnosis.judgement.leftover import judge_leftover
from vpptwin.diagnosis.judgement.material import Material, Stage, divide, prepare
from vpptwin.diagnosis.judgement.power import Shown
from vpptwin.diagnosis.judgement.selection import Selection
from vpptwin.diagnosis.judgement.verdict import Cause, Cut, Experiment, Verdict
from vpptwin.diagnosis.judgement.wrench import WrenchPlot
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.separation import Hypothesis
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects import find_effect
from vpptwin.estimation.measurements import Measurements
from vpptwin.logs.flight import Flight
from vpptwin.system.deadline import Deadline
from vpptwin.twin.robot.robot import Robot, by_robot
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

MMAP_THRESHOLD = -3
"""M_MMAP_THRESHOLD of malloc.h."""


@dataclass(frozen=True)
class Diagnosis:
    """A verdict with what a report needs beyond it.

    Attributes:
        verdict: the verdict.
        values: parameters of the extended twin's new effects.
        suggested: the same with those that are too weak for it, too; {} where there are none.
        ranking: effect → drop in cost when it was tried first of all, best first.
        held_out: the judging windows, with the twin as it was judged: what of it follows its log too.
        leftover_plot: the missing force that remains, against what it follows; None if nothing remains.
        preflight: what each log could show, in the order of the logs.
        measurements: of each log.
    """

    verdict: Verdict
    values: dict[Key, float]
    ranking: list[tuple[str, float]]
    held_out: HeldOut
    leftover_plot: WrenchPlot | None = None
    preflight: list[Preflight] = field(default_factory=list)
    measurements: list[Measurements] = field(default_factory=list)
    suggested: dict[Key, float] = field(default_factory=dict)


def diagnose(
    spec: TwinSpec, flights: Sequence[Flight], stage: Stage = lambda text: None,
    progress: Callable[[int], None] | None = None, criteria: Criteria = CRITERIA, causes: Sequence[str] | None = None,
    make_twin: MakeTwin = Twin, only: Collection[str] = (), deadline: Deadline | None = None,
    announce: Stage = lambda text: None,
) -> Diagnosis:  # fmt: skip
    """Find what a twin gets wrong.

    Args:
        spec: the twin.
        flights: logs; with several, whole logs may be held out.
        stage: called with the present step, in words.
        progress: called with the number of inner steps that were simulated.
        criteria: thresholds that decide.
        causes: effects to fit and judge whatever the evidence, as if they were known; None looks for them.
        make_twin: makes the simulations, as `Bench` says.
        only: effects that are candidates; none named for all.
        deadline: when to stop with what was found so far; None for never.
        announce: told, before a search on a jointed rig, what it may find and how long it takes, line by line.

    Raises:
        Stopped: if that is before all candidates have been tried once.
        InputError: if a log is too short, lacks what the twin needs, or never moves.
        KeyError: if the catalogue lacks one of the causes.
    """
    for effect in causes or ():
        find_effect(spec.catalogue, effect)
    return_memory()
    deadline = deadline or Deadline()
    progress = deadline.watch(progress)
    # Thousands of small factorisations: BLAS threads cost more than they give, and steal the engine's cores.
    with threadpool_limits(limits=1, user_api="blas"):
        material = prepare(spec, flights, stage, progress, criteria, make_twin, only, deadline, announce, causes)
        spec = material.search.bench.spec
        selection = select_inferred(material.inferred, material.search)
        deadline.held = True  # what a verdict takes, and pictures of it
        deadline.not_done += selection.not_done
        better, kept = keep_better(material, selection) if causes is None else (material, selection)
        if only:
            kept = replace(kept, unrivalled=kept.fit.effects)
        found = judge(spec, flights, better, kept, stage, deadline)
        if weak := found.verdict.weak:
            lesser = leave_out(better, kept, [cause.effect for cause in weak])
            lesser = keep_better(lesser[0], replace(lesser[1], left_out=kept.left_out, reduced=kept.reduced))
            whole, found = found, judge(spec, flights, *lesser, stage, deadline)
            found = suggest(found, weak, whole.verdict.after, whole.values)
        else:
            found = recall(found, material, selection)
            divide(material.held_out, better.inferred)
        if causes is not None:
            return replace(found, verdict=replace(found.verdict, settled=sorted(spec.settled)))
        if (blows := material.blows) is None or not blows.causes:  # other causes may have hidden them
            given = stage, progress, criteria, make_twin, only
            work = partial(judge_blows, spec, material.measurements, found.values, *given)
            struck = any(len(flight.blows) for flight in material.measurements)
            blows = deadline.attempt(["judging contacts by impacts"], work, Findings()) if struck else work()
        found = add_blows(found, blows)
        cut = Cut(deadline.why, round(deadline.passed, 1), deadline.not_done) if deadline.not_done else None
        settled = sorted(spec.settled)
        return replace(found, verdict=replace(found.verdict, stopped=cut, only=sorted(only), settled=settled))


def add_blows(found: Diagnosis, blows: Findings) -> Diagnosis:
    """A diagnosis with what impacts showed, errors before as they are without that."""
    values, held_out, verdict = found.values | blows.values, found.held_out, found.verdict
    if blows.causes:
        after, change = held_out.score(values), held_out.errors.compare(blows.nominal, values).change
        verdict = replace(verdict, before=held_out.score(blows.nominal), after=after, improvement=change)
    suggested = found.suggested | blows.values if found.suggested else {}
    return replace(found, verdict=blows.add_to(verdict), values=values, suggested=suggested)


def return_memory() -> None:
    """Let glibc give arrays of megabytes back when they go: kept for later they double what a diagnosis takes."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(MMAP_THRESHOLD, 4 * 2**20)


def keep_better(material: Material, selection: Selection) -> tuple[Material, Selection]:
    """Both without causes that make errors of held-out data grow at any horizon, the weakest first.

    Whatever the search believed: this is what is written.
    """
    while selection.fit.effects:
        rule = judge_twin(material.held_out.errors.compare({}, selection.fit.values))
        if rule.passed:
            break
        weakest = min(sorted(selection.fit.effects), key=selection.evidence.__getitem__)
        material.decisions.setdefault(weakest, []).append(rule)
        material, selection = leave_out(material, selection, [weakest])
    return material, selection


def leave_out(material: Material, selection: Selection, effects: Sequence[str]) -> tuple[Material, Selection]:
    """Both without some of the causes, all others fitted anew."""
    inferred = material.inferred
    for effect in effects:
        inferred = inferred.drop(effect)
    divide(material.held_out, inferred)
    material = replace(material, inferred=inferred)
    return material, selection.reduce_to(select_inferred(inferred, material.search).fit)


def recall(found: Diagnosis, material: Material, whole: Selection) -> Diagnosis:
    """A diagnosis that suggests what was left out because some error grew with it, if most of another goes with it."""
    search, held_out, values, told = material.search, material.held_out, whole.fit.values, []
    gone = sorted(whole.fit.effects - {key[0] for key in found.values})
    if not gone:
        return found
    divide(held_out, material.inferred)
    for effect in gone:
        rest = {key: value for key, value in values.items() if key[0] != effect}
        sure = min(whole.confidence(effect), search.criteria.sober)
        cause = tell_cause(search, whole, effect, sure, *held_out.share_removed(rest, values, {}))
        told.append(replace(cause, weak=True))
    suggested = suggest(found, told, held_out.score(values), values)
    return suggested if suggested.verdict.suggests else found


def suggest(found: Diagnosis, weak: Sequence[Cause], score: Score, values: Mapping[Key, float]) -> Diagnosis:
    """A diagnosis with weak causes beside, and the score and the values of a twin that has them too."""
    verdict, ids = found.verdict, {cause.effect for cause in weak}
    verdict = replace(
        verdict, causes=[*verdict.causes, *weak], suggested=score,
        cleared=[c for c in verdict.cleared if c.effect not in ids],
        unseen=[u for u in verdict.unseen if u.effect not in ids],
    )  # fmt: skip
    verdict = replace(verdict, gap=verdict.gap or verdict.suggests)
    return replace(found, verdict=verdict, suggested=dict(values))


def judge(
    spec: TwinSpec, flights: Sequence[Flight], material: Material, selection: Selection, stage: Stage,
    deadline: Deadline,
) -> Diagnosis:  # fmt: skip
    """The verdict on selected causes."""
    search, held_out, fit = material.search, material.held_out, selection.fit
    stage("judging on held-out windows")
    leftover = judge_leftover(held_out, search, fit)
    inferred = material.inferred
    shown = Shown(inferred.fitter, inferred.chosen, inferred.comparison.temper)
    verdict = conclude(spec, flights, material.measurements, search, held_out, selection, leftover.unexplained, shown,
                       material.decisions)  # fmt: skip
    if any(cause.also_explained_by for cause in verdict.causes):
        stage("looking for the manoeuvre that separates the rivals")
        work = partial(suggest_experiment, spec, search, selection, verdict.causes)
        experiment = deadline.attempt(["looking for the manoeuvre that separates the rivals"], work, None)
        verdict = replace(verdict, experiment=experiment)
    preflight = [inspect_flight(spec, measured) for measured in material.measurements]
    return Diagnosis(verdict, fit.values, selection.first, held_out, leftover.plot, preflight, material.read)


@by_robot
def propose(
    robot: Robot, spec: TwinSpec, hypotheses: Sequence[Hypothesis], unknowns: Sequence[Unknown], criteria: Criteria
) -> Experiment | None:
    """The motion that would separate the hypotheses; None where the robot has no library of motions."""
    return None


def suggest_experiment(
    spec: TwinSpec, search: Search, selection: Selection, causes: Sequence[Cause]
) -> Experiment | None:
    """The manoeuvre for the cause whose rivals are most probable."""
    doubtful = max(causes, key=lambda cause: sum(rival.confidence for rival in cause.also_explained_by)).effect
    return propose(spec.robot, spec, [selection.fit, *selection.instead[doubtful]], search.unknowns, search.criteria)
