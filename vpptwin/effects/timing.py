"""Delays: from command to servo, and from the world to the motion capture's stamp."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior


def apply_command_delay(constants: Constants, site: Site, /, delay: np.ndarray) -> None:
    """Transport delay from rotor command to servo [s]."""
    constants["actuator.delay"][:] += delay[:, None]


def apply_mocap_delay(constants: Constants, site: Site, /, delay: np.ndarray) -> None:
    """The pose is older than its stamp by this much [s]."""
    constants["mocap.delay"][:] += delay


COMMAND_DELAY = Effect(
    id="command.delay",
    summary="a delay from command to servo",
    equation="α_cmd(t - delay)",
    parameters=(Parameter("delay", "s", 0.0, 0.0, 0.05, Prior("halfnormal", 0.0, 0.005), 0.003, 0.0005),),
    stage=Stage.CONSTANT,
    apply=apply_command_delay,
    shows=("/imu/data", "/mocap/pose"),
    look_alikes=("servo.lag",),
    writes=("actuator.delay",),
    follows="command change",
)
MOCAP_DELAY = Effect(
    id="mocap.delay",
    summary="motion capture poses older than their stamps",
    equation="pose(t - delay)",
    parameters=(Parameter("delay", "s", 0.0, 0.0, 0.05, Prior("halfnormal", 0.0, 0.005), 0.004, 0.0005),),
    stage=Stage.CONSTANT,
    apply=apply_mocap_delay,
    shows=("/mocap/pose",),
    look_alikes=("clock.drift",),
    writes=("mocap.delay",),
)
EFFECTS = (COMMAND_DELAY, MOCAP_DELAY)
