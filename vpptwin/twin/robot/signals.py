"""Which topics carry a rig's joints, bodies and control inputs, and whether they fit its MJCF."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from vpptwin.system.errors import InputError
from vpptwin.system.fields import BODIES, SITES, TURNS, SignalEntry, dump_entry
from vpptwin.twin.robot.manifold import FREE, conjugate, multiply_attitudes
from vpptwin.twin.robot.model import find_floating

SIGNAL_TOPICS = {"joints": "/joint_states", "driven": "/joint_states", "actuators": "/actuator_command",
                 "bodies": BODIES, "sites": SITES}  # fmt: skip
"""Where signals are read that a twin makes of fields of other topics; what is a vector on a topic of its own below."""


class Signals(BaseModel):
    """Topics that carry a rig's joints, free bodies, IMUs and control inputs, by MJCF name.

    Joints and free bodies under `driven` are not simulated but follow their log: whatever moves them, its errors stay
    out of the question. Bodies are those that fly, float or hang by a ball joint; of those that are `turned` too, only
    where they go is simulated, and their attitude follows its log; sites are those where an IMU sits on a body.
    Instead of a topic a YAML may name fields of any topic, which come to lie in `entries`: topic that they are read as
    → name → where they are. There are topics of bodies, of IMUs and of what is driven, without a name where none is.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    joints: dict[str, str] = {}
    bodies: dict[str, str] = {}
    sites: dict[str, str] = {}
    actuators: dict[str, str] = {}
    driven: dict[str, str] = {}
    turned: tuple[str, ...] = ()
    entries: dict[str, dict[str, SignalEntry]] = Field(default_factory=dict, exclude=True)

    @model_validator(mode="before")
    @classmethod
    def split_entries(cls, given: Any) -> Any:  # noqa: ANN401
        """Part the names of topics from the entries of fields."""
        if not isinstance(given, dict):
            return given
        split: dict[str, Any] = dict(given)
        entries: dict[str, dict[str, Any]] = {}
        for group, topic in SIGNAL_TOPICS.items():
            signals = given.get(group)
            if isinstance(signals, dict):
                fields = {name: entry for name, entry in signals.items() if isinstance(entry, dict)}
                told = {name: place_entry(topic, name, entry) for name, entry in fields.items()}
                for name, entry in fields.items():
                    entries.setdefault(told[name], {})[name] = entry
                split[group] = {**signals, **told}
        spatial = [split.get(group) for group in ("bodies", "sites", "driven")]
        for topic in {topic for names in spatial if isinstance(names, dict) for topic in names.values()}:
            entries.setdefault(topic, {})
        return {**split, "entries": entries}

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """What a twin YAML says."""
        told = self.model_dump()
        turned = told.pop("turned")
        content = {part: names for part, names in told.items() if names or part not in ("bodies", "sites")}
        for names in content.values():
            for name, topic in names.items():
                if (entry := self.entries.get(topic, {}).get(name)) is not None:
                    names[name] = dump_entry(entry)
        return content | ({"turned": list(turned)} if turned else {})


NO_SIGNALS = Signals()


def place_entry(topic: str, name: str, entry: dict[str, Any]) -> str:
    """The topic that an entry is read as: one of its own for bodies, IMUs and what turns any way about a place."""
    if "attitude" in entry and topic != SITES:
        return (BODIES if "position" in entry else TURNS) + name
    return topic + name if topic.endswith("/") else topic


class Tracked(NamedTuple):
    """What a signal tells the motion of."""

    name: str  # of the joint or the body
    topic: str  # that carries it
    joint: int  # index of the joint, or of that which carries the body
    posed: bool  # it is the pose of a body in the world, not where a joint is from its parent
    led: bool  # it follows the log


def list_tracked(model: mujoco.MjModel, signals: Signals) -> list[Tracked]:
    """All that signals tell the motion of: joints, then bodies, then what is driven."""
    joints = {model.joint(i).name: i for i in range(model.njnt) if model.jnt_type[i] != FREE}
    bodies = find_floating(model)
    found = [Tracked(n, topic, joints[n], False, False) for n, topic in signals.joints.items()]
    found += [Tracked(n, topic, bodies[n], True, False) for n, topic in signals.bodies.items()]
    for name, topic in signals.driven.items():
        found.append(Tracked(name, topic, joints.get(name, bodies.get(name, -1)), name not in joints, True))
    return found


def turn_from_parent(model: mujoco.MjModel, tracked: Tracked, attitude: np.ndarray) -> np.ndarray:
    """What a ball joint turns by, (n, 4), of logged attitudes: as they are, or those of its body in the world."""
    if not tracked.posed:
        return attitude
    return multiply_attitudes(conjugate(find_upright(model, tracked.joint)), attitude)


