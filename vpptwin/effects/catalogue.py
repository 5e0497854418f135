"""The effects of any rig, made of laws for its joints, actuators, links and contacts.

The drone on its rail has a list of its own, `vpptwin.robots.planar_drone.effects.catalogue`.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from vpptwin.effects import actuator, friction, joint, link, sensing
from vpptwin.effects.base import Effect
from vpptwin.effects.joint import HINGE_ACCELERATION, SLIDE_ACCELERATION, JointScale
from vpptwin.effects.link import Link

GENERIC_JOINT = (
    friction.coulomb, friction.stiction, joint.viscous, joint.drag, joint.bias, joint.spring, joint.cogging,
    joint.inertia, joint.offset, friction.load, joint.fade, friction.tight_spot, friction.lugre, sensing.velocity_bias,
    sensing.velocity_scale,
)  # fmt: skip
"""The laws that give joint j of any rig the effects j.coulomb, j.stiction and so on: a new law is named here."""

GENERIC_TOLERANCE = 0.0005
"""Build tolerance of other people's rigs, as a share of a joint's typical force: little is taken for granted there."""
GENERIC_SIZE = 0.02
"""Secant size there, as a share of a joint's typical force: a free pivot's friction is far below what moves it."""
GENERIC_ROOM = 1e4
"""Factor on bounds where no log has told yet what is typical: of the largest force on any joint of the rig.

They tell what a twin may have from what none can, such as values in another unit. A search keeps within them, so that
whatever it finds is a twin."""
INPUT_ROOM = 1e6
"""The same of control inputs, whose unit nobody knows."""

GENERIC_ACTUATOR: tuple[Effect, ...] = (
    actuator.GAIN, actuator.DELAY, actuator.LAG, actuator.BACKLASH, actuator.RATE_LIMIT, actuator.SATURATION,
    actuator.DEAD_BAND,
)  # fmt: skip
"""What becomes a.gain, a.delay and so on of actuator a of any rig."""

GENERIC_GROUP = tuple(
    replace(effect, look_alikes=()) for effect in (actuator.GAIN, actuator.DELAY, actuator.LAG, actuator.SAG)
)
"""What becomes a+b+c.gain and so on of rotors that are alike: one battery and one make may be off for all of them."""
GENERIC_WHOLE = tuple(
    replace(effect, look_alikes=alike)
    for effect, alike in ((actuator.GAIN, ()), (actuator.DELAY, ("lag",)), (actuator.LAG, ("delay",)))
)
"""What becomes actuators.gain and so on of several: one supply, bus, or unit in the log may be off for all of them.

