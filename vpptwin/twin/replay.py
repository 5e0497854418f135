"""What goes into a replay besides commands, and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vpptwin.twin.state import TwinState


@dataclass(frozen=True)
class Driven:
    """Joints and free bodies that follow a log.

    Attributes:
        dofs: their degrees of freedom, (D,).
        pose: whole poses at every step, of which theirs count, (N, steps, nq) m, rad, unit quaternions.
        velocity: likewise, (N, steps, nv) m/s, rad/s.
    """

    dofs: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray


class Replay(NamedTuple):
    """What became of N simulations under logged commands.

    Attributes:
        state: the final state.
        qpos: the engine's positions after every step, (N, steps, nq) m, rad.
        qvel: velocities after every step, (N, steps, nv) m/s, rad/s.
        rotor_speed: of the simulated motors after every step, (N, steps, 2) rad/s; None where none is simulated.
    """

    state: TwinState
    qpos: np.ndarray
    qvel: np.ndarray
    rotor_speed: np.ndarray | None
