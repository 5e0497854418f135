"""Where new episodes start: as the task says, or as an episode did that failed soon after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

KEPT = 256
"""Failed starts that are kept, the latest."""
SOON = 1.0
"""How long after its start a failure is put down to it, s."""


@dataclass
class FailedStarts:
    """A ring of the latest starts that led to a failure."""

    target: np.ndarray  # x, z, θ that were asked for, (KEPT, 3) m, m, rad
    pose: np.ndarray  # x, z, θ, (KEPT, 3) m, m, rad
    velocity: np.ndarray  # m/s, m/s, rad/s, (KEPT, 3)
    seen: np.ndarray  # how many there have been so far, (1,) int

    @classmethod
    def empty(cls) -> FailedStarts:
        """None yet."""
        return cls(np.zeros((KEPT, 3)), np.zeros((KEPT, 3)), np.zeros((KEPT, 3)), np.zeros(1, int))

    def add(self, target: np.ndarray, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Keep more, (n, 3) each, in place of the oldest."""
        slots = (self.seen[0] + np.arange(len(target))) % KEPT
        self.target[slots], self.pose[slots], self.velocity[slots] = target, pose, velocity
        self.seen += len(target)

    def replace(
        self, share: float, rng: np.random.Generator, target: np.ndarray, pose: np.ndarray, velocity: np.ndarray
    ) -> None:
        """Put one of these in place of a `share` of new starts (n, 3), in place; of none while there are none."""
        again = np.flatnonzero(rng.uniform(size=len(target)) < share)
        kept = min(int(self.seen[0]), KEPT)
        if not kept or not len(again):
            return
        ids = rng.integers(0, kept, len(again))
        target[again], pose[again], velocity[again] = self.target[ids], self.pose[ids], self.velocity[ids]
