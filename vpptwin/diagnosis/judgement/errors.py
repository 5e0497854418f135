"""How far a twin's predictions are off on flights that no fit has seen, ahead of states known without looking ahead."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from vpptwin.diagnosis.evidence.bench import Bench
from vpptwin.diagnosis.evidence.channels import BIN
from vpptwin.diagnosis.evidence.flights import HORIZONS_S
from vpptwin.diagnosis.evidence.runs import Key
from vpptwin.diagnosis.judgement.blocks import blocks_of
from vpptwin.diagnosis.judgement.case import Case, Pair
from vpptwin.estimation.initial import estimate_states
from vpptwin.twin.robot.manifold import difference_poses


class PredictionErrors:
    """Errors of twins over the horizon.

    Args:
        bench: windows as long as the last horizon, started from states estimated without looking ahead.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench, self.criteria = bench, bench.criteria
        self._found: dict[frozenset[tuple[Key, float]], dict[str, np.ndarray]] = {}

    def compare(self, before: Mapping[Key, float], after: Mapping[Key, float]) -> Case:
        """Errors of a twin with some parameters beside those with others."""
        first, second, noise = self.squares(before), self.squares(after), self.noise
        blocks = blocks_of(self.bench.windows, self.criteria.block)
        return Case({name: Pair(old, second[name], noise[name], blocks) for name, old in first.items()}, self.criteria)

    @cached_property
    def noise(self) -> dict[str, np.ndarray]:
        """Variance that sensors, and estimates of starting states, put into errors near every horizon, (H,) each.

        Where nobody told how good sensors are, so do the estimates: by how far one that looks ahead too is from one
        that doesn't.
        """
        rotary, windows, horizons = self.bench.spec.robot.rotary, self.bench.windows, np.array(HORIZONS_S)
        off = np.zeros((2, len(rotary)))
        if self.bench.guessed and self.bench.flights:
            model = self.bench.spec.model
            for i in np.unique(windows.flight):
                rows = windows.flight == i
                seen = estimate_states(self.bench.flights[i], windows.start[rows], model, False)
                moved = difference_poses(model, seen[0], windows.pose[rows])
                off += ((moved**2).sum(axis=0), ((seen[1] - windows.velocity[rows]) ** 2).sum(axis=0))
            off /= len(windows)
        found: dict[str, np.ndarray] = {}
        for channel in self.bench.channels:
            if channel.kind in ("position", "velocity"):
                unit, (place, speed) = "rad" if rotary[channel.axis] else "m", off[:, channel.axis]
                name, start = (
                    (unit, place + speed * horizons**2) if channel.kind == "position" else (channel.name, speed)
                )
                found[name] = found.get(name, 0.0) + channel.sensor_std**2 + start + 0.0 * horizons
        return found

    def squares(self, values: Mapping[Key, float]) -> dict[str, np.ndarray]:
        """Squared errors of every long window near every horizon, (K, H): of slides "m", hinges "rad", and rates."""
        errors, rotary = self.by_channel(values), self.bench.spec.robot.rotary
        squares: dict[str, np.ndarray] = {}
        for channel in self.bench.channels:
            if channel.name in errors:
                unit = "rad" if rotary[channel.axis] else "m"
                name, near = unit if channel.kind == "position" else channel.name, errors[channel.name]
                squares[name] = squares[name] + near if name in squares else near
        return squares

    def by_channel(self, values: Mapping[Key, float]) -> dict[str, np.ndarray]:
        """The same of every channel of a position or a velocity, by its name."""
        key = frozenset(values.items())
        if key not in self._found:
            self._found[key] = self._measure_errors(values)
        return self._found[key]

    def locate_miss(self, values: Mapping[Key, float]) -> tuple[str, float | None, float, str]:
        """Where a twin is off most of what its sensors make: joint, from which horizon [s] on, error at the last, unit.

        An error stands out at twice the sensors' noise, or at none: then the horizon is None.
        """
        worst: tuple[float, str, float | None, float, str] = (-1.0, "", None, 0.0, "")
        for channel in self.bench.channels:
            if channel.kind == "position":
                rmse, noise = mean_over(self.by_channel(values)[channel.name]), channel.sensor_std
                out = next((h for h, error in zip(HORIZONS_S, rmse) if error > 2.0 * noise), None)
                found = rmse[-1] / noise, channel.name, out, rmse[-1], channel.unit
                worst = max(worst, found, key=lambda each: each[0])
        return worst[1:]

    def _measure_errors(self, values: Mapping[Key, float]) -> dict[str, np.ndarray]:
        square = np.where(self.bench.valid, self.bench.residual(values), np.nan) ** 2
        return {
            channel.name: np.stack([last_bins(square[:, columns], h) for h in HORIZONS_S], axis=1)
            for channel, columns in zip(self.bench.channels, self.bench.columns)
            if channel.kind in ("position", "velocity")
        }


def last_bins(square: np.ndarray, horizon: float) -> np.ndarray:
    """Mean of the last two bins up to a horizon [s] in every window, (K,); NaN where nothing was measured."""
    end = round(horizon / BIN)
    part = square[:, max(end - 2, 0) : end]
    number = np.isfinite(part).sum(axis=1)
    return np.where(number > 0, np.nansum(part, axis=1) / np.maximum(number, 1), np.nan)


def mean_over(squares: np.ndarray) -> list[float]:
    """Root of the mean over windows that were measured, per horizon."""
    number = np.isfinite(squares).sum(axis=0)
    mean = np.where(number > 0, np.nansum(squares, axis=0) / np.maximum(number, 1), np.nan)
    return [float(v) for v in np.sqrt(mean)]
