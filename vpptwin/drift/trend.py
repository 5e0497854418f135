"""Whether a parameter changes from log to log: constant, steady change, a step, or steady change from some log on.

A flight's value scatters by its own standard deviation and by a scatter between flights, which nobody knows: it is
integrated out over a prior that is even in its logarithm. A change has a course that goes from 0 at the first flight
to 1 at the last, and a size that is Gaussian, as wide as the values lie apart. So the evidence is what BIC comes close
to where flights are many, and holds where they are few.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import logsumexp

Kind = Literal["constant", "line", "step", "bend"]
"""It stays; changes steadily from the first flight on; jumps before a flight; changes steadily from a flight on."""

CLEAR = 8.0
"""Evidence (twice the logarithm of the odds) from which there is a change: of 100 parameters that stay, one at most has
that by chance, however much they scatter (a test says so). Below `STAYS` nothing speaks for one; between, who knows."""
STAYS = 2.0
LEAST = 3
"""Flights from which a change is looked for."""
FINEST, COARSEST, NUMBER = 0.1, 100.0, 80
"""Scatter between flights that is looked through, in median standard deviations, and in how many values."""
WAYS: tuple[Kind, ...] = ("line", "step", "bend")
SHARE = 0.9
"""Probability that a change began within the flights that are given."""


@dataclass(frozen=True)
class Trend:
    """What a parameter did over a number of flights."""

    kind: Kind  # the likeliest way, `constant` where no change is clear
    evidence: float  # twice the logarithm of how much likelier any change is than none; -inf with too few flights
    evidences: dict[Kind, float]  # the same of every way to change
    since: int  # number of the flight from which on it is otherwise (`step`) or changes (`line`, `bend`)
    between: tuple[int, int]  # the first and last flight of which that may be true, with a probability of `SHARE`
    first: tuple[float, float]  # level at the first and the last flight, and their standard deviations
    last: tuple[float, float]  # level at the first and the last flight, and their standard deviations
    change: tuple[float, float]  # last less first, and its standard deviation
    scatter: float  # between flights, beyond their own deviations; the median of what is likely
    fitted: np.ndarray  # the level at every flight, (n,)


@dataclass(frozen=True)
class ChangeShape:
    """A way to change: kind, the flight it begins with, and its course from 0 to 1, (n,)."""

    kind: Kind
    since: int
    course: np.ndarray


def list_shapes(time: np.ndarray) -> list[ChangeShape]:
    """Ways to change over flights at increasing times (n,): a line, steps before each, bends with two after them."""
    span = time - time[0]
    shapes = [ChangeShape("line", 0, span / span[-1])]
    shapes += [ChangeShape("step", k, (np.arange(len(time)) >= k).astype(float)) for k in range(1, len(time))]
    for k in range(1, len(time) - 2):
        since = np.maximum(time - time[k], 0.0)
        shapes.append(ChangeShape("bend", k, since / since[-1]))
    return shapes


def judge_trend(time: np.ndarray, value: np.ndarray, std: np.ndarray) -> Trend:
    """Weigh all ways to change against none.

    Args:
        time: of the flights, increasing, not all the same, any unit, (n,).
        value: of the parameter there, (n,).
        std: its standard deviation in every flight, (n,).
    """
    n, typical = len(value), float(np.median(std))
    most = max(COARSEST * typical, 3.0 * float(np.std(value)))
    scatter = np.geomspace(FINEST * typical, most, NUMBER)
    weight = 1.0 / (np.square(std) + np.square(scatter)[:, None])
    total = weight.sum(axis=1)
    mean = weight @ value / total
    residual = value - mean[:, None]
    # log p(y | s) = ½ (Σ log wᵢ - Σ wᵢ (yᵢ - ȳ)² - log Σ wᵢ), wᵢ = 1/(σᵢ² + s²), flat prior on the level (BDA3, 5.4)
    staying = 0.5 * (np.log(weight).sum(axis=1) - (weight * residual**2).sum(axis=1) - np.log(total))
    none, size = float(logsumexp(staying)), max(float(np.ptp(value)), typical)
    shapes = list_shapes(time) if n >= LEAST else []
    found = [weigh_shape(shape.course, size, weight, residual, staying) for shape in shapes]
    likelihood = np.array([logsumexp(changing) for changing, *_ in found])
    kinds = {kind: [i for i, s in enumerate(shapes) if s.kind == kind] for kind in WAYS if n >= LEAST}
    evidences = {
        kind: float(2.0 * (logsumexp(likelihood[places]) - np.log(len(places)) - none))
        for kind, places in kinds.items()
        if places
    }
    every = 0.5 * np.array(list(evidences.values()))
    evidence = float(2.0 * (logsumexp(every) - np.log(len(every)))) if len(every) else -np.inf
    if evidence < CLEAR:
        likely = np.exp(staying - none)
        level, beyond = mix(likely, mean, 1.0 / total), find_median(scatter, likely)
        return Trend("constant", evidence, evidences, 0, (0, 0), level, level, (0.0, 0.0), beyond, np.full(n, level[0]))
    kind = max(evidences, key=lambda name: evidences[name])
    places = kinds[kind]
    best = int(np.argmax(likelihood[places]))
    shape, (changing, slope, precision) = shapes[places[best]], found[places[best]]
    likely = np.exp(changing - logsumexp(changing))
    away = np.array([[0.0], [1.0]]) - weight @ shape.course / total
    first, last = (mix(likely, mean + slope * a, 1.0 / total + a**2 / precision) for a in away)
    begin, change = [shapes[i].since for i in places], mix(likely, slope, 1.0 / precision)
    return Trend(
        kind, evidence, evidences, shape.since, enclose(begin, likelihood[places], best), first, last, change,
        find_median(scatter, likely), first[0] + (last[0] - first[0]) * shape.course,
    )  # fmt: skip


def weigh_shape(
    course: np.ndarray, size: float, weight: np.ndarray, residual: np.ndarray, staying: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A change of one course (n,), for S sizes of the scatter.

    Args:
        course: from 0 to 1, (n,).
        size: standard deviation of the prior of the change.
        weight: of the flights, (S, n).
        residual: values less their weighted mean, (S, n).
        staying: log likelihood of no change, (S,).

    Returns:
        Log likelihood, size of the change, and its precision, (S,) each.
    """
    apart = course - (weight @ course / weight.sum(axis=1))[:, None]
    precision = (weight * apart**2).sum(axis=1)
    slope = (weight * apart * residual).sum(axis=1) / precision
    told = precision * size**2
    # log Bayes factor of a linear term with a Gaussian prior (BDA3, 14): ½ (b² p t/(1 + t) - log(1 + t)), t = p s²
    won = 0.5 * (slope**2 * precision * told / (1.0 + told) - np.log1p(told))
    return staying + won, slope, precision


def mix(likely: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation over what is likely, (S,) each."""
    middle = likely @ mean
    return float(middle), float(np.sqrt(likely @ (variance + np.square(mean - middle))))


def find_median(values: np.ndarray, likely: np.ndarray) -> float:
    """The median of increasing values by how likely they are, (S,) each."""
    return float(values[np.searchsorted(np.cumsum(likely), 0.5 * likely.sum())])


def enclose(begin: list[int], likelihood: np.ndarray, best: int) -> tuple[int, int]:
    """The fewest flights about the likeliest, `begin[best]`, of which one began it with a probability of `SHARE`."""
    share = np.exp(likelihood - logsumexp(likelihood))
    low = high = best
    while share[low : high + 1].sum() < SHARE:
        below, above = (share[low - 1] if low else -1.0), (share[high + 1] if high + 1 < len(share) else -1.0)
        low, high = (low - 1, high) if below > above else (low, high + 1)
    return begin[low], begin[high]
