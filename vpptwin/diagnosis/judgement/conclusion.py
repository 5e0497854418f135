"""A verdict from the causes that were selected: how sure each is, what is doubtful about it, and what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest

import mujoco
import numpy as np

from vpptwin.diagnosis.evidence.contradiction import weigh_causes
from vpptwin.diagnosis.evidence.logged_inputs import describe_input_error, describe_turned, describe_weak_inputs
from vpptwin.diagnosis.evidence.other_motors import describe_other_motors
from vpptwin.diagnosis.judgement.case import Rule, judge_twin
from vpptwin.diagnosis.judgement.holdout import HeldOut, Score
from vpptwin.diagnosis.judgement.power import Shown, judge_power
from vpptwin.diagnosis.judgement.selection import CALIBRATION, Alternative, Explanation, Selection
from vpptwin.diagnosis.judgement.verdict import Cause, Estimate, Misfit, Rival, Unexplained, Verdict
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects import find_effect
from vpptwin.effects.joint import apply_cogging
from vpptwin.estimation.measurements import Measurements, list_warnings
from vpptwin.logs.flight import Flight
from vpptwin.twin.spec import TwinSpec

CONTRADICTED = (
    "left out {}: fitted data need it, held-out data are in part predicted worse with it; one set of parameters may "
    "not fit all of these logs: diagnose them one by one"
)
STIFF = 0.99
"""Least impedance (`solimp`) of an equality that couples as a gear does."""
SOFT = (
    "equality {} of the MJCF is soft (solimp up to {:.4g}): if it is rigid, such as a gear or a linkage, "
    'solimp="0.9999 0.9999 0.001" solref="0.004 1" make it so'
)
PASSING = "{}: a wave that does not repeat along the way may be any force that depends on place; at most 89 % probable"
UNRIVALLED = "{}: not every rival was fitted in its place; at most 89 % probable"


def conclude(
    spec: TwinSpec, flights: Sequence[Flight], measurements: Sequence[Measurements], search: Search, held_out: HeldOut,
    selection: Selection, unexplained: Unexplained, shown: Shown, decisions: Mapping[str, list[Rule]],
) -> Verdict:  # fmt: skip
    """Put the verdict together.

    Args:
        spec: the twin.
        flights: logs that were diagnosed.
        measurements: what they tell.
        search: with the fitted windows.
        held_out: those that judge.
        selection: the causes.
        unexplained: what they leave.
        shown: what the logs would have shown beside them.
        decisions: effect → rules that it passed, or not.
    """
    fit, criteria, guessed = selection.fit, search.criteria, search.bench.guessed
    before, after = held_out.score({}), held_out.score(fit.values)
    missed = after.chi2 > criteria.missed and unexplained.significant  # gusts make errors, too
    denied: dict[str, str] = {}
    if guessed:
        seen = weigh_causes(spec, measurements, fit.values, criteria)
        denied = {s.effect: s.tell(criteria) for s in seen if s.contradicts(criteria)}
    # What leaves half of the error ahead is judged as its probability says.
    left = share_ahead(before, after) - 0.5
    sober = 1.0 - (1.0 - criteria.sober) * float(np.clip(2.0 * left, 0.0, 1.0)) * unexplained.significant
    if fit.effects and not judge_twin(held_out.errors.compare({}, fit.values)).passed:
        sober = criteria.sober
    nearly = not guessed and unexplained.sigma > criteria.doubted
    doubtful = selection.reduced or unexplained.significant or nearly
    most = criteria.suggested if doubtful else 1.0
    causes, order, doubts = [], {}, dict.fromkeys(selection.unrivalled & fit.effects, UNRIVALLED)
    doubts |= dict.fromkeys(list_passing(search, fit), PASSING)
    for effect in sorted(fit.effects):
        rest = {key: value for key, value in fit.values.items() if key[0] != effect}
        gain, interval = held_out.share_removed(rest, fit.values, {})
        order[effect] = held_out.errors.compare(rest, fit.values).gain
        confidence = min(sober * selection.confidence(effect), criteria.suggested if effect in doubts else most)
        if effect in denied:
            confidence = min(confidence, criteria.sober)
        causes.append(tell_cause(search, selection, effect, confidence, gain, interval))
    causes = sorted(causes, key=lambda cause: -order[cause.effect])
    alike = {rival.effect for cause in causes for rival in cause.also_explained_by}
    cleared, unseen = judge_power(search, shown, fit.effects | alike)
    if selection.not_done:  # what comes near nothing beside these may do so beside all causes
        cleared = []
    warnings = describe_other_motors(spec, measurements) if guessed else []
    warnings += [*describe_turned(spec), *denied.values(), *(doubts[e].format(e) for e in sorted(doubts))]
    if missed:
        warnings += describe_soft_couplings(spec.model)
        warnings += describe_weak_inputs(spec, measurements, criteria) if guessed else []
    if selection.left_out:
        warnings.append(CONTRADICTED.format(" and ".join(sorted(selection.left_out))))
    warnings += filter(None, (describe_input_error(spec, find_effect(spec.catalogue, e)) for e in sorted(fit.effects)))
    warnings += list_warnings(flights, measurements)
    return Verdict(
        logs=[str(flight.path) for flight in flights],
        twin=spec.name,
        windows=len(search.bench.windows),
        held_out_windows=len(held_out.short.windows),
        before=before,
        after=after,
        gap=bool(causes) or unexplained.significant or missed,
        causes=causes,
        unexplained=unexplained,
        cleared=cleared,
        unseen=unseen,
        improvement=held_out.errors.compare({}, fit.values).change if causes else {},
        misfit=find_misfit(search, held_out, fit, after.chi2) if missed else None,
        warnings=warnings,
        decisions=dict(decisions),
    )


def share_ahead(before: Score, after: Score) -> float:
    """Least share of the error of the pose that is left, of all horizons at which one was measured."""
    pairs = [(before.position_rmse_m, after.position_rmse_m), (before.angle_rmse_rad, after.angle_rmse_rad)]
    told = [(first, last) for olds, news in pairs if olds and news for first, last in zip(olds, news)]
    return min((last / first for first, last in told if first > 0.0 and np.isfinite(last)), default=1.0)


def list_passing(search: Search, fit: Explanation) -> set[str]:
    """Cogging that does not come again along the way, and what else depends on place there.

    Less than `comes_again` times over the travel of its joint a wave is any force that depends on place: what lies
    beside it makes up for what that is not.
    """
    loads, robot, passing = search.bench.spec.robot.loads, search.bench.spec.robot, set[str]()
    effects = {u.effect.id: u.effect for u in search.unknowns if u.effect.id in fit.effects}
    if loads is None:
        return passing
    for effect in (each for each in effects.values() if each.apply is apply_cogging):
        travel = 2.0 * float(loads.travel[robot.locate(effect).dof])
        if fit.values[effect.id, "waves"] * travel < search.criteria.comes_again:
            passing |= {e.id for e in effects.values() if e.target == effect.target and e.follows == "position"}
    return passing


def describe_soft_couplings(model: mujoco.MjModel) -> list[str]:
    """Equalities of an MJCF that give: MuJoCo's own softness lets joints that a gear couples part by millimetres."""
    soft = np.flatnonzero(model.eq_active0 & (model.eq_solimp[:, 1] < STIFF))
    return [SOFT.format(model.equality(int(i)).name or i, model.eq_solimp[i, 1]) for i in soft]


