"""Domain randomization: parameters of the twin drawn from the catalogue's priors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vpptwin.effects import Effect

ALL = "all"
"""Stands for every effect of the twin's catalogue."""
PAPER = "paper"
"""Stands for `IDENTIFIED`."""
IDENTIFIED = (
    "airframe.mass", "airframe.inertia", "airframe.com", "carriage.mass", "air.drag", "rotor.thrust_gain",
    "rotor.asymmetry", "rotor.drag", "servo.lag", "servo.trim", "servo.backlash", "command.delay", "mocap.delay",
    "gyro.bias", "rail_x.coulomb", "rail_z.coulomb", "rail_x.viscous", "rail_z.viscous", "pitch.viscous",
)  # fmt: skip
"""What the paper identifies and then randomizes (Domain Randomization): vehicle, actuators, latencies, air, the rig."""


class Parametrized(Protocol):
    """What randomization needs of a twin."""

    def set_parameters(
        self, keys: Sequence[tuple[str, str]], values: np.ndarray, ids: np.ndarray | None = None
    ) -> None:
        """Set K parameters of the simulations `ids` (n,) to values (n, K)."""


@dataclass(frozen=True)
class Priors:
    """The priors of K parameters side by side, so that all are drawn at once.

    Attributes:
        keys: effect id and parameter.
        start: where a draw starts, (K,): mean, low end, or start of a half-normal.
        width: standard deviation or length of the range, (K,).
        uniform: which are uniform, (K,) bool.
        halved: which are half-normal, (K,) bool.
        low: physical bounds, (K,).
        high: likewise.
        off: values without the effects, (K,).
    """

    keys: tuple[tuple[str, str], ...]
    start: np.ndarray
    width: np.ndarray
    uniform: np.ndarray
    halved: np.ndarray
    low: np.ndarray
    high: np.ndarray
    off: np.ndarray

    @classmethod
    def of(cls, effects: Iterable[Effect]) -> Priors:
        """Those of every parameter of some effects."""
        pairs = [(effect.id, p) for effect in effects for p in effect.parameters]
        priors = [p.prior for _, p in pairs]
        return cls(
            keys=tuple((effect, p.name) for effect, p in pairs),
            start=np.array([p.a for p in priors]),
            width=np.array([p.b - p.a if p.kind == "uniform" else p.b for p in priors]),
            uniform=np.array([p.kind == "uniform" for p in priors], dtype=bool),
            halved=np.array([p.kind == "halfnormal" for p in priors], dtype=bool),
            low=np.array([p.low for _, p in pairs]),
            high=np.array([p.high for _, p in pairs]),
            off=np.array([p.off for _, p in pairs]),
        )

    def draw(self, rng: np.random.Generator, count: int, level: np.ndarray | float = 1.0) -> np.ndarray:
        """Draw every parameter inside its bounds, its distance from off times `level`, (count,) or one, (count, K)."""
        draw = rng.standard_normal((count, len(self.keys)))
        draw[:, self.uniform] = rng.uniform(size=(count, int(self.uniform.sum())))
        draw[:, self.halved] = np.abs(draw[:, self.halved])
        drawn = np.clip(self.start + self.width * draw, self.low, self.high)
        share = np.broadcast_to(level, count)[:, None]
        return np.where(share == 1.0, drawn, self.off + share * (drawn - self.off))

    def standardize(self, values: np.ndarray) -> np.ndarray:
        """Values (..., K) from their means in standard deviations, for a critic that is told."""
        spread = self.width * np.where(self.uniform, 12.0**-0.5, np.where(self.halved, (1.0 - 2.0 / np.pi) ** 0.5, 1.0))
        mean = self.start + self.width * np.where(self.uniform, 0.5, np.where(self.halved, (2.0 / np.pi) ** 0.5, 0.0))
        return (values - mean) / spread


def name_effects(names: Sequence[str], catalogue: Sequence[Effect]) -> list[str]:
    """Effect ids that `names`, ids or the names of groups, stand for, each once, in the order of the catalogue.

    An unknown name is passed on, for whoever checks ids to refuse.
    """
    everything = [effect.id for effect in catalogue]
    groups = {ALL: everything, PAPER: list(IDENTIFIED)}
    wanted = [effect for name in names for effect in groups.get(name, [name])]
    return sorted(set(wanted), key=lambda id_: (everything.index(id_) if id_ in everything else -1, id_))


def randomize(
    twin: Parametrized, priors: Priors, ids: np.ndarray, rng: np.random.Generator, level: np.ndarray | float = 1.0
) -> np.ndarray:
    """Give the simulations `ids` (n,) fresh parameters.

    Every draw comes from the prior, which is centred on the nominal vehicle, whatever was drawn before.

    Args:
        twin: in which the effects of the priors are switched on.
        priors: of the parameters to draw.
        ids: simulations to change, (n,) int.
        rng: source of the draws.
        level: multiplies how far the draws are from off, (n,) or one for all.

    Returns:
        What was drawn, (n, K).
    """
    drawn = priors.draw(rng, len(ids), level)
    twin.set_parameters(priors.keys, drawn, ids)
    return drawn
