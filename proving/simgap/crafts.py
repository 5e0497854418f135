"""Rigs that are not drawn: the drone on its rail, an arm and a leg with position servos, a quadrotor."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from scipy.signal import lfilter

from proving.drone import EFFECTS, Recording, draw_effect, draw_wind, fly_many
from proving.drone.flight import FlightPlan
from proving.drone.rig import MODELS, load_nominal
from proving.hidden import Hidden, Spans
from proving.logs import Log, Stream
from proving.simgap.causes import LAWS, Deal, Made, assemble, first, make_cause
from proving.simgap.scores import NOTHING, UNKNOWN
from proving.simgap.session import Cause, Truth


def draw_craft(
    rng: np.random.Generator, number: int, kind: str, deal: Deal, mjcf: str, spans: Spans,
    make: Callable[[Hidden, float, int], Log], off: Mapping[str, float], units: Mapping[str, str], seconds: float,
    known: Mapping[str, float] = MappingProxyType({}),
) -> Made:  # fmt: skip
    """A session of one of the rigs that are not drawn: three logs, the last held out."""
    names = {key.split()[0] if " " not in key else key.replace(" ", ":"): key for key in spans}
    causes = {}
    for name, key in names.items():
        parameter, low, high = spans[key]
        law_of, nominal = name.split(".")[1].split(":")[0], off.get(parameter, 0.0)
        typical = abs(float(np.sqrt(low * high)) - nominal)
        causes[name] = make_cause(law_of, parameter, law_of not in ("wind", "drag"), nominal, typical)
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
