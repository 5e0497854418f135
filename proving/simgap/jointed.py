"""Rigs with slides and hinges, drawn: carts, pendula, cart-poles, double pendula, arms; and those to watch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from proving.mechanisms.families import FAMILIES
from proving.mechanisms.hidden import (
    Hidden,
    Scale,
    draw_hidden,
    list_kinds,
    name_effect,
    size_effect,
)
from proving.mechanisms.recording import simulate
from proving.mechanisms.rig import Rig
from proving.mechanisms.sensors import draw_disturbance, draw_sensors
from proving.mechanisms.session import RATES, draw_motions
from proving.mechanisms.session import Session as Plan
from proving.mechanisms.trial import Motion
from proving.simgap.causes import Deal, Made, assemble, first, make_cause
from proving.simgap.scores import NOTHING, UNKNOWN
from proving.simgap.session import Cause, Truth

OFTEN = 0.2
"""Share of what is usual at a joint that a typical size is."""


def list_causes(rig: Rig, scale: Scale) -> dict[str, Cause]:
    """What may be wrong with a rig, with typical sizes."""
    causes = {}
    for kind, joint in [*list_kinds(rig, False), *((k, j) for k in ("drag", "cogging") for j in range(len(rig.links)))]:
        often = {"offset": 0.05, "delay": 0.02, "lag": 0.02}.get(kind, OFTEN)
        typical = first(size_effect(Hidden(name_effect(rig, kind, joint), joint, often), rig, scale))
        i = next((i for i, drive in enumerate(rig.drives) if drive.joint == joint), -1)
        off = 0.0
        if kind == "gain":
            off = 1.0
        elif kind == "saturation":  # what has no limit acts up to the largest command
            off = float(np.abs(scale.inputs[:, i]).max())
        elif kind == "rate_limit":
            off = float(np.abs(np.diff(scale.inputs[:, i])).max() / scale.period)
        size = max(abs(typical - off), 1e-9)
        causes[name_effect(rig, kind, joint)] = make_cause(kind, "", rig.links[joint].rotary, off, size)
    return causes


def draw_rig(
    rng: np.random.Generator, number: int, kind: str, deal: Deal, families: Sequence[str], watch: bool = False,
    many: int = 1,
) -> Made:  # fmt: skip
    """A session of a rig of one of these families, with so many causes where there is one that is listed."""
    rig = FAMILIES[families[number % len(families)]](rng)
    hidden: tuple[Hidden, ...] = ()
    if watch and rng.random() < 0.75:
        hidden = (draw_hidden(rng, rig, outside=True, turn="sudden"),)
    elif kind == UNKNOWN and not watch:
        pool = {k for k, _ in list_kinds(rig, True)} - {"ripple", "drag", "sudden", "cross_coupling"}
        hidden = (draw_hidden(rng, rig, outside=True, turn=deal(list(pool))),)
    elif kind == "single" and not watch:
        hidden = (draw_hidden(rng, rig, turn=deal(list({k for k, _ in list_kinds(rig, False)}))),)
        while len(hidden) < many:
            other = draw_hidden(rng, rig)
            hidden += (other,) if other.effect not in {one.effect for one in hidden} else ()
    motions = shorten(draw_motions(rng, rig), 2, 15.0)
    held = shorten(draw_motions(rng, rig), 1, 12.0)
    rate = int(rng.choice(RATES[:3] if rig.family == "arm" else RATES[:4]))
    plan = Plan(
        int(rng.integers(2**31)), number, "single", rig, hidden, (), False, (*motions, *held), rate, draw_sensors(rng),
        draw_disturbance(rng),
    )  # fmt: skip
    if watch:
        return watch_rig(plan)
    logs, found, scale = simulate(plan, held_out=1)
    truth, causes = Truth(NOTHING), list_causes(rig, scale)
    if hidden:
        told = {h.effect: first(found.hidden[h.effect] if h.outside else found.true[h.effect]) for h in hidden}
        seen = [found.visibility[h.effect] for h in hidden]
        truth = Truth(
            hidden[0].effect if hidden[0].effect in causes else UNKNOWN,
            {name: float(f"{size:.6g}") for name, size in told.items()}, min(one.seen for one in seen),
            min(one.apart for one in seen), [name for one in seen for name in one.alike if name not in told],
        )  # fmt: skip
    sheet = describe_sensors(rng, plan, scale)
    session, logs, truth = assemble(rig.write_mjcf(), logs, causes, truth, sheet, name_units(rig))
    return replace(session, many=many), logs, truth


def watch_rig(plan: Plan) -> Made:
    """A session with a healthy run and one in which something may set in."""
    healthy = replace(plan, hidden=(), motions=plan.motions[:1])
    watched = replace(plan, number=plan.number + 100_000, motions=plan.motions[1:2] or plan.motions[:1])
    # one build of the rig: its tolerances follow from the number
    logs, _, scale = simulate(healthy)
    more, found, _ = simulate(replace(watched, number=plan.number))
    rig, onset = plan.rig, None
    if plan.hidden:
        onset = found.hidden["outside:sudden"]["at"] * float(
            next(iter(more[0].joints["/joint_states"].values())).time[-1]
        )
    truth = Truth(UNKNOWN if plan.hidden else NOTHING, onset=onset)
    return assemble(rig.write_mjcf(), [*logs, *more], list_causes(rig, scale), truth, {}, name_units(rig), ("watch",))


def shorten(motions: Sequence[Motion], most: int, seconds: float) -> tuple[Motion, ...]:
    """At most so many motions, none longer than that."""
    return tuple(replace(motion, duration=min(motion.duration, seconds)) for motion in motions[:most])


def describe_sensors(rng: np.random.Generator, plan: Plan, scale: Scale) -> dict[str, float]:
    """The data sheet of half of the rigs: noise of the encoders, right within a factor of two; others have none."""
    known, about = rng.random() < 0.5, np.exp(rng.uniform(-0.7, 0.7, len(plan.rig.links)))
    noise = scale.spread * np.hypot(plan.sensors.noise, plan.sensors.quantum / np.sqrt(12.0)) * about
    return {name: float(f"{std:.2g}") for name, std in zip(plan.rig.joints, noise)} if known else {}


def name_units(rig: Rig) -> dict[str, str]:
    """Column → unit; commands are multiples of what a motor's gear makes of them."""
    units = {link.joint: "rad" if link.rotary else "m" for link in rig.links}
    return units | {f"v_{name}": f"{unit}/s" for name, unit in units.items()}
