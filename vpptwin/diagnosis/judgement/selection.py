"""Which suspects become causes: evidence on the fitted windows, judgement by held-out ones, rivals for every cause."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.rivals import (
    compare,
    evidence_against_rival,
    find_better,
    find_simpler,
    handicap,
    is_powerless,
    look_alike,
    tell_nothing,
    tell_roughness,
    trusts_errors,
    weigh_freedom,
    weigh_rivals,
)
from vpptwin.diagnosis.judgement.verdict import Rival
from vpptwin.diagnosis.search.fits import Fit, find_cheapest
from vpptwin.diagnosis.search.search import Search, Step
from vpptwin.system.deadline import Deadline, Stopped

Stage = Callable[[str], None]


@dataclass(frozen=True)
class Alternative:
    """Effects with their parameters that may be there instead, and standard deviations of these."""

    effects: frozenset[str]
    values: Mapping[Key, float]
    std: Mapping[Key, float]


@dataclass(frozen=True)
class Selection:
    """The causes, and what speaks for and against each.

    Attributes:
        fit: the causes fitted together.
        first: every suspect's drop in cost as the only cause, best first, as `rank_first` has it.
        rivals: cause → effects that explain the fitted windows nearly as well in its place.
        instead: cause → the fits with those effects in its place, in the same order.
        evidence: cause → drop in cost that it brings beside the others.
        left_out: effects that fitted windows asked for, and held-out ones are predicted worse with.
        unconfirmed: causes that held-out windows by themselves would not show, where errors have the last word.
        reduced: whether others were left out of what is written, so that these were found beside what is not there.
        unrivalled: causes in whose place no other was fitted.
        not_done: what was left out as it was stopped, in words.
        probability: cause → posterior probability that it is there, where all hypotheses were compared at once.
        kinds: cause → its kind, and the probability that anything of that kind is there.
    """

    fit: Fit
    first: list[tuple[str, float]]
    rivals: dict[str, list[Rival]]
    instead: dict[str, list[Alternative]]
    evidence: dict[str, float]
    left_out: frozenset[str] = frozenset()
    unconfirmed: frozenset[str] = frozenset()
    reduced: bool = False
    unrivalled: frozenset[str] = frozenset()
    not_done: tuple[str, ...] = ()
    probability: Mapping[str, float] | None = None
    kinds: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def reduce_to(self, fit: Fit) -> Selection:
        """The selection with a fit of fewer causes: with all of them held-out log was predicted worse."""
        gone, kept = self.fit.effects - fit.effects, fit.effects
        rivals = {e: [r for r in self.rivals[e] if r.effect not in gone] for e in kept}
        instead = {
            e: [
                replace(f, effects=f.effects - gone, values={k: v for k, v in f.values.items() if k[0] not in gone})
                for rival, f in zip(self.rivals[e], self.instead[e]) if rival.effect not in gone
            ]
            for e in kept
        }  # fmt: skip
        evidence = {e: self.evidence[e] for e in kept}
        return replace(self, fit=fit, rivals=rivals, instead=instead, evidence=evidence, left_out=self.left_out | gone,
                       unconfirmed=self.unconfirmed & kept, reduced=True)  # fmt: skip

    def confidence(self, effect: str) -> float:
        """Probability that the cause is right, among its rivals and that nothing is there."""
        criteria = self.fit.frame.criteria
        if self.probability is not None:
            return min(self.probability[effect], criteria.most_confident)
        doubt = float(np.exp(-0.5 * min(max(self.evidence[effect], 0.0), 1400.0) / criteria.temper))
        others = sum(rival.confidence for rival in self.rivals[effect])
        return float(min((1.0 - others) * (1.0 - 0.5 * doubt), criteria.most_confident))


def select_causes(search: Search, held_out: HeldOut, stage: Stage, deadline: Deadline | None = None) -> Selection:
    """Add the best suspect as long as it clears the bar, matters and improves held-out windows; prune; try rivals.

    Raises:
        Stopped: before suspects have been tried once; later the causes so far are what is returned.
    """
    return Choosing(search, held_out, stage, deadline or Deadline()).choose()


class Choosing:
    """The causes chosen so far, and what was learnt of the suspects on the way.

    Attributes:
        fit: the causes fitted together.
        barred: effects that don't come in again: they made way, did not last, or held-out windows spoke against them.
        left_out: the last of these.
        drops: cause → drop in cost when it was added, or of what it took the place of.
        near: cause → suspects that came near it then, or made way for it.
        seen: sets of causes.
        first: every suspect's drop in cost as the only cause.
        steps, swaps: how many suspects were looked for, and how many causes were exchanged.
        passed: cause → drop in cost as it passed for one, and by how much others tried then fell short of that.
        pending: causes with one that has passed and is not settled yet.
    """

    def __init__(self, search: Search, held_out: HeldOut, stage: Stage, deadline: Deadline) -> None:
        self.search, self.held_out, self.stage, self.deadline = search, held_out, stage, deadline
        self.fit = search.start
        self.barred, self.left_out = frozenset[str](), frozenset[str]()
        self.drops: dict[str, float] = {}
        self.near = defaultdict[str, frozenset[str]](frozenset)
        self.seen: set[frozenset[str]] = set()
        self.first: list[tuple[str, float]] = []
        self.steps = self.swaps = 0
        self.passed: dict[str, tuple[float, dict[str, float]]] = {}
        self.pending: Fit | None = None

    def choose(self) -> Selection:
        """The causes for which nothing better is found, or those so far where it is stopped."""
        try:
            return self.go_on()
        except Stopped:
            if not self.deadline.worth:
                raise
            return self.break_off()

    def go_on(self) -> Selection:
        """The causes for which nothing better is found."""
        while True:
            self.seen.add(self.fit.effects)
            if self.add() or self.drop_harmful() or self.drop_faint():
                continue
            self.stage("checking rivals")
            replaced = {
                effect: replace_cause(self.search, self.fit, effect, self.near[effect])
                for effect in sorted(self.fit.effects)
            }
            weigh = partial(evidence_against_rival, self.search, self.held_out, self.fit)
            evidence = {e: {r: weigh(tried) for r, tried in step.tried.items()} for e, step in replaced.items()}
            lasting = self.list_lasting(replaced, evidence)
            if self.swap(replaced, lasting):
                continue
            beside = {effect: self.fit.evidence_against(step.before) for effect, step in replaced.items()}
            rough = self.tell_roughness(replaced, evidence, beside)
            simpler = find_simpler(self.search, lasting, rough) if self.may_swap() else None
            if simpler is not None and exchange(self.fit, *simpler) not in self.seen and self.put(*simpler, replaced):
                continue
            return self.conclude(replaced, evidence, beside, rough)

    def add(self) -> bool:
        """Take in the best suspect that passes for a cause, and leave out what it makes superfluous."""
        criteria, fit = self.search.criteria, self.fit
        self.stage(f"trying candidates (named: {', '.join(sorted(fit.effects)) or 'nothing yet'})")
        step = self.search.extend(fit, self.barred)
        self.first, self.steps = self.first or rank_first(self.search, step), self.steps + 1
        step, accepted = accept_cause(self.search, self.held_out, step, self.drops)
        self.deadline.worth = True  # every suspect has been tried, and held against held-out windows
        if accepted is None or len(fit.effects) >= criteria.most_causes or self.steps >= criteria.most_steps:
            return False
        self.pending = step.tried[accepted]
        short = {other: self.pending.evidence_against(tried) for other, tried in step.tried.items()}
        self.passed[accepted] = step.drop(accepted), short
        taken = self.take(self.pending, {accepted: find_near(self.search, step, accepted)})
        self.pending = None
        if not taken:
            self.barred, self.left_out = self.barred | {accepted}, self.left_out | {accepted}
            return True
        self.drops[accepted] = step.drop(accepted)
        # What made way does not come back, nor what did not last: it would be taken in again and again.
        self.barred |= (step.before.effects | {accepted}) - self.fit.effects
        return True

    def take(self, found: Fit, near: dict[str, frozenset[str]]) -> bool:
        """Make what lasts of other causes those at hand; tells whether it did.

        Where errors have the last word it does not if they leave clearly more of held-out log: in a frame of its own,
        with other weights and noise, a fit that was better may be far worse.

        Args:
            found: the other causes.
            near: cause → suspects that came near it, where this is news.
        """
        known = defaultdict(frozenset, self.near) | near
        other = prune(self.search, self.held_out, found, known)
        sticks = self.search.sticks(other.effects)
        if trusts_errors(self.search) and self.held_out.is_farther(self.fit.values, other.values, sticks):
            return False
        self.fit, self.near = other, known
        return True

    def drop_harmful(self) -> bool:
        """Leave out the cause that held-out windows can best do without, if all together make them worse."""
        fit = self.fit
        if not fit.effects or not self.held_out.is_worse({}, fit.values, self.search.sticks(fit.effects)):
            return False
        lesser = [self.search.without(fit, effect) for effect in sorted(fit.effects)]
        best = min(lesser, key=lambda other: self.held_out.chi2(other.values))
        self.fit = self.search.reframe(best) if best.effects else self.search.start
        self.left_out |= fit.effects - self.fit.effects
        self.barred |= self.left_out
        return True

    def drop_faint(self) -> bool:
        """Leave out causes that came near nothing beside the others."""
        faint = {e for e in self.fit.effects if is_faint(self.search, self.fit, e)}
        for effect in self.fit.effects - faint:
            self.near[effect] |= faint
        for effect in sorted(faint):
            self.fit = self.search.without(self.fit, effect)
        if faint:
            self.fit = self.search.reframe(self.fit) if self.fit.effects else self.search.start
        self.barred |= faint
        return bool(faint)

    def list_lasting(
        self, replaced: Mapping[str, Step], evidence: Mapping[str, Mapping[str, float]]
    ) -> Mapping[str, Mapping[str, float]]:
        """The evidence against rivals that pass for causes in a cause's place, where errors have the last word."""
        if not trusts_errors(self.search):
            return evidence
        passes = partial(is_cause, self.search, self.held_out)
        return {
            effect: {r: found for r, found in row.items() if passes(replaced[effect], r, self.drops)}
            for effect, row in evidence.items()
        }

    def may_swap(self) -> bool:
        """Whether one cause may yet take the place of another."""
        criteria = self.search.criteria
        return self.swaps < (criteria.most_steps if trusts_errors(self.search) else criteria.most_swaps)

    def swap(self, replaced: Mapping[str, Step], evidence: Mapping[str, Mapping[str, float]]) -> bool:
        """Put a better rival in the place of a cause, or a better set of causes that differs in two."""
        better = find_better(self.search, evidence, self.drops) if self.may_swap() else None
        if better is not None and trusts_errors(self.search) and exchange(self.fit, *better) in self.seen:
            better = None  # evidence and errors rank in a circle
        if better is not None and self.put(*better, replaced):
            return True
        other = exchange_causes(self.search, self.held_out, self.fit, self.barred, self.stage)
        if other is None or self.steps + self.swaps >= self.search.criteria.most_steps:
            return False
        if not self.take(other, {}):
            return False
        self.swaps += 1
        return True

    def put(self, cause: str, rival: str, replaced: Mapping[str, Step]) -> bool:
        """Put a rival in the place of a cause; tells whether it stays there."""
        self.swaps += 1
        if not self.take(replaced[cause].tried[rival], {rival: self.near[cause] | {cause}}):
            self.seen.add(exchange(self.fit, cause, rival))
            return False
        if trusts_errors(self.search):  # what they voted out does not come back on evidence
            self.barred |= {cause}
        self.drops[rival] = self.drops.get(cause, 0.0)
        return True

    def tell_roughness(
        self, replaced: Mapping[str, Step], evidence: Mapping[str, Mapping[str, float]], beside: Mapping[str, float]
    ) -> dict[str, dict[str, float]]:
        """How much of the evidence for every cause against every rival tells nothing."""
        rough = {e: {r: tell_roughness(self.search, e, r, beside) for r in row} for e, row in evidence.items()}
        for effect, step in replaced.items():
            for rival, tried in step.tried.items():
                told = step.before, self.fit, tried, evidence[effect][rival]
                nothing = tell_nothing(self.search, self.held_out, *told)
                freedom = weigh_freedom(self.search, self.fit, tried, effect, rival)
                rough[effect][rival] = max(rough[effect][rival], nothing, freedom)
        return rough

    def conclude(
        self, replaced: Mapping[str, Step], evidence: Mapping[str, Mapping[str, float]], beside: dict[str, float],
        rough: Mapping[str, Mapping[str, float]],
    ) -> Selection:  # fmt: skip
        """The causes with their rivals."""
        rivals = {e: weigh_rivals(row, self.search.criteria, rough[e]) for e, row in evidence.items()}
        fits = {e: [replaced[e].tried[r.effect] for r in found] for e, found in rivals.items()}
        unknowns = self.search.unknowns
        instead = {
            e: [
                Alternative(f.effects, f.values, {u.key: f.stated_std(u) for u in unknowns if u.key in f.std})
                for f in row
            ]
            for e, row in fits.items()
        }
        before = {effect: step.before for effect, step in replaced.items()}
        unconfirmed = {e for e, fit in before.items() if not confirms(self.search, self.held_out, fit, self.fit)}
        left_out = self.left_out - self.fit.effects
        return Selection(self.fit, self.first, rivals, instead, beside, left_out, frozenset(unconfirmed))

    def break_off(self) -> Selection:
        """The causes so far; their rivals are those that came near as they were found, none fitted in their place."""
        fit = self.pending or self.fit
        evidence, rivals = dict[str, float](), dict[str, list[Rival]]()
        for effect in sorted(fit.effects):
            evidence[effect], short = self.passed.get(effect, (0.0, {}))
            others = {name: found for name, found in short.items() if name not in fit.effects}
            rivals[effect] = weigh_rivals(others, self.search.criteria)
        not_done = ["looking for further causes", *(f"fitting others in the place of {e}" for e in evidence)]
        instead, left_out = {effect: list[Alternative]() for effect in evidence}, self.left_out - fit.effects
        given = fit, self.first, rivals, instead, evidence, left_out
        return Selection(*given, unrivalled=fit.effects, not_done=tuple(not_done))


