"""The search for causes: rank every suspect in closed form, refit the best in the twin, keep what lasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.stats.qmc import LatinHypercube

from vpptwin.diagnosis.evidence.runs import Key, Variation
from vpptwin.diagnosis.search.fits import ITERATIONS, Fit, Fitter, find_cheapest
from vpptwin.diagnosis.search.motion import follow_motion
from vpptwin.diagnosis.search.responses import Responses
from vpptwin.diagnosis.search.shortlist import Start, advance, rank_effects, rank_trials, start_from_look_alikes
from vpptwin.diagnosis.search.solution import price_of_freedom, solve_hypothesis
from vpptwin.diagnosis.search.suspects import SIZES
from vpptwin.effects import Stage

LOWER = 4.0
"""How far below the limits that the commands suggest a scan looks."""
SCANNED, SPREAD, AROUND, REFINED = 40, 10.0, 1.5, 2
"""Places that a scan simulates, the factors up and down by which shapes, and all around a fit, differ there, and how
often a fit is refined."""
FOLLOWED = 2
"""Times that motion and parameters of what sticks are fitted in turn in the end."""
FARTHER = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0), (0.6, 0.8, 1.0, 1.25, 1.6), (0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15)
"""Times, at first and then around the best, that a law of dry friction is tried at which slopes liken to another."""
LONG, BRIEF = 3, 2
"""A list of suspects longer than that is gone through with so many steps of Gauss-Newton, and the best go on."""


@dataclass(frozen=True)
class Step:
    """One step of the search: the fit before it, and every shortlisted suspect added to it.

    Attributes:
        before: the fit.
        tried: suspect → refit, under its own likelihood.
        behind: the same of those that fall far behind the best, not yet judged.
    """

    before: Fit
    tried: dict[str, Fit]
    behind: dict[str, Fit] = field(default_factory=dict)

    def drop(self, effect: str) -> float:
        """Drop in cost that adding an effect brought."""
        return self.tried[effect].evidence_against(self.before)

    @property
    def ordered(self) -> list[str]:
        """The suspects, the one whose addition brought most first."""
        return sorted(self.tried, key=self.drop, reverse=True)


class Search(Fitter):
    """Fits on one set of windows, and the suspects that are worth fitting there."""

    def rank(self, fit: Fit, barred: frozenset[str] = frozenset()) -> list[Start]:
        """Where to start refitting every other effect beside those of a fit, by linearisation, most promising first."""
        base = solve_hypothesis(fit.about, self.unknowns, fit.effects)
        placed = {t.effect for t in self.trials} & {u.effect.id for u in self.unknowns if u.effect.placed}
        placed = placed if self.bench.guessed else set()
        starts = rank_effects(fit.about, self.unknowns, base, fit.effects, barred | placed)  # no slope leads to a place
        starts += rank_trials(fit.about, self.unknowns, self.trials, base, fit.effects | barred)
        known = {key: value for key, value in fit.values.items() if key[0] in fit.effects}
        starts = [replace(start, values={**known, **start.values}) for start in starts]
        return sorted(starts, key=lambda start: (-start.drop, start.effect))

    def extend(
        self, fit: Fit, barred: frozenset[str] = frozenset(), against: str = "",
        whole: Fit | None = None, near: frozenset[str] = frozenset(),
    ) -> Step:  # fmt: skip
        """Refit with each of the best-ranked further suspects added in turn, each under its own likelihood.

        Those that the catalogue calls hard to tell from the best, or from the cause whose place they take, are tried
        from where they do the same: of a large effect derivatives at the nominal twin tell little.

        Args:
            fit: what they are added to.
            barred: suspects that are not tried.
            against: a cause in whose place the others stand; those that fall far behind it are not tried.
            whole: the fit with it.
            near: those that came near it when it was found, which are tried whatever they promise.
        """
        starts: dict[str, list[Start]] = {}
        for start in self.rank(fit, barred):
            starts.setdefault(start.effect, []).append(start)
        least = self.criteria.worth_a_refit
        if against in starts:
            least = max(least, self.criteria.rival_hope * starts.pop(against)[0].drop)
        names, found = self._choose(starts, least, fit, against), dict[str, Fit]()
        names += [name for name in starts if name in near and name not in names]
        brief = len(names) > LONG and self.bench.guessed
        number, iterations = (1, BRIEF) if brief else (self.criteria.starts, ITERATIONS)
        sticking = set[str]()
        for name in names:
            self._refit(found, fit, starts[name][:number], iterations)
            if places := self._scan(fit, name):  # only by its own likelihood does a law that sticks look its best
                beside = {name: found[name]}
                self._refit(beside, fit, places)
                found[name] = self.judge_alone(beside[name])
                sticking.add(name)
        if brief:  # those that got somewhere go on
            worth = max(self.criteria.chance * max(each.evidence_against(fit) for each in found.values()), least)
            hopeful = [name for name, each in found.items() if each.evidence_against(fit) >= 0.5 * worth]
            for name in hopeful:
                longer = self.fit(found[name].effects, found[name].values, found[name].about)
                found[name] = self.judge_alone(longer) if name in sticking else longer
        if found:
            best = find_cheapest(list(found.values()))
            (leader,) = best.effects - fit.effects
            for start in start_from_look_alikes(fit.about, self.unknowns, leader, best.values, fit.values):
                if start.effect in starts and start.effect not in found:
                    self._refit(found, fit, self._lead_on(fit, start))
        if whole is not None:
            # Without the cause the others have moved to make up for it: beside a look-alike they are as they were.
            rest = {key: value for key, value in whole.values.items() if key[0] != against}
            for start in start_from_look_alikes(fit.about, self.unknowns, against, whole.values, rest):
                if start.effect in starts and (rest or start.effect not in found):
                    self._refit(found, fit, self._lead_on(fit, start))
        drops = {name: refitted.evidence_against(fit) for name, refitted in found.items()}
        least = max(self.criteria.chance * max(drops.values(), default=0.0), 0.0)
        behind = {name: found[name] for name, drop in drops.items() if self.criteria.bar < drop < least}
        step = Step(fit, {}, {name: found[name] for name, drop in drops.items() if drop >= least})
        step = self.judge_behind(step)
        tried = {name: self.judge_beside(each, whole) if whole else each for name, each in step.tried.items()}
        return replace(step, tried=tried, behind=behind)

    def judge_beside(self, rival: Fit, fit: Fit) -> Fit:
        """A rival as it was judged, or begun with the gusts that a fit needs, where it costs less so.

        Gusts and parameters are fitted in turn: begun with gusts that made up for all that a cause explains, what
        explains as much may end where they still do a part of it.
        """
        if not self.bench.guessed:
            return rival
        about = rival.about.under(fit.likelihood, rival.frame)
        hoped = solve_hypothesis(about, self.unknowns, rival.effects)
        cost = hoped.cost + fit.likelihood.logdet.sum() + price_of_freedom(hoped, self.unknowns, rival.effects)
        if cost > rival.cost - self.criteria.better:
            return rival
        return find_cheapest([rival, self.judge_alone(self.fit(rival.effects, rival.values, about))])

    def judge_behind(self, step: Step) -> Step:
        """A step in which those that fall behind are judged by their own likelihoods too."""
        return Step(step.before, step.tried | {name: self.judge_alone(fit) for name, fit in step.behind.items()})

    def _choose(self, starts: Mapping[str, Sequence[Start]], least: float, fit: Fit, against: str) -> list[str]:
        """Suspects to refit, of starts in the order of their promise, none below `least` unless they are few.

        Linearisation promises nothing of a large effect; where all can be refitted, none is dropped for it, nor is any
        law of dry friction of a joint that a cause brakes, nor damping where one rubs: no slope gives back what one
        took of another's share. Those that stand instead of a cause must promise something, and so must errors of
        signals, which are nearly linear, and what is tried where logs show it, at the size they show.
        """
        criteria = self.criteria
        promising = [name for name in starts if starts[name][0].drop > least]
        if not self.bench.guessed:
            return promising[: criteria.shortlist]
        effects = {u.effect.id: u.effect for u in self.unknowns}
        sure = {name for name in starts if effects[name].placed or name in self.bench.of_sensors}
        told = sure - set(promising)
        if not against and len(starts) - len(sure) <= criteria.few:
            return [name for name in starts if name not in told]
        chosen = promising[: criteria.shortlist if against else criteria.generous]
        braking = [effects[name] for name in sorted({*fit.effects, against} - {""}) if effects[name].dissipative]
        slowed = {effect.places for effect in braking}
        sliding = {effect.places for effect in braking if effect.stage is Stage.FRICTION}
        laws = [
            n for n in starts if n not in told and effects[n].brakes
            and effects[n].places in (slowed if effects[n].stage is Stage.FRICTION else sliding)
        ]  # fmt: skip
        return list(dict.fromkeys(chosen + laws))

    def _scan(self, fit: Fit, effect: str) -> list[Start]:
        """Where else to start refitting a limit, or what brakes beside dry friction: the best of many, all simulated.

        What limits, or sticks and slips, makes the cost rough: from a wrong share of two laws no slope leads to the
        right one.
        """
        added = [u for u in self.unknowns if u.effect.id == effect]
        law = added[0].effect
        if not self.bench.guessed:
            return []
        if added[0].is_limit:
            limits = [t.values[added[0].key] for t in self.trials if t.effect == effect]
            span = np.geomspace(min(limits) / LOWER, max(limits), SCANNED) if limits else np.empty(0)
            limited = [fit.values | {added[0].key: float(added[0].parameter.clip(limit))} for limit in span]
            return [Start(effect, each, 0.0) for each in (self._pick_places(fit, limited) if limited else [])]
        rubbing = [
            u for u in self.unknowns
            if u.effect.id in fit.effects and u.effect.stage is Stage.FRICTION and u.effect.places == law.places
        ]  # fmt: skip
        laws = added + rubbing
        if len(laws) < 2 or not law.brakes or not (rubbing or law.stage is Stage.FRICTION):
            return []
        strengths = [u.key for u in laws if u.parameter is u.effect.parameters[0]]
        forces = [u.key for u in laws if u.key in strengths and u.parameter.unit in ("N", "N m")]
        most = 1.5 * sum(abs(fit.values.get(key, 0.0)) for key in forces) or SIZES[-1] * added[0].parameter.size
        there: Mapping[Key, float] = next((t.values for t in self.trials if t.effect == effect and law.placed), {})
        places = LatinHypercube(len(laws), rng=np.random.default_rng(0)).random(SCANNED)
        tried = []
        for place in places:
            values = dict(fit.values)
            for unknown, share in zip(laws, place):
                parameter, away = unknown.parameter, 2.0 * share - 1.0
                if unknown.key not in strengths:
                    value = unknown.nominal * SPREAD**away
                    if unknown.effect.placed:
                        value = there.get(unknown.key, fit.values.get(unknown.key, unknown.nominal))
                elif unknown.key in forces:
                    value = most * share**2
                else:  # a share of the friction or of a load, which may have either sign
                    value = SIZES[-1] * parameter.size * (away * abs(away) if parameter.low < 0.0 else share**2)
                values[unknown.key] = float(parameter.clip(np.array(value)))
            tried.append(values)
        return [Start(effect, values, 0.0) for values in self._pick_places(fit, tried)]

    def _lead_on(self, fit: Fit, start: Start) -> list[Start]:
        """The same start; for dry friction the best place farther on: where it sticks no slope tells how far."""
        strength = next(u for u in self.unknowns if u.effect.id == start.effect)
        if strength.effect.stage is not Stage.FRICTION:
            return [start]
        place = dict(start.values)
        for spread in FARTHER:
            farther = strength.nominal + np.array(spread) * (place[strength.key] - strength.nominal)
            tried = [{**place, strength.key: float(value)} for value in strength.parameter.clip(farther)]
            place = self._pick_places(fit, tried)[0]
        return [Start(start.effect, place, 0.0)]

    def _pick_places(self, fit: Fit, tried: Sequence[dict[Key, float]]) -> list[dict[Key, float]]:
        """The two of many places that miss least under a fit's likelihood."""
        track = fit.about.track
        predicted = self.bench.about(track).predict([Variation(values) for values in tried], fit.values)
        cost = (fit.frame.whiten_missed(self.bench.miss(predicted), track, fit.likelihood) ** 2).sum(axis=1)
        return [tried[i] for i in np.argsort(cost)[:2]]

    def follow(self, fit: Fit) -> Fit:
        """A fit with the parameters that it has about the motion that is likeliest with it; as it is if nothing sticks.

        About another's motion a twin that sticks slips when the rig did not, and the fit makes it stick less.
        """
        if self.bench.track is None or not self.sticks(fit.effects):
            return fit
        here, other = fit, copy(self)
        for _ in range(FOLLOWED):
            track = follow_motion(other.bench, here.values, here.likelihood.gust)
            other.bench, other._derivatives = other.bench.about(track), {}
            other.bench.followed = None
            other.responses = Responses(other.bench)
            moved = replace(here, about=replace(here.about, track=track))
            before, here = here, other.refine(other.reframe(moved))
            if all(abs(here.values[key] - before.values[key]) < 0.5 * std for key, std in here.std.items()):
                break
        return replace(fit, values=here.values, std=here.std)

    def refine(self, fit: Fit) -> Fit:
        """A fit with several laws of dry friction, or one with a shape, from the best of many places around it."""
        own = [u for u in self.unknowns if u.effect.id in fit.effects and u.effect.stage is Stage.FRICTION]
        if len(own) < 2:
            return fit
        for _ in range(REFINED):
            places = LatinHypercube(len(own), rng=np.random.default_rng(1)).random(SCANNED)
            now, away = np.array([fit.values[u.key] for u in own]), 2.0 * places - 1.0
            shape = np.array([u.effect.placed and u.parameter is not u.effect.parameters[0] for u in own])
            size = np.array([u.parameter.size for u in own])
            around = [
                fit.values | {u.key: float(u.parameter.clip(value)) for u, value in zip(own, row)}
                for row in np.where(shape, now + size * away, now * AROUND**away)
            ]
            found = [self.fit(fit.effects, values, fit.about) for values in self._pick_places(fit, around)]
            best = find_cheapest([self.judge_alone(each) for each in found])
            if best.evidence_against(fit) < self.criteria.better:
                break
            fit = self.reframe(best)
        return fit

    def neighbours(self, fit: Fit) -> list[Fit]:
        """Refits of the most promising sets that lack one or two of a fit's effects and have up to two others.

        Sets that differ by one addition or one exchange are left out: `extend` tries these.
        """
        starts: dict[frozenset[str], Start] = {}
        for number in (1, 2):
            for out in combinations(sorted(fit.effects), number):
                left = fit.effects - set(out)
                for chosen in self._pair_up(fit, left, frozenset(out)):
                    far = len(chosen - fit.effects) + number > 2 or (number == 2 and len(chosen) < len(fit.effects))
                    if far and chosen not in starts:
                        solution = solve_hypothesis(fit.about, self.unknowns, chosen)
                        values = advance(fit.about, self.unknowns, chosen, solution)
                        price = price_of_freedom(solution, self.unknowns, chosen)
                        starts[chosen] = Start(",".join(sorted(chosen)), values, -solution.cost - price)
        most = self.criteria.more_neighbours if self.bench.guessed else self.criteria.neighbours
        best = sorted(starts, key=lambda chosen: -starts[chosen].drop)[:most]
        return [self.judge_alone(self.fit(chosen, starts[chosen].values, fit.about)) for chosen in best]

    def _pair_up(self, fit: Fit, left: frozenset[str], out: frozenset[str]) -> list[frozenset[str]]:
        """What is left with one or two suspects beside it: those that linearisation likes best, and best beside one."""
        most, names = self.criteria.neighbours, self._rank_beside(fit, left, out)
        pairs = [left | set(pair) for pair in combinations(names[: 2 * most], 2)]
        for name in names[:most]:
            pairs += [left | {name, other} for other in self._rank_beside(fit, left | {name}, out)[: 2 * most]]
        return [left | {name} for name in names[:most]] + pairs

    def _rank_beside(self, fit: Fit, effects: frozenset[str], out: frozenset[str]) -> list[str]:
        """Suspects as linearisation likes them beside some effects, the best first."""
        base = solve_hypothesis(fit.about, self.unknowns, effects)
        ranked = rank_effects(fit.about, self.unknowns, base, effects, out)
        return [start.effect for start in sorted(ranked, key=lambda start: (-start.drop, start.effect))]

    def _refit(
        self, found: dict[str, Fit], fit: Fit, starts: Sequence[Start], iterations: int = ITERATIONS
    ) -> None:  # fmt: skip
        """Add to `found` the best refit of one suspect beside the effects of a fit, unless a better one is there.

        One that ends far above the fit without it went astray on its way, and starts once more from where it is off.
        """
        effect = starts[0].effect
        freed, turned = fit.effects | {effect}, frozenset({effect}) if iterations == BRIEF else None
        refits = [self.fit(freed, start.values, fit.about, iterations, turned) for start in starts]
        if all(each.evidence_against(fit) < -self.criteria.bar for each in refits):
            off = {u.key: float(u.nominal) for u in self.unknowns if u.effect.id == effect}
            refits.append(self.fit(freed, {**fit.values, **off}, fit.about, iterations, turned))
        found[effect] = find_cheapest(refits + ([found[effect]] if effect in found else []))

    def without(self, fit: Fit, effect: str) -> Fit:
        """The fit without one of its effects, under its own likelihood."""
        return self.judge_alone(self.fit(fit.effects - {effect}, fit.values, fit.about))

    def drop_superfluous(self, fit: Fit, weigh: Callable[[Fit, Fit], float] = Fit.evidence_against) -> Fit:
        """Leave out every effect without which the rest explains the data as well, by the evidence for all of them."""
        while len(fit.effects) > 1:
            found = [(weigh(fit, lesser), lesser) for e in sorted(fit.effects) for lesser in (self.without(fit, e),)]
            evidence, weakened = min(found, key=lambda each: each[0])
            if evidence > self.criteria.bar:
                return fit
            fit = self.reframe(weakened)
        return fit
