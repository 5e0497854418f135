"""What evolves in an environment besides the twin and its sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class Episodes:
    """The episodes that N simulations are in; arrays are written in place, never handed out.

    Attributes:
        target: x, z, θ, (N, 3) m, m, rad.
        turn: angle that the target has still to turn through, (N,) rad.
        stage: number of triggers so far, (N,) int.
        criterion: what is rewarded, one of `reward.BOTH`, `POSITION`, `ANGLE`, (N,) int.
        closest: smallest angle error since the last trigger, (N,) rad.
        surprised: whether a trigger came in the last step that was not to be expected, (N,) bool.
        missed: whether a target's angle was left before it was met, (N,) bool.
        integral: Γ of what is sensed, which the policy is shown, (N, 2) m.
        true_integral: Γ of the true errors, by which the reward goes, (N, 2) m.
        started: first target, pose and velocity, (N, 9) m, rad, m/s, rad/s.
        age: time since the start, (N,) s.
        elapsed: clock of the episode, which may start later than at 0, (N,) s.
        switch: when the next trigger comes, (N,) s.
        due: when it may come at the earliest, (N,) s.
        total: sum of rewards so far, (N,).
        action: last one taken, (N, 2) in [-1, 1].
        drawn: values of the randomized parameters, as the critic is told them, (N, K).
        observation: last one given out, (N, inputs).
        seen: what the critic was shown in the last steps, oldest first, (N, memory, width).
    """

    target: np.ndarray
    turn: np.ndarray
    stage: np.ndarray
    criterion: np.ndarray
    closest: np.ndarray
    surprised: np.ndarray
    missed: np.ndarray
    integral: np.ndarray
    true_integral: np.ndarray
    started: np.ndarray
    age: np.ndarray
    elapsed: np.ndarray
    switch: np.ndarray
    due: np.ndarray
    total: np.ndarray
    action: np.ndarray
    drawn: np.ndarray
    observation: np.ndarray
    seen: np.ndarray

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
