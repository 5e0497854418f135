"""Which suspects become causes: evidence on the fitted windows, judgement by held-out ones, rivals for every cause."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.verdict import Rival
from vpptwin.diagnosis.search.fits import Fit, find_cheapest
from vpptwin.diagnosis.search.search import Search, Step
from vpptwin.effects import Effect
from vpptwin.effects import Stage as EffectStage

Stage = Callable[[str], None]


@dataclass(frozen=True)
class Selection:
    """The causes, and what speaks for and against each.

    Attributes:
        fit: the causes fitted together.
        first: the first step of the search, which ranks every suspect as the only cause.
        rivals: cause → effects that explain the fitted windows nearly as well in its place.
        instead: cause → the fits with those effects in its place, in the same order.
        evidence: cause → drop in cost that it brings beside the others.
        left_out: effects that fitted windows asked for, and held-out ones are predicted worse with.
        unconfirmed: causes that held-out windows by themselves would not show, where errors have the last word.
    """

    fit: Fit
    first: Step
    rivals: dict[str, list[Rival]]
    instead: dict[str, list[Fit]]
    evidence: dict[str, float]
    left_out: frozenset[str] = frozenset()
    unconfirmed: frozenset[str] = frozenset()

    def confidence(self, effect: str) -> float:
        """Probability that the cause is right, among its rivals and that nothing is there."""
        criteria = self.fit.frame.criteria
        doubt = float(np.exp(-0.5 * min(max(self.evidence[effect], 0.0), 1400.0) / criteria.temper))
        others = sum(rival.confidence for rival in self.rivals[effect])
        return float(min((1.0 - others) * (1.0 - 0.5 * doubt), criteria.most_confident))


def select_causes(search: Search, held_out: HeldOut, stage: Stage) -> Selection:
    """Add the best suspect as long as it clears the bar, matters and improves held-out windows; prune; try rivals."""
    fit, barred, swaps, steps, criteria = search.start, frozenset[str](), 0, 0, search.criteria
    left_out = frozenset[str]()
    earlier_drops: dict[str, float] = {}
    first: Step | None = None
    while True:
        named = ", ".join(sorted(fit.effects)) or "nothing yet"
        stage(f"trying suspects (named: {named})")
        step = search.extend(fit, barred)
        first, steps = first or step, steps + 1
        step, accepted = accept_cause(search, held_out, step, earlier_drops)
        if accepted is not None and len(fit.effects) < criteria.most_causes and steps < criteria.most_steps:
            best, earlier_drops[accepted] = step.tried[accepted], step.drop(accepted)
            fit = search.drop_superfluous(settle(search, best))
            # What made way does not come back, nor what did not last: it would be taken in again and again.
            barred |= (step.before.effects | {accepted}) - fit.effects
            continue
        if fit.effects and held_out.is_worse({}, fit.values, search.sticks(fit.effects)):
            lesser = drop_harmful(search, held_out, fit)
            left_out |= fit.effects - lesser.effects
            barred, fit = barred | left_out, lesser
            continue
        if faint := {e for e in fit.effects if trusts_errors(search) and is_faint(search, fit, e)}:
            for effect in sorted(faint):
                fit = search.without(fit, effect)
            fit, barred = search.reframe(fit) if fit.effects else search.start, barred | faint
            continue
        stage("checking rivals")
        replaced = {effect: replace_cause(search, fit, effect) for effect in sorted(fit.effects)}
        evidence = {
            effect: {rival: evidence_against_rival(search, held_out, fit, tried) for rival, tried in step.tried.items()}
            for effect, step in replaced.items()
        }
        # Where what made way is barred no swap comes back, so that the best is reached.
        most = criteria.most_steps if trusts_errors(search) else criteria.most_swaps
        better = find_better(search, evidence, earlier_drops) if swaps < most else None
        other = exchange_causes(search, held_out, fit, barred, stage) if better is None else None
        if other is not None and steps + swaps < criteria.most_steps:
            fit, swaps = search.drop_superfluous(settle(search, other)), swaps + 1
            continue
        if better is None:
            beside = {effect: fit.evidence_against(step.before) for effect, step in replaced.items()}
            rough = {e: {r: tell_roughness(search, e, r, beside) for r in row} for e, row in evidence.items()}
            for effect, step in replaced.items():
                as_good = {r for r, t in step.tried.items() if leaves_as_little(search, held_out, step.before, fit, t)}
                rough[effect] |= dict.fromkeys(as_good, np.inf)
            rivals = {e: weigh_rivals(row, criteria, rough[e]) for e, row in evidence.items()}
            instead = {e: [replaced[e].tried[r.effect] for r in found] for e, found in rivals.items()}
            unconfirmed = {e for e, step in replaced.items() if not confirms(search, held_out, step.before, fit)}
            return Selection(fit, first, rivals, instead, beside, left_out - fit.effects, frozenset(unconfirmed))
        cause, rival = better
        if trusts_errors(search):  # what they voted out does not come back on evidence
            barred |= {cause}
        earlier_drops[rival] = earlier_drops.get(cause, 0.0)
        fit = search.drop_superfluous(settle(search, replaced[cause].tried[rival]))
        swaps += 1


def settle(search: Search, fit: Fit) -> Fit:
    """A fit in a frame of its own; several laws of friction from many places, unless motion is followed in the end."""
    framed = search.reframe(fit)
    return search.refine(framed) if search.bench.track is None else framed


def impose_causes(search: Search, effects: Sequence[str]) -> Selection:
    """Fit exactly these effects, whatever the evidence for them: what somebody who knows the truth would find."""
    first = search.extend(search.start)
    fit = fit_together(search, effects)
    return Selection(fit, first, {e: [] for e in effects}, {e: [] for e in effects}, dict.fromkeys(effects, np.inf))


def fit_together(search: Search, effects: Sequence[str]) -> Fit:
    """Free these effects one after the other, each from its best starts, all of them fitted together in the end.

    Those that the windows do not show at all, as limits that nothing comes near, have no start and are left out.
    """
    fit = search.start
    for effect in effects:
        starts = [start for start in search.rank(fit) if start.effect == effect]
        if not starts:
            continue
        freed = fit.effects | {effect}
        found = [search.judge_alone(search.fit(freed, s.values, fit.about)) for s in starts[: search.criteria.starts]]
        fit = search.reframe(find_cheapest(found))
    return fit


def drop_harmful(search: Search, held_out: HeldOut, fit: Fit) -> Fit:
    """A fit without the cause that held-out windows can best do without."""
    lesser = [search.without(fit, effect) for effect in sorted(fit.effects)]
    best = min(lesser, key=lambda other: held_out.chi2(other.values))
    return search.reframe(best) if best.effects else search.start


def exchange_causes(
    search: Search, held_out: HeldOut, fit: Fit, barred: frozenset[str], stage: Stage
) -> Fit | None:  # fmt: skip
    """A set of causes that differs in two and is better, on the fitted windows and not worse on the others; or None.

    Two wrong laws may hold against the right ones: no single exchange leads from one set to the other.
    """
    if not fit.effects:
        return None
    stage("exchanging causes two by two")
    best: tuple[float, Fit | None] = (0.0, None)
    for other in search.neighbours(fit):
        more = max(len(other.effects) - len(fit.effects), 0)
        won = other.evidence_against(fit) - search.criteria.better - more * search.criteria.bar
        if won > best[0] and not other.effects & barred and len(other.effects) <= search.criteria.most_causes:
            gain, error = compare(search, held_out, fit, other)
            if gain > -search.criteria.sigmas_against * error and not held_out.worsens(fit.values, other.values):
                best = won, other
    return best[1]


def accept_cause(
    search: Search, held_out: HeldOut, step: Step, earlier_drops: Mapping[str, float]
) -> tuple[Step, str | None]:
    """The suspect that becomes a cause, of a step in which it is judged; None for none.

    Of two effects that hide each other either alone may bring less than a wrong one which held-out log contradicts:
    where errors have the last word, those that fall behind are heard too if no other is left.
    """
    accepted = next((e for e in step.ordered if is_cause(search, held_out, step, e, earlier_drops)), None)
    if accepted is not None or not (step.behind and trusts_errors(search)):
        return step, accepted
    late = search.judge_behind(replace(step, tried={}))
    accepted = next((e for e in late.ordered if is_cause(search, held_out, late, e, earlier_drops)), None)
    return replace(late, tried=step.tried | late.tried), accepted


def is_cause(search: Search, held_out: HeldOut, step: Step, effect: str, earlier_drops: Mapping[str, float]) -> bool:
    """Whether a suspect clears the bar, leaves its build tolerance and predicts held-out windows better.

    Beside a cause that looks like it, it must bring a good part of what that cause brought: no law of friction is
    exact, and what one leaves over another of its kind would mop up. `earlier_drops` are each of the frame in
    which its cause was added, where noise seemed larger than now: a yardstick, from which nothing is subtracted.
    Where errors have the last word, they outvote gains that contradict, and veto by one standard error, or two where
    evidence of fitted and held-out windows together is overwhelming.
    """
    tried, drop, criteria = step.tried[effect], step.drop(effect), search.criteria
    kin = [d for e, d in earlier_drops.items() if e in tried.effects and look_alike(search, effect, e)]
    if drop < criteria.bars_fitted * criteria.bar + criteria.kinship * max(kin, default=0.0):
        return False
    if is_faint(search, tried, effect):
        return False
    gain, error = compare(search, held_out, step.before, tried)
    favour, together = 0.0, drop
    if trusts_errors(search):
        favour = held_out.prefer(step.before.values, tried.values)
        gain = max(gain, 0.0) if favour > criteria.sigmas_held_out else gain
        together = drop + float(np.clip(gain, 0.0, drop))
    strong = together > criteria.bars_strong * criteria.bar
    agreed = gain > (-criteria.sigmas_against if strong else criteria.sigmas_held_out) * error
    agreed = agreed and drop + gain > criteria.bars_together * criteria.bar
    undecided = drop > criteria.bars_powerless * criteria.bar and gain > -criteria.sigmas_held_out * error
    few = trusts_errors(search) and held_out.count < criteria.judges
    if not agreed and not (undecided and (few or is_powerless(held_out, step.before, tried))):
        return False
    if held_out.worsens(step.before.values, tried.values):
        return False
    even = criteria.sigmas_held_out if strong else criteria.sigmas_against
    return not agreed or favour > -even


def is_faint(search: Search, fit: Fit, effect: str) -> bool:
    """Whether a fit leaves an effect within its build tolerance or, where errors have the last word, near nothing."""
    own, criteria = [u for u in search.unknowns if u.effect.id == effect], search.criteria
    if all(abs(fit.values[u.key] - u.nominal) < criteria.tolerances * u.parameter.tolerance for u in own):
        return True
    if not trusts_errors(search) or own[0].is_limit:
        return False
    strengths = [u for u in own if u.parameter in u.effect.strengths]
    return all(abs(fit.values[u.key] - u.nominal) < criteria.clear_of_off * fit.stated_std(u) for u in strengths)


def confirms(search: Search, held_out: HeldOut, before: Fit, after: Fit) -> bool:
    """Whether held-out windows alone show that a fit is better, where errors have the last word; else they need not."""
    if not trusts_errors(search):
        return True
    gain, error = compare(search, held_out, before, after)
    shown = gain > search.criteria.sigmas_held_out * error
    return shown and (held_out.count < search.criteria.judges or held_out.prefer(before.values, after.values) > 0.0)


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

    Where errors have the last word, it is theirs if they differ by `sigmas_held_out` standard errors; and a rival that
    makes them grow is never better.
    """
    gain, error = compare(search, held_out, rival, fit)
    evidence = fit.evidence_against(rival) + float(np.sign(gain) * max(abs(gain) - error, 0.0))
    if not trusts_errors(search):
        return evidence
    sigmas = held_out.prefer(rival.values, fit.values)
    if abs(sigmas) > search.criteria.sigmas_held_out:
        evidence = float(np.sign(sigmas)) * max(float(np.sign(sigmas)) * evidence, sigmas**2)
    return max(evidence, 0.0) if held_out.worsens(fit.values, rival.values) else evidence


