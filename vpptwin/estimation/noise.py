"""Noise of samples of what is smooth otherwise."""

from __future__ import annotations

import numpy as np

WILD = 12.0
"""Third differences beyond so many times the noise are jumps."""
WHITE = (-0.85, -0.65)
"""Correlation of neighbouring third differences of white noise, which is -0.75, as samples show it."""


def find_spread(value: np.ndarray) -> float:
    """Noise from sample to sample of what is smooth otherwise, (n,), by its third differences."""
    return float(np.median(np.abs(np.diff(value, 3)))) / 0.6745 / np.sqrt(20.0)


def is_white(value: np.ndarray) -> bool:
    """Whether the noise of what is smooth otherwise, (n,), is white, as its third differences show it."""
    spread = find_spread(value)
    third = np.clip(np.diff(value, 3), -WILD * spread, WILD * spread)
    return WHITE[0] < float(third[1:] @ third[:-1]) / max(float(third @ third), 1e-300) < WHITE[1]
