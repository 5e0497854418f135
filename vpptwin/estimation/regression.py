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
    coefficients = np.linalg.lstsq(inputs / scale, wanted, rcond=None)[0]
    residual = wanted - inputs / scale @ coefficients
    freedom = max(len(wanted) / alike - len(coefficients), 1.0)
    # Cov = (XᵀX)⁻¹ rᵀr / (n - k)
    covariance = np.linalg.pinv((inputs / scale).T @ (inputs / scale)) * float(residual @ residual) / freedom
    return coefficients / scale, np.sqrt(np.diag(covariance)) / scale
