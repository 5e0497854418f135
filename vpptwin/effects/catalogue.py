"""The list of effects: one for the drone on its rig, and factories that give any joint and actuator its own."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable

from vpptwin.effects import actuator, airframe, joint, rotor, timing
from vpptwin.effects.base import Effect

RAIL = joint.Place("rail_x", "on the horizontal rail")
GUIDE = joint.Place("rail_z", "on the vertical guide")

CATALOGUE: tuple[Effect, ...] = (
    joint.coulomb(RAIL),
    joint.coulomb(GUIDE),
    joint.viscous(RAIL, others=("air.drag",)),
    joint.viscous(GUIDE, others=("air.drag",)),
    joint.bias(RAIL),
    joint.bias(GUIDE, others=("airframe.mass", "rotor.thrust_gain")),
    *airframe.EFFECTS,
    *rotor.EFFECTS,
    *timing.EFFECTS,
)
"""Every effect of the drone on its rail rig (SPEC 5)."""

GENERIC_JOINT: tuple[Callable[..., Effect], ...] = (joint.coulomb, joint.viscous, joint.bias, joint.spring)
"""Factories that give joint j of any rig the effects j.coulomb, j.viscous, j.bias and j.spring."""

GENERIC_TOLERANCE = 0.002
"""Build tolerance of other people's rigs, as a share of a joint's typical force: little is taken for granted there."""
GENERIC_SIZE = 0.02
"""Secant size there, as a share of a joint's typical force: a free pivot's friction is far below what moves it."""

GENERIC_ACTUATOR: tuple[Callable[..., Effect], ...] = (actuator.gain, actuator.delay, actuator.lag)
"""Factories that give actuator a of any rig the effects a.gain, a.delay and a.lag."""


def effects_for_rig(joints: Iterable[tuple[str, bool, float]], actuators: Iterable[str]) -> tuple[Effect, ...]:
    """The generic effects of a rig that is not ours.

    Args:
        joints: name, whether it is rotary, and a typical force [N] or torque [N m] for each joint.
        actuators: names.
    """
    effects: list[Effect] = []
    for name, rotary, scale in joints:
        place = joint.Place(name, f"on joint {name}", rotary, scale, GENERIC_TOLERANCE, GENERIC_SIZE)
        effects.extend(factory(place) for factory in GENERIC_JOINT)
    for name in actuators:
        effects.extend(factory(name, f"of actuator {name}") for factory in GENERIC_ACTUATOR)
    return tuple(effects)


def find_effect(effects: Iterable[Effect], effect_id: str) -> Effect:
    """The effect of that id.

    Raises:
        KeyError: whose text names the closest ids there are.
    """
    known = {effect.id: effect for effect in effects}
    if effect_id in known:
        return known[effect_id]
    close = difflib.get_close_matches(effect_id, known, n=3, cutoff=0.4) or sorted(known)
    raise KeyError(", ".join(close))
