"""Symmetric matrices that are positive definite but for rounding: their factors, inverses and what they solve.

What is well conditioned is done as LAPACK does it, to the last bit. Where rounding leaves a matrix indefinite, a share
of its own diagonal is added, the least power of ten of rounding with which it has a factor: directions so much weaker
than the others that no number tells them are then as strong as that share, and no strong one moves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg.lapack import dpotri

from vpptwin.system.errors import InputError

EPS = float(np.finfo(float).eps)


def factor(matrix: np.ndarray) -> np.ndarray:
    """Lower triangular factors L of matrices (..., n, n), L L' = matrix.

    Raises:
        InputError: if an entry is not a finite number; so do all functions here.
    """
    check_finite(matrix)
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return one_by_one(factor, matrix) if matrix.ndim > 2 else mend(matrix)


def invert(matrix: np.ndarray) -> np.ndarray:
    """Inverses of matrices (..., n, n), (..., n, n); see `factor`."""
    check_finite(matrix)
    try:
        found = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return one_by_one(invert, matrix) if matrix.ndim > 2 else invert_mended(matrix)
    # Times its own inverse the diagonal of a positive definite matrix is 1 or more.
    sound = (np.einsum("...ii,...ii->...i", found, matrix) > 0.5).all(axis=-1)
    if not sound.all():
        found[~sound] = one_by_one(invert_mended, matrix[~sound])
    return found


def invert_factored(root: np.ndarray) -> np.ndarray:
    """Inverses of L L' of lower triangular factors (K, n, n), several times as fast as `invert`."""
    upper = np.stack([dpotri(each.T)[0] for each in root])  # LAPACK reads the other way round, and fills one half
    return np.asarray(np.triu(upper) + np.swapaxes(np.triu(upper, 1), 1, 2))


def solve(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The x (..., n, m) or, of one matrix, (n,) with `matrix` (..., n, n) x = `target`; see `factor`."""
    check_finite(matrix, target)
    try:
        found = np.linalg.solve(matrix, target)
    except np.linalg.LinAlgError:
        return invert(matrix) @ target
    return found if np.isfinite(found).all() else invert(matrix) @ target


def logdet(matrix: np.ndarray) -> np.ndarray:
    """Logarithms of the determinants of matrices (..., n, n), (...); see `factor`."""
    check_finite(matrix)
    sign, found = np.linalg.slogdet(matrix)
    if (sign > 0.0).all():
        return np.asarray(found)
    roots = 2.0 * np.log(np.einsum("...ii->...i", factor(matrix))).sum(axis=-1)
    return np.where(sign > 0.0, found, roots)


def mend(matrix: np.ndarray) -> np.ndarray:
    """The factor of a matrix (n, n) with as little of its diagonal added as gives it one."""
    size = np.maximum(np.diag(matrix), 0.0)
    unit = np.sqrt(np.where(size > 0.0, size, size.max(initial=0.0) or 1.0))
    with np.errstate(over="ignore"):
        # A strong direction decides nothing on a weak one, and none correlates by more than 1: the loop ends.
        scaled = np.clip(matrix / unit[:, None] / unit, -1.0, 1.0)
    np.fill_diagonal(scaled, size > 0.0)
    share = len(size) * EPS
    while True:
        try:
            return unit[:, None] * np.linalg.cholesky(scaled + share * np.eye(len(size)))
        except np.linalg.LinAlgError:
            share *= 10.0


def invert_mended(matrix: np.ndarray) -> np.ndarray:
    """The inverse of a matrix (n, n) that `mend` factors."""
    root = np.linalg.inv(mend(matrix))
    return root.T @ root


def check_finite(*numbers: np.ndarray) -> None:
    """Refuse what is not a number before anything is made of it.

    Raises:
        InputError: if any is not finite.
    """
    if not all(np.isfinite(each).all() for each in numbers):
        raise InputError(
            "a simulation of the twin that does not stay finite", "finite numbers",
            "look for what runs away: masses, inertias, the unit of the inputs, a step that is too long",
        )  # fmt: skip


def one_by_one(one: Callable[[np.ndarray], np.ndarray], matrices: np.ndarray) -> np.ndarray:
    """What a function makes of every one of some matrices (..., n, n)."""
    flat = matrices.reshape(-1, *matrices.shape[-2:])
    return np.stack([one(each) for each in flat]).reshape(matrices.shape)
