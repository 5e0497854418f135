"""Flights that no fit has seen: what a twin's predictions are worth on them, before and after it was extended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from vpptwin.diagnosis.bench import Bench, Key, Variation
from vpptwin.diagnosis.channels import BIN
from vpptwin.diagnosis.likelihood import Likelihood, build_likelihood, rotary_dofs, whiten_with

HORIZONS_S = (0.05, 0.1, 0.25, 0.5, 1.0)


@dataclass(frozen=True)
class Score:
    """Error of one twin on held-out windows.

    Attributes:
        position_rmse_m: root mean square over slide joints per horizon; None where the rig has none.
        angle_rmse_rad: the same over hinges.
        velocity_rmse: joint → root mean square error of its velocity per horizon [m/s or rad/s], where logged.
        chi2: mean squared pose residual over sensor variance, starting states fitted; 1 is the noise floor.
    """

    position_rmse_m: list[float] | None
    angle_rmse_rad: list[float] | None
    velocity_rmse: dict[str, list[float]]
    chi2: float

    def as_dict(self) -> dict[str, object]:
        """The score in the form of SPEC 7, velocities added."""
        return asdict(self)


class HeldOut:
    """Held-out windows, short ones to judge likelihood and long ones for errors over the horizon.

    Args:
        short: windows of the length that is fitted, channels observed.
        long: windows as long as the last horizon, started from states estimated without looking ahead.
    """

    def __init__(self, short: Bench, long: Bench) -> None:
        self.short, self.long = short, long
        self.likelihood: Likelihood = build_likelihood(short, {})
        pose = [c.kind == "position" for c in short.channels]
        self._pose = np.repeat(pose, short.channels[0].value.shape[1])

    def relinearise(self, values: Mapping[Key, float]) -> None:
        """Let gusts and starting states act through a twin with `values` from now on."""
        self.likelihood = build_likelihood(self.short, dict(values))

    def cost(self, values: Mapping[Key, float]) -> np.ndarray:
        """Misfit of every short window under gusts and sensor noise, (K,): minus twice the log-likelihood."""
        return (self.whitened(values) ** 2).sum(axis=1)

    def whitened(self, values: Mapping[Key, float]) -> np.ndarray:
        """Whitened residual of the short windows, (K, M)."""
        return self.likelihood.whiten(self._residual(values))

    def chi2(self, values: Mapping[Key, float]) -> float:
        """Mean squared pose residual over sensor variance with each window's starting state fitted (SPEC 7)."""
        pose, free = self._pose, self.short.windows.free_dofs
        valid = self.short.valid[:, pose]
        noise = self.short.std[:, pose]
        state = self.likelihood.state[:, pose] * self.likelihood.state_std
        covariance = np.einsum("kmi,kni->kmn", state, state)
        diagonal = np.arange(covariance.shape[1])
        covariance[:, diagonal, diagonal] += noise**2
        white = whiten_with(np.linalg.cholesky(covariance), self._residual(values)[:, pose])
        return float((white**2).sum() / max(valid.sum() - 2 * free * len(valid), 1))

    def score(self, values: Mapping[Key, float]) -> Score:
        """Errors over the horizon from causally estimated states, and chi2."""
        pose, velocity = self.long.simulate([Variation(dict(values))])
        rotary = rotary_dofs(self.long.spec)
        sensors = self.long.sensors(values)
        squares: dict[str, list[np.ndarray]] = {"m": [], "rad": []}
        rates: dict[str, list[float]] = {}
        for channel in self.long.channels:
            if channel.kind == "specific force":
                continue
            predicted = self.long.observe_channel(channel, pose[0], velocity[0], sensors)
            measured = channel.weight.sum(axis=2) > 0
            square = np.where(measured, (predicted - channel.value) ** 2, np.nan)
            per_horizon = np.array([self._near(square, h) for h in HORIZONS_S])
            if channel.kind == "position":
                squares["rad" if rotary[channel.axis] else "m"].append(per_horizon)
            else:
                rates[channel.name] = [float(v) for v in np.sqrt(per_horizon)]
        position, angle = (self._root(squares[unit]) for unit in ("m", "rad"))
        return Score(position, angle, rates, self.chi2(values))

    def _near(self, square: np.ndarray, horizon: float) -> float:
        """Mean of the last bins up to a horizon over all windows."""
        end = round(horizon / BIN)
        found = square[:, max(end - 2, 0) : end]
        return float(np.nanmean(found)) if np.isfinite(found).any() else float("nan")

    def _root(self, squares: Sequence[np.ndarray]) -> list[float] | None:
        return [float(v) for v in np.sqrt(np.sum(squares, axis=0))] if squares else None

    def _residual(self, values: Mapping[Key, float]) -> np.ndarray:
        predicted = self.short.predict([Variation(dict(values))])[0]
        return np.where(self.short.valid, self.short.measured - predicted, 0.0)


def improvement(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """Mean drop in cost per window and its standard error, from windows paired before and after, (K,) each.

    Costs count logarithmically, so that one window which goes astray does not decide for all.
    """
    usual = max(float(np.median(after)), 1e-12)
    drop = usual * (np.log1p(before / usual) - np.log1p(after / usual))
    return float(drop.mean()), float(drop.std(ddof=1) / np.sqrt(len(drop))) if len(drop) > 1 else float("inf")