def rank_first(search: Search, first: Step) -> list[tuple[str, float]]:
    """Every suspect's drop in cost as the only cause, best first: refitted where it was, by linearisation elsewhere."""
    found: dict[str, float] = {}
    for start in search.rank(first.before):
        found.setdefault(start.effect, first.drop(start.effect) if start.effect in first.tried else start.drop)
    return sorted(found.items(), key=lambda item: -item[1])


def exchange(fit: Fit, effect: str, rival: str) -> frozenset[str]:
    """The effects of a fit with a rival in the place of one."""
    return fit.effects - {effect} | {rival}


def prune(search: Search, held_out: HeldOut, fit: Fit, near: dict[str, frozenset[str]]) -> Fit:
    """A fit in a frame of its own without what it can do without, on all windows, which is near what stays."""
    if not trusts_errors(search):
        return search.drop_superfluous(settle(search, fit))
    weigh = partial(evidence_against_rival, search, held_out)
    lesser = search.drop_superfluous(settle(search, fit), weigh)
    for effect in lesser.effects:
        near[effect] |= fit.effects - lesser.effects
    return lesser


def settle(search: Search, fit: Fit) -> Fit:
    """A fit in a frame of its own; several laws of friction from many places, unless motion is followed in the end."""
    framed = search.reframe(fit)
    return search.refine(framed) if search.bench.track is None else framed


