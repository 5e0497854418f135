"""Which suspects become causes: evidence on the fitted windows, judgement by held-out ones, rivals for every cause."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.holdout import HeldOut
from vpptwin.diagnosis.judgement.rivals import (
    compare,
    evidence_against_rival,
    find_better,
    is_powerless,
    look_alike,
    tell_roughness,
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
    """Effects with their parameters that may be there instead."""

    effects: frozenset[str]
    values: Mapping[Key, float]


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
            if self.add() or self.drop_harmful() or self.drop_faint():
                continue
            self.stage("checking rivals")
            replaced = {
                effect: replace_cause(self.search, self.fit, effect, self.near[effect])
                for effect in sorted(self.fit.effects)
            }
            weigh = partial(evidence_against_rival, self.search, self.held_out, self.fit)
            evidence = {e: {r: weigh(tried) for r, tried in step.tried.items()} for e, step in replaced.items()}
            if self.swap(replaced, evidence):
                continue
            beside = {effect: self.fit.evidence_against(step.before) for effect, step in replaced.items()}
            rough = self.tell_roughness(replaced, evidence, beside)
            return self.conclude(replaced, evidence, beside, rough)

    def add(self) -> bool:
        """Take in the best suspect that passes for a cause, and leave out what it makes superfluous."""
        criteria, fit = self.search.criteria, self.fit
        self.stage(f"trying candidates (named: {', '.join(sorted(fit.effects)) or 'nothing yet'})")
        step = self.search.extend(fit, self.barred)
        self.first, self.steps = self.first or rank_first(self.search, step), self.steps + 1
        accepted = choose_cause(self.search, self.held_out, step, self.drops)
        self.deadline.worth = True  # every suspect has been tried, and held against held-out windows
        if accepted is None or len(fit.effects) >= criteria.most_causes or self.steps >= criteria.most_steps:
            return False
        self.pending = step.tried[accepted]
        short = {other: self.pending.evidence_against(tried) for other, tried in step.tried.items()}
        self.passed[accepted] = step.drop(accepted), short
        self.fit, self.pending = self.search.drop_superfluous(self.search.reframe(self.pending)), None
        self.drops[accepted] = step.drop(accepted)
        # What made way does not come back, nor what did not last: it would be taken in again and again.
        self.barred |= (step.before.effects | {accepted}) - self.fit.effects
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

    def swap(self, replaced: Mapping[str, Step], evidence: Mapping[str, Mapping[str, float]]) -> bool:
        """Put a better rival in the place of a cause, or a better set of causes that differs in two."""
        better = find_better(self.search, evidence, self.drops)
        if better is not None and self.swaps < self.search.criteria.most_swaps:
            self.put(*better, replaced)
            return True
        other = exchange_causes(self.search, self.held_out, self.fit, self.barred, self.stage)
        if other is None or self.steps + self.swaps >= self.search.criteria.most_steps:
            return False
        self.fit = self.search.drop_superfluous(self.search.reframe(other))
        self.swaps += 1
        return True

    def put(self, cause: str, rival: str, replaced: Mapping[str, Step]) -> None:
        """Put a rival in the place of a cause."""
        self.swaps += 1
        self.near[rival] = self.near[cause] | {cause}
        self.fit = self.search.drop_superfluous(self.search.reframe(replaced[cause].tried[rival]))
        self.drops[rival] = self.drops.get(cause, 0.0)

    def tell_roughness(
        self, replaced: Mapping[str, Step], evidence: Mapping[str, Mapping[str, float]], beside: Mapping[str, float]
    ) -> dict[str, dict[str, float]]:
        """How much of the evidence for every cause against every rival tells nothing."""
        rough = {e: {r: tell_roughness(self.search, e, r, beside) for r in row} for e, row in evidence.items()}
        for effect, step in replaced.items():
            for rival, tried in step.tried.items():
                freedom = weigh_freedom(self.search, self.fit, tried, effect, rival)
                rough[effect][rival] = max(rough[effect][rival], freedom)
        return rough

    def conclude(
        self, replaced: Mapping[str, Step], evidence: Mapping[str, Mapping[str, float]], beside: dict[str, float],
        rough: Mapping[str, Mapping[str, float]],
    ) -> Selection:  # fmt: skip
        """The causes with their rivals."""
        rivals = {e: weigh_rivals(row, self.search.criteria, rough[e]) for e, row in evidence.items()}
        fits = {e: [replaced[e].tried[r.effect] for r in found] for e, found in rivals.items()}
        instead = {e: [Alternative(f.effects, f.values) for f in row] for e, row in fits.items()}
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
            agreed = gain > -search.criteria.sigmas_against * error and confirms(search, held_out, fit, other)
            if agreed and not held_out.errors.worsens(fit.values, other.values):
                best = won, other
    return best[1]


def choose_cause(search: Search, held_out: HeldOut, step: Step, earlier_drops: Mapping[str, float]) -> str | None:
    """The suspect of a step that fitted windows like best of those that pass for a cause; None if none does."""
    return next((e for e in step.ordered if is_cause(search, held_out, step, e, earlier_drops)), None)


def is_cause(search: Search, held_out: HeldOut, step: Step, effect: str, earlier_drops: Mapping[str, float]) -> bool:
    """Whether a suspect clears the bar, leaves its build tolerance and predicts held-out windows better.

    Beside a cause that looks like it, it must bring a good part of what that cause brought: no law of friction is
    exact, and what one leaves over another of its kind would mop up. `earlier_drops` are each of the frame in
    which its cause was added, where noise seemed larger than now: a yardstick, from which nothing is subtracted.
    """
    tried, drop, criteria = step.tried[effect], step.drop(effect), search.criteria
    kin = [d for e, d in earlier_drops.items() if e in tried.effects and look_alike(search, effect, e)]
    if drop < criteria.bars_fitted * criteria.bar + criteria.kinship * max(kin, default=0.0):
        return False
    if is_faint(search, tried, effect):
        return False
    gain, error = compare(search, held_out, step.before, tried)
    strong = drop > criteria.bars_strong * criteria.bar
    agreed = gain > (-criteria.sigmas_against if strong else criteria.sigmas_held_out) * error
    agreed = agreed and drop + gain > criteria.bars_together * criteria.bar
    undecided = drop > criteria.bars_powerless * criteria.bar and gain > -criteria.sigmas_held_out * error
    if not agreed and not (undecided and is_powerless(held_out, step.before, tried)):
        return False
    return not held_out.errors.worsens(step.before.values, tried.values)


def is_faint(search: Search, fit: Fit, effect: str) -> bool:
    """Whether a fit leaves an effect within its build tolerance."""
    own, criteria = [u for u in search.unknowns if u.effect.id == effect], search.criteria
    return all(abs(fit.values[u.key] - u.nominal) < criteria.tolerances * u.parameter.tolerance for u in own)


def confirms(search: Search, held_out: HeldOut, before: Fit, after: Fit) -> bool:
    """Whether held-out windows alone show that a fit is better; they need not, but for an effect in a place.

    A place was looked for, and somewhere chance always is.
    """
    if not {u.effect.id for u in search.unknowns if u.effect.placed} & (after.effects - before.effects):
        return True
    gain, error = compare(search, held_out, before, after)
    return gain > search.criteria.sigmas_held_out * error


def replace_cause(search: Search, fit: Fit, effect: str, near: frozenset[str]) -> Step:
    """The fit without a cause, and every shortlisted suspect, or one of those near it, tried in its place."""
    without = search.rederive(search.without(fit, effect))
    return search.extend(without, against=effect, whole=fit, near=near)
