"""The true rig under given commands: no pilot, no firmware, no gusts, and the sensors are perfect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .plant import Plant
from .rig import Rig
from .rotor import STEP, SUBSTEPS, Motor, Propeller, Servo


@dataclass(frozen=True)
class Replay:
    """What became of the flights at 0, every, 2 every, ... s."""

    states: np.ndarray  # x m, z m, theta rad and their rates. (times, 6, flights)
    reversed: np.ndarray  # Dry friction N, N m of each joint, summed over its reversals so far. (times, 3, flights)
    arrested: np.ndarray  # Likewise, summed over its reversals and its stops

    def take(self, which: np.ndarray) -> Replay:
        """Some of the flights."""
        return Replay(self.states[..., which], self.reversed[..., which], self.arrested[..., which])


def replay_commands(
    rig: Rig,
    state: np.ndarray,
    pitch: np.ndarray,
    throttle: np.ndarray,
    hold: float,
    *,
    every: float = 0.01,
    start: float = 0.0,
    step: float = STEP,
) -> Replay:
    """Fly from given states with the blades at zero and the rotors at their governed speed.

    Args:
        rig: The true rigs.
        state: x m, z m, theta rad and their rates. (6, flights).
        pitch: Commanded blade pitch, rad. (commands, 2, flights).
        throttle: Share of battery voltage. (commands, 2, flights).
        hold: s that each command lasts; a whole number of steps.
        every: s from one kept state to the next; a whole number of steps.
        start: s since the start of the log.
        step: s, a quarter of which the mechanics take at a time.
    """
    plant, motor = Plant(rig, state[:3], state[3:], step), Motor(rig, step)
    servo, propeller = Servo(rig, np.zeros_like(pitch[0]), step), Propeller(rig)
    calm = np.zeros((SUBSTEPS, 3, rig.count))
    per, keep = round(hold / step), round(every / step)
    reversed_so_far = arrested_so_far = np.zeros_like(state[:3])
    states, reversals, arrests = [state.copy()], [reversed_so_far], [arrested_so_far]
    for k in range(len(pitch) * per):
        path = servo.advance(pitch[k // per])
        speeds = motor.advance(throttle[k // per], path, start + k * step)
        before = np.sign(plant.velocity)
        plant.advance(propeller.compute_thrust(path, speeds), speeds, calm)
        along = before * plant.velocity
        arrested = (along <= 0.0) & (before != 0.0)
        if arrested.any():
            level = plant.friction.compute_levels(plant.position, plant.velocity, plant.side_load)[1]
            arrested_so_far = arrested_so_far + np.where(arrested, level, 0.0)
            reversed_so_far = reversed_so_far + np.where(along < 0.0, level, 0.0)
        if (k + 1) % keep == 0:
            states.append(np.concatenate([plant.position, plant.velocity]))
            reversals.append(reversed_so_far)
            arrests.append(arrested_so_far)
    return Replay(np.array(states), np.array(reversals), np.array(arrests))
