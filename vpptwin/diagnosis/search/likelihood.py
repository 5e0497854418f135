"""How improbable a residual is: sensor noise, unknown gusts and the unknown starting state, all at once.

A window's residual is r = J_x δx₀ + J_n n + e: δx₀ the error of the estimated starting state, n force pulses that
nobody modelled (gusts), e sensor noise. All are Gaussian, so δx₀ and n are marginalised exactly through the covariance
S = R + J_x P J_xᵀ + J_n Q J_nᵀ, and a residual is judged by S⁻¹.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dtrtri
from scipy.optimize import minimize

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.runs import Key, Track, Variation
from vpptwin.inference.covariance import factor, invert, logdet
from vpptwin.system.cores import in_parts, map_rows

FORGOTTEN = 5.0
"""Gusts so many times that apart have nothing in common."""
MUCH = 10**6
"""Multiplications for which another thread pays."""
MOST_COUPLED = 432
"""Pulses in a stretch of windows: the cost of coupling them grows with the cube, the loss at a cut is small."""
STEP_POSE = {False: 0.002, True: 0.005}
STEP_VELOCITY = {False: 0.01, True: 0.05}


@dataclass(frozen=True, eq=False)
class Whitening:
    """What makes K windows' noise of covariance R + A Aᵀ, R diagonal, independent with variance 1.

    In units of R's standard deviation that is I + U s² Uᵀ, whose inverse root is I + U (1 / √(1 + s²) - 1) Uᵀ: with as
    few columns as A has, it takes no matrix (M, M).

    Attributes:
        std: root of R, (K, M).
        ways: U, orthonormal columns, (K, M, n).
        shrink: 1 / √(1 + s²) - 1, (K, n).
        logdet: logarithm of the determinant of the covariance, (K,).
    """

    std: np.ndarray
    ways: np.ndarray
    shrink: np.ndarray
    logdet: np.ndarray

    @classmethod
    def of(cls, std: np.ndarray, spread: np.ndarray) -> Whitening:
        """For R of standard deviation `std`, (K, M), and A `spread`, (K, M, n)."""
        ways, size, _ = np.linalg.svd(spread / std[..., None], full_matrices=False)
        logdet = np.log1p(size**2).sum(axis=1) + 2.0 * np.log(std).sum(axis=1)
        return cls(std, ways, 1.0 / np.hypot(1.0, size) - 1.0, logdet)

    def apply(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors (..., K, M) whitened."""
        white = vectors / self.std
        return white + apply(self.ways, self.shrink * apply(np.swapaxes(self.ways, 1, 2), white))


@dataclass(frozen=True, eq=False)
class Response:
    """What starting states and unmodelled forces do to K windows of a twin; factors are computed once they are asked.

    Attributes:
        state: derivative by the starting state, (K, M, 2 nv).
        state_std: prior of the starting state, (2 nv,).
        push: derivative by force pulses in units of their standard deviation, (K, M, G) with G = segments nv.
        std: of the sensors' noise and of what nothing is believed beyond, (K, M).
        freedom: measured values less fitted starting states, over all windows.
        assumed: standard deviation of a pulse per degree of freedom, (nv,) N or N m.
    """

    state: np.ndarray
    state_std: np.ndarray
    push: np.ndarray
    std: np.ndarray
    freedom: int
    assumed: np.ndarray

    @cached_property
    def sensors(self) -> Whitening:
        """What whitens sensors' noise and starting states, R + J_x P J_xᵀ."""
        return self.whiten_some(slice(None))

    def whiten_some(self, columns: np.ndarray | slice) -> Whitening:
        """The same for some of what is measured, (M,) bool or a slice of it."""
        return Whitening.of(self.std[:, columns], self.state[:, columns] * self.state_std)

    @cached_property
    def _pushed(self) -> tuple[np.ndarray, np.ndarray]:
        white = self.sensors.apply(np.moveaxis(self.push, -1, 0))
        basis, triangles = np.linalg.qr(np.moveaxis(white, 0, -1))
        return basis, triangles

    @property
    def basis(self) -> np.ndarray:
        """U, orthonormal columns of what force pulses do in every window once sensors are whitened, (K, M, G)."""
        return self._pushed[0]

    @property
    def triangles(self) -> np.ndarray:
        """The pulses in that basis, in units of their standard deviation, (K, G, G)."""
        return self._pushed[1]

    def restore(self, missed: np.ndarray, track: Track | None) -> np.ndarray:
        """What a twin without a track would have missed, to first order, from what one with it missed, (..., K, M)."""
        if track is None:
            return missed
        moved = np.einsum("kmi,ki->km", self.state, np.concatenate([track.pose, track.velocity], axis=1))
        pushed = np.einsum("kmg,kg->km", self.push, (track.push / self.assumed).reshape(len(self.push), -1))
        return missed + moved + pushed

    def along(self, residual: np.ndarray) -> np.ndarray:
        """What pulses could have done to residuals (..., K, M), (..., K, G)."""
        return apply(np.swapaxes(self.basis, 1, 2), self.sensors.apply(residual))


