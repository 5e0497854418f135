"""Small symmetric positive definite systems, as the inertia of joints, in compiled steps and in plain Python."""

from __future__ import annotations

import numpy as np

from vpptwin.engine.compile import compilable


@compilable(forceinline=True, keep=True)
def eliminate(dense: np.ndarray) -> None:
    """Factors of a symmetric positive definite matrix in the place of its upper half, D Lᵀ, on the diagonal 1/D."""
    n = len(dense)
    for k in range(n):
        pivot = 1.0 / dense[k, k]
        dense[k, k] = pivot
        for i in range(k + 1, n):
            share = dense[k, i] * pivot
            for j in range(i, n):
                dense[i, j] -= share * dense[k, j]


@compilable(forceinline=True, keep=True)
def substitute(dense: np.ndarray, result: np.ndarray) -> None:
    """Multiply a vector, (n,), in its place, by the inverse of the matrix of which `eliminate` left factors."""
    # What is known is taken from all that follow at once: they do not wait for each other.
    n = len(result)
    for k in range(n):
        share = result[k] * dense[k, k]
        for i in range(k + 1, n):
            result[i] -= share * dense[k, i]
    for k in range(n - 1, -1, -1):
        found = result[k] * dense[k, k]
        result[k] = found
        for i in range(k):
            result[i] -= found * dense[i, k]


@compilable(forceinline=True, keep=True)
def solve_inertia(
    mass: np.ndarray, damping: np.ndarray, dt: float, dense: np.ndarray, force: np.ndarray, result: np.ndarray
) -> None:
    """Write (M + dt D)⁻¹ force, (nv,); `dense`, (nv, nv), is room."""
    n = len(force)
    for i in range(n):
        for j in range(i, n):
            dense[i, j] = mass[i, j]
        dense[i, i] += dt * damping[i]
        result[i] = force[i]
    eliminate(dense)
    substitute(dense, result)
