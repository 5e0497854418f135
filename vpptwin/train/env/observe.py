"""The observation of SPEC 6, as pure functions of pose, velocity, target and integral. World frame, SI, unscaled."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vpptwin.engine.arrays import Array, library

OBSERVATION = (
    "delta_x", "delta_z", "velocity_x", "velocity_z", "sin_delta_theta", "cos_delta_theta", "rate",
    "integral_x", "integral_z", "sin_target_theta", "cos_target_theta",
)  # fmt: skip
"""Name of every input of the setup `All`; the paper's nine come first."""

SETUPS = ("VA", "TA", "PI", "All")
"""The paper's four: the angle in radians, or as sine and cosine (TA, All); with the integral (PI, All), or without."""

INTEGRAL_DECAY = 0.9
"""Per policy step (paper, Task Formulation)."""


@dataclass(frozen=True)
class Sight:
    """What a policy is shown."""

    setup: str = "All"  # one of `SETUPS`
    target_angle: bool = True  # show the target's angle, which the paper's inputs lack

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of every input, in order; `delta_theta` and `target_theta` are radians within ±π."""
        trigonometric, integral = self.setup in ("TA", "All"), self.setup in ("PI", "All")
        shown = ["delta_x", "delta_z", "velocity_x", "velocity_z"]
        shown += ["sin_delta_theta", "cos_delta_theta"] if trigonometric else ["delta_theta"]
        shown += ["rate"] + (["integral_x", "integral_z"] if integral else [])
        if self.target_angle:
            shown += ["sin_target_theta", "cos_target_theta"] if trigonometric else ["target_theta"]
        return tuple(shown)


def accumulate_error(integral: Array, error: Array) -> Array:
    """Position integral Γ_t = 0.9 Γ_{t-1} + Δp_t.

    Args:
        integral: Γ_{t-1}, (N, 2) m; zero before the first step.
        error: Δp_t = target - position, (N, 2) m.

    Returns:
        Γ_t, (N, 2) m.
    """
    return INTEGRAL_DECAY * integral + error


def wrap_angle(angle: Array) -> Array:
    """The same angle within [-π, π), rad; any shape."""
    wrapped: Array = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return wrapped


def observe(pose: Array, velocity: Array, target: Array, integral: Array, sight: Sight | None = None) -> Array:
    """What the policy sees, in the order of `sight.names`.

    Args:
        pose: x, z, θ of the craft, (N, 3) m, m, rad.
        velocity: v_x, v_z, q, (N, 3) m/s, m/s, rad/s.
        target: x, z, θ to reach, (N, 3) m, m, rad.
        integral: Γ_t, (N, 2) m.
        sight: what it is shown; by default `OBSERVATION`.

    Returns:
        (N, len(sight.names)) float32; of tensors, their own type.
    """
    xp = library(pose)
    delta = target - pose
    angle, target_angle = delta[:, 2], target[:, 2]
    ways = {
        "delta_x": lambda: delta[:, 0], "delta_z": lambda: delta[:, 1],
        "velocity_x": lambda: velocity[:, 0], "velocity_z": lambda: velocity[:, 1],
        "sin_delta_theta": lambda: xp.sin(angle), "cos_delta_theta": lambda: xp.cos(angle),
        "delta_theta": lambda: wrap_angle(angle), "rate": lambda: velocity[:, 2],
        "integral_x": lambda: integral[:, 0], "integral_z": lambda: integral[:, 1],
        "sin_target_theta": lambda: xp.sin(target_angle), "cos_target_theta": lambda: xp.cos(target_angle),
        "target_theta": lambda: wrap_angle(target_angle),
    }  # fmt: skip
    names = OBSERVATION if sight is None else sight.names
    seen: Array = xp.stack([ways[name]() for name in names], -1)
    return seen.astype(np.float32) if xp is np else seen
