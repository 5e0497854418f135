"""The search for causes: rank every suspect in closed form, refit the best in the twin, keep what lasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from vpptwin.diagnosis.evidence.bench import Key
from vpptwin.diagnosis.search.fits import Fit, Fitter, find_cheapest
from vpptwin.diagnosis.search.shortlist import Start, rank_effects, rank_trials, start_from_look_alikes
from vpptwin.diagnosis.search.solution import solve_hypothesis


@dataclass(frozen=True)
class Step:
    """One step of the search: the fit before it, and every shortlisted suspect added to it."""

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
        values: Mapping[Key, float] | None = None,
    ) -> Step:  # fmt: skip
        """Refit with each of the best-ranked further suspects added in turn, each under its own likelihood.

        Those that the catalogue calls hard to tell from the best, or from the cause whose place they take, are tried
        from where they do the same: of a large effect derivatives at the nominal twin tell little.

        Args:
            fit: what they are added to.
            barred: suspects that are not tried.
            against: a cause in whose place the others stand; those that fall far behind it are not tried.
            values: its parameters.
        """
        starts: dict[str, list[Start]] = {}
        for start in self.rank(fit, barred):
            starts.setdefault(start.effect, []).append(start)
        least = self.criteria.worth_a_refit
        if against in starts:
            least = max(least, self.criteria.rival_hope * starts.pop(against)[0].drop)
        names = [name for name in starts if starts[name][0].drop > least][: self.criteria.shortlist]
        found: dict[str, Fit] = {}
        for name in names:
            self._refit(found, fit, starts[name][: self.criteria.starts])
        if found:
            best = find_cheapest(list(found.values()))
            (leader,) = best.effects - fit.effects
            for start in start_from_look_alikes(fit.about, self.unknowns, leader, best.values, fit.values):
                if start.effect in starts and start.effect not in found:
                    self._refit(found, fit, [start])
        if values:
            # Without the cause the others have moved to make up for it: beside a look-alike they are as they were.
            rest = {key: value for key, value in values.items() if key[0] != against}
            for start in start_from_look_alikes(fit.about, self.unknowns, against, values, rest):
                if start.effect in starts and (rest or start.effect not in found):
                    self._refit(found, fit, [start])
        drops = {name: refitted.evidence_against(fit) for name, refitted in found.items()}
        least = max(self.criteria.chance * max(drops.values(), default=0.0), 0.0)
        return Step(fit, {name: self.judge_alone(found[name]) for name, drop in drops.items() if drop >= least})

    def _refit(self, found: dict[str, Fit], fit: Fit, starts: Sequence[Start]) -> None:
        """Add to `found` the best refit of one suspect beside the effects of a fit, unless a better one is there."""
        effect = starts[0].effect
        refits = [self.fit(fit.effects | {effect}, start.values, fit.about) for start in starts]
        found[effect] = find_cheapest(refits + ([found[effect]] if effect in found else []))

    def without(self, fit: Fit, effect: str) -> Fit:
        """The fit without one of its effects, under its own likelihood."""
        return self.judge_alone(self.fit(fit.effects - {effect}, fit.values, fit.about))

    def drop_superfluous(self, fit: Fit) -> Fit:
        """Leave out every effect without which the rest explains the data as well."""
        while len(fit.effects) > 1:
            weakened = find_cheapest([self.without(fit, effect) for effect in sorted(fit.effects)])
            if fit.evidence_against(weakened) > self.criteria.bar:
                return fit
            fit = self.reframe(weakened)
        return fit