def tell_cause(
    search: Search, selection: Selection, effect: str, confidence: float, gain: float, interval: tuple[float, float]
) -> Cause:
    """A cause with its parameters, and its rivals, which are doubted as much as it is."""
    own = [u for u in search.unknowns if u.effect.id == effect]
    doubt = confidence / max(selection.confidence(effect), 1e-12)
    rivals = [
        replace(describe_rival(search, rival, there), confidence=doubt * rival.confidence)
        for rival, there in zip_longest(selection.rivals[effect], selection.instead[effect])
    ]
    found = {u.parameter.name: estimate(u, selection.fit) for u in own}
    kind, odds = selection.kinds.get(effect, ("", 0.0))
    sure = max(doubt * CALIBRATION.apply(odds), confidence) if kind else 0.0
    weak = max(confidence, sure) < search.criteria.named
    told = selection.odds[effect]
    return Cause(effect, confidence, found, gain, rivals, own[0].effect.summary, interval, 0, kind, sure, weak,
                 told if np.isfinite(told) else None)  # fmt: skip


def describe_rival(search: Search, rival: Rival, there: Alternative | None) -> Rival:
    """A rival with its parameters in the set of effects that has it; without them where none was fitted."""
    own = [u for u in search.unknowns if u.effect.id == rival.effect]
    found = {
        u.parameter.name: Estimate(there.values[u.key], u.parameter.unit, there.std[u.key], float(u.nominal))
        for u in own
        if there is not None and u.key in there.std
    }
    return replace(rival, parameters=found, summary=own[0].effect.summary, kind=own[0].effect.kind) if own else rival


def find_misfit(search: Search, held_out: HeldOut, fit: Explanation, chi2: float) -> Misfit:
    """How far the extended twin is off, which is far above what the sensors make."""
    found = Misfit(float(np.sqrt(chi2)), *held_out.errors.locate_miss(fit.values))
    explained = float(min((chi2 - held_out.chi2(fit.likeliest)) / (chi2 - 1.0), 1.0))
    if explained < 0.5:
        return found
    moved: dict[str, float] = {}
    for unknown in search.unknowns:
        off = abs(fit.tolerated.get(unknown.key, unknown.nominal) - unknown.nominal)
        tolerance = max(unknown.parameter.tolerance, 1e-12)
        moved[unknown.effect.id] = max(moved.get(unknown.effect.id, 0.0), off / tolerance)
    within = [e for e in sorted(moved, key=lambda e: -moved[e]) if moved[e] > 1.0]
    return replace(found, within=within, explained=explained if within else 0.0)


def estimate(unknown: Unknown, fit: Explanation) -> Estimate:
    """A fitted parameter with its unit and uncertainty."""
    return Estimate(fit.values[unknown.key], unknown.parameter.unit, fit.stated_std(unknown), float(unknown.nominal))
