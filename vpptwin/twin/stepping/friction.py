"""Dry friction that sticks: the force that brings a joint to rest within the step if its friction level suffices."""

from __future__ import annotations

import numpy as np

from vpptwin.engine.compile import compilable
from vpptwin.engine.tree import eliminate, substitute

SWEEPS = 100
"""Most sweeps of the relaxation over rubbing joints; one suffices where the inertia does not couple them."""
SETTLED = 1e-12
"""A sweep that changes no force by more than this share of the largest level ends the relaxation."""


@compilable(keep=True)
def expand_inertia(
    inertia: np.ndarray, row_length: np.ndarray, row_start: np.ndarray, column: np.ndarray, damping: np.ndarray,
    dt: float, dense: np.ndarray,
) -> bool:  # fmt: skip
    """Write M + dt D into `dense`, (nv, nv), from the lower rows of a sparse M; tell whether it couples joints.

    That is the matrix which the engine's Euler step inverts, with D the joints' damping (nv,) [N s/m, N m s/rad].
    """
    coupled = False
    dense[:, :] = 0.0
    for i in range(len(dense)):
        for k in range(row_start[i], row_start[i] + row_length[i]):
            j = column[k]
            dense[i, j] = inertia[k]
            dense[j, i] = inertia[k]
            coupled = coupled or (j != i and inertia[k] != 0.0)
        dense[i, i] += dt * damping[i]
    return coupled


@compilable(keep=True)
def hold_or_slide(push: float, inertia: float, velocity: float, forward: float, backward: float, dt: float) -> float:
    """Friction on one joint [N, N m]: what stops it at the end of the step, within what friction can muster.

    Args:
        push: all other forces on it [N, N m].
        inertia: that they move [kg, kg m²].
        velocity: at the start of the step [m/s, rad/s].
        forward: friction level against motion forward [N, N m].
        backward: likewise against motion backward.
        dt: step [s].
    """
    # v + dt (push + f) / m = 0 solved for f, within the levels: the implicit Euler step of set-valued friction, which
    # sticks at rest and does not chatter (Acary, Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008).
    return np.minimum(np.maximum(-inertia * velocity / dt - push, -forward), backward)


@compilable(forceinline=True)
def rub(
    push: np.ndarray, velocity: np.ndarray, forward: np.ndarray, backward: np.ndarray, dense: np.ndarray,
    inverse: np.ndarray, coupled: bool, dt: float, friction: np.ndarray,
) -> None:  # fmt: skip
    """Write the dry friction of all joints, (nv,) [N, N m], into `friction`.

    Joints that the inertia couples are relaxed one after the other (projected Gauss-Seidel) until none changes.

    Args:
        push: all other generalized forces, (nv,); overwritten.
        velocity: at the start of the step, (nv,).
        forward: friction levels against motion forward, (nv,); 0 for a joint without friction.
        backward: likewise against motion backward.
        dense: M + dt D, (nv, nv); overwritten.
        inverse: room for the rows of its inverse that rubbing joints need, (nv, nv).
        coupled: whether it has entries off the diagonal.
        dt: step [s].
        friction: where the result goes.
    """
    n = len(push)
    if not coupled:
        for i in range(n):
            friction[i] = hold_or_slide(push[i], dense[i, i], velocity[i], forward[i], backward[i], dt)
        return
    # v⁺ = v + dt (M + dt D)⁻¹ (push + f): for each joint in turn the f that stops it, the others' held (Jourdan, Alart,
    # Jean, A Gauss-Seidel like algorithm to solve frictional contact problems, 1998). That is descent, coordinate by
    # coordinate, in a strictly convex quadratic within bounds: it converges, and to the one solution.
    eliminate(dense)
    substitute(dense, push)
    largest = 0.0
    for i in range(n):
        push[i] = velocity[i] + dt * push[i]  # as it would be without friction
        friction[i] = 0.0
        largest = max(largest, forward[i], backward[i])
        if forward[i] > 0.0 or backward[i] > 0.0:
            for j in range(n):
                inverse[i, j] = 0.0
            inverse[i, i] = dt
            substitute(dense, inverse[i])
    for _ in range(SWEEPS):
        change = 0.0
        for i in range(n):
            if forward[i] == 0.0 and backward[i] == 0.0:
                continue
            after = push[i]
            for j in range(n):
                after += inverse[i, j] * friction[j]
            held = min(max(friction[i] - after / inverse[i, i], -forward[i]), backward[i])
            change = max(change, abs(held - friction[i]))
            friction[i] = held
        if change <= SETTLED * largest:
            break
