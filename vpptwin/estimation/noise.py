"""How good logged positions and velocities of joints are, read off their samples."""

from __future__ import annotations

import numpy as np

MIN_SAMPLES = 50
"""Samples below which nothing is read off them."""
BELIEVED = 0.01
"""Samples of white noise are averaged over so long [s]."""
WILD = 12.0
"""Third differences beyond so many times the noise are jumps."""
WHITE = (-0.85, -0.65)
"""Correlation of neighbouring third differences of white noise, which is -0.75, as samples show it."""
COUNTED, FAST, DIGIT = 0.1, 20.0, 1e-3
"""Counts are whole within so much, most of them go by so few at once, and decimal steps are decimal to within this."""


def find_spread(value: np.ndarray) -> float:
    """Noise from sample to sample of what is smooth otherwise, (n,), by its third differences."""
    return float(np.median(np.abs(np.diff(value, 3)))) / 0.6745 / np.sqrt(20.0)  # Var(Δ³) = 20 σ², σ = MAD / 0.6745


def find_count(value: np.ndarray) -> float:
    """The step of an encoder whose counts are what is smooth otherwise, (n,); 0 where other noise hides it, or none is.

    Steps of 1, 2 or 5 of the last digit are how a log is written, not how anything was measured.
    """
    moved = np.abs(np.diff(value))
    still = moved <= 1e-9 * max(float(np.ptp(value)), 1e-12)
    moved = moved[~still]
    if len(moved) < MIN_SAMPLES:
        return 0.0
    step = float(np.min(moved))
    step = float(np.mean(moved[moved < 1.5 * step]))
    counts = moved / step
    several = still.any() or np.ptp(np.round(counts)) > 0.0  # else it goes at one speed
    if (
        not several
        or np.median(counts) > FAST
        or np.abs(counts - np.round(counts)).max() > COUNTED
        or find_spread(value) > step
    ):
        return 0.0
    digits = np.log10(np.outer([1.0, 180.0 / np.pi], step / np.array([1.0, 2.0, 5.0])))
    return 0.0 if np.abs(digits - np.round(digits)).min() < DIGIT else step


def estimate_noise(
    time: np.ndarray, value: np.ndarray, share: float, apart: float | None = None, widest: float = np.inf
) -> float:
    """Noise of a joint's logged position or velocity as its bins show it, 1 sigma in its unit.

    Third differences remove what is smooth and leave the noise; but estimators smooth that away too. How far position
    and velocity disagree tells what is left, but for a tenth of `share` of the range in which the signal moves, 1st to
    99th percentile of the samples (n,). Where only one was logged, it is believed so far if its noise is white, which
    shows in third differences, and else no better than `share`.

    Args:
        time: of the samples, (n,) s.
        value: (n,).
        share: of its range.
        apart: the disagreement; None for not known.
        widest: range of the sensor: one that turns for ever errs no more in the tenth turn than in the first.
    """
    low, high = np.percentile(value, [1.0, 99.0])
    floor = max(share * min(float(high - low), widest), 1e-9)
    if len(value) < MIN_SAMPLES:
        return floor
    spread = find_spread(value)
    third = np.clip(np.diff(value, 3), -WILD * spread, WILD * spread)
    likeness = float(third[1:] @ third[:-1]) / max(float(third @ third), 1e-300)
    if white := WHITE[0] < likeness < WHITE[1]:
        spread /= np.sqrt(max(BELIEVED / float(np.median(np.diff(time))), 1.0))
    if step := find_count(value):
        spread, white = 0.5 * step, True  # errors of neighbouring samples are alike: more than step / √12 of each
    if apart is None:
        apart = 0.0 if white else floor
    return float(max(spread, 0.1 * floor, min(apart, floor)))
