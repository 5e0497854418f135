"""Least squares within bounds."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv
from scipy.optimize import lsq_linear

from vpptwin.inference.covariance import factor, invert_mended

SETS, PATIENCE, MOST = 200, 5, 10_000
"""Sets of bounds that are tried before another method is, those in a row that may leave no fewer on a wrong side, and
steps of that method at most."""
ROUNDING = 8.0 * np.finfo(float).eps
"""Share of its terms by which rounding may be wrong about a sum."""
Held = tuple[np.ndarray, np.ndarray]
"""Which parameters lie at their lower and at their upper bounds, (n,) bool each."""


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
