"""Thrust against blade pitch: the paper's line, polynomials, blade elements with inflow; held-out error chooses.

All are T = ω (ω/ω_ref)^(n - 1) s(α): n = 1 is the paper's T ∝ ω at a fixed pitch, n = 2 what blades do in air.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from vpptwin.actuators.blade import shape_thrust

Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From pitch, (n,) rad, and coefficients to s(α)."""


def bend(order: int) -> Shape:
    """A polynomial in |α| that is odd in α, of up to third order."""

    def shape(pitch: np.ndarray, values: np.ndarray) -> np.ndarray:
        k_t, k_t2, k_t3 = np.concatenate([values[:order], np.zeros(3 - order)])
        return np.asarray(shape_thrust(k_t, k_t2, k_t3, 0.0, pitch))

    return shape


def inflow(pitch: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Blade elements with momentum theory; of coefficients that a search made negative the size counts."""
    p, q = np.abs(values)
    return np.asarray(shape_thrust(p, 0.0, 0.0, q, pitch))


@dataclass(frozen=True)
class ThrustMapForm:
    """A form that a thrust map may have."""

    name: str  # for people
    shape: Shape  # s(α) without its offset
    start: tuple[float, ...]  # coefficients that a search begins with, for thrusts and pitches of order 1
    power: int  # n of T ∝ ω^n


CANDIDATES: tuple[ThrustMapForm, ...] = tuple(
    ThrustMapForm(f"{name}, T ∝ {'ω²' if power == 2 else 'ω'}", shape, start, power)
    for power in (1, 2)
    for name, shape, start in (
        ("linear", bend(1), (1.0,)),
        ("second order", bend(2), (1.0, 0.0)),
        ("third order", bend(3), (1.0, 0.0, 0.0)),
        ("blade elements with inflow", inflow, (1.0, 1.0)),
    )
)


@dataclass(frozen=True)
class ThrustMap:
    """A fitted map."""

    candidate: ThrustMapForm  # its form
    values: np.ndarray  # coefficients, (k,), N s/rad and up
    std: np.ndarray  # their standard deviations, (k,)
    offset: float  # pitch at which there is no thrust, rad
    offset_std: float  # its standard deviation
    reference: float  # rotor speed that coefficients go by, rad/s
    residual: float  # RMS over all levels, N
    held_out: float  # RMS error at pitches that were left out, N
    held_out_std: float  # its standard error

    def predict(self, speed: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        """Thrust of each rotor, (..., r) N, at speed [rad/s] and commanded pitch [rad]."""
        return predict_thrust(self.candidate, self.values, self.offset, self.reference, speed, pitch)


def predict_thrust(
    candidate: ThrustMapForm, values: np.ndarray, offset: float, reference: float, speed: np.ndarray, pitch: np.ndarray
) -> np.ndarray:
    """Thrust of each rotor [N]."""
    return speed * (speed / reference) ** (candidate.power - 1) * candidate.shape(pitch - offset, values)


def fit_map(
    candidate: ThrustMapForm, speed: np.ndarray, pitch: np.ndarray, thrust: np.ndarray, group: np.ndarray,
    shifted: bool = True,
) -> ThrustMap:  # fmt: skip
    """Fit a form by least squares; its held-out error leaves out one pitch after the other.

    Args:
        candidate: the form.
        speed: (L, r) rad/s.
        pitch: (L, r) rad.
        thrust: of all rotors together, (L,) N.
        group: which levels share a pitch, (L,).
        shifted: whether the pitch of no thrust is fitted too; else it is zero.
    """
    reference, wide, most = float(speed.mean()), float(np.abs(pitch).max()), float(np.abs(thrust).max())
    unit = most / (reference * wide)
    scale = np.array([unit / wide**k for k in range(len(candidate.start))])
    if candidate.shape is inflow:
        scale = np.array([unit, np.sqrt(unit * wide)])

    def predict(given: np.ndarray, rows: np.ndarray) -> np.ndarray:
        offset = float(given[-1]) * wide if shifted else 0.0
        values = given[: len(scale)] * scale
        return predict_thrust(candidate, values, offset, reference, speed[rows], pitch[rows]).sum(axis=1)

    def solve(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        start = np.array([*candidate.start, *([0.0] if shifted else [])])
        found = least_squares(lambda given: (predict(given, rows) - thrust[rows]) / most, start, x_scale="jac")
        return found.x, found.jac

    every = np.arange(len(thrust))
    found, jacobian = solve(every)
    missed = np.empty(len(thrust))
    for left_out in np.unique(group):
        out = group == left_out
        missed[out] = predict(solve(every[~out])[0], every[out]) - thrust[out]
    residual = predict(found, every) - thrust
    freedom = max(len(thrust) - len(found), 1)
    # cov = (Jᵀ J)⁻¹ s² (Ljung, 9.4)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(((residual / most) ** 2).sum()) / freedom
    std = np.sqrt(np.diag(covariance))
    squares = np.array([float((missed[group == g] ** 2).mean()) for g in np.unique(group)])
    held_out = float(np.sqrt((missed**2).mean()))
    error = squares.std(ddof=1) / np.sqrt(len(squares)) if len(squares) > 1 else 0.0
    spread = float(error / max(2.0 * held_out, 1e-12))
    count = len(scale)
    return ThrustMap(
        candidate, found[:count] * scale, std[:count] * scale, float(found[-1]) * wide if shifted else 0.0,
        float(std[-1]) * wide if shifted else 0.0, reference, float(np.sqrt((residual**2).mean())), held_out, spread,
    )  # fmt: skip


def choose_map(maps: Sequence[ThrustMap]) -> ThrustMap:
    """The simplest map whose held-out error is within a standard error of the least."""
    best = min(maps, key=lambda fitted: fitted.held_out)
    near = [fitted for fitted in maps if fitted.held_out <= best.held_out + best.held_out_std]
    return min(near, key=lambda fitted: (len(fitted.values), fitted.held_out))
