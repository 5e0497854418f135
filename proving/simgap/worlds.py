"""The worlds: simulations of their own, from which sessions are drawn.

None shares physics with an entrant: they integrate their own equations of motion (Pinocchio's for arms), with friction,
drives and sensors of their own. In every session one thing is wrong with the nominal model, or nothing.
"""

from __future__ import annotations

import hashlib
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
from scipy.signal import lfilter

from proving import quadrotor, servo_arm
from proving.drone import EFFECTS, Recording, draw_effect, draw_wind, fly_many
from proving.drone.flight import FlightPlan
from proving.drone.rig import MODELS, load_nominal
from proving.hidden import Hidden as Sizes
from proving.hidden import Spans
from proving.logs import Log, Stream
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
from proving.simgap.scores import NOTHING, UNKNOWN
from proving.simgap.session import PREDICTED, Cause, Session, Truth, cut_windows, make_run

DECK = ("single",) * 8 + (NOTHING,) * 2 + (UNKNOWN,) * 2
"""Kinds of twelve sessions in a row, in a new order each time."""
LAWS = {
    "coulomb": ("dry friction", "-size sign(v)", "force"),
    "stiction": ("dry friction", "-size sign(v) exp(-(v / v_s)²)", "force"),
    "viscous": ("damping", "-size v", "damping"),
    "drag": ("damping", "-size |v| v", "drag"),
    "bias": ("steady force", "size", "force"),
    "spring": ("spring", "-size (q - rest)", "stiffness"),
    "cogging": ("cogging", "size sin(2 pi waves q + phase)", "force"),
    "inertia": ("inertia", "-size a", "inertia"),
    "offset": ("zero", "the encoder reads size too much", "angle"),
    "gain": ("gain", "size times the commanded force", "gain"),
    "delay": ("timing", "the command acts size later", "delay"),
    "lag": ("timing", "a first-order lag of size", "time_constant"),
    "backlash": ("limits", "play of width size in the command", "gap"),
    "rate_limit": ("limits", "the command changes by at most size a second", "rate"),
    "saturation": ("limits", "the command acts up to size", "limit"),
    "load": ("dry friction", "-size |drive force| sign(v)", "mu"),
    "stiffness": ("gain", "size times the servo's stiffness", "stiffness"),
    "dead_band": ("limits", "errors up to size have no effect", "band"),
    "force_limit": ("limits", "size times the servo's largest force", "limit"),
    "payload": ("inertia", "a mass of size at the tip", "mass"),
    "mass": ("inertia", "a mass of size more", "mass"),
    "com": ("steady force", "the centre of mass is off by size along an axis", "m"),
    "wind": ("steady force", "a steady force of size along an axis", "force"),
    "twist": ("steady force", "a steady torque of size about an axis", "torque"),
}
"""Kind of effect → its group, its law as force or torque of `size`, and what its size is called."""
UNITS = {
    "force": ("N", "N m"), "damping": ("N s/m", "N m s/rad"), "drag": ("N s²/m²", "N m s²/rad²"),
    "stiffness": ("N/m", "N m/rad"), "inertia": ("kg", "kg m²"), "angle": ("m", "rad"),
}  # fmt: skip
"""Parameter → unit at a slide and at a hinge."""
PLAIN = {"delay": "s", "time_constant": "s", "torque": "N m", "mass": "kg", "m": "m", "band": "rad"}
OFTEN = 0.2
"""Share of what is usual at a joint that a typical size is."""

Made = tuple[Session, list[Log], Truth]
Deal = Callable[[Sequence[str]], str]


