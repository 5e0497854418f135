"""The paper's reward (Eq. reward_design), as a pure function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vpptwin.engine.arrays import Array, library


@dataclass
class RewardWeights:
    """Weights of the terms; the first five default to those of the paper's flip.

    Attributes:
        position: w_p.
        orientation: w_o.
        velocity: w_v.
        rate: w_ω.
        integral: w_i.
        near: w_n, which is ours: within 2 cm of the target r_p changes by 0.4 %. 0 for the paper's reward.
        width: distance at which w_n is worth half, m.
    """

    position: float = 0.8
    orientation: float = 0.8
    velocity: float = 0.2
    rate: float = 0.2
    integral: float = 0.2
    near: float = 0.2
    width: float = 0.03

    @property
    def best(self) -> float:
        """Reward of a step at rest on the target, the most there is."""
        return self.position + self.orientation + self.velocity + self.rate + self.integral + self.near


BOTH, POSITION, ANGLE = 0, 1, 2
"""What an episode is judged by: everything, its position only, or its angle only."""


def compute_reward(
    weights: RewardWeights, delta: Array, velocity: Array, integral: Array,
    criterion: Array | None = None,
) -> Array:  # fmt: skip
    """R = w_p r_p + r_p (w_o r_o + w_v r_v + w_ω r_ω) + w_i r_i + w_n r_n, r_n = r_o / (1 + d² / width²).

    The last term is ours. As the paper writes them, r_v and r_ω carry a factor r_p of their own besides the one in R.
    An episode judged by its position lacks the term of w_o and the r_o in r_n, one judged by its angle gets
    w_o r_o + w_ω / (1 + ω²); both are scaled to the same best value (our reading of the paper's "only one reward
    criterion per episode").

    Args:
        weights: of the task.
        delta: target - state: Δx, Δz, Δθ, (N, 3) m, m, rad.
        velocity: v_x, v_z, q, (N, 3) m/s, m/s, rad/s.
        integral: Γ, (N, 2) m.
        criterion: `BOTH`, `POSITION` or `ANGLE` of every episode, (N,); None for both.

    Returns:
        (N,), between 0 and `weights.best`.
    """
    xp = library(delta)
    distance2 = delta[:, 0] ** 2 + delta[:, 1] ** 2
    r_p = 1.0 / (1.0 + 10.0 * distance2)
    r_o = 0.5 * (1.0 + xp.cos(delta[:, 2]))
    calm = 1.0 / (1.0 + velocity[:, 2] ** 2)
    r_v = r_p / (1.0 + velocity[:, 0] ** 2 + velocity[:, 1] ** 2)
    r_w = r_p * calm
    r_i = 1.0 / (1.0 + integral[:, 0] ** 2 + integral[:, 1] ** 2)
    place = weights.position * r_p + weights.integral * r_i + r_p * (weights.velocity * r_v + weights.rate * r_w)
    near = weights.near / (1.0 + distance2 / weights.width**2)
    reward: Array = place + (r_p * weights.orientation + near) * r_o
    if criterion is not None and (xp is not np or criterion.any()):  # a card is not asked
        best, angle = weights.best, weights.orientation * r_o + weights.rate * calm
        place_best, angle_best = best - weights.orientation, weights.orientation + weights.rate
        reward = xp.where(criterion == POSITION, (place + near) * (best / max(place_best, 1e-9)), reward)
        reward = xp.where(criterion == ANGLE, angle * (best / max(angle_best, 1e-9)), reward)
    return reward
