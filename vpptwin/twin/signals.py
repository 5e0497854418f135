"""Which topics carry a rig's joints, bodies and control inputs, and whether they fit its MJCF."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from vpptwin.errors import InputError
from vpptwin.fields import BODIES, SITES, SignalEntry, dump_entry
from vpptwin.twin.manifold import BALL, FREE
from vpptwin.twin.model import find_free, free_bodies

SIGNAL_TOPICS = {
    "joints": "/joint_states", "driven": "/joint_states", "actuators": "/actuator_command",
    "bodies": BODIES + "{}", "sites": SITES + "{}",
}  # fmt: skip
"""Where signals are read, bodies and IMUs each on a topic of its own, that a twin makes of fields of other topics."""


class Signals(BaseModel):
    """Topics that carry a rig's joints, free bodies, IMUs and control inputs, by MJCF name.

    Joints under `driven` are not simulated but follow their log: whatever moves them, its errors stay out of the
    question. Bodies are those that fly or float; sites those where an IMU sits on one. Instead of a JointState topic a
    YAML may name fields of any topic, which come to lie in `entries`: topic that they are read as → name → where they
    are.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    joints: dict[str, str] = {}
    bodies: dict[str, str] = {}
    sites: dict[str, str] = {}
    actuators: dict[str, str] = {}
    driven: dict[str, str] = {}
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
                for name, entry in fields.items():
                    entries.setdefault(topic.format(name), {})[name] = entry
                split[group] = {**signals, **{name: topic.format(name) for name in fields}}
        return {**split, "entries": {topic: names for topic, names in entries.items() if names}}

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """What a twin YAML says."""
        told = self.model_dump()
        content = {part: names for part, names in told.items() if names or part not in ("bodies", "sites")}
        for group, topic in SIGNAL_TOPICS.items():
            for name in content.get(group, ()):
                if (entry := self.entries.get(topic.format(name), {}).get(name)) is not None:
                    content[group][name] = dump_entry(entry)
        return content


NO_SIGNALS = Signals()


def check_signals(name: str, model: mujoco.MjModel, signals: Signals | None) -> None:
    """Check that signals name joints, free bodies, sites and actuators of the MJCF, and all that can move.

    A joint that no signal names would be simulated from wherever the MJCF puts it: nobody knows where it was.
    """
    if (model.jnt_type == BALL).any():
        joint = model.joint(int(np.argmax(model.jnt_type == BALL))).name
        raise InputError(f"{name}: ball joint {joint!r}", "hinges, slides and free bodies", "replace it by hinges")
    free = [model.body(int(model.jnt_bodyid[i])).name for i in find_free(model)]
    joints = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] != FREE]
    actuators = [model.actuator(i).name for i in range(model.nu)]
    if signals is None or not (signals.joints or signals.bodies):
        example = f"bodies: {{{free[0]}: /pose}}" if free else f"joints: {{{joints[0] if joints else 'joint'}: "
        raise InputError(
            f"{name}: {'neither vehicle nor signals' if signals is None else 'signals without joints'}",
            "signals that map joints and actuators to topics, as the rig is not ours",
            f"add `signals: {{{example if free else example + '/joint_states}'}}}`",
        )
    both = sorted(set(signals.joints) & set(signals.driven))
    if both:
        raise InputError(f"{name}: joint {both[0]!r} under joints and driven", "it under one of them", "remove one")
    if signals.driven and free:
        found = f"{name}: driven joint {next(iter(signals.driven))!r} on a rig with a free body"
        raise InputError(found, "driven joints where the base stands", "list it under joints")
    sites = [model.site(i).name for i in range(model.nsite)]
    kinds = (("joint", signals.joints, joints), ("joint", signals.driven, joints), ("free body", signals.bodies, free),
             ("site", signals.sites, sites), ("actuator", signals.actuators, actuators))  # fmt: skip
    unheld = [site for site in signals.sites if site in sites and model.site(site).bodyid[0] not in free_bodies(model)]
    if unheld:
        found = f"{name}: signals name site {unheld[0]!r}, which is on no free body"
        raise InputError(found, "IMUs on bodies that fly or float", "leave it out: joints tell their own motion")
    for kind, given, known in kinds:
        for key in given:
            if key not in known:
                listed = ", ".join(filter(None, known))
                named = f"one of {listed}" if listed else f"a {kind} that the MJCF names, which names none"
                raise InputError(f"{name}: signals name {kind} {key!r}", named, "rename it")
    told = {**signals.joints, **signals.driven}
    lost = [f"joint {joint!r}" if joint else "a joint without a name" for joint in joints if joint not in told]
    unseen = (body for body in free if body not in signals.bodies)
    lost += [f"free body {body!r}" if body else "a free body without a name" for body in unseen]
    if lost:
        raise InputError(
            f"{name}: signals leave out {' and '.join(lost)}",
            "every joint of the MJCF under `joints` (simulated) or `driven` (follows its log), every free body under "
            "`bodies`",
            "name what was logged there, and remove the rest from the MJCF: bodies without joints are fixed",
        )