def impose_causes(search: Search, effects: Sequence[str]) -> Selection:
    """Fit exactly these effects, whatever the evidence for them: what somebody who knows the truth would find."""
    first = rank_first(search, search.extend(search.start))
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


def exchange_causes(
    search: Search, held_out: HeldOut, fit: Fit, barred: frozenset[str], stage: Stage
) -> Fit | None:  # fmt: skip
    """A set of causes that differs in two and is better, on the fitted windows and not worse on the others; or None.

    Two wrong laws may hold against the right ones: no single exchange leads from one set to the other. Of many sets
    one fits by chance: where errors have the last word, the other windows have to show that it is better.
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
            agreed = gain > -search.criteria.sigmas_against * error and confirms(search, held_out, fit, other)
            if agreed and not held_out.errors.worsens(fit.values, other.values):
                best = won, other
    return best[1]


def accept_cause(
    search: Search, held_out: HeldOut, step: Step, earlier_drops: Mapping[str, float]
) -> tuple[Step, str | None]:
    """The suspect that becomes a cause, of a step in which it is judged; None for none.

    Of two effects that hide each other either alone may bring less than a wrong one which held-out log contradicts:
    where errors have the last word, those that fall behind are heard too if no other is left.
    """
    accepted = choose_cause(search, held_out, step, earlier_drops)
    if accepted is not None or not (step.behind and trusts_errors(search)):
        return step, accepted
    late = search.judge_behind(replace(step, tried={}))
    accepted = choose_cause(search, held_out, late, earlier_drops)
    return replace(late, tried=step.tried | late.tried), accepted


def choose_cause(search: Search, held_out: HeldOut, step: Step, earlier_drops: Mapping[str, float]) -> str | None:
    """The suspect of a step that fitted windows like best of those that pass for a cause; None if none does.

    Where errors have the last word it makes way for another that is better on all windows together.
    """
    passing = (e for e in step.ordered if is_cause(search, held_out, step, e, earlier_drops))
    best = next(passing, None)
    if best is None or not trusts_errors(search):
        return best
    for other in passing:
        against = evidence_against_rival(search, held_out, step.tried[best], step.tried[other])
        if against + handicap(search, best, other, {best: step.drop(best)}) < 0.0:
            best = other
    return best


def is_cause(search: Search, held_out: HeldOut, step: Step, effect: str, earlier_drops: Mapping[str, float]) -> bool:
    """Whether a suspect clears the bar, leaves its build tolerance and predicts held-out windows better.

    Beside a cause that looks like it, it must bring a good part of what that cause brought: no law of friction is
    exact, and what one leaves over another of its kind would mop up. `earlier_drops` are each of the frame in
    which its cause was added, where noise seemed larger than now: a yardstick, from which nothing is subtracted.
    Where errors have the last word, they outvote gains that contradict, and veto by one standard error, or two where
    evidence of fitted and held-out windows together is overwhelming; held-out windows need not show by two standard
    errors what both together show, nor tell from assumed gusts what settles their chi².
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
        favour = held_out.errors.prefer(step.before.values, tried.values)
        gain = max(gain, 0.0) if favour > criteria.sigmas_held_out else gain
        together = drop + float(np.clip(gain, 0.0, drop))
    strong = together > criteria.bars_strong * criteria.bar
    shown = ask_of_held_out(together, criteria) if trusts_errors(search) else criteria.sigmas_held_out
    agreed = gain > (-criteria.sigmas_against if strong else shown) * error
    agreed = agreed and drop + gain > criteria.bars_together * criteria.bar
    if trusts_errors(search) and gain > -criteria.sigmas_against * error:
        agreed = agreed or held_out.settles(step.before.values, tried.values)
    undecided = drop > criteria.bars_powerless * criteria.bar and gain > -criteria.sigmas_held_out * error
    few = trusts_errors(search) and held_out.count < criteria.judges
    if not agreed and not (undecided and (few or is_powerless(held_out, step.before, tried))):
        return False
    if held_out.errors.worsens(step.before.values, tried.values):
        return False
    even = criteria.sigmas_held_out if strong else criteria.sigmas_against
    return not agreed or favour > -even


