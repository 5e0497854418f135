"""How improbable a residual is: sensor noise, unknown gusts and the unknown starting state, all at once.

A window's residual is r = J_x δx₀ + J_n n + e: δx₀ the error of the estimated starting state, n force pulses that
nobody modelled (gusts), e sensor noise. All are Gaussian, so δx₀ and n are marginalised exactly through the covariance
S = R + J_x P J_xᵀ + J_n Q J_nᵀ, and a residual is judged by S⁻¹.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from vpptwin.diagnosis.bench import Bench, Variation
from vpptwin.twin.model import describe_joints
from vpptwin.twin.spec import TwinSpec

START_POSE = {False: 0.02, True: 0.1}
"""Prior on the starting pose [m], rotary [rad]: wide, the window itself pins it down."""
START_VELOCITY = {False: 0.3, True: 1.0}
"""Prior on the starting velocity [m/s], rotary [rad/s]."""
GUST = 0.01
"""Force that nobody modelled, as a share of the drone's weight."""
GENERIC_GUST = 0.001
"""The same on other rigs, as a share of the force that moves a joint about: indoors, without rotors."""
GUST_TIME = 0.3
"""Time over which gusts stay alike [s]."""
STEP_POSE = {False: 0.002, True: 0.005}
STEP_VELOCITY = {False: 0.01, True: 0.05}


@dataclass(frozen=True)
class Likelihood:
    """Whitening of K windows' residuals.

    Attributes:
        factor: lower Cholesky factors of S, (K, M, M).
        sensor_factor: the same without gusts: what only sensors and the starting state leave uncertain.
        freedom: measured values less fitted starting states, over all windows.
        state: derivative by the starting state, (K, M, 2 nv).
        state_std: prior of the starting state, (2 nv,).
        push: derivative by force pulses in units of their standard deviation, (K, M, segments nv).
    """

    factor: np.ndarray
    sensor_factor: np.ndarray
    freedom: int
    state: np.ndarray
    state_std: np.ndarray
    push: np.ndarray

    def whiten(self, residual: np.ndarray) -> np.ndarray:
        """Residuals (..., K, M) in units of their own standard deviation; independent if the model is right."""
        return whiten_with(self.factor, residual)


def whiten_with(factor: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Solve factor y = residual window by window; residual (V, K, M) or (K, M)."""
    stacked = residual if residual.ndim == 3 else residual[None]
    result = np.empty_like(stacked)
    for k in range(stacked.shape[1]):
        result[:, k] = solve_triangular(factor[k], stacked[:, k].T, lower=True, check_finite=False).T
    return result if residual.ndim == 3 else result[0]


def gust_std(spec: TwinSpec) -> np.ndarray:
    """Standard deviation of an unmodelled force pulse per degree of freedom, (nv,) N, N m."""
    if spec.vehicle is not None:
        weight = spec.vehicle.airframe.mass * spec.vehicle.gravity
        return GUST * weight * np.array([1.0, 1.0, spec.vehicle.airframe.half_length])
    std = np.full(spec.model.nv, 0.0)
    for name, _, scale in describe_joints(spec.model):
        std[spec.model.joint(name).dofadr[0]] = GENERIC_GUST * scale
    return std


def rotary_dofs(spec: TwinSpec) -> np.ndarray:
    """Which degrees of freedom are angles, (nv,) bool."""
    rotary = np.zeros(spec.model.nv, dtype=bool)
    for name, is_rotary, _ in describe_joints(spec.model):
        rotary[spec.model.joint(name).dofadr[0]] = is_rotary
    return rotary


def correlate_segments(bench: Bench) -> np.ndarray:
    """Cholesky factor of the correlation of gusts between the segments of a window, (segments, segments).

    Wind outlasts a segment; what disturbs a rig without rotors is taken as independent from segment to segment.
    """
    if bench.spec.vehicle is None:
        return np.eye(bench.segments)
    middle = (np.arange(bench.segments) + 0.5) * bench.windows.steps * bench.windows.dt / bench.segments
    return np.linalg.cholesky(np.exp(-np.abs(middle[:, None] - middle) / GUST_TIME))


def build_likelihood(bench: Bench, values: dict[tuple[str, str], float]) -> Likelihood:
    """Linearise the windows about a twin with the parameters `values` and assemble their covariances."""
    spec, nv = bench.spec, bench.spec.model.nv
    rotary = rotary_dofs(spec)
    gust = gust_std(spec)
    variations = [Variation(values)]
    sizes = []
    for dof in range(nv):
        step = STEP_POSE[bool(rotary[dof])]
        variations.append(Variation(values, pose=step * np.eye(nv)[dof]))
        sizes.append(step)
    for dof in range(nv):
        step = STEP_VELOCITY[bool(rotary[dof])]
        variations.append(Variation(values, velocity=step * np.eye(nv)[dof]))
        sizes.append(step)
    pulses = [(segment, dof) for segment in range(bench.segments) for dof in range(nv)]
    for segment, dof in pulses:
        variations.append(Variation(values, push=(segment, dof, float(gust[dof]))))
        sizes.append(1.0)
    predicted = bench.predict(variations)
    slopes = (predicted[1:] - predicted[0]) / np.array(sizes)[:, None, None]
    state, push = slopes[: 2 * nv], slopes[2 * nv :]
    prior = [START_POSE[bool(r)] for r in rotary] + [START_VELOCITY[bool(r)] for r in rotary]
    scaled = np.moveaxis(state * np.array(prior)[:, None, None], 0, -1)
    noise = bench.std
    sensor = np.einsum("kmi,kni->kmn", scaled, scaled)
    diagonal = np.arange(sensor.shape[1])
    sensor[:, diagonal, diagonal] += noise**2
    gusts = np.moveaxis(push, 0, -1)
    correlated = gusts @ np.kron(correlate_segments(bench), np.eye(nv))
    full = sensor + np.einsum("kmi,kni->kmn", correlated, correlated)
    return Likelihood(
        np.linalg.cholesky(full),
        np.linalg.cholesky(sensor),
        int(bench.valid.sum()) - 2 * bench.windows.free_dofs * len(bench.windows),
        np.moveaxis(state, 0, -1),
        np.array(prior),
        gusts,
    )
