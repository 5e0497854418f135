"""What the noise of the sensors alone makes of prediction errors: the floor that no twin can go below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vpptwin.diagnosis.evidence.channels import BIN
from vpptwin.estimation.measurements import Measurements, Series

POSITION, ANGLE = "position_rmse_m", "angle_rmse_rad"
"""Keys of `Score`."""


@dataclass(frozen=True)
class NoiseFloor:
    """Root mean square errors of a perfect twin."""

    rmse: dict[str, float]  # key of a score (velocities by name) → error, in SI units
    units: dict[str, str]  # name of a velocity → its unit
    label: str = "sensor noise"  # else "assumed", a cautious guess that a good twin may well go below, or "estimated"


def find_noise_floor(flights: Sequence[Measurements], guess: str = "assumed noise") -> NoiseFloor:
    """Errors that sensor noise alone makes, root mean square over flights; slides and hinges summed as in a score.

    Args:
        flights: what was measured.
        guess: what the noise of unknown sensors is called.
    """
    squares: dict[str, list[float]] = {}
    units: dict[str, str] = {}
    for flight in flights:
        own: dict[str, float] = {}
        for series in flight.positions.values():
            key = POSITION if series.unit == "m" else ANGLE
            own[key] = own.get(key, 0.0) + variance_of_bin(series)
        for series in flight.velocities.values():
            own[series.name], units[series.name] = variance_of_bin(series), series.unit
        for key, square in own.items():
            squares.setdefault(key, []).append(square)
    known = all(series.white for flight in flights for series in flight.positions.values())
    return NoiseFloor(
        {key: float(np.sqrt(np.mean(parts))) for key, parts in squares.items()},
        units,
        "sensor noise" if known else guess,
    )


def variance_of_bin(series: Series) -> float:
    """Variance of the mean over a bin, whose samples errors are compared with."""
    period = float(np.median(np.diff(series.time))) if len(series.time) > 1 else BIN
    return series.std**2 / (max(round(BIN / period), 1) if series.white else 1)
