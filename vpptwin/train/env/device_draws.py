"""What is drawn for simulations on a device: numbers there, and sets of parameters from a bank."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from vpptwin.engine.arrays import beside
from vpptwin.train.env.episodes import KEPT
from vpptwin.train.env.randomize import Priors, randomize
from vpptwin.twin.warp.step import WarpStep

BANK = 1024
"""Sets of parameters that episodes take theirs from at any time."""
TURNS = 32
"""Policy steps in which all of them are drawn afresh."""


class DeviceDraws:
    """Random numbers on a device, with numpy's names; what draws from `numpy.random.Generator` draws from this too."""

    def __init__(self, device: torch.device, seed: int) -> None:
        self.device = device
        self.generator = torch.Generator(device).manual_seed(seed)

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> torch.Tensor:  # noqa: ANN401
        """Uniform numbers, by default of the shape of `low`."""
        shape = low.shape if size is None else shape_of(size)
        unit = torch.rand(shape, generator=self.generator, device=self.device)
        low, high = (end if isinstance(end, (float, int, torch.Tensor)) else beside(unit, end) for end in (low, high))
        return low + (high - low) * unit

    def standard_normal(self, size: Any) -> torch.Tensor:  # noqa: ANN401
        """Normal numbers."""
        return torch.randn(shape_of(size), generator=self.generator, device=self.device)

    def integers(self, low: int, high: int, size: Any) -> torch.Tensor:  # noqa: ANN401
        """Whole numbers from low to below high."""
        return torch.randint(low, high, shape_of(size), generator=self.generator, device=self.device)

    def choice(self, values: Sequence[float], size: Any) -> torch.Tensor:  # noqa: ANN401
        """Any of some values, each as likely as the other."""
        table = beside(torch.empty(0, device=self.device), values)
        return table[self.integers(0, len(values), size)]


def shape_of(size: Any) -> tuple[int, ...]:  # noqa: ANN401
    """A shape from what numpy calls size."""
    return (size,) if isinstance(size, int) else tuple(size)


class ParameterBank:
    """Sets of parameters with all that effects make of them, drawn on the processor and kept on a device.

    Effects that act on constants run in numpy, as everywhere; a new episode takes a set of the bank.

    Attributes:
        numbers: of the stepper, (rows, sets).
        drawn: what was drawn, standardized for a critic, (sets, K).
    """

    def __init__(self, stepper: WarpStep, priors: Priors, rng: np.random.Generator, device: torch.device) -> None:
        self._stepper, self._priors, self._rng = stepper, priors, rng
        self._device = device
        self.sets = stepper.twin.num_sims
        self.numbers = torch.tensor(stepper.pack_numbers(), dtype=torch.float32, device=device)
        self.drawn = torch.zeros(self.sets, len(priors.keys), device=device)

    def refresh(self, draw_levels: Callable[[int], np.ndarray], first: int = 0, last: int | None = None) -> None:
        """Draw sets afresh, all or those from first to before last, at levels of the moment, (sets,)."""
        ids = np.arange(self.sets)[first:last]
        if not self._priors.keys or not len(ids):
            return
        drawn = randomize(self._stepper.twin, self._priors, ids, self._rng, draw_levels(len(ids)))
        known = np.clip(self._priors.standardize(drawn), -5.0, 5.0)
        self.numbers[:, first:last] = self._send(self._stepper.pack_numbers(slice(first, last)))
        self.drawn[first:last] = self._send(known)

    def _send(self, numbers: np.ndarray) -> torch.Tensor:
        """Numbers on the device, for which nothing waits."""
        tensor = torch.as_tensor(numbers, dtype=torch.float32)
        return tensor.pin_memory().to(self._device, non_blocking=True) if self._device.type == "cuda" else tensor

    def follow(self, step: int, draw_levels: Callable[[int], np.ndarray]) -> None:
        """Draw a share of the sets afresh, that of a policy step."""
        size, turn = -(-self.sets // TURNS), step % TURNS
        self.refresh(draw_levels, turn * size, (turn + 1) * size)


class StartRing:
    """The latest starts that led to a failure, on a device, as `vpptwin.train.env.episodes.FailedStarts` keeps them.

    Attributes:
        starts: target, pose and velocity, (KEPT + 1, 9); the last row takes what is not to be kept.
        seen: how many there have been so far, () int.
    """

    def __init__(self, device: torch.device) -> None:
        self.starts = torch.zeros(KEPT + 1, 9, device=device)
        self.seen = torch.zeros((), dtype=torch.int64, device=device)

    def add(self, here: torch.Tensor, started: torch.Tensor) -> None:
        """Keep the starts (N, 9) of the rows where `here`, (N,) bool, says so."""
        slots = (self.seen + here.cumsum(0) - 1) % KEPT
        self.starts[torch.where(here, slots, KEPT)] = started
        self.seen += here.sum()

    def replace(
        self, share: float, draws: DeviceDraws, target: torch.Tensor, pose: torch.Tensor, velocity: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        """Starts (N, 3) each, one of these in place of a share of them."""
        if not share:
            return target, pose, velocity
        kept = self.seen.clamp(max=KEPT)
        ids = (draws.uniform(size=len(target)) * kept).long().clamp(max=KEPT - 1)
        again = (draws.uniform(size=len(target)) < share) & (kept > 0)
        return torch.where(again[:, None], self.starts[ids], torch.cat([target, pose, velocity], 1)).split(3, 1)
