"""Errors of neighbouring windows are alike: blocks of log, and what their scatter says of sums and differences."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from vpptwin.estimation.windows import Windows


def blocks_of(windows: Windows, length: float) -> np.ndarray:
    """Which block of flight, of so many seconds, every window belongs to, (K,): errors of neighbours are alike."""
    block = np.floor(windows.start / length).astype(int) + 10**6 * windows.flight
    return np.unique(block, return_inverse=True)[1]


def sum_blocks(rows: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Sums of rows (K, H) over blocks, (B, H)."""
    sums = np.zeros((blocks.max() + 1, rows.shape[1]))
    np.add.at(sums, blocks, rows)
    return sums


def resample(sums: np.ndarray, times: int = 500) -> np.ndarray:
    """Totals of sums (V, B, H) over blocks drawn with replacement, the same for all V, (times, V, H)."""
    blocks = sums.shape[1]
    draws = np.random.default_rng(0).integers(blocks, size=(times, blocks))
    counts = np.stack([np.bincount(draw, minlength=blocks) for draw in draws])
    return np.einsum("tb,vbh->tvh", counts, sums)


def tell_apart(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean over blocks (B, H) and its standard error, (H,) each; infinite from fewer than two blocks."""
    number = np.isfinite(rows).sum(axis=0)
    mean = np.nansum(rows, axis=0) / np.maximum(number, 1)
    square = np.nansum((rows - mean) ** 2, axis=0) / np.maximum(number - 1, 1)
    return mean, np.where(number > 1, np.sqrt(square / np.maximum(number, 1)), np.inf)


def to_deviations(times: float, number: int) -> float:
    """The normal deviation that is as improbable as a mean over so many that is so many of its standard errors.

    From a few their own scatter is hardly known (Student's t): two or three that agree by chance tell little.
    """
    tail = max(float(student.sf(abs(times), number - 1)), 1e-300) if number > 1 else 0.5
    return float(np.copysign(norm.isf(tail), times))
