"""What goes into a replay besides commands, and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vpptwin.twin.state import TwinState


@dataclass(frozen=True)
class Driven:
    """Joints and free bodies that follow a log."""

    dofs: np.ndarray  # their degrees of freedom, (D,)
    pose: np.ndarray  # whole poses at every step, of which theirs count, (N, steps, nq) m, rad, unit quaternions
    velocity: np.ndarray  # likewise, (N, steps, nv) m/s, rad/s


class Trajectory(NamedTuple):
    """What became of N simulations under logged commands."""

    state: TwinState  # the final state
    qpos: np.ndarray  # the engine's positions after every step, (N, steps, nq) m, rad
    qvel: np.ndarray  # velocities after every step, (N, steps, nv) m/s, rad/s
    # of the simulated motors after every step, (N, steps, 2) rad/s; None where none is simulated
    rotor_speed: np.ndarray | None
