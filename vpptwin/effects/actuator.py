"""Effects on any actuator: gain, delay, lag, limited rate, play, saturation, dead band, sagging supply; a servo's loop.

Control inputs are in MuJoCo's `ctrl`, whatever unit that has; sizes are for inputs of the order of one (`attach`). What
the actuator layer makes of the constants lies in `vpptwin.actuators.layer`.
"""

from __future__ import annotations

from dataclasses import replace

from vpptwin.effects.base import Effect, Stage
from vpptwin.effects.constants import add, limit, multiply
from vpptwin.effects.parameter import UNLIMITED, Parameter, Prior

ACTUATOR_SHOWS = ("/joint_states",)
WHOLE = "actuators"
"""What ids of effects on all actuators of a rig begin with."""

GAIN = Effect(
    "gain", "a wrong gain", "u × gain",
    (Parameter(name="gain", unit="", off=1.0, low=-3.0, high=3.0, prior=Prior("normal", 1.0, 0.1), size=0.05,
               tolerance=0.01, source="assumption: an uncalibrated drive is within 10 %"),),
    Stage.CONSTANT, multiply(("actuator.gain", "actuator")), ACTUATOR_SHOWS, ("saturation", "dead_band", "sag"),
    follows="command",
)  # fmt: skip
DELAY = Effect(
    "delay", "a delay", "u(t - delay)",
    (Parameter(name="delay", unit="s", off=0.0, low=0.0, high=0.1, prior=Prior("halfnormal", 0.0, 0.01), size=0.004,
               tolerance=0.001, source="assumption: a bus and a control period, some 10 ms"),),
    Stage.CONSTANT, add(("actuator.delay", "actuator")), ACTUATOR_SHOWS, ("lag", "backlash"), follows="command change",
)  # fmt: skip
LAG = Effect(
    "lag", "a first-order lag", "1/(time_constant s + 1)",
    (Parameter(name="time_constant", unit="s", off=0.0, low=0.0, high=0.2, prior=Prior("halfnormal", 0.0, 0.02),
               size=0.005, tolerance=0.001, source="assumption: small drives, some 20 ms"),),
    Stage.CONSTANT, add(("actuator.time_constant", "actuator")), ACTUATOR_SHOWS, ("delay", "rate_limit"),
    follows="command change",
)  # fmt: skip
BACKLASH = Effect(
    "backlash", "play", "u within ±gap/2",
    (Parameter(name="gap", unit="ctrl", off=0.0, low=0.0, high=10.0, prior=Prior("halfnormal", 0.0, 0.02), size=0.05,
               tolerance=0.005, source="assumption: some 2 % of inputs of the order of one"),),
    Stage.CONSTANT, add(("actuator.gap", "actuator")), ACTUATOR_SHOWS, ("delay", "dead_band"), follows="command change",
)  # fmt: skip
RATE_LIMIT = Effect(
    "rate_limit", "a limited rate", "|u̇| ≤ rate",
    (Parameter(name="rate", unit="ctrl/s", off=UNLIMITED, low=0.001, high=UNLIMITED, prior=Prior("uniform", 5.0, 50.0),
               size=UNLIMITED - 10.0, tolerance=0.001 * UNLIMITED,
               source="assumption: typically 10/s for inputs of order one"),),
    Stage.CONSTANT, limit(("actuator.rate_limit", "actuator")), ACTUATOR_SHOWS, ("lag",), follows="command change",
)  # fmt: skip
SATURATION = Effect(
    "saturation", "saturation", "|u| ≤ limit",
    (Parameter(name="limit", unit="ctrl", off=UNLIMITED, low=0.001, high=UNLIMITED, prior=Prior("uniform", 0.7, 1.5),
               size=UNLIMITED - 0.5, tolerance=0.001 * UNLIMITED,  # secants go to half a ctrl
               source="assumption: about the largest input, of order one"),),
    Stage.CONSTANT, limit(("actuator.limit", "actuator")), ACTUATOR_SHOWS, ("gain",), follows="command",
)  # fmt: skip
DEAD_BAND = Effect(
    "dead_band", "a dead band", "u less ±band",
    (Parameter(name="band", unit="ctrl", off=0.0, low=0.0, high=10.0, prior=Prior("halfnormal", 0.0, 0.02), size=0.02,
               tolerance=0.002, source="assumption: some 2 % of inputs of the order of one"),),
    Stage.CONSTANT, add(("actuator.dead_band", "actuator")), ACTUATOR_SHOWS, ("backlash", "gain"), follows="command",
)  # fmt: skip
SAG = Effect(
    "sag", "a sagging supply", "u × (1 - rate t)",
    (Parameter(name="rate", unit="1/s", off=0.0, low=0.0, high=0.05, prior=Prior("halfnormal", 0.0, 0.001), size=0.002,
               tolerance=0.0002, source="assumption: a battery that is empty in some ten minutes"),),
    Stage.CONSTANT, add(("actuator.sag", "actuator")), ACTUATOR_SHOWS, ("gain",), follows="command",
)  # fmt: skip

