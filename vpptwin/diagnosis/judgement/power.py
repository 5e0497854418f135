"""What these flights could have shown: suspects that are cleared, and those that could not be seen."""

from __future__ import annotations

import numpy as np

from vpptwin.diagnosis.judgement.verdict import Cleared, Unseen
from vpptwin.diagnosis.search.fits import Fit
from vpptwin.diagnosis.search.search import Search
from vpptwin.diagnosis.search.solution import scatter_by_stretch, solve_hypothesis
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.effects import Effect, Parameter


def judge_power(search: Search, fit: Fit, accused: frozenset[str]) -> tuple[list[Cleared], list[Unseen]]:
    """Sort the effects that are not accused into those that would have shown and those that could not.

    Args:
        search: the search with its unknowns and trials.
        fit: the last fit, all derivatives taken at it.
        accused: named effects and those that cannot be told from them.
    """
    cleared: list[Cleared] = []
    unseen: list[Unseen] = []
    for effect in dict.fromkeys(u.effect for u in search.unknowns):
        if effect.id in accused:
            continue
        own = [u for u in search.unknowns if u.effect.id == effect.id and u.parameter in effect.strengths]
        found = [(weigh_limit if u.is_limit else weigh_strength)(search, fit, u) for u in own]
        dark = [each for each in found if isinstance(each, Unseen)]
        if dark:
            unseen.append(dark[0])
        else:  # of a vector the axis of which these flights tell least
            cleared.append(max((each for each in found if isinstance(each, Cleared)), key=lambda c: c.high - c.low))
    return cleared, unseen


def weigh_strength(search: Search, fit: Fit, strength: Unknown) -> Cleared | Unseen:
    """Whether a typical size of an effect would have shown, everything else uncertain within its tolerance."""
    effect, parameter = strength.effect, strength.parameter
    lacking = [other for other in effect.modifies if other not in fit.effects]
    if effect.modifies and len(lacking) == len(effect.modifies):
        return Unseen(effect.id, f"it only changes {' or '.join(lacking)}, which the twin lacks")
    i = next(i for i, u in enumerate(search.unknowns) if u.key == strength.key)
    solution = solve_hypothesis(fit.about, search.unknowns, fit.effects | {effect.id})
    scatter = scatter_by_stretch(fit.about, solution, search.bench)
    std = float(max(np.sqrt(solution.covariance[i, i]), scatter[i]))
    # The range that was looked through counts as prior knowledge; it must not pass for something seen.
    if std > search.criteria.known_width * strength.width or parameter.size < search.criteria.seen * std:
        return Unseen(effect.id, describe_blindness(effect, parameter, parameter.size / max(std, 1e-12), search))
    value = float(fit.about.at[i] + solution.deviation[i])
    low, high = (float(parameter.clip(np.array(value + side * 1.645 * std))) for side in (-1.0, 1.0))
    if not low - parameter.tolerance <= strength.nominal <= high + parameter.tolerance:
        bounds = f"{parameter.name} lies between {low:.2g} and {high:.2g} {parameter.unit}".strip()
        return Unseen(effect.id, f"{bounds}, which is neither needed nor excluded")
    return Cleared(effect.id, parameter.name, low, high, parameter.unit)


def weigh_limit(search: Search, fit: Fit, limit: Unknown) -> Cleared | Unseen:
    """The lowest limit that these flights would not have run into visibly."""
    about, parameter = fit.about, limit.parameter
    base = solve_hypothesis(about, search.unknowns, fit.effects)
    scale = about.frame.scale
    best = 0.0
    own = [i for i, trial in enumerate(search.trials) if trial.effect == limit.effect.id]
    for i, column in zip(own, about.whiten_trials(own)):
        cross = about.columns @ column
        square = float(column @ column) / scale - float(cross @ base.covariance @ cross) / scale**2
        if square > search.criteria.seen**2:
            best = max(best, search.trials[i].values[limit.key])
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
