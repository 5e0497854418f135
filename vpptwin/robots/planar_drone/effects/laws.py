"""Laws that the planar craft alone has: thrust of its rotors, air on its body, sliders that cock, a tilted rail.

What any rig may have lies in `vpptwin.effects`; equation numbers are those of the paper (docs/paper.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vpptwin.effects.base import Motion
from vpptwin.effects.constants import Constants, Site

LOST_TO_STALL = 0.75
"""Share of the pitch beyond onset that makes no thrust."""
X, Z = 0, 2
"""Indices of the world's axes in gravity."""


class Craft(NamedTuple):
    """The planar craft, as FORCE effects on it see it.

    Attributes:
        x, z: position of the hinge [m].
        v_x, v_z: its velocity [m/s].
        rate: q [rad/s].
        sine, cosine: of θ.
        arm: hinge to rotor [m].
        speed_1, speed_2: of the rotors [rad/s].
        time: s since the start of the log.
    """

    x: float
    z: float
    v_x: float
    v_z: float
    rate: float
    sine: float
    cosine: float
    arm: float
    speed_1: float
    speed_2: float
    time: float


class Rotor(NamedTuple):
    """One rotor, as THRUST effects see it.

    Attributes:
        side: -1 for rotor 1 on the left arm, +1 for rotor 2.
        speed: rad/s.
        pitch: blade pitch, mean over the step [rad].
        height: of the hinge above the floor [m].
        axial: velocity of the rotor along its thrust axis [m/s].
    """

    side: float
    speed: float
    pitch: float
    height: float
    axial: float


def apply_thrust_gain(thrust: float, rotor: Rotor, /, gain: float) -> float:
    """k_T is off by a factor (paper Eq. 4)."""
    return thrust * gain


def apply_asymmetry(thrust: float, rotor: Rotor, /, fraction: float) -> float:
    """Rotor 1 is stronger and rotor 2 weaker by a fraction."""
    return thrust * (1.0 - rotor.side * fraction)


def apply_negative_thrust(thrust: float, rotor: Rotor, /, loss: float) -> float:
    """Cambered blades make less thrust at negative pitch."""
    return thrust * (1.0 - loss * (rotor.pitch < 0.0))


def apply_stall(thrust: float, rotor: Rotor, /, onset: float) -> float:
    """Only a quarter of the pitch beyond onset [rad] counts."""
    pitch = np.abs(rotor.pitch)
    return thrust * (1.0 - LOST_TO_STALL * np.maximum(pitch - onset, 0.0) / np.maximum(pitch, onset))


def apply_inflow(thrust: float, rotor: Rotor, /, damping: float) -> float:
    """A rotor that climbs along its thrust axis meets the air at a smaller angle."""
    return thrust - damping * rotor.speed * rotor.axial


def apply_ground_effect(thrust: float, rotor: Rotor, /, gain: float, height: float) -> float:
    """Thrust grows near the floor, fading with `height` [m]; below the floor, where none is, it grows no further."""
    return thrust * (1.0 + gain * np.exp(-np.maximum(rotor.height, 0.0) / height))


def apply_drag(craft: Craft, /, k_d: float) -> tuple[float, float, float]:
    """Aerodynamic drag f_d = -k_d |v| v on the craft (paper, System Identification, item 2)."""
    resistance = k_d * np.sqrt(craft.v_x * craft.v_x + craft.v_z * craft.v_z)
    return -resistance * craft.v_x, -resistance * craft.v_z, 0.0


def apply_in_plane(craft: Craft, /, damping: float) -> tuple[float, float, float]:
    """H-force: the discs resist motion along the arm."""
    along_arm = craft.v_x * craft.cosine + craft.v_z * craft.sine
    force = -damping * (craft.speed_1 + craft.speed_2) * along_arm
    return force * craft.cosine, force * craft.sine, 0.0


def apply_jamming(level: float, motion: Motion, /, mu: float) -> float:
    """The carriage cocks under the moment of the horizontal force on the guide, which its bearings take up."""
    # mu |N (z - rail_height)|/bearing_spacing: the couple of the bearings by their distance, times mu.
    return level + mu * np.abs(motion.load * motion.lever)


def apply_tilt(constants: Constants, site: Site, /, angle: np.ndarray) -> None:
    """Gravity leaks into x: -g sin(angle) on all that moves along the rail [rad]."""
    gravity = constants["opt.gravity"]
    gravity[:, X] += gravity[:, Z] * np.sin(angle)
