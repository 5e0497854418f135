"""What log odds are worth: a monotone map from posterior log odds to how often such a claim is right.

A posterior is as good as its model, and no simulation is exact: claims are overconfident. The map is a logistic
regression (Platt, in Advances in Large Margin Classifiers, 1999) of what was right in sessions with a known truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, log_expit

SPREAD = 3.0
"""Standard deviation of the normal priors of intercept and slope: few claims must not make a step of the map."""
SURE = 0.95
"""Probability by the regression from which claims are among the surest."""


@dataclass(frozen=True)
class Calibration:
    """p = highest / (1 + exp(-(intercept + slope · log odds))).

    Attributes:
        intercept, slope: of the regression; the slope is not negative.
        highest: probability at most: (n + 1) / (n + 2) of n claims that are surest (Laplace's rule of succession).
    """

    intercept: float
    slope: float
    highest: float

    def apply(self, log_odds: float) -> float:
        """Probability that a claim with these posterior log odds is right."""
        return float(self.highest * expit(self.intercept + self.slope * log_odds))


def fit_calibration(log_odds: Sequence[float], right: Sequence[bool], most: float) -> Calibration:
    """The most likely map.

    Args:
        log_odds: of claims; beyond `most` they count as `most`: what is certain must not set the slope.
        right: which of them are.
        most: see above.
    """
    x, y = np.clip(np.asarray(log_odds, float), -most, most), np.asarray(right, bool)

    def cost(parameters: np.ndarray) -> float:
        value = parameters[0] + parameters[1] * x
        prior = 0.5 * float(((parameters / SPREAD) ** 2).sum())
        return prior - float(log_expit(value[y]).sum() + log_expit(-value[~y]).sum())

    found = minimize(cost, [0.0, 1.0], bounds=[(None, None), (0.0, None)])
    sure = int((expit(found.x[0] + found.x[1] * x) > SURE).sum())
    return Calibration(float(found.x[0]), float(found.x[1]), (sure + 1.0) / (sure + 2.0))