# A servo's force is gain u + bias_1 q + bias_2 q̇ (MuJoCo's affine actuators): kp (u - q) - kv q̇, or kv (u - q̇).
SERVO_GAIN = "actuator_gainprm", "actuator", 0
SERVO_STIFFNESS, SERVO_DAMPING = ("actuator_biasprm", "actuator", 1), ("actuator_biasprm", "actuator", 2)
STIFFNESS = Effect(
    "stiffness", "a wrong stiffness of the servo", "kp × stiffness",
    (Parameter(name="stiffness", unit="", off=1.0, low=0.05, high=20.0, prior=Prior("normal", 1.0, 0.3), size=0.05,
               tolerance=0.01, source="assumption: gains of servos are set by hand, and known by a third"),),
    Stage.CONSTANT, multiply(SERVO_GAIN, SERVO_STIFFNESS), ACTUATOR_SHOWS, follows="command",
)  # fmt: skip
DAMPING = Effect(
    "damping", "a wrong damping of the servo", "kv × damping",
    (Parameter(name="damping", unit="", off=1.0, low=0.0, high=20.0, prior=Prior("normal", 1.0, 0.3), size=0.05,
               tolerance=0.01, source="assumption: as of its stiffness"),),
    Stage.CONSTANT, multiply(SERVO_DAMPING), ACTUATOR_SHOWS, follows="command change",
)  # fmt: skip
STRENGTH = replace(
    STIFFNESS, id="strength", summary="a wrong strength of the servo", equation="(kp, kv) × strength",
    parameters=(replace(STIFFNESS.parameters[0], name="strength"),), look_alikes=("stiffness",),
    apply=multiply(SERVO_GAIN, SERVO_STIFFNESS, SERVO_DAMPING),
)  # fmt: skip
FORCE_LIMIT = Effect(
    "force_limit", "a wrong limit of the force", "|force| ≤ range × limit",
    (Parameter(name="limit", unit="", off=1.0, low=0.02, high=5.0, prior=Prior("normal", 1.0, 0.3), size=0.1,
               tolerance=0.01, source="assumption: datasheets of small servos are off by a third"),),
    Stage.CONSTANT, multiply(("actuator_forcerange", "actuator")), ACTUATOR_SHOWS, ("saturation",), follows="command",
)  # fmt: skip
TRACKING = replace(DAMPING, apply=multiply(SERVO_GAIN, SERVO_DAMPING), writes=STIFFNESS.writes, follows="command")
"""The damping of a velocity servo, which is all of its force."""


def list_loop_effects(gain: float, stiffness: float, damping: float, limited: bool = False) -> tuple[Effect, ...]:
    """What a servo may have of its loop, besides what every actuator may; of what is none the supply may sag.

    Args:
        gain: force per input.
        stiffness: force per position, as MuJoCo's `biasprm`; that of a position servo is -gain.
        damping: force per velocity, likewise; that of a velocity servo is -gain.
        limited: whether its force is.
    """
    limits = (FORCE_LIMIT,) if limited else ()
    if gain and stiffness == -gain:
        return (STRENGTH, STIFFNESS, DAMPING, *limits) if damping else (STIFFNESS, *limits)
    return (TRACKING, *limits) if gain and damping == -gain else (SAG,)


def attach(
    effect: Effect, actuator: str, typical: float = 1.0, room: float = 1.0, members: tuple[str, ...] = ()
) -> Effect:  # fmt: skip
    """An effect above, which any actuator may have, as that of one whose inputs are about `typical` [ctrl].

    So are its look-alikes. What is in units of the input is scaled, with `room` times as much between its bounds. With
    `members` it is that of all of these alike: their battery, their make; `WHOLE` is what all of a rig are called.
    """
    parameters = tuple(scale_input(p, typical, room) if p.unit.startswith("ctrl") else p for p in effect.parameters)
    whose = f"all of {', '.join(members)}" if members else f"actuator {actuator}"
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