What is tolerated of each is tolerated of all, so that these tolerate nothing beside.
"""
GENERIC_DRIVES = (
    (friction.coulomb, ("viscous", "load")), (joint.viscous, ("coulomb",)), (friction.load, ("coulomb",)),
)  # fmt: skip
"""What becomes joints.coulomb and so on where the drives of joints are of one make, whose gears rub alike."""
JOINTS = "joints"
"""What ids of effects on all joints of a rig begin with."""


def generic_place(
    name: str, rotary: bool, scale: float, reason: str = "", room: float = GENERIC_ROOM, driven: bool = False,
    dof: int = 0, **known: float,
) -> JointScale:  # fmt: skip
    """A joint of any rig: its typical force [N] or torque [N m], and what else of `JointScale` is known of it."""
    reason = reason or (f"{HINGE_ACCELERATION:g} rad/s^2" if rotary else f"{SLIDE_ACCELERATION:g} m/s^2")
    where = f"on joint {name}"
    return JointScale(name, where, rotary, scale, GENERIC_TOLERANCE, GENERIC_SIZE, f"from {reason}", room=room,
                 driven=driven, dof=dof, **known)  # fmt: skip


def effects_for_rig(
    joints: Iterable[JointScale], actuators: Mapping[str, float], room: float = INPUT_ROOM,
    loops: Mapping[str, tuple[Effect, ...]] | None = None, groups: Iterable[tuple[str, ...]] = (),
    links: Iterable[Link] = (), mounted: bool = False, contacts: Iterable[Effect] = (), whole: tuple[str, ...] = (),
    drives: Mapping[tuple[str, ...], tuple[str, ...]] | None = None,
) -> tuple[Effect, ...]:  # fmt: skip
    """The generic effects of a rig that is not ours.

    Args:
        joints: as `generic_place` makes them.
        actuators: name → a typical control input; 1 where nobody knows.
        room: factor on the bounds of what is in units of such an input.
        loops: name → what that one may have besides what every actuator may, as `actuator.list_loop_effects` tells.
        groups: names of actuators that are alike; what one has of its own comes after what all have.
        links: bodies that joints move.
        mounted: whether gravity tells how their mount stands, apart from any zero of an encoder.
        contacts: what `contact.effects_for_contacts` makes of what may touch.
        whole: names of all actuators that are logged.
        drives: names of joints whose drives are of one make → of their actuators.
    """
    effects, groups, joints, links = [], list(groups), list(joints), list(links)
    for group in drives or {}:
        effects += effects_for_drives([place for place in joints if place.joint in group], len(joints))
    for place in joints:
        laws = [law for law in GENERIC_JOINT if not law.only or getattr(place, law.only)]
        had = {law.kind for law in laws}
        effects += [law(place, tuple(f"{place.joint}.{kind}" for kind in law.alike if kind in had)) for law in laws]
    for group in groups:
        size = max(actuators[name] for name in group)
        effects += [actuator.attach(effect, "+".join(group), size, room, group) for effect in GENERIC_GROUP]
    called = ["+".join(group) for group in groups] or (list(actuators) if len(actuators) == 1 else [])
    if len(whole) > 1 and whole not in groups:
        together = name_together(whole, whole, actuators)
        effects += [tolerate_nothing(actuator.attach(e, together, members=whole)) for e in GENERIC_WHOLE]
        called.append(together)
    simulated = {place.joint for place in joints}
    for group, members in (drives or {}).items():
        servos = tuple(name for joint, name in zip(group, members) if joint in simulated and name in actuators)
        if len(servos) > 2:
            loop = [effect for effect in (loops or {}).get(servos[0], ()) if effect.id != actuator.SAG.id]
            together = name_together(servos, whole, actuators)
            alike = [actuator.attach(effect, together, members=servos) for effect in keep_alike(loop)]
            effects += map(tolerate_nothing, alike)
    for name, size in actuators.items():
        kinds = (*GENERIC_ACTUATOR, *(loops or {}).get(name, ()))
        if any(name in group for group in groups):  # whose battery is one
            kinds = tuple(effect for effect in kinds if effect.id != actuator.SAG.id)
        effects += [actuator.attach(effect, name, size, room) for effect in keep_alike(kinds)]
    weights = link.effects_for_links(links)
    effects = tie_alike([*effects, *weights], [f"{name}.gain" for name in called], [effect.id for effect in weights])
    known = {effect.id for effect in effects}
    for each in links:
        hinged = [f"{each.hinge}.{kind}" for kind in link.LOOK_ALIKES if f"{each.hinge}.{kind}" in known]
        if each.ways:
            effects = tie_alike(effects, [f"{each.name}.com"], hinged)
    return (*effects, *((link.MOUNT_TILT,) if mounted else ()), *contacts)


def name_together(names: tuple[str, ...], whole: tuple[str, ...], actuators: Iterable[str]) -> str:
    """What some actuators are called together: as all are, where they are all that are logged and none is called so."""
    return actuator.WHOLE if set(names) == set(whole) and actuator.WHOLE not in actuators else "+".join(names)


def effects_for_drives(places: Sequence[JointScale], count: int) -> list[Effect]:
    """What the drives of joints may have alike, of a rig with `count` joints; nothing for fewer than three of them.

    What is tolerated of each is tolerated of all, so that these tolerate nothing beside.
    """
    if len(places) < 3:
        return []
    names = tuple(place.joint for place in places)
    called = JOINTS if len(names) == count and JOINTS not in names else "+".join(names)
    where = "on all joints" if called == JOINTS else f"on joints {', '.join(names)} alike"
    largest = replace(max(places, key=lambda place: place.scale), joint=called, where=where)
    made = [make(largest, tuple(f"{called}.{kind}" for kind in alike)) for make, alike in GENERIC_DRIVES]
    return [tolerate_nothing(replace(effect, target="", members=names)) for effect in made]


def keep_alike(effects: Collection[Effect]) -> list[Effect]:
    """The effects with those look-alikes alone that are among them."""
    kinds = {effect.id for effect in effects}
    return [replace(e, look_alikes=tuple(kind for kind in e.look_alikes if kind in kinds)) for e in effects]


def tolerate_nothing(effect: Effect) -> Effect:
    """The effect without a build tolerance."""
    return replace(effect, parameters=tuple(replace(p, tolerance=0.0) for p in effect.parameters))


def effects_for_ball(place: JointScale, ways: tuple[str, ...]) -> tuple[Effect, ...]:
    """Friction in a ball joint, alike about all of its axes, whose degrees of freedom are called `ways`."""
    found = friction.coulomb(place, (f"{place.joint}.viscous",)), joint.viscous(place, (f"{place.joint}.coulomb",))
    return tuple(replace(effect, members=ways) for effect in found)


def tie_alike(effects: Iterable[Effect], some: Sequence[str], others: Sequence[str]) -> list[Effect]:
    """The effects, of which each of `some` is hard to tell from each of `others`: a drive's strength, a link's mass."""
    alike = {**dict.fromkeys(some, tuple(others)), **dict.fromkeys(others, tuple(some))}
    return [
        replace(effect, look_alikes=tuple(dict.fromkeys((*effect.look_alikes, *alike.get(effect.id, ())))))
        for effect in effects
    ]


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
