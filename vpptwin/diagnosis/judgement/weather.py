"""Whether a force that a twin misses is weather: stationary gusts that the log itself tells of, following nothing.

What gusts are like is fitted to the missing force: how strong, and over which time alike. What is new in them from one
moment to the next, the innovations, nothing can foretell, not even where gusts push a rig about that steers against
them. So any quantity of the rig that predicts innovations on stretches of flight which it was not learnt from says
that an effect is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular
from scipy.signal import lombscargle

from vpptwin.diagnosis.criteria import Criteria
from vpptwin.inference.covariance import factor, solve

FOLDS = 4
FAR = 10**6
"""Tells blocks of one flight from those of another."""
BINS = (4, 8, 16, 48)
MEMORIES = (0.1, 0.3, 1.0)
"""Of the longest that gusts may stay alike."""
ROUGHNESS = (0.01, 0.1, 0.3, 1.0)
"""Variance of what is drawn anew for every pulse, over that of the gusts."""
MOST = 3.0
"""Standard deviations that an innovation counts at most: a step of the wind does not decide."""
SWINGS = 4.0
"""A force swings at least so often in a log, or it only drifts."""
SHRUNK = 30.0
"""Means of bins are held towards zero as if one in so many of their pulses had been zero."""


@dataclass(frozen=True)
class Gusts:
    """Stationary gusts, fitted to the missing force of one joint.

    Attributes:
        memory: time over which they stay alike [s].
        factors: pulses of every flight, with the lower factor of their covariance, of any scale.
        innovations: what is new from pulse to pulse, of variance 1, (n,).
    """

    memory: float
    factors: list[tuple[np.ndarray, np.ndarray]]
    innovations: np.ndarray

    def whiten(self, rows: np.ndarray) -> np.ndarray:
        """What acts on the innovations as rows (n, m) act on the force."""
        white = np.empty_like(rows)
        for pulses, root in self.factors:
            white[pulses] = solve_triangular(root, rows[pulses], lower=True, check_finite=False)
        return white


def fit_gusts(force: np.ndarray, time: np.ndarray, flight: np.ndarray, longest: float) -> Gusts:
    """The likeliest gusts of an exponential law for a force (n,) at times [s] of flights; `longest` in s."""
    best: tuple[float, Gusts] | None = None
    for memory in longest * np.array(MEMORIES):
        for roughness in ROUGHNESS:
            factors, surprise = [], 0.0
            for name in np.unique(flight):
                pulses = np.flatnonzero(flight == name)
                alike = np.exp(-np.abs(time[pulses, None] - time[pulses]) / memory)
                factors.append((pulses, factor(alike + roughness * np.eye(len(pulses)))))
                surprise += 2.0 * float(np.log(np.diag(factors[-1][1])).sum())
            raw = Gusts(float(memory), factors, force)
            white = raw.whiten(force[:, None])[:, 0]
            scale = float(np.sqrt((white**2).mean()))
            surprise += 2.0 * len(force) * np.log(max(scale, 1e-30))
            if best is None or surprise < best[0]:
                innovations = np.clip(white / max(scale, 1e-30), -MOST, MOST)
                best = surprise, Gusts(raw.memory, factors, innovations)
    assert best is not None
    return best[1]


@dataclass(frozen=True)
class Followed:
    """How well a quantity foretells innovations: share of their variance, and in standard deviations of chance."""

    label: str
    share: float
    sigma: float


def rank_followed(gusts: Gusts, quantities: Mapping[str, np.ndarray], fold: np.ndarray) -> list[Followed]:
    """How well quantities (n,) predict innovations on folds that they were not learnt from, best first.

    Sigma is the root of the drop in surprise.
    """
    found = []
    for label, quantity in quantities.items():
        share = max(foretell(gusts, quantity, bins, fold) for bins in BINS)
        sigma = np.sqrt(-len(fold) * np.log1p(-min(max(share, 0.0), 1.0 - 1e-9)))
        found.append(Followed(label, share, float(sigma)))
    return sorted(found, key=lambda each: -each.share)


def foretell(gusts: Gusts, quantity: np.ndarray, bins: int, fold: np.ndarray) -> float:
    """Share of the innovations' variance that a force which is a function of the quantity, in bins, predicts."""
    edges = np.quantile(quantity, np.linspace(0.0, 1.0, bins + 1)[1:-1])
    rows = gusts.whiten((np.searchsorted(edges, quantity)[:, None] == np.arange(bins)).astype(float))
    predicted = np.zeros_like(gusts.innovations)
    for i in range(FOLDS):
        learnt = rows[fold != i]
        gram = learnt.T @ learnt
        gram += np.eye(bins) * np.trace(gram) / bins / SHRUNK
        predicted[fold == i] = rows[fold == i] @ solve(gram, learnt.T @ gusts.innovations[fold != i])
    total = float((gusts.innovations**2).sum())
    return 1.0 - float(((gusts.innovations - predicted) ** 2).sum()) / total if total > 0.0 else 0.0