def find_base(model: mujoco.MjModel, tracked: Tracked) -> np.ndarray:
    """The attitude in the world, (4,), of what logged ones are from; of what hangs from something that stands."""
    if tracked.posed or model.jnt_type[tracked.joint] == FREE:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return find_upright(model, tracked.joint)


def find_upright(model: mujoco.MjModel, joint: int) -> np.ndarray:
    """The attitude in the world, (4,), that a joint's body has in the reference pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    return np.asarray(data.xquat[model.jnt_bodyid[joint]])


def check_signals(name: str, model: mujoco.MjModel, signals: Signals | None) -> None:
    """Check that signals name joints, bodies, sites and actuators of the MJCF, and all that can move, each once.

    A joint that no signal names would be simulated from wherever the MJCF puts it: nobody knows where it was.
    """
    floating, bodies = find_floating(model), {model.body(i).name for i in range(1, model.nbody)}
    free = [body for body, i in floating.items() if model.jnt_type[i] == FREE]
    joints = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] != FREE]
    actuators = [model.actuator(i).name for i in range(model.nu)]
    if signals is not None and signals.driven and not (signals.joints or signals.bodies):
        found, action = f"{name}: every joint follows its log", "list what is in question under joints or bodies"
        raise InputError(found, "something to simulate", action)
    if signals is None or not (signals.joints or signals.bodies):
        example = f"bodies: {{{free[0]}: /pose}}" if free else f"joints: {{{joints[0] if joints else 'joint'}: "
        raise InputError(
            f"{name}: {'neither vehicle nor signals' if signals is None else 'signals without joints'}",
            "signals that map joints and actuators to topics, as the rig is not ours",
            f"add `signals: {{{example if free else example + '/joint_states}'}}}`",
        )
    for body in signals.turned:
        if body not in signals.bodies or body not in free:
            found = f"{name}: signals name {body!r} under turned"
            raise InputError(found, "a free body that is under bodies, too", "remove it, or name the body there")
    sites = {model.site(i).name: model.body(int(model.site_bodyid[i])).name for i in range(model.nsite)}
    unheld = [site for site in signals.sites if site in sites and sites[site] not in floating]
    if unheld:
        found = f"{name}: signals name site {unheld[0]!r}, which is on no free body"
        raise InputError(found, "IMUs on bodies that fly or float", "leave it out: joints have their own signals")
    kinds = (("joint", signals.joints, joints), ("free body", signals.bodies, list(floating)),
             ("joint", signals.driven, [*joints, *floating]), ("site", signals.sites, list(sites)),
             ("actuator", signals.actuators, actuators))  # fmt: skip
    for kind, given, known in kinds:
        for key in given:
            if key in bodies and key not in known and kind != "actuator":
                raise InputError(
                    f"{name}: signals name body {key!r}, whose pose is not its joint's",
                    "bodies on a <freejoint/>, or alone on a ball joint below what stands",
                    "name its joints instead; what is moved by hand, mocap too, gets a <freejoint/> and is driven",
                )
            if key not in known:
                listed = ", ".join(filter(None, known))
                named = (
                    f"one of {listed}"
                    if listed
                    else f"{'an' if kind == 'actuator' else 'a'} {kind} that the MJCF names, which names none"
                )
                raise InputError(f"{name}: signals name {kind} {key!r}", named, "rename it")
    told: dict[int, Tracked] = {}
    for each in list_tracked(model, signals):
        if (other := told.setdefault(each.joint, each)) is not each:
            what = [("driven" if one.led else "bodies" if one.posed else "joints", one.name) for one in (other, each)]
            (first, called), (second, too) = what
            found = f"{name}: {'body' if other.posed else 'joint'} {called!r} under {first} and "
            found += second if called == too else f"{too!r} under {second}"
            raise InputError(found, "it under one of them", "remove one")
    lost = []
    for i in (i for i in range(model.njnt) if i not in told):
        missed, kind = model.joint(i).name, "joint"
        if model.jnt_type[i] == FREE:
            missed, kind = model.body(int(model.jnt_bodyid[i])).name, "free body"
        lost.append(f"{kind} {missed!r}" if missed else f"a {kind} without a name")
    if lost:
        raise InputError(
            f"{name}: signals leave out {' and '.join(lost)}",
            "every joint of the MJCF under `joints` (simulated) or `driven` (follows its log), every free body under "
            "`bodies`",
            "name what was logged there, and remove the rest from the MJCF: bodies without joints are fixed",
        )
