"""Effects on the craft as a body: errors of mass and inertia, a centre of mass off the hinge."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior

X, Y, Z = 0, 1, 2
"""Indices of the body's axes: along the arm, into the page, along the thrust."""


def apply_mass(constants: Constants, site: Site, /, mass: np.ndarray) -> None:
    """Mass added to that of a body [kg]: the craft, or the carriage, which moves in x only."""
    constants["body_mass"][:, site.body] += mass


def apply_inertia(constants: Constants, site: Site, /, inertia: np.ndarray) -> None:
    """Inertia about the hinge added to the nominal craft [kg m^2]."""
    constants["body_inertia"][:, site.body, Y] += inertia


def apply_com(constants: Constants, site: Site, /, offset: np.ndarray) -> None:
    """Centre of mass along the arm, towards rotor 2 [m]. The inertia about the hinge grows by m offset²."""
    constants["body_ipos"][:, site.body, X] += offset


def apply_com_height(constants: Constants, site: Site, /, offset: np.ndarray) -> None:
    """Centre of mass above the hinge [m]. The inertia about the hinge grows by m offset²."""
    constants["body_ipos"][:, site.body, Z] += offset


MASS = Effect(
    id="airframe.mass", summary="a wrong mass of the craft", equation="m + mass",
    parameters=(
        Parameter(name="mass", unit="kg", off=0.0, low=-0.09, high=0.15, prior=Prior("normal", 0.0, 0.02), size=0.02,
                  tolerance=0.0018, source="assumption: 0.450 kg (vehicle.yaml) within 20 g"),
    ),
    stage=Stage.CONSTANT, apply=apply_mass, shows=("/mocap/pose", "/imu/data"),
    look_alikes=("rotor.thrust_gain", "rail_z.bias", "servo.trim"), writes=("body_mass",), follows="command",
)  # fmt: skip
INERTIA = Effect(
    id="airframe.inertia", summary="a wrong moment of inertia of the craft", equation="I + inertia",
    parameters=(
        Parameter(name="inertia", unit="kg m^2", off=0.0, low=-0.003, high=0.006, prior=Prior("normal", 0.0, 0.0004),
                  size=0.0004, tolerance=0.00008, source="assumption: 0.0060 kg m^2 (vehicle.yaml) within 7 %"),
    ),
    stage=Stage.CONSTANT, apply=apply_inertia, shows=("/imu/data", "/mocap/pose"),
    look_alikes=("rotor.thrust_gain", "gyro.scale", "servo.lag"), writes=("body_inertia",), follows="command",
)  # fmt: skip
COM = Effect(
    id="airframe.com", summary="a centre of mass beside the hinge", equation="c_arm = offset, I + m offset²",
    parameters=(
        Parameter(name="offset", unit="m", off=0.0, low=-0.05, high=0.05, prior=Prior("normal", 0.0, 0.003), size=0.005,
                  tolerance=0.0005, source="assumption: balanced by hand to 3 mm"),
    ),
    stage=Stage.CONSTANT, apply=apply_com, shows=("/imu/data", "/mocap/pose"),
    look_alikes=("rotor.asymmetry", "servo.trim", "pitch.bias"), writes=("body_ipos",), follows="position",
)  # fmt: skip
COM_HEIGHT = Effect(
    id="airframe.com_height", summary="a centre of mass above or below the hinge",
    equation="c_up = offset, I + m offset²",
    parameters=(
        Parameter(name="offset", unit="m", off=0.0, low=-0.05, high=0.05, prior=Prior("normal", 0.0, 0.003), size=0.005,
                  tolerance=0.0005, source="assumption: built to 3 mm of the drawing"),
    ),
    stage=Stage.CONSTANT, apply=apply_com_height, shows=("/imu/data", "/mocap/pose"), writes=("body_ipos",),
    follows="position",
)  # fmt: skip
