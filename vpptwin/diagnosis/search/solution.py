"""The most probable parameters of a hypothesis in closed form, and what its freedom costs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dposv
from scipy.optimize import lsq_linear

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.search.covariance import factor, invert, invert_mended, logdet
from vpptwin.diagnosis.search.frame import Linearisation
from vpptwin.diagnosis.search.suspects import Unknown

SETS, PATIENCE, MOST = 200, 5, 10_000
"""Sets of bounds that are tried before another method is, those in a row that may leave no fewer on a wrong side, and
steps of that method at most."""
ROUNDING = 8.0 * np.finfo(float).eps
"""Share of its terms by which rounding may be wrong about a sum."""
Held = tuple[np.ndarray, np.ndarray]
"""Which parameters lie at their lower and at their upper bounds, (n,) bool each."""


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


def solve_bounded(
    hessian: np.ndarray, target: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], held: Held | None = None
) -> tuple[np.ndarray, Held]:
    """The x (n,) within bounds at which x' `hessian` x / 2 - `target`' x is least, `hessian` (n, n) positive definite.

    By block principal pivoting (Júdice and Pires, Computers & Operations Research 21, 1994): all that are on the wrong
    side change sides at once; where that leaves no fewer of them, the last alone, by which it ends sooner or later.

    Returns:
        x, and which of it lie at their lower and at their upper bounds.

    Args:
        hessian: (n, n).
        target: (n,).
        bounds: lower and upper ones, (n,) each.
        held: which are believed to lie at their bounds; None for none.
    """
    low, high = bounds
    size = np.abs(hessian)
    below, above = held or (np.zeros(len(target), bool),) * 2
    least, patience = len(target) + 1, PATIENCE
    for _ in range(SETS):
        free = ~(below | above)
        x = np.where(below, low, np.where(above, high, 0.0))
        pulled = target - hessian @ x
        if free.any():
            part = hessian[free][:, free]
            x[free], failed = dposv(part, pulled[free])[1:]
            if failed:
                x[free] = invert_mended(part) @ pulled[free]
        uphill, rounding = hessian @ x - target, ROUNDING * (size @ np.abs(x) + np.abs(target))
        wrong = (x < low) & free | (below & (uphill < -rounding)), (x > high) & free | (above & (uphill > rounding))
        number = int(np.count_nonzero(wrong[0] | wrong[1]))
        if not number:
            return x, (below, above)
        least, patience = (number, PATIENCE) if number < least else (least, patience - 1)
        if patience < 0:
            last = np.arange(len(target)) == np.flatnonzero(wrong[0] | wrong[1])[-1]
            wrong = wrong[0] & last, wrong[1] & last
        below, above = below ^ wrong[0], above ^ wrong[1]
    root = factor(hessian)
    wanted = np.linalg.solve(root, target)
    try:
        found = lsq_linear(root.T, wanted, bounds=bounds, method="bvls", max_iter=MOST)
    except np.linalg.LinAlgError:  # LAPACK's divide and conquer gives up on rare well-conditioned matrices
        found = lsq_linear(root.T, wanted, bounds=bounds, method="trf")
    return np.asarray(found.x), (found.active_mask < 0, found.active_mask > 0)


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
