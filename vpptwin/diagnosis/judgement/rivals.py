"""What speaks for one set of causes against another: evidence, held-out windows, and what neither can tell."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.judgement.blocks import blocks_of, sum_blocks
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.verdict import Rival
from vpptwin.diagnosis.search.fits import Fit
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.solution import price_of_freedom, solve_hypothesis
from vpptwin.effects import Effect
from vpptwin.effects import Stage as EffectStage


def is_powerless(held_out: HeldOut, before: Fit, after: Fit) -> bool:
    """Whether two fits predict so much the same for held-out windows that these cannot judge between them."""
    likelihood = held_out.likelihood({}, after.likelihood.gust)
    changed = likelihood.whiten(held_out.residual(before.likeliest) - held_out.residual(after.likeliest))
    return bool((changed**2).sum() < after.frame.criteria.powerless)


def trusts_errors(search: Search) -> bool:
    """Whether errors on held-out flights have the last word.

    How gusts push on rigs other than the drone is assumed, not known, and evidence stands and falls with that.
    """
    return search.bench.guessed


def compare(search: Search, held_out: HeldOut, before: Fit, after: Fit) -> tuple[float, float]:
    """Drop in held-out surprise from one fit to another, and its standard error."""
    fits = [(fit, search.sticks(fit.effects)) for fit in (before, after)]
    return held_out.weigh(fits[0], fits[1])


def evidence_against_rival(search: Search, held_out: HeldOut, fit: Fit, rival: Fit) -> float:
    """Evidence for a fit against a rival: on the fitted windows, and on the held-out ones beyond a standard error.

    Where errors have the last word, it is theirs if they differ by `sigmas_held_out` standard errors, and chi² does not
    say otherwise; and a rival that makes them grow is never better.
    """
    gain, error = compare(search, held_out, rival, fit)
    evidence = fit.evidence_against(rival) + float(np.sign(gain) * max(abs(gain) - error, 0.0))
    if not trusts_errors(search):
        return evidence
    sigmas = held_out.errors.prefer(rival.values, fit.values)
    better, worse = (fit, rival) if sigmas > 0.0 else (rival, fit)
    contradicted = held_out.is_farther(worse.values, better.values, False)
    if abs(sigmas) > search.criteria.sigmas_held_out and not contradicted:
        evidence = float(np.sign(sigmas)) * max(float(np.sign(sigmas)) * evidence, sigmas**2)
    return max(evidence, 0.0) if held_out.errors.worsens(fit.values, rival.values) else evidence


def tell_nothing(
    search: Search, held_out: HeldOut, without: Fit, fit: Fit, rival: Fit, evidence: float
) -> float:  # fmt: skip
    """How much of the evidence for a cause against a rival that leaves no more held-out error tells nothing.

    Where errors have the last word and far more is left than noise makes, nothing tells that a model of noise says of
    it. Else evidence counts by its standard errors, as windows scatter (Vuong, Likelihood ratio tests for model
    selection and non-nested hypotheses, 1989): noise that is not as modelled favours one as well as the other.

    Args:
        search: of all fits.
        held_out: the windows that judge.
        without: the fit without that cause.
        fit: all causes.
        rival: another in the place of that cause.
        evidence: for all causes against that.
    """
    if not trusts_errors(search):
        return 0.0
    criteria = search.criteria
    there, left, other = (held_out.chi2(each.values) - 1.0 for each in (without, fit, rival))
    if other >= left + criteria.worse * min(max(left, 1.0), there - left) and not is_open(search, held_out, fit, rival):
        return 0.0
    if left > criteria.missed:
        return float("inf")
    found, error = weigh_windows(search, held_out, fit, rival)
    return evidence - criteria.temper * max(found / max(error, 1e-9), 0.0) ** 2


def is_open(search: Search, held_out: HeldOut, fit: Fit, rival: Fit) -> bool:
    """Whether two fits differ in effects that are hard to tell apart, and held-out windows do not favour the first.

    Not by a standard error, with all that either leaves open: errors are those of a point, which chance sets.
    """
    pairs = [(one, other) for one in fit.effects - rival.effects for other in rival.effects - fit.effects]
    if not any(look_alike(search, one, other) for one, other in pairs):
        return False
    gain, error = compare(search, held_out, rival, fit)
    return gain <= error


def weigh_windows(search: Search, held_out: HeldOut, fit: Fit, rival: Fit) -> tuple[float, float]:
    """Evidence for a fit against a rival, of fitted and held-out windows, and its standard error by their scatter."""
    gain, error = compare(search, held_out, rival, fit)
    drop = search.cost_by_window(rival) - search.cost_by_window(fit)
    sums = sum_blocks(drop[:, None], blocks_of(search.bench.windows, search.criteria.block))[:, 0]
    scatter = np.sqrt(len(sums)) * sums.std(ddof=1) if len(sums) > 1 else np.inf
    return float(fit.evidence_against(rival) + gain), float(np.hypot(scatter, error))


def look_alike(search: Search, first: str, second: str) -> bool:
    """Whether two effects are hard to tell apart: by the catalogue, or as two kinds of dry friction on one joint."""
    effects = {u.effect.id: u.effect for u in search.unknowns}
    one, other = effects[first], effects[second]
    return rub_together(one, other) or second in one.look_alikes or first in other.look_alikes


def rub_together(one: Effect, other: Effect) -> bool:
    """Whether two effects are laws of dry friction of one joint."""
    return one.stage is other.stage is EffectStage.FRICTION and one.places == other.places


def find_better(
    search: Search, evidence: Mapping[str, Mapping[str, float]], earlier_drops: Mapping[str, float]
) -> tuple[str, str] | None:
    """The cause that a rival should take the place of, and that rival; None if the evidence prefers none."""
    behind = [
        (found + handicap(search, effect, rival, earlier_drops), effect, rival)
        for effect, row in evidence.items()
        for rival, found in row.items()
    ]
    least, effect, rival = min(behind, default=(0.0, "", ""))
    return (effect, rival) if least < 0.0 else None


def find_simpler(
    search: Search, evidence: Mapping[str, Mapping[str, float]], rough: Mapping[str, Mapping[str, float]]
) -> tuple[str, str] | None:
    """A cause and a rival of fewer parameters that nothing tells from it, and should be named in its place; or None."""
    number = {u.effect.id: len(u.effect.parameters) for u in search.unknowns}
    alike = [
        (number[rival] - number[effect], found, effect, rival)
        for effect, row in evidence.items()
        for rival, found in row.items()
        if np.isinf(rough[effect][rival]) and number[rival] < number[effect]
    ]
    return min(alike)[2:] if alike else None


def handicap(search: Search, effect: str, rival: str, earlier_drops: Mapping[str, float]) -> float:
    """Evidence by which a rival must be better to take the place of a cause.

    How a slider sticks makes the evidence rough: of two laws of a joint's dry friction that differ by less than such
    laws are inexact, it is the one with fewer parameters that is named.
    """
    effects = {u.effect.id: u.effect for u in search.unknowns}
    better = search.criteria.better
    richer = len(effects[rival].parameters) - len(effects[effect].parameters)
    if richer == 0 or not rub_together(effects[effect], effects[rival]):
        return better
    inexact = max(better, search.criteria.kinship * earlier_drops.get(effect, 0.0))
    return inexact if richer > 0 else -inexact


def weigh_freedom(search: Search, fit: Fit, rival: Fit, effect: str, other: str) -> float:
    """How much of the evidence for a cause against a rival is the freedom of a rival that moves the same weight.

    Where logs show only mass times distance, a weight hung on a body is one that lies elsewhere in it: that it has more
    numbers, from a range that nobody knows, does not tell them apart.
    """
    effects = {u.effect.id: u.effect for u in search.unknowns}
    one, two = effects[effect], effects[other]
    if one.target != two.target or not set(one.writes) & set(two.writes) & {"body_ipos"}:
        return 0.0
    solved = [(each, solve_hypothesis(each.about, search.unknowns, each.effects)) for each in (fit, rival)]
    own, price = (price_of_freedom(solution, search.unknowns, each.effects) for each, solution in solved)
    return max(price - own, 0.0)


def tell_roughness(search: Search, effect: str, rival: str, drops: Mapping[str, float]) -> float:
    """Evidence that tells nothing between a cause and a rival.

    What shapes dry friction, as lopsidedness does, may be the same law as a force beside that friction: how a slider
    sticks tells them apart by no more than laws of dry friction are inexact, of which the evidence for the friction
    itself is the measure.

    Args:
        search: that knows the effects.
        effect: the cause.
        rival: what is tried in its place.
        drops: cause → drop in cost that it brings beside the others.
    """
    effects = {u.effect.id: u.effect for u in search.unknowns}
    pair = effects[effect], effects[rival]
    shaping = [each for each in pair if each.stage is EffectStage.FRICTION and each.modifies]
    if not shaping or rub_together(*pair):
        return 0.0
    shaped = [drop for cause, drop in drops.items() if cause == effect or rub_together(effects[cause], shaping[0])]
    return search.criteria.kinship * max(shaped)


def weigh_rivals(
    evidence: Mapping[str, float], criteria: Criteria, rough: Mapping[str, float] | None = None
) -> list[Rival]:
    """Rivals that these flights cannot tell from a cause, with probabilities, the most probable first.

    Args:
        evidence: rival → evidence for the cause against it.
        criteria: how far evidence is believed, and which rivals are near.
        rough: rival → how much of that tells nothing; None for all of it does.
    """
    rough = rough or {}
    gaps = {name: max(found - rough.get(name, 0.0), 0.0) / criteria.temper for name, found in evidence.items()}
    close = {name: gap for name, gap in gaps.items() if gap < criteria.rival_sigma**2}
    weights = {name: float(np.exp(-0.5 * gap)) for name, gap in close.items()}
    total = 1.0 + sum(weights.values())
    ordered = sorted(close, key=lambda name: close[name])
    return [Rival(name, weights[name] / total, float(np.sqrt(close[name]))) for name in ordered]
