"""What a policy is shown, and what its critic, as pure functions. World frame, SI, unscaled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vpptwin.engine.arrays import Array, library
from vpptwin.train.env.reward import ANGLE, POSITION

if TYPE_CHECKING:
    from vpptwin.robots.planar_drone.vehicle import Vehicle
    from vpptwin.train.env.episodes import Episodes
    from vpptwin.twin import TwinState

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
class ObservationTerms:
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


OBSERVATION_TERMS: dict[str, Callable[[Array, Array, Array, Array], Array]] = {
    "delta_x": lambda delta, *_: delta[:, 0],
    "delta_z": lambda delta, *_: delta[:, 1],
    "delta_theta": lambda delta, *_: wrap_angle(delta[:, 2]),
    "sin_delta_theta": lambda delta, *_: library(delta).sin(delta[:, 2]),
    "cos_delta_theta": lambda delta, *_: library(delta).cos(delta[:, 2]),
    "velocity_x": lambda delta, velocity, *_: velocity[:, 0],
    "velocity_z": lambda delta, velocity, *_: velocity[:, 1],
    "rate": lambda delta, velocity, *_: velocity[:, 2],
    "target_theta": lambda delta, velocity, target, _: wrap_angle(target[:, 2]),
    "sin_target_theta": lambda delta, velocity, target, _: library(target).sin(target[:, 2]),
    "cos_target_theta": lambda delta, velocity, target, _: library(target).cos(target[:, 2]),
    "integral_x": lambda delta, velocity, target, integral: integral[:, 0],
    "integral_z": lambda delta, velocity, target, integral: integral[:, 1],
}
"""Every observation term: a function of Δ = target - pose, velocity and target, (N, 3) each, and Γ, (N, 2)."""


def observe(
    pose: Array, velocity: Array, target: Array, integral: Array, observation: ObservationTerms | None = None
) -> Array:
    """What the policy sees, in the order of `observation.names`.

    Args:
        pose: x, z, θ of the craft, (N, 3) m, m, rad.
        velocity: v_x, v_z, q, (N, 3) m/s, m/s, rad/s.
        target: x, z, θ to reach, (N, 3) m, m, rad.
        integral: Γ_t, (N, 2) m.
        observation: what it is shown; by default `OBSERVATION`.

    Returns:
        (N, len(observation.names)) float32; of tensors, their own type.
    """
    xp, delta = library(pose), target - pose
    names = OBSERVATION if observation is None else observation.names
    seen: Array = xp.stack([OBSERVATION_TERMS[name](delta, velocity, target, integral) for name in names], -1)
    return seen.astype(np.float32) if xp is np else seen


PRIVILEGED = (
    *OBSERVATION, "action_thrust", "action_rate", "blade_pitch_1", "blade_pitch_2", "rotor_speed_1", "rotor_speed_2",
    "position_only", "angle_only", "turn", "trigger_soon",
)  # fmt: skip
"""What an asymmetric critic may see and a policy may not: the true observation, in SI units, actuators and schedule, of
order 1; after them come the randomized parameters."""
SPEED_SPAN = 50.0
"""Typical deviation of the rotor speed from nominal, rad/s."""
FORESIGHT = 0.5
"""How far ahead a trigger is shown, as exp(-time / FORESIGHT), s: a value that did not know would jump at every one.

Where an angle is still to be met, that is when it has to be: a value that did not know drowned what a tilt is worth in
the noise of when the flight ends, and a policy never tilted at all."""


def privileged_size(parameters: int) -> int:
    """Length of what is shown of one step when so many parameters are randomized."""
    return len(PRIVILEGED) + parameters


def observe_critic(
    state: TwinState, episodes: Episodes, vehicle: Vehicle, rows: np.ndarray | slice, unmet: np.ndarray
) -> np.ndarray:
    """The privileged state of the simulations `rows` (n), as `PRIVILEGED`, then the parameters, (n, width).

    `unmet`, (N,) bool, says whose angle is still to be met.
    """
    xp = library(unmet)
    criterion, soon = episodes.criterion[rows], xp.where(unmet, episodes.due, episodes.switch)[rows]
    return xp.column_stack([
        observe(state.qpos[rows], state.qvel[rows], episodes.target[rows], episodes.integral[rows]),
        episodes.action[rows],
        state.blade_pitch[rows] / vehicle.rotor.pitch_max,
        (state.rotor_speed[rows] - vehicle.rotor.speed) / SPEED_SPAN,
        criterion == POSITION,
        criterion == ANGLE,
        episodes.turn[rows] / (2.0 * np.pi),
        xp.exp((episodes.elapsed[rows] - soon) / FORESIGHT),
        episodes.drawn[rows],
    ])  # fmt: skip