def ask_of_held_out(evidence: float, criteria: Criteria) -> float:
    """Standard errors by which held-out windows must show a cause for which both speak together by `evidence`.

    From two at the bar to one where it is strong: a few windows that scatter never show by two what acts in some only.
    """
    span = [times * criteria.bar for times in (criteria.bars_together, criteria.bars_strong)]
    return float(np.interp(evidence, span, [criteria.sigmas_held_out, criteria.sigmas_against]))


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
    """Whether held-out windows alone show that a fit is better; they need not where errors have no last word.

    Unless it has an effect for which a place was looked for: somewhere chance always is.
    """
    looked_for = {u.effect.id for u in search.unknowns if u.effect.placed} & (after.effects - before.effects)
    if not trusts_errors(search) and not looked_for:
        return True
    gain, error = compare(search, held_out, before, after)
    if gain <= search.criteria.sigmas_held_out * error:
        return False
    few = not trusts_errors(search) or held_out.count < search.criteria.judges
    return few or held_out.errors.prefer(before.values, after.values) > 0.0


def find_near(search: Search, step: Step, effect: str) -> frozenset[str]:
    """Suspects that brought a good part of what a cause did, where linearisation may promise nothing of them."""
    if not trusts_errors(search):
        return frozenset()
    least = search.criteria.rival_hope * step.drop(effect)
    return frozenset(other for other in step.tried if other != effect and step.drop(other) > least)


def replace_cause(search: Search, fit: Fit, effect: str, near: frozenset[str]) -> Step:
    """The fit without a cause, and every shortlisted suspect, or one of those near it, tried in its place."""
    without = search.rederive(search.without(fit, effect))
    return search.extend(without, against=effect, whole=fit, near=near)
