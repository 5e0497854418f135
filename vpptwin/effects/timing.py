"""Delays and clocks: from command to servo, and from the world to the motion capture's stamp."""

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


def apply_drift(constants: Constants, site: Site, /, drift: np.ndarray) -> None:
    """The motion capture's clock gains this much on the onboard clock [s/s]."""
    constants["clock.drift"][:] += drift


COMMAND_DELAY = Effect(
    id="command.delay", summary="a delay from command to servo", equation="α_cmd(t - delay)",
    parameters=(
        Parameter(name="delay", unit="s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.005),
                  size=0.003, tolerance=0.0005, source="assumption: most within a policy step of 10 ms"),
    ),
    stage=Stage.CONSTANT, apply=apply_command_delay, shows=("/imu/data", "/mocap/pose"),
    look_alikes=("servo.lag", "servo.backlash"), writes=("actuator.delay",), follows="command change",
)  # fmt: skip
MOCAP_DELAY = Effect(
    id="mocap.delay", summary="motion capture poses older than their stamps", equation="pose(t - delay)",
    parameters=(
        Parameter(name="delay", unit="s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.005),
                  size=0.004, tolerance=0.0005, source="assumption: most within a period of 10 ms"),
    ),
    stage=Stage.CONSTANT, apply=apply_mocap_delay, shows=("/mocap/pose",), look_alikes=("clock.drift",),
    writes=("mocap.delay",),
)  # fmt: skip
CLOCK_DRIFT = Effect(
    id="clock.drift", summary="a motion capture clock that runs fast or slow", equation="pose(t - drift t)",
    parameters=(
        Parameter(name="drift", unit="s/s", off=0.0, low=-0.01, high=0.01, prior=Prior("normal", 0.0, 2e-4), size=1e-3,
                  tolerance=2e-5, source="assumption: free-running clocks, 200 ppm apart"),
    ),
    stage=Stage.CONSTANT, apply=apply_drift, shows=("/mocap/pose",), look_alikes=("mocap.delay",),
    writes=("clock.drift",),
)  # fmt: skip
