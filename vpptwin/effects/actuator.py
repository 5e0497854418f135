"""Effects on any actuator: gain, delay, lag, limited rate, play, saturation, dead band, sagging supply; a servo's loop.

Those of the drone's rotors are its own.

Control inputs are in MuJoCo's `ctrl`, whatever unit that has; sizes are for inputs of the order of one (`attach`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vpptwin.effects.base import Constants, Effect, Site, Stage
from vpptwin.effects.parameter import UNLIMITED, Parameter, Prior

ACTUATOR_SHOWS = ("/joint_states",)
WHOLE = "actuators"
"""What ids of effects on all actuators of a rig begin with."""


def apply_gain(constants: Constants, site: Site, /, gain: np.ndarray) -> None:
    """Output times gain."""
    constants["actuator.gain"][:, site.actuator] *= gain


def apply_delay(constants: Constants, site: Site, /, delay: np.ndarray) -> None:
    """Transport delay from command to actuator [s]."""
    constants["actuator.delay"][:, site.actuator] += delay


def apply_lag(constants: Constants, site: Site, /, time_constant: np.ndarray) -> None:
    """First-order lag of the actuator [s]."""
    constants["actuator.time_constant"][:, site.actuator] += time_constant


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


def apply_dead_band(constants: Constants, site: Site, /, band: np.ndarray) -> None:
    """Inputs within ±band of where the actuator does nothing do nothing, those beyond are less by it [ctrl]."""
    constants["actuator.dead_band"][:, site.actuator] += band


def apply_sag(constants: Constants, site: Site, /, rate: np.ndarray) -> None:
    """The output fades as the supply does, from the start of the log on [1/s]."""
    constants["actuator.sag"][:, site.actuator] += rate


def apply_force_limit(constants: Constants, site: Site, /, limit: np.ndarray) -> None:
    """The limits of a servo's force times this."""
    constants["actuator_forcerange"][:, site.actuator] *= limit[:, None]


def apply_stiffness(constants: Constants, site: Site, /, stiffness: np.ndarray) -> None:
    """Stiffness of a position servo times this."""
    constants["actuator_gainprm"][:, site.actuator, 0] *= stiffness
    constants["actuator_biasprm"][:, site.actuator, 1] *= stiffness


def apply_damping(constants: Constants, site: Site, /, damping: np.ndarray) -> None:
    """Damping of a position servo times this."""
    constants["actuator_biasprm"][:, site.actuator, 2] *= damping


def apply_strength(constants: Constants, site: Site, /, strength: np.ndarray) -> None:
    """Force of a position servo times this, stiffness and damping alike."""
    apply_stiffness(constants, site, strength)
    apply_damping(constants, site, strength)


def apply_tracking(constants: Constants, site: Site, /, damping: np.ndarray) -> None:
    """Force of a velocity servo times this."""
    constants["actuator_gainprm"][:, site.actuator, 0] *= damping
    constants["actuator_biasprm"][:, site.actuator, 2] *= damping


def list_loop_effects(gain: float, stiffness: float, damping: float, limited: bool = False) -> tuple[Effect, ...]:
    """What a servo may have of its loop, besides what every actuator may; of what is none the supply may sag.

    Args:
        gain: force per input.
        stiffness: force per position, as MuJoCo's `biasprm`; that of a position servo is -gain.
        damping: force per velocity, likewise; that of a velocity servo is -gain.
        limited: whether its force is.
    """
    limit = (FORCE_LIMIT,) if limited else ()
    if gain and stiffness == -gain:
        return (STRENGTH, STIFFNESS, DAMPING, *limit) if damping else (STIFFNESS, *limit)
    return (TRACKING, *limit) if gain and damping == -gain else (SAG,)


