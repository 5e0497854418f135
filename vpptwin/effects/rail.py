"""Effects of the rig that carries the craft: sliders that cock, a tight spot, a tilted rail, the carriage's mass."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.airframe import apply_mass
from vpptwin.effects.base import Constants, Effect, Motion, Site, Stage
from vpptwin.effects.joint import JOINT_SHOWS
from vpptwin.effects.parameter import Parameter, Prior

X, Z = 0, 2
"""Indices of the world's axes in gravity."""
RIG = ("carriage", "slider")
"""Bodies without which nothing cocks."""
REACH = 2.0
"""Farther than any rail [m]."""


def apply_jamming_x(level: float, motion: Motion, /, mu: float) -> float:
    """The carriage cocks under the moment of the horizontal force on the guide: mu |N (z - rail_height)|/spacing."""
    return level + mu * np.abs(motion.load * motion.lever)


def apply_jamming_z(level: float, motion: Motion, /, mu: float) -> float:
    """The slider is pressed onto the guide by the horizontal force between them: mu |N|."""
    return level + mu * np.abs(motion.load)


def apply_tight_spot(level: float, motion: Motion, /, force: float, place: float, width: float) -> float:
    """More dry friction [N] around a place on the rail [m]."""
    ratio = (motion.position - place) / width
    return level + force * np.exp(-ratio * ratio)


def apply_tilt(constants: Constants, site: Site, /, angle: np.ndarray) -> None:
    """Gravity leaks into x: -g sin(angle) on all that moves along the rail [rad]."""
    gravity = constants["opt.gravity"]
    gravity[:, X] += gravity[:, Z] * np.sin(angle)


JAMMING_X = Effect(
    id="rail_x.jamming",
    summary="a carriage that jams on the horizontal rail under load",
    equation="-mu |N (z - rail_height)|/bearing_spacing sgn(v)",
    parameters=(Parameter("mu", "", 0.0, 0.0, 0.1, Prior("halfnormal", 0.0, 0.005), 0.005, 0.0005),),
    stage=Stage.FRICTION,
    apply=apply_jamming_x,
    shows=JOINT_SHOWS,
    look_alikes=("rail_x.coulomb",),
    target="rail_x",
    needs=RIG,
    dissipative=True,
)
JAMMING_Z = Effect(
    id="rail_z.jamming",
    summary="a slider that jams on the vertical guide under load",
    equation="-mu |N| sgn(v)",
    parameters=(Parameter("mu", "", 0.0, 0.0, 1.0, Prior("halfnormal", 0.0, 0.05), 0.05, 0.005),),
    stage=Stage.FRICTION,
    apply=apply_jamming_z,
    shows=JOINT_SHOWS,
    look_alikes=("rail_z.coulomb",),
    target="rail_z",
    needs=RIG,
    dissipative=True,
)
TIGHT_SPOT = Effect(
    id="rail_x.tight_spot",
    summary="a tight spot on the horizontal rail",
    equation="-force exp(-((x - place)/width)²) sgn(v)",
    parameters=(
        Parameter("force", "N", 0.0, 0.0, 5.0, Prior("halfnormal", 0.0, 0.1), 0.2, 0.02),
        Parameter("place", "m", 0.0, -REACH, REACH, Prior("normal", 0.0, 0.5), 0.05, REACH),
        Parameter("width", "m", 0.1, 0.02, 0.5, Prior("normal", 0.1, 0.02), 0.03, 0.5),
    ),
    stage=Stage.FRICTION,
    apply=apply_tight_spot,
    shows=JOINT_SHOWS,
    look_alikes=("rail_x.coulomb",),
    target="rail_x",
    dissipative=True,
    follows="position",
)
TILT = Effect(
    id="rail.tilt",
    summary="a horizontal rail that is not level",
    equation="-m_x g sin(angle)",
    parameters=(Parameter("angle", "rad", 0.0, -0.3, 0.3, Prior("normal", 0.0, 0.01), 0.02, 0.002),),
    stage=Stage.CONSTANT,
    apply=apply_tilt,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.bias", "mocap.misalignment", "rail_x.asymmetry"),
    writes=("opt.gravity",),
    follows="position",
)
CARRIAGE_MASS = Effect(
    id="carriage.mass",
    summary="a wrong mass of the carriage",
    equation="m_carriage + mass",
    parameters=(Parameter("mass", "kg", 0.0, -0.06, 0.3, Prior("normal", 0.0, 0.01), 0.03, 0.0015),),
    stage=Stage.CONSTANT,
    apply=apply_mass,
    shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.spring", "rail_x.elastic"),
    writes=("body_mass",),
    target="carriage",
    needs=("carriage",),
    follows="command",
)
