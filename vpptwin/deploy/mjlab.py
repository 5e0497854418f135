"""A twin as events of mjlab that draw what is uncertain about it from its 90 % intervals."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass

import jinja2
import numpy as np

from vpptwin.deploy.hold import Held, Place, hold
from vpptwin.deploy.mjcf import describe
from vpptwin.system.errors import escape_text
from vpptwin.twin.spec import TwinSpec

EVENTS = {
    ("joint", "frictionloss"): "joint_friction", ("joint", "damping"): "joint_damping",
    ("joint", "armature"): "joint_armature", ("joint", "stiffness"): "joint_stiffness",
    ("inertial", "mass"): "body_mass", ("inertial", "pos"): "body_com_offset",
}  # fmt: skip
"""Attribute of an MJCF → the function of `mjlab.envs.mdp.dr` (1.6) that draws it."""
NAMES = {"joint": "joint_names", "inertial": "body_names"}
SETTINGS = ("solreffriction", "solimpfriction", "nsample", "biastype")


@dataclass(frozen=True)
class Event:
    """One term of mjlab's event manager."""

    term: str  # what it is called
    function: str  # of `mjlab.envs.mdp.dr`
    names: str  # the argument that selects elements
    pattern: str  # which, a regular expression
    ranges: str  # Python text of what is drawn, absolute numbers
    about: list[str]  # the effects that it stands for


def write_mjlab(spec: TwinSpec) -> tuple[str, list[str]]:
    """Python text that makes the events, and what of the twin they can't draw, in lines."""
    held = hold(spec)
    drawn = spread(spec, held)
    events = list(list_events(spec, held, drawn))
    fixed = [
        f"{element} {name} {attribute}: {write_range(drawn[element, name, attribute])}"
        for element, name, attribute in drawn
        if (element, attribute) not in EVENTS and attribute not in SETTINGS
    ]
    lost = [f"{describe(effect, spec)} - {why}" for effect, why in held.lost]
    template = TEMPLATES.get_template("mjlab.py.j2")
    return template.render(name=spec.name, events=events, fixed=fixed, lost=lost), fixed


def spread(spec: TwinSpec, held: Held) -> dict[Place, np.ndarray]:
    """Ends of what each attribute may be by the 90 % intervals of the effects, (2, k); the deviations add up."""
    ends = {place: np.array([values, values]) for place, values in held.values.items()}
    for effect in held.effects:
        for parameter in effect.parameters:
            between = spec.intervals.get(f"{effect.id}.{parameter.name}", ())
            for value in parameter.clip(np.array(between)):
                effects = spec.effects | {effect.id: spec.effects[effect.id] | {parameter.name: float(value)}}
                for place, values in hold(spec.with_effects(effects)).values.items():
                    if place in ends:
                        off = np.array(values) - held.values[place]
                        ends[place] += np.array([np.minimum(off, 0.0), np.maximum(off, 0.0)])
    return ends


def list_events(spec: TwinSpec, held: Held, drawn: dict[Place, np.ndarray]) -> Iterator[Event]:
    """The events for what mjlab can draw."""
    for (element, name, attribute), ends in drawn.items():
        if (element, attribute) in EVENTS:
            function = EVENTS[element, attribute]
            term = re.sub(r"\W", "_", f"{name}_{function}", flags=re.ASCII)
            about = [describe(effect, spec) for effect in held.reasons[element, name, attribute]]
            yield Event(term, function, NAMES[element], re.escape(name), write_range(ends), about)


def write_range(ends: np.ndarray) -> str:
    """Ends (2, k) as Python text: a pair, or a pair for each axis."""
    pairs = [f"({low!r}, {high!r})" for low, high in ends.T.tolist()]
    return pairs[0] if len(pairs) == 1 else "{" + ", ".join(f"{i}: {pair}" for i, pair in enumerate(pairs)) + "}"


TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("vpptwin.deploy"), undefined=jinja2.StrictUndefined, keep_trailing_newline=True,
    trim_blocks=True, lstrip_blocks=True,
)  # fmt: skip
TEMPLATES.filters |= {"comment": escape_text, "text": json.dumps}
