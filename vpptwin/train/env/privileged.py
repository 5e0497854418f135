"""What an asymmetric critic may see and a policy may not: the truth, the actuators, and what was randomized."""

from __future__ import annotations

import numpy as np

from vpptwin.engine.arrays import library
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.train.env.episodes import Episodes
from vpptwin.train.env.observe import OBSERVATION, observe
from vpptwin.train.env.reward import ANGLE, POSITION
from vpptwin.twin import TwinState

STATE = (
    *OBSERVATION, "action_thrust", "action_rate", "blade_pitch_1", "blade_pitch_2", "rotor_speed_1", "rotor_speed_2",
    "position_only", "angle_only", "turn", "trigger_soon",
)  # fmt: skip
"""What is shown before the randomized parameters; the observation is the true one, in SI units, the rest of order 1."""
SPEED_SPAN = 50.0
"""Typical deviation of the rotor speed from nominal, rad/s."""
FORESIGHT = 0.5
"""How far ahead a trigger is shown, as exp(-time / FORESIGHT), s: a value that did not know would jump at every one.

Where an angle is still to be met, that is when it has to be: a value that did not know drowned what a tilt is worth in
the noise of when the flight ends, and a policy never tilted at all."""


def privileged_size(parameters: int) -> int:
    """Length of what is shown of one step when so many parameters are randomized."""
    return len(STATE) + parameters


def see_everything(
    state: TwinState, episodes: Episodes, vehicle: Vehicle, rows: np.ndarray | slice, unmet: np.ndarray
) -> np.ndarray:
    """The privileged state of the simulations `rows` (n), in the order of `STATE`, then the parameters, (n, width).

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
