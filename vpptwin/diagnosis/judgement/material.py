"""What a diagnosis works on: logs cut into windows, hypotheses compared on them, and the rules of every cause."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.flights import (
    HORIZONS_S,
    build_bench,
    choose_window,
    list_starts,
    long_starts,
    thin_out,
)
from vpptwin.diagnosis.evidence.forces import scale_twin
from vpptwin.diagnosis.evidence.logged_inputs import read_session
from vpptwin.diagnosis.evidence.runs import MakeTwin
from vpptwin.diagnosis.judgement.blows import Findings, judge_blows, strikes_on
from vpptwin.diagnosis.judgement.case import Rule
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.inferred import Inferred, infer_causes, judge_causes, rescale
from vpptwin.diagnosis.search.prospects import foresee
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.suspects import Unknown, list_unknowns
from vpptwin.estimation.measurements import Measurements
from vpptwin.logs.flight import Flight
from vpptwin.system.deadline import Deadline
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.twin import Twin

TRIED, SCREENED = 4, 4_000_000
"""Simulations that screen a candidate's parameter, and simulated values up to which all windows take part in that."""

Stage = Callable[[str], None]


@dataclass(frozen=True)
class Material:
    """What a diagnosis works on: measurements, windows that are fitted, held-out windows, and impacts."""

    read: list[Measurements]  # as the logs have them, with the noise that was inferred where it was
    measurements: list[Measurements]  # with blows marked
    search: Search
    held_out: HeldOut
    blows: Findings | None  # what they told, where they come first
    inferred: Inferred  # what all windows told together
    decisions: dict[str, list[Rule]] = field(default_factory=dict)  # of every effect that was a cause, or nearly


def prepare(
    spec: TwinSpec, flights: Sequence[Flight], stage: Stage, progress: Callable[[int], None] | None,
    criteria: Criteria = CRITERIA, make_twin: MakeTwin = Twin, only: Collection[str] = (),
    deadline: Deadline | None = None, announce: Stage = lambda text: None, causes: Sequence[str] | None = None,
) -> Material:  # fmt: skip
    """Read logs, cut them into windows, and compare hypotheses on these, or fit the `causes` that somebody names.

    Where causes are looked for and logs have impacts, the twin has what these told of its contacts.
    """
    spec, read = read_session(spec, flights, criteria)
    spec, measurements = choose_window(spec, read)
    spec = scale_twin(spec, measurements)
    blows = None
    if causes is None and strikes_on(spec, measurements):
        blows = judge_blows(spec, measurements, {}, stage, progress, criteria, make_twin, only)
        spec = spec.with_effects({**spec.effects, **blows.effects})
    unknowns = list_unknowns(spec, only)
    inferred, measurements, search, held_out, decisions = infer(
        spec, measurements, unknowns, stage, progress, criteria, make_twin, deadline or Deadline(), announce, causes
    )
    read = rescale(read, search.bench, inferred.scales)
    return Material(read, measurements, search, held_out, blows, inferred, decisions)


def infer(
    spec: TwinSpec, measurements: Sequence[Measurements], unknowns: tuple[Unknown, ...], stage: Stage,
    progress: Callable[[int], None] | None, criteria: Criteria, make_twin: MakeTwin, deadline: Deadline,
    announce: Stage, causes: Sequence[str] | None = None,
) -> tuple[Inferred, list[Measurements], Search, HeldOut, dict[str, list[Rule]]]:  # fmt: skip
    """Compare hypotheses on all windows; then logs with the noise that was inferred, benches of them, and decisions.

    Causes that somebody names are fitted whatever the evidence.
    """
    window = spec.robot.window
    starts = list_starts(measurements, window)
    stage("linearising the twin about the logs")
    few, given = thin_out(spec, starts), (window, False, progress, criteria)
    bench = build_bench(spec, measurements, few, *given, make_twin=make_twin)
    every = -(-TRIED * len(unknowns) * bench.measured.size // SCREENED)
    scout = (
        bench if every < 2 else build_bench(spec, measurements, [s[::every] for s in few], *given, make_twin=make_twin)
    )
    ahead = open_held_out(spec, measurements, starts, progress, criteria, make_twin).errors
    if causes is None:
        for line in foresee(bench, scout, unknowns).describe():
            announce(line)
    # From here on it holds the deadline.
    inferred = infer_causes(bench, scout, ahead, unknowns, stage, deadline, causes)
    stage("predicting every stretch by fits to the others")
    calm = rescale(measurements, bench, inferred.scales)
    search = Search(build_bench(spec, calm, few, *given, make_twin=make_twin), unknowns)
    held_out = open_held_out(spec, calm, starts, progress, criteria, make_twin)
    decisions: dict[str, list[Rule]] = {}
    while True:
        divide(held_out, inferred)
        found = judge_causes(search, held_out, inferred)
        decisions |= found
        failing = {effect: rules[-1] for effect, rules in found.items() if not all(rule.passed for rule in rules)}
        if not failing or inferred.imposed:
            return inferred, calm, search, held_out, decisions
        inferred = inferred.drop(min(sorted(failing), key=lambda effect: failing[effect].statistic))  # it helps least


def divide(held_out: HeldOut, inferred: Inferred) -> None:
    """Judge every window by parameters that were inferred from others."""
    held_out.divide(*((inferred.deal(each), inferred.fitted) for each in (held_out.short, held_out.errors.bench)))


def open_held_out(
    spec: TwinSpec, measurements: Sequence[Measurements], starts: list[np.ndarray],
    progress: Callable[[int], None] | None, criteria: Criteria = CRITERIA, make_twin: MakeTwin = Twin,
) -> HeldOut:  # fmt: skip
    """Benches of the held-out windows."""
    window, few = spec.robot.window, thin_out(spec, starts, True)
    short = build_bench(spec, measurements, few, window, True, progress, criteria, make_twin=make_twin)
    far, horizon = long_starts(starts, window), HORIZONS_S[-1]
    return HeldOut(
        short, build_bench(spec, measurements, far, horizon, True, progress, criteria, True, make_twin)
    )  # fmt: skip
