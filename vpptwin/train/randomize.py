"""Domain randomization: parameters of the twin drawn from the catalogue's priors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vpptwin.effects import Effect

ALL = "all"
"""Stands for every effect of the twin's catalogue."""


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
    """

    keys: tuple[tuple[str, str], ...]
    start: np.ndarray
    width: np.ndarray
    uniform: np.ndarray
    halved: np.ndarray
    low: np.ndarray
    high: np.ndarray

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
        )

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Draw every parameter inside its bounds, (count, K)."""
        draw = rng.standard_normal((count, len(self.keys)))
        draw[:, self.uniform] = rng.uniform(size=(count, int(self.uniform.sum())))
        draw[:, self.halved] = np.abs(draw[:, self.halved])
        return np.clip(self.start + self.width * draw, self.low, self.high)


def randomize(twin: Parametrized, priors: Priors, ids: np.ndarray, rng: np.random.Generator) -> None:
    """Give the simulations `ids` (n,) fresh parameters.

    Every draw comes from the prior, which is centred on the nominal vehicle, whatever was drawn before.

    Args:
        twin: in which the effects of the priors are switched on.
        priors: of the parameters to draw.
        ids: simulations to change, (n,) int.
        rng: source of the draws.
    """
    twin.set_parameters(priors.keys, priors.draw(rng, len(ids)), ids)
