"""Effects of the rig that carries the craft: sliders that cock, a tilted rail, the carriage's mass."""

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


def apply_jamming_x(level: float, motion: Motion, /, mu: float) -> float:
    """The carriage cocks under the moment of the horizontal force on the guide: mu |N (z - rail_height)|/spacing."""
    return level + mu * np.abs(motion.load * motion.lever)


def apply_jamming_z(level: float, motion: Motion, /, mu: float) -> float:
    """The slider is pressed onto the guide by the horizontal force between them: mu |N|."""
    return level + mu * np.abs(motion.load)


def apply_tilt(constants: Constants, site: Site, /, angle: np.ndarray) -> None:
    """Gravity leaks into x: -g sin(angle) on all that moves along the rail [rad]."""
    gravity = constants["opt.gravity"]
    gravity[:, X] += gravity[:, Z] * np.sin(angle)


JAMMING_X = Effect(
    id="rail_x.jamming", summary="a carriage that jams on the horizontal rail under load",
    equation="-mu |N (z - rail_height)|/bearing_spacing sgn(v)",
    parameters=(
        Parameter(name="mu", unit="", off=0.0, low=0.0, high=0.1, prior=Prior("halfnormal", 0.0, 0.005), size=0.005,
                  tolerance=0.0005, source="assumption: the paper tells of stuck sliders, no numbers"),
    ),
    stage=Stage.FRICTION, apply=apply_jamming_x, shows=JOINT_SHOWS, look_alikes=("rail_x.coulomb",), target="rail_x",
    needs=RIG, dissipative=True,
)  # fmt: skip
JAMMING_Z = Effect(
    id="rail_z.jamming", summary="a slider that jams on the vertical guide under load", equation="-mu |N| sgn(v)",
    parameters=(
        Parameter(name="mu", unit="", off=0.0, low=0.0, high=1.0, prior=Prior("halfnormal", 0.0, 0.05), size=0.05,
                  tolerance=0.005, source="assumption: the paper tells of stuck sliders, no numbers"),
    ),
    stage=Stage.FRICTION, apply=apply_jamming_z, shows=JOINT_SHOWS, look_alikes=("rail_z.coulomb",), target="rail_z",
    needs=RIG, dissipative=True,
)  # fmt: skip
TILT = Effect(
    id="rail.tilt", summary="a horizontal rail that is not level", equation="-m_x g sin(angle)",
    parameters=(
        Parameter(name="angle", unit="rad", off=0.0, low=-0.3, high=0.3, prior=Prior("normal", 0.0, 0.01), size=0.02,
                  tolerance=0.002, source="assumption: levelled by hand to 0.6 degrees"),
    ),
    stage=Stage.CONSTANT, apply=apply_tilt, shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rail_x.bias", "mocap.misalignment", "rail_x.asymmetry"), writes=("opt.gravity",), follows="position",
)  # fmt: skip
CARRIAGE_MASS = Effect(
    id="carriage.mass", summary="a wrong mass of the carriage", equation="m_carriage + mass",
    parameters=(
        Parameter(name="mass", unit="kg", off=0.0, low=-0.06, high=0.3, prior=Prior("normal", 0.0, 0.01), size=0.03,
                  tolerance=0.0015, source="assumption: 0.080 kg (vehicle.yaml) within 10 g"),
    ),
    stage=Stage.CONSTANT, apply=apply_mass, shows=("/mocap/pose", "/imu/data"), writes=("body_mass",),
    target="carriage", look_alikes=("rail_x.spring", "rail_x.elastic"), needs=("carriage",), follows="command",
)  # fmt: skip
