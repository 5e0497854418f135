"""What evolves in an environment besides the twin and its sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class Episodes:
    """The episodes that N simulations are in; arrays are written in place, never handed out."""

    target: np.ndarray  # x, z, θ, (N, 3) m, m, rad
    turn: np.ndarray  # angle that the target has still to turn through, (N,) rad
    stage: np.ndarray  # number of triggers so far, (N,) int
    criterion: np.ndarray  # what is rewarded, one of `reward.BOTH`, `POSITION`, `ANGLE`, (N,) int
    closest: np.ndarray  # smallest angle error since the last trigger, (N,) rad
    surprised: np.ndarray  # whether a trigger came in the last step that was not to be expected, (N,) bool
    missed: np.ndarray  # whether a target's angle was left before it was met, (N,) bool
    integral: np.ndarray  # Γ of what is sensed, which the policy is shown, (N, 2) m
    true_integral: np.ndarray  # Γ of the true errors, by which the reward goes, (N, 2) m
    started: np.ndarray  # first target, pose and velocity, (N, 9) m, rad, m/s, rad/s
    age: np.ndarray  # time since the start, (N,) s
    elapsed: np.ndarray  # clock of the episode, which may start later than at 0, (N,) s
    switch: np.ndarray  # when the next trigger comes, (N,) s
    due: np.ndarray  # when it may come at the earliest, (N,) s
    total: np.ndarray  # sum of rewards so far, (N,)
    action: np.ndarray  # last one taken, (N, 2) in [-1, 1]
    drawn: np.ndarray  # values of the randomized parameters, as the critic is told them, (N, K)
    observation: np.ndarray  # last one given out, (N, inputs)
    seen: np.ndarray  # what the critic was shown in the last steps, oldest first, (N, memory, width)

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
