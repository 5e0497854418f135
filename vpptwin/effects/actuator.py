"""Effects on any actuator: gain, delay, lag, limited rate, play, saturation. Those of the drone's rotors are its own.

Control inputs are in MuJoCo's `ctrl`, whatever unit that has; sizes suppose that they are of the order of one.
"""

from __future__ import annotations

import numpy as np

from vpptwin.effects.base import Constants, Effect, Site, Stage
from vpptwin.effects.parameter import Parameter, Prior

ACTUATOR_SHOWS = ("/joint_states",)
UNLIMITED = 1e6
"""Off value of a limit: no actuator gets there [ctrl], [ctrl/s]."""


def apply_gain(constants: Constants, site: Site, /, gain: np.ndarray) -> None:
    """Output times gain."""
    constants["actuator.gain"][:, site.actuator] *= gain


def apply_delay(constants: Constants, site: Site, /, delay: np.ndarray) -> None:
    """Transport delay from command to actuator [s]."""
    constants["actuator.delay"][:, site.actuator] += delay


def apply_lag(constants: Constants, site: Site, /, time_constant: np.ndarray) -> None:
    """First-order lag of the actuator, replacing its nominal time constant [s]."""
    constants["actuator.time_constant"][:, site.actuator] = time_constant


def apply_rate_limit(constants: Constants, site: Site, /, rate: np.ndarray) -> None:
    """The actuator changes no faster than this [ctrl/s]."""
    limit = constants["actuator.rate_limit"][:, site.actuator]
    limit[:] = np.minimum(limit, rate)


def apply_backlash(constants: Constants, site: Site, /, gap: np.ndarray) -> None:
    """Play between the actuator and what it moves [ctrl]."""
    constants["actuator.gap"][:, site.actuator] += gap


def apply_saturation(constants: Constants, site: Site, /, limit: np.ndarray) -> None:
    """The output stays within ±limit [ctrl]."""
    bound = constants["actuator.limit"][:, site.actuator]
    bound[:] = np.minimum(bound, limit)


def gain(actuator: str, where: str, look_alikes: tuple[str, ...] = ()) -> Effect:
    """The actuator is stronger or weaker than believed."""
    parameter = Parameter("gain", "", 1.0, 0.1, 3.0, Prior("normal", 1.0, 0.1), 0.05, 0.01)
    return Effect(
        f"{actuator}.gain", f"a wrong gain {where}", "u × gain", (parameter,), Stage.CONSTANT, apply_gain,
        ACTUATOR_SHOWS, look_alikes, ("actuator.gain",), actuator, follows="command",
    )  # fmt: skip


def delay(actuator: str, where: str, look_alikes: tuple[str, ...] = ()) -> Effect:
    """The actuator obeys late."""
    parameter = Parameter("delay", "s", 0.0, 0.0, 0.1, Prior("halfnormal", 0.0, 0.01), 0.004, 0.001)
    return Effect(
        f"{actuator}.delay", f"a delay {where}", "u(t - delay)", (parameter,), Stage.CONSTANT, apply_delay,
        ACTUATOR_SHOWS, look_alikes, ("actuator.delay",), actuator, follows="command change",
    )  # fmt: skip


def lag(actuator: str, where: str, look_alikes: tuple[str, ...] = ()) -> Effect:
    """The actuator obeys with a first-order lag."""
    parameter = Parameter("time_constant", "s", 0.0, 0.0, 0.2, Prior("halfnormal", 0.0, 0.02), 0.005, 0.001)
    return Effect(
        f"{actuator}.lag", f"a first-order lag {where}", "1/(time_constant s + 1)", (parameter,), Stage.CONSTANT,
        apply_lag, ACTUATOR_SHOWS, look_alikes, ("actuator.time_constant",), actuator, follows="command change",
    )  # fmt: skip


def rate_limit(actuator: str, where: str, look_alikes: tuple[str, ...] = ()) -> Effect:
    """The actuator changes at a limited rate; typical are 10 ctrl/s."""
    size, tolerance = UNLIMITED - 10.0, 0.001 * UNLIMITED
    prior = Prior("uniform", 5.0, 50.0)
    parameter = Parameter("rate", "ctrl/s", UNLIMITED, 0.1, UNLIMITED, prior, size, tolerance)
    return Effect(
        f"{actuator}.rate_limit", f"a limited rate {where}", "|u̇| ≤ rate", (parameter,), Stage.CONSTANT,
        apply_rate_limit, ACTUATOR_SHOWS, look_alikes, ("actuator.rate_limit",), actuator, follows="command change",
    )  # fmt: skip


def backlash(actuator: str, where: str, look_alikes: tuple[str, ...] = ()) -> Effect:
    """There is play behind the actuator."""
    parameter = Parameter("gap", "ctrl", 0.0, 0.0, 10.0, Prior("halfnormal", 0.0, 0.02), 0.05, 0.005)
    return Effect(
        f"{actuator}.backlash", f"play {where}", "u within ±gap/2", (parameter,), Stage.CONSTANT, apply_backlash,
        ACTUATOR_SHOWS, look_alikes, ("actuator.gap",), actuator, follows="command change",
    )  # fmt: skip


def saturation(actuator: str, where: str, look_alikes: tuple[str, ...] = ()) -> Effect:
    """The actuator gives no more than it can; secants go to half a ctrl."""
    size, tolerance = UNLIMITED - 0.5, 0.001 * UNLIMITED
    prior = Prior("uniform", 0.7, 1.5)
    parameter = Parameter("limit", "ctrl", UNLIMITED, 0.05, UNLIMITED, prior, size, tolerance)
    return Effect(
        f"{actuator}.saturation", f"saturation {where}", "|u| ≤ limit", (parameter,), Stage.CONSTANT,
        apply_saturation, ACTUATOR_SHOWS, look_alikes, ("actuator.limit",), actuator, follows="command",
    )  # fmt: skip