def draw_session(world: str, seed: int, number: int) -> Made:
    """The session of that number: what entrants get, its logs, and the truth.

    Raises:
        ValueError: where there is no such world.
    """
    if world not in WORLDS:
        raise ValueError(f"no world {world}: there are {', '.join(WORLDS)}")
    place, (block, card) = zlib.crc32(world.encode()), divmod(number, len(DECK))
    deck = np.random.default_rng([seed, place, 1, block]).permutation(np.array(DECK))
    kind = str(deck[card])
    turn = block * DECK.count(kind) + int(np.sum(deck[:card] == kind))

    def deal(pool: Sequence[str]) -> str:
        """One of a pool; all take turns."""
        order = np.random.default_rng([seed, place, 3, turn // len(pool)]).permutation(np.array(sorted(pool)))
        return str(order[turn % len(pool)])

    session, logs, truth = WORLDS[world](np.random.default_rng([seed, place, 2, number]), number, kind, deal)
    salt = hashlib.sha256(f"simgap {seed} {world} {number}".encode()).hexdigest()
    return replace(session, name=f"{world}-{number:04d}"), logs, replace(truth, salt=salt)


def assemble(
    mjcf: str, logs: Sequence[Log], causes: Mapping[str, Cause], truth: Truth, data_sheet: Mapping[str, float],
    units: Mapping[str, str], tracks: Sequence[str] = ("name", "predict"),
    known: Mapping[str, float] = MappingProxyType({}),
) -> Made:  # fmt: skip
    """A session of logs, of which the last is held out where forecasts are asked for."""
    runs, told = zip(*(make_run(log) for log in logs))
    columns = {name: replace(column, unit=units.get(name, "")) for name, column in told[0].items()}
    shown = len(runs) - ("predict" in tracks)
    predicted = [name for name, column in columns.items() if column.role in PREDICTED]
    scales = {n: float(f"{np.nanstd(np.concatenate([r.columns[n] for r in runs[:shown]])):.4g}") for n in predicted}
    windows, measured = cut_windows(runs[-1], columns, predicted) if shown < len(runs) else ([], np.empty(0))
    session = Session(
        "",
        list(tracks),
        mjcf,
        columns,
        dict(causes),
        scales,
        dict(data_sheet),
        dict(known),
        list(runs[:shown]),
        windows,
    )
    return session, list(logs[:shown]), replace(truth, forecasts=np.round(measured, 9).tolist())


# --- rigs with slides and hinges


def list_causes(rig: Rig, scale: Scale) -> dict[str, Cause]:
    """What may be wrong with a rig, with typical sizes."""
    causes = {}
    for kind, joint in [*list_kinds(rig, False), *((k, j) for k in ("drag", "cogging") for j in range(len(rig.links)))]:
        group, law, parameter = LAWS[kind]
        hinge = rig.links[joint].rotary
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
        unit = UNITS.get(parameter, (PLAIN.get(parameter, ""),) * 2)[hinge]
        size = max(abs(typical - off), 1e-9)
        causes[name_effect(rig, kind, joint)] = Cause(
            group, law, parameter, unit, float(f"{off:.4g}"), float(f"{size:.4g}")
        )
    return causes


def first(values: Mapping[str, float]) -> float:
    """The size of an effect: the first of its parameters."""
    return next(iter(values.values()))


def draw_rig(
    rng: np.random.Generator, number: int, kind: str, deal: Deal, families: Sequence[str], watch: bool = False
) -> Made:  # fmt: skip
    """A session of a rig of one of these families."""
    rig = FAMILIES[families[number % len(families)]](rng)
    hidden: tuple[Hidden, ...] = ()
    if watch and rng.random() < 0.75:
        hidden = (draw_hidden(rng, rig, outside=True, turn="sudden"),)
    elif kind == UNKNOWN and not watch:
        pool = {k for k, _ in list_kinds(rig, True)} - {"ripple", "drag", "sudden", "cross_coupling"}
        hidden = (draw_hidden(rng, rig, outside=True, turn=deal(list(pool))),)
    elif kind == "single" and not watch:
        hidden = (draw_hidden(rng, rig, turn=deal(list({k for k, _ in list_kinds(rig, False)}))),)
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
    truth = Truth(NOTHING)
    for one in hidden:
        size = first(found.hidden[one.effect] if one.outside else found.true[one.effect])
        seen = found.visibility[one.effect]
        truth = Truth(
            UNKNOWN if one.effect not in list_causes(rig, scale) else one.effect, {one.effect: float(f"{size:.6g}")},
            seen.seen, seen.apart, list(seen.alike),
        )  # fmt: skip
    return assemble(
        rig.write_mjcf(), logs, list_causes(rig, scale), truth, describe_sensors(rng, plan, scale), name_units(rig)
    )


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


# --- position servos, and a quadrotor


def draw_craft(
    rng: np.random.Generator, number: int, kind: str, deal: Deal, mjcf: str, spans: Spans,
    make: Callable[[Sizes, float, int], Log], off: Mapping[str, float], units: Mapping[str, str], seconds: float,
    known: Mapping[str, float] = MappingProxyType({}),
) -> Made:  # fmt: skip
    """A session of one of the rigs that are not drawn: three logs, the last held out."""
    names = {key.split()[0] if " " not in key else key.replace(" ", ":"): key for key in spans}
    causes = {}
    for name, key in names.items():
        parameter, low, high = spans[key]
        law_of, nominal = name.split(".")[1].split(":")[0], off.get(parameter, 0.0)
        group, law, called = LAWS[law_of]
        unit = UNITS.get(called, (PLAIN.get(called, ""),) * 2)[law_of not in ("wind", "drag")]
        typical = float(np.sqrt(low * high))
        causes[name] = Cause(group, law, parameter, unit, nominal, float(f"{abs(typical - nominal):.4g}"))
    sizes: dict[str, dict[str, float]] = {}
    truth = Truth(NOTHING)
    if kind != NOTHING:
        name = deal(list(names))
        parameter, low, high = spans[names[name]]
        size = float(low * (high / low) ** rng.random()) * (rng.choice([-1.0, 1.0]) if ":" in name else 1.0)
        sizes = {name.split(":")[0]: {parameter: size}}
        truth = Truth(name, {name: float(f"{size:.6g}")})
    first_seed = int(rng.integers(2**31))
    logs = [make(sizes, seconds, first_seed + i) for i in range(3)]
    return assemble(mjcf, logs, causes, truth, {}, units, known=known)


# --- the planar drone on its rail

LISTED = {
    **{f"{joint}.{kind}": f"{joint}.{kind}" for joint in ("rail_x", "rail_z", "pitch")
       for kind in ("coulomb", "viscous", "bias")},
    "rail_x.stiction": "rail_x.stiction", "rail_z.stiction": "rail_z.stiction", "rail_x.spring": "rail_x.spring",
    "carriage.mass": "carriage.mass", "airframe.mass": "craft.mass", "airframe.inertia": "pitch.inertia",
    "airframe.com": "craft.com:x", "rotor.thrust_gain": "thrust_1+thrust_2.gain",
    "command.delay": "thrust_1+thrust_2.delay",
}  # fmt: skip
"""What proving/drone calls an effect → what it is called here."""
UNLISTED = (
    "air.drag", "rotor.asymmetry", "rail_x.jamming", "rail_x.tight_spot", "rotor.inflow", "battery.sag", "rotor.stall",
    "air.ground_effect", "alien.cogging", "alien.hysteresis", "alien.slosh",
)  # fmt: skip
"""What is not among the causes there."""
FLOWN = ("creep", "aggressive", "mixed")
"""A log each; the last is held out."""


def draw_drone(rng: np.random.Generator, number: int, kind: str, deal: Deal) -> Made:
    """A session of the drone: motion capture at 100 Hz, thrusts that the nominal rotors would make at 500 Hz."""
    causes, hidden, truth = {}, {}, Truth(NOTHING)
    for effect, name in LISTED.items():
        law = name.split(".")[1].split(":")[0]
        parameter, size = next(iter(EFFECTS[effect].items()))
        group, about, _ = LAWS[law]
        low, high = size.spans[-1]
        causes[name] = Cause(
            group, about, parameter, size.unit, size.off, float(f"{0.5 * (low + high) - size.off:.4g}")
        )
    if kind != NOTHING:
        effect = deal(list(LISTED)) if kind == "single" else deal(UNLISTED)
        hidden = draw_effect(rng, (effect,))
        size = float(f"{first(hidden[effect]):.6g}")
        truth = Truth(LISTED.get(effect, UNKNOWN), {LISTED.get(effect, effect): size})
    rig, wind = int(rng.integers(2**31)), draw_wind(rng, most=1.5)
    plans: list[FlightPlan] = [
        {"effects": hidden, "manoeuvre": m, "duration": 12.0, "seed": rig + 1 + i, "session": rig, "wind": wind}
        for i, m in enumerate(FLOWN)
    ]
    logs = [read_flight(flight) for flight in fly_many(plans)]
    mjcf = (MODELS / "rail_rig.xml").read_text()
    for pattern in (
        r"<!--.*?-->\s*",
        r' (frictionloss|damping)="[^"]*"',
        r'<geom name="drag"[^>]*/>',
        r'\s*density="[^"]*"',
    ):
        mjcf = re.sub(pattern, "", mjcf, flags=re.DOTALL)
    return assemble(mjcf, logs, causes, truth, {}, {"rail_x": "m", "rail_z": "m", "pitch": "rad"})


def read_flight(flight: Recording) -> Log:
    """A flight as joints and thrusts."""
    nominal, period = load_nominal(), 0.002
    pose, state, command = (flight.topics[name] for name in ("/mocap/pose", "/rotor/state", "/rotor/command"))
    angle = np.unwrap(-2.0 * np.arctan2(pose.columns["qy"], pose.columns["qw"]))
    motion = dict(zip(("rail_x", "rail_z", "pitch"), (pose.columns["x"], pose.columns["z"], angle)))
    joints = {name: Stream(pose.time, {"position": values}) for name, values in motion.items()}
    clock = np.arange(max(state.time[0], command.time[0]), min(state.time[-1], command.time[-1]), period)
    thrusts, keep = {}, np.exp(-period / nominal["servo"]["time_constant"])
    for i in (1, 2):
        blade = np.interp(clock, command.time, command.columns[f"blade_pitch_{i}"])
        lagged = lfilter([0.0, 1.0 - keep], [1.0, -keep], blade, zi=[blade[0] * keep])[0]
        speed = np.interp(clock, state.time, state.columns[f"speed_{i}"])
        thrusts[f"thrust_{i}"] = Stream(clock, {"effort": nominal["rotor"]["k_t"] * speed * lagged})
    return Log(Path(f"{flight.manoeuvre}.mcap"), 0, {}, {"/joint_states": joints, "/thrusts": thrusts})


WORLDS: dict[str, Callable[[np.random.Generator, int, str, Deal], Made]] = {
    "drones": draw_drone,
    "carts": partial(draw_rig, families=("carriage", "damped cart")),
    "pendula": partial(draw_rig, families=("pendulum",)),
    "cart-poles": partial(draw_rig, families=("cart-pole",)),
    "double-pendula": partial(draw_rig, families=("double pendulum",)),
    "arms": partial(draw_rig, families=("arm",)),
    "servos": partial(
        draw_craft, mjcf=servo_arm.MJCF, spans=servo_arm.SPANS, make=servo_arm.move, seconds=12.0,
        off={"stiffness": 1.0, "limit": 1.0}, units=dict.fromkeys(servo_arm.JOINTS, "rad"),
    ),
    "quadrotors": partial(
        draw_craft, mjcf=quadrotor.MJCF, spans=quadrotor.SPANS, make=quadrotor.fly, seconds=10.0,
        off={"gain": 1.0, "time_constant": quadrotor.LAG}, units=dict.fromkeys("xyz", "m"),
        known={"m1+m2+m3+m4.lag": quadrotor.LAG},
    ),
    "watched": partial(draw_rig, families=("carriage", "damped cart", "cart-pole", "double pendulum"), watch=True),
}  # fmt: skip
"""Name → what draws a session."""
