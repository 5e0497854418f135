"""What evolves in an environment besides the twin and its sensors: episodes, and the starts of those that failed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vpptwin.engine.arrays import Array

MAX_STARTS = 256
"""Failed starts that are kept, the latest."""


@dataclass
class Episodes:
    """The episodes that N simulations are in; arrays are written in place, never handed out."""

    target: Array  # x, z, θ, (N, 3) m, m, rad
    turn: Array  # angle that the target has still to turn through, (N,) rad
    stage: Array  # number of triggers so far, (N,) int
    criterion: Array  # what is rewarded, one of `reward.BOTH`, `POSITION`, `ANGLE`, (N,) int
    closest: Array  # smallest angle error since the last trigger, (N,) rad
    surprised: Array  # whether a trigger came in the last step that was not to be expected, (N,) bool
    missed: Array  # whether a target's angle was left before it was met, (N,) bool
    integral: Array  # Γ of what is sensed, which the policy is shown, (N, 2) m
    true_integral: Array  # Γ of the true errors, by which the reward goes, (N, 2) m
    started: Array  # first target, pose and velocity, (N, 9) m, rad, m/s, rad/s
    age: Array  # time since the start, (N,) s
    elapsed: Array  # clock of the episode, which may start later than at 0, (N,) s
    switch: Array  # when the next trigger comes, (N,) s
    due: Array  # when it may come at the earliest, (N,) s
    total: Array  # sum of rewards so far, (N,)
    action: Array  # last one taken, (N, 2) in [-1, 1]
    drawn: Array  # values of the randomized parameters, as the critic is told them, (N, K)
    observation: Array  # last one given out, (N, inputs)
    seen: Array  # what the critic was shown in the last steps, oldest first, (N, memory, width)

    @classmethod
    def allocate(cls, count: int, inputs: int, parameters: int, memory: int, width: int) -> Episodes:
        """Arrays for `count` simulations, all zero, without a trigger."""
        return cls(
            target=np.zeros((count, 3)), turn=np.zeros(count), stage=np.zeros(count, int),
            criterion=np.zeros(count, int), closest=np.full(count, np.inf),
            surprised=np.zeros(count, bool), missed=np.zeros(count, bool),
            integral=np.zeros((count, 2)), true_integral=np.zeros((count, 2)),
            started=np.zeros((count, 9)), age=np.zeros(count),
            elapsed=np.zeros(count), switch=np.full(count, np.inf), due=np.full(count, np.inf),
            total=np.zeros(count), action=np.zeros((count, 2)), drawn=np.zeros((count, parameters)),
            observation=np.zeros((count, inputs), np.float32),
            seen=np.zeros((count, memory, width), np.float32),
        )  # fmt: skip


@dataclass
class FailedStarts:
    """A ring of the latest starts that led to a failure."""

    target: Array  # x, z, θ that were asked for, (MAX_STARTS, 3) m, m, rad
    pose: Array  # x, z, θ, (MAX_STARTS, 3) m, m, rad
    velocity: Array  # m/s, m/s, rad/s, (MAX_STARTS, 3)
    seen: Array  # how many there have been so far, (1,) int

    @classmethod
    def empty(cls) -> FailedStarts:
        """None yet."""
        return cls(np.zeros((MAX_STARTS, 3)), np.zeros((MAX_STARTS, 3)), np.zeros((MAX_STARTS, 3)), np.zeros(1, int))

    def add(self, failed: np.ndarray, started: np.ndarray) -> None:
        """Keep the starts, of (N, 9), of the rows where `failed`, (N,) bool, says so, in place of the oldest."""
        slots = (self.seen[0] + np.arange(np.count_nonzero(failed))) % MAX_STARTS
        self.target[slots], self.pose[slots], self.velocity[slots] = np.split(started[failed], 3, axis=1)
        self.seen += len(slots)

    def replace(
        self, share: float, rng: np.random.Generator, target: np.ndarray, pose: np.ndarray, velocity: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Starts (n, 3) each, one of these in place of a `share` of them, in place; of none while there are none."""
        again = np.flatnonzero(rng.uniform(size=len(target)) < share)
        kept = min(int(self.seen[0]), MAX_STARTS)
        if kept and len(again):
            ids = rng.integers(0, kept, len(again))
            target[again], pose[again], velocity[again] = self.target[ids], self.pose[ids], self.velocity[ids]
        return target, pose, velocity
