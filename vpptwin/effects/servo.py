"""Effects on the servos that pitch the blades, and on the way to them: delay, lag, limited rate, play, trim."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior


def apply_delay(constants: Constants, site: Site, /, delay: np.ndarray) -> None:
    """Transport delay from rotor command to servo [s]."""
    constants["actuator.delay"][:] += delay[:, None]


def apply_lag(constants: Constants, site: Site, /, time_constant: np.ndarray) -> None:
    """The pitch servo's time constant [s] differs from the nominal (paper, System Identification, item 1)."""
    constants["actuator.time_constant"][:] = time_constant[:, None]


def apply_rate_limit(constants: Constants, site: Site, /, rate: np.ndarray) -> None:
    """The servos turn no faster than this [rad/s]."""
    limit = constants["actuator.rate_limit"]
    limit[:] = np.minimum(limit, rate[:, None])


def apply_backlash(constants: Constants, site: Site, /, gap: np.ndarray) -> None:
    """Play between servo horn and blade [rad]."""
    constants["actuator.gap"][:] += gap[:, None]


def apply_trim(constants: Constants, site: Site, /, offset_1: np.ndarray, offset_2: np.ndarray) -> None:
    """Pitch [rad] of each rotor's blades when none is commanded."""
    constants["actuator.trim"][:] += np.stack([offset_1, offset_2], axis=1)


DELAY = Effect(
    id="command.delay", summary="a delay from command to servo", equation="α_cmd(t - delay)",
    parameters=(
        Parameter(name="delay", unit="s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.005),
                  size=0.003, tolerance=0.0005, source="assumption: most within a policy step of 10 ms"),
    ),
    stage=Stage.CONSTANT, apply=apply_delay, shows=("/imu/data", "/mocap/pose"),
    look_alikes=("servo.lag", "servo.backlash"), writes=("actuator.delay",), follows="command change",
)  # fmt: skip
LAG = Effect(
    id="servo.lag", summary="a wrong time constant of the pitch servos", equation="α̇ = (α_cmd - α)/time_constant",
    parameters=(
        Parameter(name="time_constant", unit="s", off=0.020, low=0.001, high=0.2, prior=Prior("normal", 0.020, 0.003),
                  size=0.004, tolerance=0.0006, nominal="servo.time_constant",
                  source="vehicle.yaml; spread (15 %, built to 3 %): assumption"),
    ),
    stage=Stage.CONSTANT, apply=apply_lag, shows=("/imu/data", "/mocap/pose"),
    look_alikes=("command.delay", "servo.rate_limit", "airframe.inertia"), writes=("actuator.time_constant",),
    follows="command change",
)  # fmt: skip
RATE_LIMIT = Effect(
    id="servo.rate_limit", summary="pitch servos of limited rate", equation="|α̇| ≤ rate",
    parameters=(
        Parameter(name="rate", unit="rad/s", off=1000.0, low=0.5, high=1000.0, prior=Prior("uniform", 4.0, 20.0),
                  size=998.0, tolerance=1.0, source="assumption: hobby servos, typically 2 to 10 rad/s"),
    ),
    stage=Stage.CONSTANT, apply=apply_rate_limit, shows=("/imu/data", "/mocap/pose"), look_alikes=("servo.lag",),
    writes=("actuator.rate_limit",), follows="command change",
)  # fmt: skip
BACKLASH = Effect(
    id="servo.backlash", summary="play between servo horns and blades", equation="α within ±gap/2 of the horn",
    parameters=(
        Parameter(name="gap", unit="rad", off=0.0, low=0.0, high=0.1, prior=Prior("halfnormal", 0.0, 0.003), size=0.005,
                  tolerance=0.0005, source="assumption: the paper tells of gaps, no numbers"),
    ),
    stage=Stage.CONSTANT, apply=apply_backlash, shows=("/imu/data", "/mocap/pose"), look_alikes=("command.delay",),
    writes=("actuator.gap",), follows="command change",
)  # fmt: skip
TRIM = Effect(
    id="servo.trim", summary="blades that are not trimmed", equation="α_1 + offset_1, α_2 + offset_2",
    parameters=tuple(
        Parameter(name=name, unit="rad", off=0.0, low=-0.05, high=0.05, prior=Prior("normal", 0.0, 0.003), size=0.004,
                  tolerance=0.0004, source="assumption: trimmed by hand to 0.2 degrees")
        for name in ("offset_1", "offset_2")
    ),
    stage=Stage.CONSTANT, apply=apply_trim, shows=("/imu/data", "/mocap/pose"),
    look_alikes=("rotor.asymmetry", "airframe.com", "pitch.bias", "airframe.mass", "rotor.thrust_gain"),
    writes=("actuator.trim",), follows="command",
)  # fmt: skip
