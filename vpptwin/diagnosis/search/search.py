"""The search for causes: rank every suspect in closed form, refit the best in the twin, keep what lasts."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats.qmc import LatinHypercube

from vpptwin.diagnosis.evidence.runs import Key, Variation
from vpptwin.diagnosis.search.fits import Fit, Fitter, find_cheapest
from vpptwin.diagnosis.search.motion import follow_motion
from vpptwin.diagnosis.search.responses import Responses
from vpptwin.diagnosis.search.shortlist import Start, advance, rank_effects, rank_trials, start_from_look_alikes
from vpptwin.diagnosis.search.solution import price_of_freedom, solve_hypothesis
from vpptwin.effects import Stage

SCANNED, AROUND, REFINED = 40, 1.5, 2
"""Places around a fit that are simulated, the factor up and down by which they differ, and how often it is refined."""
FOLLOWED = 2
"""Times that motion and parameters of what sticks are fitted in turn in the end."""
FARTHER = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0), (0.6, 0.8, 1.0, 1.25, 1.6), (0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15)
"""Times, at first and then around the best, that a law of dry friction is tried at which slopes liken to another."""


@dataclass(frozen=True)
class Step:
    """One step of the search: the fit before it, and every shortlisted suspect added to it.

    Attributes:
        before: the fit.
        tried: suspect → refit, under its own likelihood.
    """

    before: Fit
    tried: dict[str, Fit]

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
        starts = rank_effects(fit.about, self.unknowns, base, fit.effects, barred)
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
        names = [name for name in starts if starts[name][0].drop > least][: self.criteria.shortlist]
        names += [name for name in starts if name in near and name not in names]
        found: dict[str, Fit] = {}
        for name in names:
            self._refit(found, fit, starts[name][: self.criteria.starts])
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
        tried = {name: self.judge_alone(found[name]) for name, drop in drops.items() if drop >= least}
        return Step(fit, tried)

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
        best = sorted(starts, key=lambda chosen: -starts[chosen].drop)[: self.criteria.neighbours]
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

    def _refit(self, found: dict[str, Fit], fit: Fit, starts: Sequence[Start]) -> None:
        """Add to `found` the best refit of one suspect beside the effects of a fit, unless a better one is there.

        One that ends far above the fit without it went astray on its way, and starts once more from where it is off.
        """
        effect = starts[0].effect
        freed = fit.effects | {effect}
        refits = [self.fit(freed, start.values, fit.about) for start in starts]
        if all(each.evidence_against(fit) < -self.criteria.bar for each in refits):
            off = {u.key: float(u.nominal) for u in self.unknowns if u.effect.id == effect}
            refits.append(self.fit(freed, {**fit.values, **off}, fit.about))
        found[effect] = find_cheapest(refits + ([found[effect]] if effect in found else []))

    def without(self, fit: Fit, effect: str) -> Fit:
        """The fit without one of its effects, under its own likelihood."""
        return self.judge_alone(self.fit(fit.effects - {effect}, fit.values, fit.about))

    def drop_superfluous(self, fit: Fit) -> Fit:
        """Leave out every effect without which the rest explains the data as well, by the evidence for all of them."""
        while len(fit.effects) > 1:
            weakened = min((self.without(fit, e) for e in sorted(fit.effects)), key=fit.evidence_against)
            if fit.evidence_against(weakened) > self.criteria.bar:
                return fit
            fit = self.reframe(weakened)
        return fit