def leave_behind(track: np.ndarray, time: np.ndarray, flight: np.ndarray, memory: float) -> np.ndarray:
    """How far a track (n,) is from its mean over the past, which fades over `memory` s: the way that it has come."""
    past, order = track.copy(), np.lexsort((time, flight))
    for last, now in pairwise(order):
        if flight[last] == flight[now]:
            kept = np.exp(-(time[now] - time[last]) / memory)
            past[now] = kept * past[last] + (1.0 - kept) * track[now]
    return track - past


def find_swing(force: np.ndarray, time: np.ndarray, flight: np.ndarray) -> tuple[str, np.ndarray]:
    """Phase of the strongest swing of a force (n,) at times [s] of flights, (n,) periods, and its name.

    Lomb's and Scargle's periodogram finds it. All flights have the frequency of the one in which it stands out most,
    each a phase of its own.
    """
    logs, best = [np.flatnonzero(flight == name) for name in np.unique(flight)], (-1.0, 0.0)
    for rows in logs:
        at, pushed = time[rows], force[rows] - force[rows].mean()
        slowest = SWINGS / max(float(np.ptp(at)), 1e-9)
        fastest = 0.5 / float(np.median(np.diff(np.sort(at)))) if len(at) > 1 else 0.0
        rates = np.arange(slowest, fastest, slowest / (2.0 * SWINGS))
        if len(rates) and np.any(pushed):
            power = lombscargle(at, pushed, 2.0 * np.pi * rates, normalize=True)
            best = max(best, (float(power.max()), float(rates[np.argmax(power)])))
    phase = time * best[1]
    for rows in logs:
        phase[rows] += np.angle(np.sum(force[rows] * np.exp(-2j * np.pi * phase[rows]))) / (2.0 * np.pi)
    return f"a swing at {best[1]:.2g} Hz [periods]", phase % 1.0


@dataclass(frozen=True)
class Missing:
    """The force that a twin misses, pulse by pulse of all windows, with what it may follow.

    Attributes:
        force: in multiples of the assumed gusts, (n, nv).
        time: of the pulses, on their flight's clock [s].
        flight: that they belong to.
        quantities: label → (n,).
        felt: whether each could have moved its joint, (n, nv); what sticks tells nothing of the force on it.
    """

    force: np.ndarray
    time: np.ndarray
    flight: np.ndarray
    quantities: Mapping[str, np.ndarray]
    felt: np.ndarray | None = None

    def inspect(self, dof: int, criteria: Criteria) -> Push:
        """How the force on one joint is."""
        if self.felt is not None and not self.felt[:, dof].all():
            rows = np.flatnonzero(self.felt[:, dof])
            quantities = {label: quantity[rows] for label, quantity in self.quantities.items()}
            return Missing(self.force[rows], self.time[rows], self.flight[rows], quantities).inspect(dof, criteria)
        force = self.force[:, dof]
        block = np.floor(self.time / criteria.block) + FAR * self.flight
        fold = np.unique(block, return_inverse=True)[1] % FOLDS
        gusts = fit_gusts(force, self.time, self.flight, criteria.longest_gust)
        usual = criteria.astray * float(np.median(force**2))
        strength = float(np.sqrt(np.minimum(force**2, usual).mean()))
        followed = rank_followed(gusts, self.quantities, fold)
        foretold = float(np.sqrt(max(followed[0].share, 0.0) * (force**2).mean()))
        return Push(dof, strength, followed, foretold)


@dataclass(frozen=True)
class Push:
    """What is missing on one joint.

    Attributes:
        dof: the joint's degree of freedom.
        strength: root mean square in multiples of the assumed gust, pulses that go astray counting less.
        followed: what it follows, best first.
        foretold: root mean square of what the best of these foretells, in the same unit.
    """

    dof: int
    strength: float
    followed: list[Followed]
    foretold: float

    @property
    def sigma(self) -> float:
        """By which it follows what it follows best."""
        return self.followed[0].sigma
