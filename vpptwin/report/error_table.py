"""Prediction errors over the horizon as tables of text, for the terminal and the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.diagnosis.evidence.noise import ANGLE, POSITION, NoiseFloor
from vpptwin.diagnosis.judgement.holdout import Score

CHANGED = 0.02
"""Share by which an error must change to be looked at."""


@dataclass(frozen=True)
class ErrorRow:
    """Errors at one horizon; `after` and `change` (its 90 % interval) are empty where there is nothing to compare."""

    horizon: str
    before: str
    after: str = ""
    change: str = ""


@dataclass(frozen=True)
class ErrorTable:
    """Errors of one quantity over the horizon."""

    quantity: str  # what is wrong by that much
    unit: str  # of all figures
    rows: list[ErrorRow]  # one for each horizon
    noise: str  # what the noise of the sensors alone makes; empty where nobody knows
    noise_label: str = "sensor noise"  # what to call that
    # whether it changed by more than `CHANGED` at some horizon; true where there is nothing to compare
    changed: bool = True
    pose: bool = True  # of a pose, not of a rate
    first: Sequence[float] = ()  # the figures before, in `unit`
    second: Sequence[float] | None = None  # and after
    spans: Sequence[tuple[float, float]] | None = None  # 90 % intervals of the change, as shares

    def share(self, at: int) -> float:
        """Share of the error that stays at a horizon; 1 where nobody can tell."""
        share = self.second[at] / self.first[at] if self.second is not None and self.first[at] > 0.0 else 1.0
        return share if math.isfinite(share) else 1.0

    def is_doubtful(self, at: int) -> bool:
        """Whether chance may have made the change there."""
        return self.spans is not None and self.spans[at][0] < 0.0 < self.spans[at][1]


def tabulate_errors(
    before: Score, after: Score | None, noise: NoiseFloor,
    changes: Mapping[str, Sequence[tuple[float, float]]] | None = None,
) -> list[ErrorTable]:  # fmt: skip
    """Errors over the horizon as tables.

    Args:
        before: of the twin as it was.
        after: of the extended one; None if there is none.
        noise: what sensor noise alone makes.
        changes: 90 % intervals of the change per horizon, as a share of the error before, by key of the score.
    """
    tables = []
    for key, quantity, unit, first in (
        (POSITION, "position", "mm", before.position_rmse_m),
        (ANGLE, "angle", "mrad", before.angle_rmse_rad),
        *((name, name, f"m{noise.units.get(name, '')}", rates) for name, rates in before.velocity_rmse.items()),
    ):
        if first is None:
            continue
        second = None if after is None else getattr(after, key, None) or after.velocity_rmse.get(key)
        spans = (changes or {}).get(key) if second is not None else None
        rows = [
            ErrorRow(
                f"{horizon:g} s",
                format_error(1e3 * first[i]),
                format_error(1e3 * second[i]) if second is not None else "",
                format_change(*spans[i]) if spans else "",
            )
            for i, horizon in enumerate(HORIZONS_S)
        ]
        floor = noise.rmse.get(key)
        shown = format_error(1e3 * floor) if floor is not None else ""
        given = [1e3 * error for error in first], second and [1e3 * error for error in second], spans
        about = shown, noise.label, is_changed(first, second), key in (POSITION, ANGLE)
        tables.append(ErrorTable(quantity, unit, rows, *about, *given))
    return tables


def is_changed(before: Sequence[float], after: Sequence[float] | None) -> bool:
    """Whether errors differ at some horizon by more than nobody would look at."""
    return after is None or any(abs(b - a) > CHANGED * abs(a) for a, b in zip(before, after))


def format_error(value: float) -> str:
    """Three digits, without an exponent."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def format_change(low: float, high: float) -> str:
    """An interval of a change in percent."""
    first, last = round(100.0 * low), round(100.0 * high)
    return "0 %" if first == last == 0 else f"{first:+d} to {last:+d} %".replace("-", "−").replace("+0", "0")
