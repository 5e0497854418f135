"""The observation of SPEC 6, as pure functions of pose, velocity, target and integral. World frame, SI, unscaled."""

from __future__ import annotations

import numpy as np

OBSERVATION = (
    "delta_x", "delta_z", "velocity_x", "velocity_z", "sin_delta_theta", "cos_delta_theta", "rate",
    "integral_x", "integral_z", "sin_target_theta", "cos_target_theta",
)  # fmt: skip
"""Name of every input; the paper's nine come first."""

PAPER_INPUTS = 9
"""Length of the ablation that does not see the target's angle."""

INTEGRAL_DECAY = 0.9
"""Per policy step (paper, Task Formulation)."""


def accumulate_error(integral: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Position integral Γ_t = 0.9 Γ_{t-1} + Δp_t.

    Args:
        integral: Γ_{t-1}, (N, 2) m; zero before the first step.
        error: Δp_t = target - position, (N, 2) m.

    Returns:
        Γ_t, (N, 2) m.
    """
    return INTEGRAL_DECAY * integral + error


def observe(
    pose: np.ndarray, velocity: np.ndarray, target: np.ndarray, integral: np.ndarray, paper_inputs: bool = False
) -> np.ndarray:
    """What the policy sees, in the order of `OBSERVATION`.

    Args:
        pose: x, z, θ of the craft, (N, 3) m, m, rad.
        velocity: v_x, v_z, q, (N, 3) m/s, m/s, rad/s.
        target: x, z, θ to reach, (N, 3) m, m, rad.
        integral: Γ_t, (N, 2) m.
        paper_inputs: leave out the target's angle.

    Returns:
        (N, 11) float32, or (N, 9) with `paper_inputs`.
    """
    delta = target - pose
    angle, target_angle = delta[:, 2], target[:, 2]
    columns = (
        delta[:, 0], delta[:, 1], velocity[:, 0], velocity[:, 1], np.sin(angle), np.cos(angle), velocity[:, 2],
        integral[:, 0], integral[:, 1], np.sin(target_angle), np.cos(target_angle),
    )  # fmt: skip
    seen = np.empty((len(pose), observation_size(paper_inputs)), np.float32)
    for i in range(seen.shape[1]):
        seen[:, i] = columns[i]
    return seen


def observation_size(paper_inputs: bool = False) -> int:
    """Length of the observation."""
    return PAPER_INPUTS if paper_inputs else len(OBSERVATION)
