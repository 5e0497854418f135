"""Effects on any actuator: its gain, its delay and its lag. The drone's rotors have their own forms of these."""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior

ACTUATOR_SHOWS = ("/joint_states",)


def apply_gain(constants: Constants, site: Site, /, gain: np.ndarray) -> None:
    """Output times gain."""
    constants["actuator.gain"][:, site.actuator] *= gain


def apply_delay(constants: Constants, site: Site, /, delay: np.ndarray) -> None:
    """Transport delay from command to actuator [s]."""
    constants["actuator.delay"][:, site.actuator] += delay


def apply_lag(constants: Constants, site: Site, /, time_constant: np.ndarray) -> None:
    """First-order lag of the actuator, replacing its nominal time constant [s]."""
    constants["actuator.time_constant"][:, site.actuator] = time_constant


def gain(actuator: str, where: str) -> Effect:
    """The actuator is stronger or weaker than believed."""
    parameter = Parameter("gain", "", 1.0, 0.1, 3.0, Prior("normal", 1.0, 0.1), 0.05, 0.01)
    return Effect(
        f"{actuator}.gain", f"a wrong gain {where}", "u × gain", (parameter,), Stage.CONSTANT, apply_gain,
        ACTUATOR_SHOWS, (), ("actuator.gain",), actuator, follows="command",
    )  # fmt: skip


def delay(actuator: str, where: str) -> Effect:
    """The actuator obeys late."""
    parameter = Parameter("delay", "s", 0.0, 0.0, 0.1, Prior("halfnormal", 0.0, 0.01), 0.004, 0.001)
    return Effect(
        f"{actuator}.delay", f"a delay {where}", "u(t - delay)", (parameter,), Stage.CONSTANT, apply_delay,
        ACTUATOR_SHOWS, (f"{actuator}.lag",), ("actuator.delay",), actuator, follows="command change",
    )  # fmt: skip


def lag(actuator: str, where: str) -> Effect:
    """The actuator obeys with a first-order lag."""
    parameter = Parameter("time_constant", "s", 0.0, 0.0, 0.2, Prior("halfnormal", 0.0, 0.02), 0.005, 0.001)
    return Effect(
        f"{actuator}.lag", f"a first-order lag {where}", "1/(time_constant s + 1)", (parameter,), Stage.CONSTANT,
        apply_lag, ACTUATOR_SHOWS, (f"{actuator}.delay",), ("actuator.time_constant",), actuator,
        follows="command change",
    )  # fmt: skip
