"""Dry friction of any joint: sliding friction, breakaway, one that depends on the direction, a tight spot.

Each effect raises or scales the level that the joint can muster against its motion; the engine room makes it stick.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vpptwin.effects.base import Effect, Motion, Stage
from vpptwin.effects.joint import JOINT_SHOWS, Place
from vpptwin.effects.parameter import Parameter, Prior

BREAKAWAY = 0.25
"""Share of its friction by which a well-built joint's breakaway exceeds it."""


def apply_coulomb(level: float, motion: Motion, /, force: float) -> float:
    """Dry friction -F sgn(v), the same at any speed [N, N m]."""
    return level + force


def apply_stiction(level: float, motion: Motion, /, force: float, velocity: float) -> float:
    """Breakaway exceeds sliding friction by `force` [N, N m], which fades out around `velocity` [m/s, rad/s]."""
    ratio = motion.velocity / velocity
    return level + force * np.exp(-ratio * ratio)


def apply_load(level: float, motion: Motion, /, mu: float) -> float:
    """Gears rub by a share of the force that the actuators put through them [N, N m]."""
    return level + mu * np.abs(motion.load)


def apply_asymmetry(level: float, motion: Motion, /, fraction: float) -> float:
    """All dry friction of the joint is stronger in one direction than in the other."""
    return level * (1.0 + fraction * motion.direction)


def apply_tight_spot(level: float, motion: Motion, /, force: float, place: float, width: float) -> float:
    """More dry friction [N, N m] around a place [m, rad]."""
    ratio = (motion.position - place) / width
    return level + force * np.exp(-ratio * ratio)


def coulomb(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Dry friction on a joint."""
    name, unit = ("torque", "N m") if place.rotary else ("force", "N")
    parameter = place.parameter(name, unit, 0.0, 2.0, Prior("halfnormal", 0.0, 0.3))
    return Effect(
        f"{place.joint}.coulomb", f"dry friction {place.where}", f"-{name} sgn(v)", (parameter,), Stage.FRICTION,
        apply_coulomb, JOINT_SHOWS, look_alikes, (), place.joint, dissipative=True,
    )  # fmt: skip


def stiction(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Breakaway friction on a joint, with the Stribeck curve that leads down to sliding friction F_c."""
    unit, speed, typical = ("N m", "rad/s", 0.2) if place.rotary else ("N", "m/s", 0.05)
    force = place.parameter("force", unit, 0.0, 2.0, Prior("halfnormal", 0.0, 0.1))
    force = replace(force, tolerance=BREAKAWAY * force.tolerance)
    velocity = Parameter(
        name="velocity", unit=speed, off=typical, low=0.1 * typical / place.room,
        high=10.0 * typical * place.room,
        prior=Prior("normal", typical, 0.2 * typical), size=0.4 * typical, tolerance=10.0 * typical,
        source="assumption: breakaway is over at a slow creep",
    )  # fmt: skip
    return Effect(
        f"{place.joint}.stiction", f"breakaway friction {place.where}",
        "-(F_c + force exp(-(v/velocity)²)) sgn(v)", (force, velocity), Stage.FRICTION, apply_stiction, JOINT_SHOWS,
        look_alikes, (), place.joint, dissipative=True,
    )  # fmt: skip


def asymmetry(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Dry friction that depends on the direction. It follows the joint's other dry friction, which it scales."""
    parameter = Parameter(
        name="fraction", unit="", off=0.0, low=-0.9, high=0.9, prior=Prior("normal", 0.0, 0.05), size=0.1,
        tolerance=0.02, source="assumption: wipers and seals, some 5 % to either side",
    )  # fmt: skip
    return Effect(
        f"{place.joint}.asymmetry", f"dry friction {place.where} that depends on the direction",
        "F × (1 + fraction sgn(v))", (parameter,), Stage.FRICTION, apply_asymmetry, JOINT_SHOWS, look_alikes, (),
        place.joint, modifies=(f"{place.joint}.coulomb",),
    )  # fmt: skip


def load(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Losses of a driven joint's gears, which grow with what they transmit."""
    parameter = Parameter(
        name="mu", unit="", off=0.0, low=0.0, high=0.9, prior=Prior("halfnormal", 0.0, 0.1), size=0.05,
        tolerance=0.005, source="assumption: gears lose 5 to 30 %",
    )  # fmt: skip
    return Effect(
        f"{place.joint}.load", f"losses of the gears {place.where} that grow with what drives it",
        "-mu |actuators' force| sgn(v)", (parameter,), Stage.FRICTION, apply_load, JOINT_SHOWS, look_alikes, (),
        place.joint, dissipative=True, follows="command",
    )  # fmt: skip


def tight_spot(place: Place, look_alikes: tuple[str, ...] = ()) -> Effect:
    """Dry friction around a place on a joint, anywhere that it gets to."""
    unit, length = ("N m", "rad") if place.rotary else ("N", "m")
    reach, at, room = place.reach, place.middle, place.room
    return Effect(
        f"{place.joint}.tight_spot", f"a tight spot {place.where}", "-force exp(-((q - place)/width)²) sgn(v)",
        (
            place.parameter("force", unit, 0.0, 5.0, Prior("halfnormal", 0.0, 0.1)),
            Parameter(name="place", unit=length, off=at, low=at - 2.0 * reach * room, high=at + 2.0 * reach * room,
                      prior=Prior("normal", at, 0.5 * reach), size=0.05 * reach, tolerance=2.0 * reach,
                      source="assumption: anywhere, most likely halfway along"),
            Parameter(name="width", unit=length, off=0.1 * reach, low=0.02 * reach / room, high=0.5 * reach * room,
                      prior=Prior("normal", 0.1 * reach, 0.02 * reach), size=0.03 * reach, tolerance=0.5 * reach,
                      source="assumption: a tenth of half the travel"),
        ),
        Stage.FRICTION, apply_tight_spot, JOINT_SHOWS, look_alikes, (), place.joint, dissipative=True,
        follows="position", placed=True,
    )  # fmt: skip
