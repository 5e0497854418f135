"""What costs are measured in: a frame says how much windows count, how strong noise is and where belief ends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.bench import Track
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
        turned: effects by whose parameters derivatives were taken at just this point; None if at another.
    """

    frame: Frame
    likelihood: Likelihood
    at: np.ndarray
    slopes: np.ndarray
    missed: np.ndarray
    track: Track | None
    trials: np.ndarray
    columns: np.ndarray
    residual: np.ndarray
    gram: np.ndarray
    turned: frozenset[str] | None = None

    @cached_property
    def tried(self) -> np.ndarray:
        """Whitened change of the prediction by every trial, (T, K M): few linearisations are asked for it."""
        return self.frame.whiten(self.trials, self.likelihood)

    @cached_property
    def slope(self) -> np.ndarray:
        """Inner products of columns and residual, (P,)."""
        return self.columns @ self.residual

    def under(self, likelihood: Likelihood, frame: Frame) -> Linearisation:
        """The same derivatives whitened by another likelihood, in another frame."""
        found = whiten((self.at, self.slopes, self.missed, self.track, self.trials), likelihood, frame)
        return replace(found, turned=self.turned)

    def move(
        self, at: np.ndarray, wanted: list[int], slopes: np.ndarray, missed: np.ndarray, track: Track | None
    ) -> Linearisation:
        """About another point: derivatives by the unknowns `wanted` anew, (n, K, M); the others, and trials, stay."""
        residual = self.frame.whiten_missed(missed[None], track, self.likelihood)[0]
        there = replace(self, at=at, missed=missed, track=track, residual=residual)
        if not wanted:
            return there
        moved, columns, gram = self.slopes.copy(), self.columns.copy(), self.gram.copy()
        moved[wanted], columns[wanted] = slopes, self.frame.whiten(slopes, self.likelihood)
        gram[wanted] = columns[wanted] @ columns.T
        gram[:, wanted] = gram[wanted].T
        return replace(there, slopes=moved, columns=columns, gram=gram)

    def foretell(self, at: np.ndarray) -> np.ndarray:
        """What a twin with the parameters `at` and no track would miss by this linearisation, (K, M)."""
        return self.likelihood.response.restore(self.missed, self.track) - np.tensordot(at - self.at, self.slopes, 1)


Derivatives = tuple[np.ndarray, np.ndarray, np.ndarray, Track | None, np.ndarray]
"""`at`, `slopes`, `missed`, `track` and `trials` of a linearisation: what no frame changes."""


def whiten(derivatives: Derivatives, likelihood: Likelihood, frame: Frame) -> Linearisation:
    """A linearisation from its derivatives."""
    at, slopes, missed, track, trials = derivatives
    columns = frame.whiten(slopes, likelihood)
    residual = frame.whiten_missed(missed[None], track, likelihood)[0]
    return Linearisation(frame, likelihood, at, slopes, missed, track, trials, columns, residual, columns @ columns.T)


def weigh_windows(residual: np.ndarray, valid: np.ndarray, times: float) -> np.ndarray:
    """Square roots of Student-t weights, one a window, for whitened residuals (K, M); flat, (K M,).

    A window that fits no better than so many times the usual misfit counts less: a collision, a glitch, or a slip that
    came early there must not outvote all the others.
    """
    square = (residual**2).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
    usual = times * float(np.median(square))
    weight = np.sqrt(2.0 * usual / (usual + np.maximum(square, usual)))
    return np.repeat(weight, residual.shape[1])
