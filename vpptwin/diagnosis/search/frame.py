"""What costs are measured in: a frame says how much windows count, how strong noise is and where belief ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.runs import Track
from vpptwin.diagnosis.search.likelihood import Likelihood


@dataclass(frozen=True, eq=False)
class Frame:
    """What the costs of fits must share to be compared. Two frames are the same only if they are one object.

    Attributes:
        weight: of every whitened residual, (K M,); windows that go astray count less.
        scale: variance of the whitened residual; costs are divided by it.
        floor: standard deviation that is added to the sensors' noise, (K, M).
        criteria: thresholds of the diagnosis.
    """

    weight: np.ndarray
    scale: float
    floor: np.ndarray
    criteria: Criteria = CRITERIA

    def whiten(self, raw: np.ndarray, likelihood: Likelihood) -> np.ndarray:
        """Rows (V, K, M) whitened by a likelihood and weighted, (V, K M)."""
        if not len(raw):
            return np.empty((0, self.weight.size))
        return likelihood.whiten(raw).reshape(len(raw), -1) * self.weight

    def whiten_missed(self, raw: np.ndarray, track: Track | None, likelihood: Likelihood) -> np.ndarray:
        """The same of what twins missed, (V, K, M), about a track."""
        return self.whiten(likelihood.response.restore(raw, track), likelihood)


@dataclass(frozen=True, eq=False)
class Rows:
    """A row for every unknown, (P, ...): those `own`, and for the others what many have in `common`, (P, ...)."""

    common: np.ndarray
    own: Mapping[int, np.ndarray] = field(default_factory=dict)

    def change(self, wanted: Sequence[int], rows: np.ndarray) -> Rows:
        """The same with other rows (n, ...) in `wanted` places."""
        return Rows(self.common, {**self.own, **dict(zip(wanted, rows))})

    def take(self, wanted: Sequence[int]) -> np.ndarray:
        """Some of them, (n, ...)."""
        return np.stack([self.own.get(i, self.common[i]) for i in wanted])

    def map(self, function: Callable[[np.ndarray], np.ndarray]) -> Rows:
        """What a function makes of rows (n, ...), row by row."""
        return Rows(function(self.common), {i: function(row[None])[0] for i, row in self.own.items()})

    def each(self, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """The same in one array, (P, ...), of a function that makes new ones."""
        found = self.map(function)
        for i, row in found.own.items():
            found.common[i] = row
        return found.common

    def __matmul__(self, other: np.ndarray) -> np.ndarray:
        """Their products with a vector (n,) or a matrix (n, m), where they are vectors, (P,) or (P, m)."""
        return self.each(lambda part: part @ other)

    def weigh(self, weights: np.ndarray) -> np.ndarray:
        """Their sum, each times its weight, (P,)."""
        shared = weights.copy()
        shared[list(self.own)] = 0.0
        return sum((weights[i] * row for i, row in self.own.items()), start=np.tensordot(shared, self.common, 1))

    def multiply(self) -> np.ndarray:
        """Inner products of rows that are vectors, (P, P)."""
        found = self.common @ self.common.T
        for i, row in self.own.items():
            found[i] = found[:, i] = self @ row
        return found


@dataclass(frozen=True)
class Linearisation:
    """Residual and its derivative by every unknown, about a twin with the parameters `at`, whitened in a frame.

    Attributes:
        frame: what weighed it.
        likelihood: what whitened it.
        at: (P,) in the parameters' units; deviations count from here.
        slopes: derivative of the prediction, (P, K, M).
        missed: residual, (K, M).
        track: about which all that was simulated.
        trials: change of the prediction by every trial, (T, K, M).
        columns: whitened derivative, (P, K M).
        residual: whitened residual, (K M,).
        gram: inner products of the columns, (P, P).
        turned: effects by whose parameters derivatives were taken where `taken` tells, not before; None if none were.
        taken: the parameters there, (P,).
    """

    frame: Frame
    likelihood: Likelihood
    at: np.ndarray
    slopes: Rows
    missed: np.ndarray
    track: Track | None
    trials: np.ndarray
    columns: Rows
    residual: np.ndarray
    gram: np.ndarray
    turned: frozenset[str] | None = None
    taken: np.ndarray | None = None

    def whiten_trials(self, wanted: slice | Sequence[int] = slice(None)) -> np.ndarray:
        """Whitened change of the prediction by trials, all or some, (T, K M); not kept, as it is large."""
        return self.frame.whiten(self.trials[wanted], self.likelihood)

    @cached_property
    def slope(self) -> np.ndarray:
        """Inner products of columns and residual, (P,)."""
        return self.columns @ self.residual

    def under(self, likelihood: Likelihood, frame: Frame) -> Linearisation:
        """The same derivatives whitened by another likelihood, in another frame."""
        found = whiten((self.at, self.slopes, self.missed, self.track, self.trials), likelihood, frame)
        return replace(found, turned=self.turned, taken=self.taken)

    def move(
        self, at: np.ndarray, wanted: list[int], slopes: np.ndarray, missed: np.ndarray, track: Track | None
    ) -> Linearisation:
        """About another point: derivatives by the unknowns `wanted` anew, (n, K, M); the others, and trials, stay."""
        residual = self.frame.whiten_missed(missed[None], track, self.likelihood)[0]
        there = replace(self, at=at, missed=missed, track=track, residual=residual)
        if not wanted:
            return there
        white, gram = self.frame.whiten(slopes, self.likelihood), self.gram.copy()
        columns = self.columns.change(wanted, white)
        gram[:, wanted] = columns @ white.T
        gram[wanted] = gram[:, wanted].T
        return replace(there, slopes=self.slopes.change(wanted, slopes), columns=columns, gram=gram)

    def foretell(self, at: np.ndarray) -> np.ndarray:
        """What a twin with the parameters `at` and no track would miss by this linearisation, (K, M)."""
        return self.likelihood.response.restore(self.missed, self.track) - self.slopes.weigh(at - self.at)


Derivatives = tuple[np.ndarray, Rows, np.ndarray, Track | None, np.ndarray]
"""`at`, `slopes`, `missed`, `track` and `trials` of a linearisation: what no frame changes."""


def whiten(derivatives: Derivatives, likelihood: Likelihood, frame: Frame) -> Linearisation:
    """A linearisation from its derivatives."""
    at, slopes, missed, track, trials = derivatives
    columns = slopes.map(lambda part: frame.whiten(part, likelihood))
    residual = frame.whiten_missed(missed[None], track, likelihood)[0]
    return Linearisation(frame, likelihood, at, slopes, missed, track, trials, columns, residual, columns.multiply())


def weigh_windows(residual: np.ndarray, valid: np.ndarray, times: float) -> np.ndarray:
    """Square roots of Student-t weights, one a window, for whitened residuals (K, M); flat, (K M,).

    A window that fits no better than so many times the usual misfit counts less: a collision, a glitch, or a slip that
    came early there must not outvote all the others.
    """
    square = (residual**2).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
    usual = times * float(np.median(square))
    weight = np.sqrt(2.0 * usual / (usual + np.maximum(square, usual)))
    return np.repeat(weight, residual.shape[1])