def attach(
    effect: Effect, actuator: str, typical: float = 1.0, room: float = 1.0, members: tuple[str, ...] = ()
) -> Effect:  # fmt: skip
    """An effect below, which any actuator may have, as that of one whose inputs are about `typical` [ctrl].

    So are its look-alikes. What is in units of the input is scaled, with `room` times as much between its bounds. With
    `members` it is that of all of these alike: their battery, their make; `WHOLE` is what all of a rig are called.
    """
    parameters = tuple(scale_input(p, typical, room) if p.unit.startswith("ctrl") else p for p in effect.parameters)
    whose = f"all of {', '.join(members)} alike" if members else f"actuator {actuator}"
    whose = "all actuators" if members and actuator == WHOLE else whose
    return replace(
        effect, id=f"{actuator}.{effect.id}", summary=f"{effect.summary} of {whose}", members=members,
        look_alikes=tuple(f"{actuator}.{kind}" for kind in effect.look_alikes), parameters=parameters,
        target="" if members else actuator,
    )  # fmt: skip


def scale_input(parameter: Parameter, typical: float, room: float) -> Parameter:
    """A parameter in units of an input that is `typical` instead of 1; nothing gets to a limit's off value anyway."""
    prior = replace(parameter.prior, a=parameter.prior.a * typical, b=parameter.prior.b * typical)
    if parameter.off >= UNLIMITED:
        return replace(parameter, low=parameter.low * typical / room, prior=prior)
    high, size, tolerance = (v * typical for v in (parameter.high * room, parameter.size, parameter.tolerance))
    return replace(parameter, high=high, prior=prior, size=size, tolerance=tolerance)


