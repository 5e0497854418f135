"""The paper's reward (Eq. reward_design), a table of terms: each is one function, and weighted by the task.

R = w_p r_p + r_p (w_o r_o + w_v r_v + w_ω r_ω) + w_i r_i, and w_n r_n, which is ours.

Weights are not negative, and a penalty is written as a bonus that it lowers, because an episode that ends early pays
nothing more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vpptwin.engine.arrays import Array, library


@dataclass
class RewardWeights:
    """Weights of the terms in `REWARD_TERMS`, by their names; the first five default to those of the paper's flip.

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
        return sum(weight for name, weight in vars(self).items() if name in REWARD_TERMS)


BOTH, POSITION, ANGLE = 0, 1, 2
"""What an episode is judged by: everything, its position only, or its angle only."""


@dataclass
class RewardInputs:
    """What terms are made of."""

    distance2: Array  # d² = Δx² + Δz², (N,) m²
    velocity: Array  # v_x, v_z, ω, (N, 3) m/s, m/s, rad/s
    integral: Array  # Γ, (N, 2) m
    r_p: Any  # 1 / (1 + 10 d²), (N,); 1 in an episode judged by its angle
    r_o: Any  # (1 + cos Δθ) / 2, (N,); 1 in an episode judged by its position


def position(inputs: RewardInputs, weights: RewardWeights) -> Array:
    """w_p r_p."""
    return weights.position * inputs.r_p


def integral(inputs: RewardInputs, weights: RewardWeights) -> Array:
    """w_i r_i, r_i = 1 / (1 + |Γ|²)."""
    return weights.integral * (1.0 / (1.0 + inputs.integral[:, 0] ** 2 + inputs.integral[:, 1] ** 2))


def velocity(inputs: RewardInputs, weights: RewardWeights) -> Array:
    """w_v r_v, r_v = r_p / (1 + v²): as printed, it carries a factor r_p of its own besides the one in R."""
    return weights.velocity * (inputs.r_p / (1.0 + inputs.velocity[:, 0] ** 2 + inputs.velocity[:, 1] ** 2))


def rate(inputs: RewardInputs, weights: RewardWeights) -> Array:
    """w_ω r_ω, r_ω = r_p / (1 + ω²), likewise."""
    return weights.rate * (inputs.r_p * (1.0 / (1.0 + inputs.velocity[:, 2] ** 2)))


def orientation(inputs: RewardInputs, weights: RewardWeights) -> Array:
    """w_o r_p, times r_o."""
    return inputs.r_p * weights.orientation


def near(inputs: RewardInputs, weights: RewardWeights) -> Array:
    """w_n / (1 + d² / width²), times r_o: r_p hardly tells 2 cm from none."""
    return weights.near / (1.0 + inputs.distance2 / weights.width**2)


@dataclass(frozen=True)
class RewardTerm:
    """One summand of the reward."""

    compute: Callable[[RewardInputs, RewardWeights], Array]
    factor: str = ""  # what it is multiplied by besides: `r_p`, `r_o` or nothing
    judged: tuple[int, ...] = (BOTH, POSITION, ANGLE)  # in episodes judged by which it counts


REWARD_TERMS = {
    "position": RewardTerm(position, judged=(BOTH, POSITION)),
    "integral": RewardTerm(integral, judged=(BOTH, POSITION)),
    "velocity": RewardTerm(velocity, "r_p", (BOTH, POSITION)),
    "rate": RewardTerm(rate, "r_p"),
    "orientation": RewardTerm(orientation, "r_o", (BOTH, ANGLE)),
    "near": RewardTerm(near, "r_o", (BOTH, POSITION)),
}
"""Every term by the name of its weight."""


def compute_reward(
    weights: RewardWeights, delta: Array, velocity: Array, integral: Array, criterion: Array | None = None
) -> Array:
    """R = Σ terms + r_p Σ terms with that factor + r_o Σ terms with that one, of `REWARD_TERMS`.

    An episode judged by its position gets the terms of that with r_o = 1, one judged by its angle those of that with
    r_p = 1; both are scaled to the same best value: so we read the paper's "only one reward criterion per episode".

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
    inputs = RewardInputs(
        distance2, velocity, integral, r_p=1.0 / (1.0 + 10.0 * distance2), r_o=0.5 * (1.0 + xp.cos(delta[:, 2]))
    )
    reward = add_terms(inputs, weights, BOTH)
    if criterion is not None and (xp is not np or criterion.any()):  # a card is not asked
        worth = {name: getattr(weights, name) for name in REWARD_TERMS}
        for judged, judged_inputs, best in (
            (POSITION, replace(inputs, r_o=1.0),
             weights.best - sum(worth[name] for name, term in REWARD_TERMS.items() if POSITION not in term.judged)),
            (ANGLE, replace(inputs, r_p=1.0),
             sum(worth[name] for name, term in REWARD_TERMS.items() if ANGLE in term.judged)),
        ):  # fmt: skip
            scaled = add_terms(judged_inputs, weights, judged) * (weights.best / max(best, 1e-9))
            reward = xp.where(criterion == judged, scaled, reward)
    return reward


def add_terms(inputs: RewardInputs, weights: RewardWeights, judged: int) -> Array:
    """The terms of episodes judged so, those without a factor first, then those times r_p, then those times r_o."""
    sums: dict[str, Any] = {}
    for term in REWARD_TERMS.values():
        if judged in term.judged:
            value = term.compute(inputs, weights)
            sums[term.factor] = sums[term.factor] + value if term.factor in sums else value
    return sums.get("", 0.0) + inputs.r_p * sums.get("r_p", 0.0) + sums.get("r_o", 0.0) * inputs.r_o