def leaves_as_little(search: Search, held_out: HeldOut, without: Fit, fit: Fit, rival: Fit) -> bool:
    """Whether far more held-out error is left than noise makes, and a rival leaves no more of it than a cause does.

    What a model of noise says of so large a rest tells nothing between the two, where errors have the last word.

    Args:
        search: of all fits.
        held_out: the windows that judge.
        without: the fit without that cause.
        fit: all causes.
        rival: another in the place of that cause.
    """
    if not trusts_errors(search) or (left := held_out.chi2(fit.values) - 1.0) <= search.criteria.missed:
        return False
    there, other = (held_out.chi2(each.values) - 1.0 for each in (without, rival))
    return other < left + search.criteria.worse * min(left, there - left)


def look_alike(search: Search, first: str, second: str) -> bool:
    """Whether two effects are hard to tell apart: by the catalogue, or as two kinds of dry friction on one joint."""
    effects = {u.effect.id: u.effect for u in search.unknowns}
    one, other = effects[first], effects[second]
    return rub_together(one, other) or second in one.look_alikes or first in other.look_alikes


def rub_together(one: Effect, other: Effect) -> bool:
    """Whether two effects are laws of dry friction of one joint."""
    return one.stage is other.stage is EffectStage.FRICTION and one.target == other.target


def replace_cause(search: Search, fit: Fit, effect: str) -> Step:
    """The fit without a cause, and every shortlisted suspect tried in its place."""
    return search.extend(search.rederive(search.without(fit, effect)), against=effect, values=fit.values)


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