GAIN = Effect(
    id="gain", summary="a wrong gain", equation="u × gain",
    parameters=(
        Parameter(name="gain", unit="", off=1.0, low=-3.0, high=3.0, prior=Prior("normal", 1.0, 0.1), size=0.05,
                  tolerance=0.01, source="assumption: an uncalibrated drive is within 10 %"),
    ),
    stage=Stage.CONSTANT, apply=apply_gain, shows=ACTUATOR_SHOWS, look_alikes=("saturation", "dead_band", "sag"),
    writes=("actuator.gain",), follows="command",
)  # fmt: skip
DELAY = Effect(
    id="delay", summary="a delay", equation="u(t - delay)",
    parameters=(
        Parameter(name="delay", unit="s", off=0.0, low=0.0, high=0.1, prior=Prior("halfnormal", 0.0, 0.01), size=0.004,
                  tolerance=0.001, source="assumption: a bus and a control period, some 10 ms"),
    ),
    stage=Stage.CONSTANT, apply=apply_delay, shows=ACTUATOR_SHOWS, look_alikes=("lag", "backlash"),
    writes=("actuator.delay",), follows="command change",
)  # fmt: skip
LAG = Effect(
    id="lag", summary="a first-order lag", equation="1/(time_constant s + 1)",
    parameters=(
        Parameter(name="time_constant", unit="s", off=0.0, low=0.0, high=0.2, prior=Prior("halfnormal", 0.0, 0.02),
                  size=0.005, tolerance=0.001, source="assumption: small drives, some 20 ms"),
    ),
    stage=Stage.CONSTANT, apply=apply_lag, shows=ACTUATOR_SHOWS, look_alikes=("delay", "rate_limit"),
    writes=("actuator.time_constant",), follows="command change",
)  # fmt: skip
BACKLASH = Effect(
    id="backlash", summary="play", equation="u within ±gap/2",
    parameters=(
        Parameter(name="gap", unit="ctrl", off=0.0, low=0.0, high=10.0, prior=Prior("halfnormal", 0.0, 0.02), size=0.05,
                  tolerance=0.005, source="assumption: some 2 % of inputs of the order of one"),
    ),
    stage=Stage.CONSTANT, apply=apply_backlash, shows=ACTUATOR_SHOWS, look_alikes=("delay", "dead_band"),
    writes=("actuator.gap",), follows="command change",
)  # fmt: skip
RATE_LIMIT = Effect(
    id="rate_limit", summary="a limited rate", equation="|u̇| ≤ rate",
    parameters=(
        Parameter(name="rate", unit="ctrl/s", off=UNLIMITED, low=0.001, high=UNLIMITED,
                  prior=Prior("uniform", 5.0, 50.0), size=UNLIMITED - 10.0, tolerance=0.001 * UNLIMITED,
                  source="assumption: typically 10/s for inputs of order one"),
    ),
    stage=Stage.CONSTANT, apply=apply_rate_limit, shows=ACTUATOR_SHOWS, look_alikes=("lag",),
    writes=("actuator.rate_limit",), follows="command change",
)  # fmt: skip
SATURATION = Effect(
    id="saturation", summary="saturation", equation="|u| ≤ limit",
    parameters=(
        Parameter(name="limit", unit="ctrl", off=UNLIMITED, low=0.001, high=UNLIMITED, prior=Prior("uniform", 0.7, 1.5),
                  size=UNLIMITED - 0.5, tolerance=0.001 * UNLIMITED,  # secants go to half a ctrl
                  source="assumption: about the largest input, of order one"),
    ),
    stage=Stage.CONSTANT, apply=apply_saturation, shows=ACTUATOR_SHOWS, look_alikes=("gain",),
    writes=("actuator.limit",), follows="command",
)  # fmt: skip
DEAD_BAND = Effect(
    id="dead_band", summary="a dead band", equation="u less ±band",
    parameters=(
        Parameter(name="band", unit="ctrl", off=0.0, low=0.0, high=10.0, prior=Prior("halfnormal", 0.0, 0.02),
                  size=0.02, tolerance=0.002, source="assumption: some 2 % of inputs of the order of one"),
    ),
    stage=Stage.CONSTANT, apply=apply_dead_band, shows=ACTUATOR_SHOWS, look_alikes=("backlash", "gain"),
    writes=("actuator.dead_band",), follows="command",
)  # fmt: skip
SAG = Effect(
    id="sag", summary="a sagging supply", equation="u × (1 - rate t)",
    parameters=(
        Parameter(name="rate", unit="1/s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.001),
                  size=0.002, tolerance=0.0002, source="assumption: a battery that is empty in some ten minutes"),
    ),
    stage=Stage.CONSTANT, apply=apply_sag, shows=ACTUATOR_SHOWS, look_alikes=("gain",),
    writes=("actuator.sag",), follows="command",
)  # fmt: skip
STIFFNESS = Effect(
    id="stiffness", summary="a wrong stiffness of the servo", equation="kp × stiffness",
    parameters=(
        Parameter(name="stiffness", unit="", off=1.0, low=0.05, high=20.0, prior=Prior("normal", 1.0, 0.3), size=0.05,
                  tolerance=0.01, source="assumption: gains of servos are set by hand, and known by a third"),
    ),
    stage=Stage.CONSTANT, apply=apply_stiffness, shows=ACTUATOR_SHOWS, look_alikes=(),
    writes=("actuator_gainprm", "actuator_biasprm"), follows="command",
)  # fmt: skip
DAMPING = Effect(
    id="damping", summary="a wrong damping of the servo", equation="kv × damping",
    parameters=(
        Parameter(name="damping", unit="", off=1.0, low=0.0, high=20.0, prior=Prior("normal", 1.0, 0.3), size=0.05,
                  tolerance=0.01, source="assumption: as of its stiffness"),
    ),
    stage=Stage.CONSTANT, apply=apply_damping, shows=ACTUATOR_SHOWS, look_alikes=(),
    writes=("actuator_biasprm",), follows="command change",
)  # fmt: skip
STRENGTH = replace(
    STIFFNESS, id="strength", summary="a wrong strength of the servo", equation="(kp, kv) × strength",
    parameters=(replace(STIFFNESS.parameters[0], name="strength"),), apply=apply_strength, look_alikes=("stiffness",),
)  # fmt: skip
FORCE_LIMIT = Effect(
    id="force_limit", summary="a wrong limit of the force", equation="|force| ≤ range × limit",
    parameters=(
        Parameter(name="limit", unit="", off=1.0, low=0.02, high=5.0, prior=Prior("normal", 1.0, 0.3), size=0.1,
                  tolerance=0.01, source="assumption: datasheets of small servos are off by a third"),
    ),
    stage=Stage.CONSTANT, apply=apply_force_limit, shows=ACTUATOR_SHOWS, look_alikes=("saturation",),
    writes=("actuator_forcerange",), follows="command",
)  # fmt: skip
TRACKING = replace(DAMPING, apply=apply_tracking, writes=STIFFNESS.writes, follows="command")
