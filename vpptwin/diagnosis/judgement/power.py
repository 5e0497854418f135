"""What these flights could have shown: suspects that are cleared, and those that could not be seen."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from vpptwin.diagnosis.judgement.verdict import Cleared, Unseen
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects import Effect, Parameter
from vpptwin.inference.covariance import invert
from vpptwin.inference.fit import Fit, Fitter, Key
from vpptwin.inference.model import find_mode


class Shown:
    """What logs would show of further effects beside a fit, all others within their tolerance.

    Args:
        fitter: with the candidates.
        fit: derivatives are taken at it.
        temper: by which log evidence is divided.
    """

    def __init__(self, fitter: Fitter, fit: Fit, temper: float) -> None:
        self.fitter, self.fit, self.temper = fitter, fit, temper
        self.information = fitter.screen(fit)[0] / temper
        self.at = np.array([fit.values.get(u.key, u.mean) for u in fitter.unknowns])

    def solve(self, effects: frozenset[str]) -> tuple[list[int], np.ndarray, np.ndarray]:
        """Rows, most probable values and covariance of the parameters of some effects, and of what is tolerated."""
        fitter, last = self.fitter, len(self.information) - 1
        own = [i for i, u in enumerate(fitter.unknowns) if u.key[0] in effects]
        rows = own + fitter.loose(effects)
        prior = fitter.prior_of([fitter.unknowns[i] for i in own])
        mean, precision, _ = find_mode(self.information[np.ix_([*rows, last], [*rows, last])], self.at[rows], prior)
        return rows, mean, invert(precision) if rows else np.empty((0, 0))

    @cached_property
    def _base(self) -> tuple[list[int], np.ndarray, np.ndarray]:
        """The same of the fit itself."""
        return self.solve(self.fit.effects)

    def of(self, key: Key) -> tuple[float, float]:
        """Most probable value of a parameter, its effect freed beside the fit's, and its standard deviation."""
        rows, mean, covariance = self.solve(self.fit.effects | {key[0]})
        i = next(i for i, row in enumerate(rows) if self.fitter.unknowns[row].key == key)
        return float(mean[i]), float(np.sqrt(covariance[i, i]))

    def square_of_trial(self, number: int) -> float:
        """Square of the signal of a trial that nothing else makes up for."""
        rows, _, covariance = self._base
        trial = len(self.fitter.unknowns) + number
        cross = self.information[rows, trial]
        return float(self.information[trial, trial] - cross @ covariance @ cross)


def judge_power(search: Search, shown: Shown, accused: frozenset[str]) -> tuple[list[Cleared], list[Unseen]]:
    """Sort the effects that are not accused into those that would have shown and those that could not.

    Args:
        search: the windows and the candidates.
        shown: what they tell beside the causes.
        accused: named effects and those that cannot be told from them.
    """
    cleared: list[Cleared] = []
    unseen: list[Unseen] = []
    for effect in dict.fromkeys(u.effect for u in search.unknowns):
        if effect.id in accused:
            continue
        own = [u for u in search.unknowns if u.effect.id == effect.id and u.parameter in effect.strengths]
        found = [(weigh_limit if u.is_limit else weigh_strength)(search, shown, u) for u in own]
        dark = [each for each in found if isinstance(each, Unseen)]
        if dark:
            unseen.append(dark[0])
        else:  # of a vector the axis of which these flights tell least
            cleared.append(max((each for each in found if isinstance(each, Cleared)), key=lambda c: c.high - c.low))
    return cleared, unseen


def weigh_strength(search: Search, shown: Shown, strength: Unknown) -> Cleared | Unseen:
    """Whether a typical size of an effect would have shown, everything else uncertain within its tolerance."""
    effect, parameter = strength.effect, strength.parameter
    lacking = [other for other in effect.modifies if other not in shown.fit.effects]
    if effect.modifies and len(lacking) == len(effect.modifies):
        return Unseen(effect.id, f"it only changes {' or '.join(lacking)}, which the twin lacks")
    value, std = shown.of(strength.key)
    # The range that was looked through counts as prior knowledge; it must not pass for something seen.
    if std > search.criteria.known_width * strength.width or parameter.size < search.criteria.seen * std:
        return Unseen(effect.id, describe_blindness(effect, parameter, parameter.size / max(std, 1e-12), search))
    low, high = (float(parameter.clip(np.array(value + side * 1.645 * std))) for side in (-1.0, 1.0))
    if not low - parameter.tolerance <= strength.nominal <= high + parameter.tolerance:
        bounds = f"{parameter.name} lies between {low:.2g} and {high:.2g} {parameter.unit}".strip()
        return Unseen(effect.id, f"{bounds}, which is neither needed nor excluded")
    return Cleared(effect.id, parameter.name, low, high, parameter.unit)


def weigh_limit(search: Search, shown: Shown, limit: Unknown) -> Cleared | Unseen:
    """The lowest limit that these flights would not have run into visibly."""
    parameter, best = limit.parameter, 0.0
    for number, trial in enumerate(shown.fitter.trials):
        if trial.effect == limit.effect.id and shown.square_of_trial(number) > search.criteria.seen**2:
            best = max(best, trial.values[limit.key])
    if best == 0.0:
        return Unseen(limit.effect.id, "no motion in these logs comes near a limit")
    return Cleared(limit.effect.id, parameter.name, best, parameter.high, parameter.unit)


def describe_blindness(effect: Effect, parameter: Parameter, sigma: float, search: Search) -> str:
    """Why an effect could not have been seen."""
    size = f"{parameter.size:.2g} {parameter.unit}".strip()
    shown = f"only {sigma:.1f}" if sigma >= 0.1 else "less than 0.1"
    text = f"{parameter.name} of {size} would show by {shown} sigma"
    if effect.fades_along:
        place = search.bench.spec.model.joint(effect.fades_along).qposadr[0]
        text += f": never below {float(search.bench.windows.pose[:, place].min()):.2f} m"
    return text
