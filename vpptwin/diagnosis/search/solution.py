"""The most probable parameters of a hypothesis in closed form, and what its freedom costs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.search.frame import Linearisation
from vpptwin.diagnosis.search.suspects import Unknown
from vpptwin.inference.bounded import Held, solve_bounded
from vpptwin.inference.covariance import invert, logdet


@dataclass(frozen=True)
class Solution:
    """Minimum of a penalised fit: parameter deviations from the point of linearisation, (P,), and the cost there.

    Attributes:
        hessian: half of the cost's by those n parameters that move, each in its unit, (n, n).
        unit: of every parameter; 0 for those that stay, (P,).
        held: those at their bounds, (P,) each.
    """

    deviation: np.ndarray
    cost: float
    hessian: np.ndarray
    unit: np.ndarray
    held: Held

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of all parameters, (P, P), 0 for those that stay."""
        moving, result = self.unit > 0.0, np.zeros((len(self.unit), len(self.unit)))
        unit = self.unit[moving]
        result[np.ix_(moving, moving)] = invert(self.hessian) * unit[:, None] * unit
        return result


def solve_hypothesis(
    about: Linearisation, unknowns: tuple[Unknown, ...], freed: frozenset[str], frozen: bool = False,
    near: Solution | None = None,
) -> Solution:  # fmt: skip
    """Most probable parameters if the effects `freed` are wrong and all others sit within their build tolerance.

    Args:
        about: the linearised windows, in whose frame costs are measured.
        unknowns: their parameters.
        freed: ids of effects whose parameters the data may move anywhere inside the bounds.
        frozen: the freed parameters stay where they are; only the others move.
        near: a solution that is believed to lie at nearly the same bounds.
    """
    scale, reach = about.frame.scale, about.frame.criteria.most_tolerated
    nominal = np.array([u.nominal for u in unknowns])
    free = np.array([u.effect.id in freed for u in unknowns])
    width = np.array([u.width if f else max(u.parameter.tolerance, 1e-12) for u, f in zip(unknowns, free)])
    low = np.array([u.parameter.low for u in unknowns])
    high = np.array([u.parameter.high for u in unknowns])
    low = np.where(free, low, np.maximum(low, nominal - reach * width)) - about.at
    high = np.where(free, high, np.minimum(high, nominal + reach * width)) - about.at
    # A freed parameter is not drawn anywhere: only its range is known.
    pull = np.where(free, 0.0, nominal - about.at)
    moving = ~(free & frozen)
    units = np.where(moving, [u.scale_at(at) for u, at in zip(unknowns, about.at)], 0.0)
    unit = units[moving]
    gram, slope = about.gram[np.ix_(moving, moving)], about.slope[moving]
    hessian = gram / scale * unit[:, None] * unit + np.diag((unit / width[moving]) ** 2)
    target = slope / scale * unit + unit / width[moving] ** 2 * pull[moving]
    margin = 1e-12
    bounds = (low[moving] - margin) / unit, (high[moving] + margin) / unit
    believed = None if near is None else tuple((each & ~free)[moving] for each in near.held)
    least, at_bound = solve_bounded(hessian + 1e-9 * np.diag(np.diag(hessian)), target, bounds, believed)
    step = least * unit
    deviation, held = np.zeros(len(unknowns)), np.zeros((2, len(unknowns)), bool)
    deviation[moving], held[:, moving] = step, at_bound
    cost = (about.residual @ about.residual - 2.0 * slope @ step + step @ gram @ step) / scale
    cost += float(np.sum(((deviation - pull)[~free] / width[~free]) ** 2))
    return Solution(deviation, float(cost), hessian, units, (held[0], held[1]))


def price_of_freedom(solution: Solution, unknowns: tuple[Unknown, ...], freed: frozenset[str]) -> float:
    """What a fit must gain to pay for its freedom: twice the log of prior range over posterior width (Laplace)."""
    free = [i for i, u in enumerate(unknowns) if u.effect.id in freed]
    if not free:
        return 0.0
    width = np.array([unknowns[i].width for i in free])
    share = solution.covariance[np.ix_(free, free)] / width[:, None] / width
    return float(-logdet(share + 1e-12 * np.eye(len(free))))


def scatter_by_stretch(about: Linearisation, solution: Solution, bench: Bench) -> np.ndarray:
    """Standard deviation of every parameter from how much stretches of flight disagree about it, (P,).

    The sandwich estimate with stretches of a few windows as clusters: unlike the curvature alone it notices residuals
    that are larger, or more alike from window to window, than the noise model says.
    """
    residual = about.residual - about.columns.weigh(solution.deviation)
    number = len(bench.windows)
    windows = residual.reshape(number, -1)

    def score(columns: np.ndarray) -> np.ndarray:
        return np.einsum("pkm,km->pk", columns.reshape(-1, *windows.shape), windows) / about.frame.scale

    scores = about.columns.each(score)
    stretch = np.floor(bench.windows.start / about.frame.criteria.stretch).astype(int) + 10**6 * bench.windows.flight
    _, index = np.unique(stretch, return_inverse=True)
    sums = np.zeros((index.max() + 1, len(scores)))
    np.add.at(sums, index, scores.T)
    return np.sqrt(((sums @ solution.covariance) ** 2).sum(axis=0))