@dataclass(frozen=True)
class Likelihood:
    """Whitening of K windows' residuals.

    Gusts outlast a window, so that windows of one flight are not independent: with U an orthonormal basis of what
    gusts can do inside the windows, the covariance is I + U C Uᵀ once sensors and starting states are whitened, and
    the Cholesky factor of I + C in the order of time turns residuals into innovations.

    Attributes:
        response: what starting states and pulses do.
        gust: strength of the gusts as a multiple of what is assumed, per degree of freedom, (nv,).
        stretches: windows whose gusts are coupled, in the order of time, with the factor of I + C, (n G, n G).
        logdet: logarithm of the determinant of S, every window's share of it, (K,).
    """

    response: Response
    gust: np.ndarray
    stretches: list[tuple[np.ndarray, np.ndarray]]
    logdet: np.ndarray

    def whiten(self, residual: np.ndarray) -> np.ndarray:
        """Residuals (..., K, M) in units of their own standard deviation; independent if the model is right."""
        white = self.response.sensors.apply(residual)
        along = apply(np.swapaxes(self.response.basis, 1, 2), white)
        return white + apply(self.response.basis, self.innovate(along) - along)

    def innovate(self, along: np.ndarray) -> np.ndarray:
        """Innovations of the gusts from what pulses could have done, (..., K, G).

        They are independent with variance 1 if nothing but gusts as strong as assumed disturbs the rig.
        """
        innovation = np.empty_like(along)
        for windows, inverses in self._stretched:
            part = along[..., windows, :]
            flat = part.reshape(*along.shape[:-2], len(windows), -1)
            innovation[..., windows, :] = apply(inverses, flat).reshape(part.shape)
        return innovation

    @cached_property
    def _stretched(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Stretches of as many windows each, side by side: windows (n, w), inverses of the factors (n, w G, w G)."""
        alike = defaultdict[int, list[tuple[np.ndarray, np.ndarray]]](list)
        for windows, root in self.stretches:
            alike[len(windows)].append((windows, root))
        pairs = [tuple(map(np.stack, zip(*each))) for each in alike.values()]
        return [(windows, invert_factors(factors)) for windows, factors in pairs]


def invert_factors(factors: np.ndarray) -> np.ndarray:
    """Inverses of lower triangular matrices, (K, M, M): one is used often, and solving for each costs more."""
    return np.stack([dtrtri(factor.T)[0].T for factor in factors])


def apply(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """The product of matrices (K, N, M) and vectors (V, K, M) or (K, M), one by one, (..., K, N)."""
    if vectors.ndim == 2:
        return np.asarray((matrices @ vectors[..., None])[..., 0])
    least = max(MUCH // max(vectors[:, 0].size * matrices.shape[1], 1), 1)
    product = map_rows(np.matmul, np.moveaxis(vectors, 0, 1), np.swapaxes(matrices, 1, 2), least=least)
    return np.moveaxis(product, 1, 0)


def gust_std(bench: Bench) -> np.ndarray:
    """Standard deviation of an unmodelled force pulse per degree of freedom, (nv,) N, N m."""
    return bench.criteria.gust * bench.spec.robot.disturbance.std


def start_std(bench: Bench) -> np.ndarray:
    """Standard deviation of the state that a window starts from, (2 nv,)."""
    rotary, criteria = bench.spec.robot.rotary, bench.criteria
    pose = np.where(rotary, criteria.start_angle, criteria.start_pose)
    return np.concatenate([pose, np.where(rotary, criteria.start_rate, criteria.start_velocity)])


def likeness_of_gusts(bench: Bench, time: np.ndarray) -> np.ndarray:
    """Correlation between the gusts of segments at times (..., n), (..., n, n).

    Wind outlasts a segment; what disturbs a rig without rotors is taken as independent from segment to segment.
    """
    apart, memory = np.abs(time[..., :, None] - time[..., None, :]), bench.spec.robot.disturbance.memory
    return np.exp(-apart / memory) if memory > 0.0 else (apart == 0.0).astype(float)


def middles_of_segments(bench: Bench) -> np.ndarray:
    """Times of the middle of every gust segment of every window, (K, segments) s."""
    span = bench.windows.steps * bench.windows.dt
    return bench.windows.start[:, None] + (np.arange(bench.segments) + 0.5) * span / bench.segments


def list_stretches(bench: Bench) -> list[np.ndarray]:
    """Windows of one flight that follow each other, in the order of time."""
    windows, memory = bench.windows, bench.spec.robot.disturbance.memory
    if memory == 0.0:
        return [np.array([k]) for k in range(len(windows))]
    order = np.lexsort((windows.start, windows.flight))
    breaks = np.diff(windows.flight[order]) != 0
    breaks |= np.diff(windows.start[order]) > windows.steps * windows.dt + FORGOTTEN * memory
    whole = np.split(order, np.flatnonzero(breaks) + 1)
    most = max(MOST_COUPLED // (bench.segments * bench.spec.model.nv), 1)
    return [piece for part in whole for piece in np.array_split(part, -(-len(part) // most))]


def couple_gusts(bench: Bench, response: Response, gust: np.ndarray) -> Likelihood:
    """The likelihood of a twin whose windows respond so, under gusts `gust` times as strong as assumed, (nv,).

    Args:
        bench: K windows.
        response: what starting states and pulses do in them.
        gust: (nv,).
    """
    size = response.triangles.shape[1]
    time, stretches = middles_of_segments(bench), list_stretches(bench)
    factors, sizes = [np.empty(0)] * len(stretches), response.sensors.logdet.copy()

    def couple(begin: int, end: int) -> None:
        for number, part in enumerate(stretches[begin:end], begin):
            prior = np.kron(likeness_of_gusts(bench, time[part].ravel()), np.diag(gust**2))
            rows = np.zeros((len(part) * size, len(part) * size))
            for i, k in enumerate(part):
                rows[i * size : (i + 1) * size, i * size : (i + 1) * size] = response.triangles[k]
            factors[number] = factor(np.eye(len(rows)) + rows @ prior @ rows.T)
            sizes[part] += 2.0 * np.log(np.diag(factors[number])).reshape(len(part), -1).sum(axis=1)

    in_parts(couple, len(stretches), least=max(MUCH // size**3, 1))
    return Likelihood(response, gust, list(zip(stretches, factors)), sizes)


def tune_gust(bench: Bench, response: Response, residual: np.ndarray) -> np.ndarray:
    """Most probable strength of the gusts as a multiple of what is assumed, (nv,), windows taken one by one.

    Args:
        bench: K windows.
        response: what starting states and pulses do in them.
        residual: (K, M).
    """
    along, criteria = response.along(residual), bench.criteria
    alike = likeness_of_gusts(bench, middles_of_segments(bench))
    (count, size, _), nv = response.triangles.shape, bench.spec.model.nv
    pulses = response.triangles.reshape(count, size, -1, nv)
    spread = np.einsum("kij,kgja->kgia", alike, pulses)
    most, least = criteria.tails * size, max(MUCH // size**3, 1)

    def surprise(log_gust: np.ndarray) -> tuple[float, np.ndarray]:
        """Twice the negative log of how probable gusts are, and its slope by the log of their strength, (nv,)."""
        variance = np.exp(2.0 * log_gust)
        blown = (variance * spread).reshape(count, size, -1)
        covariance = np.eye(size) + blown @ np.swapaxes(response.triangles, 1, 2)
        inverse = map_rows(invert, covariance, least=least)
        white = np.einsum("kgf,kf->kg", inverse, along)
        square = (white * along).sum(axis=1)
        # Student's t: a window that goes astray must not make a storm.
        heavy = (criteria.tails + 1.0) * size * np.log1p(square / most)
        weight = (criteria.tails + 1.0) * size / (most + square)
        pushed, shared = (np.einsum("kg,kgia->kia", white, each) for each in (pulses, spread))
        asked = np.einsum("kgia,kgia->a", (inverse @ response.triangles).reshape(pulses.shape), spread)
        slope = 2.0 * variance * (asked - np.einsum("kia,kia,k->a", pushed, shared, weight))
        doubt = log_gust / criteria.gust_doubt
        total = heavy.sum() + logdet(covariance).sum() + (doubt**2).sum()
        return float(total), slope + 2.0 * doubt / criteria.gust_doubt

    low, high = np.log(criteria.least_gust), np.log(bench.spec.robot.disturbance.most)
    found = minimize(surprise, np.zeros(nv), jac=True, method="L-BFGS-B", bounds=[(low, high)] * nv)
    return np.exp(found.x)


def measure_response(bench: Bench, values: Mapping[Key, float], pushed: bool = True) -> Response:
    """Linearise the windows of a twin with parameters `values` by starting states and, if `pushed`, force pulses."""
    spec, nv = bench.spec, bench.spec.model.nv
    rotary, assumed = spec.robot.rotary, gust_std(bench)
    still = Variation(values)
    variations = [still]
    sizes = []
    led = set(spec.robot.driven)  # which nothing moves
    for dof in range(nv):
        step = STEP_POSE[bool(rotary[dof])]
        variations.append(still if dof in led else Variation(values, pose=step * np.eye(nv)[dof]))
        sizes.append(step)
    for dof in range(nv):
        step = STEP_VELOCITY[bool(rotary[dof])]
        variations.append(still if dof in led else Variation(values, velocity=step * np.eye(nv)[dof]))
        sizes.append(step)
    for segment in range(bench.segments if pushed else 0):
        for dof in range(nv):
            push = segment, dof, float(assumed[dof])
            variations.append(still if dof in led else Variation(values, push=push))
            sizes.append(1.0)
    predicted = bench.predict(variations, values)
    slopes = bench.bound(predicted[1:] - predicted[0]) / np.array(sizes)[:, None, None]
    state, push = slopes[: 2 * nv], slopes[2 * nv :]
    prior = start_std(bench)
    freedom = int(bench.valid.sum()) - 2 * bench.windows.free_dofs * len(bench.windows)
    state, push = np.moveaxis(state, 0, -1), np.moveaxis(push, 0, -1)
    return Response(state, prior, push, bench.std, freedom, assumed)


def build_likelihood(bench: Bench, values: Mapping[Key, float]) -> Likelihood:
    """The likelihood of a twin with the parameters `values`, under gusts as strong as assumed."""
    return couple_gusts(bench, measure_response(bench, values), np.ones(bench.spec.model.nv))
