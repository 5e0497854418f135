"""Linear regression."""

from __future__ import annotations

import numpy as np


def solve_linear(inputs: np.ndarray, wanted: np.ndarray, alike: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Least squares: coefficients and their standard deviations, both (k,).

    Args:
        inputs: (n, k).
        wanted: (n,).
        alike: so many neighbouring samples count as one.
    """
    scale = np.abs(inputs).max(axis=0)
    found = np.linalg.lstsq(inputs / scale, wanted, rcond=None)[0]
    left = wanted - inputs / scale @ found
    freedom = max(len(wanted) / alike - len(found), 1.0)
    covariance = np.linalg.pinv((inputs / scale).T @ (inputs / scale)) * float(left @ left) / freedom
    return found / scale, np.sqrt(np.diag(covariance)) / scale
