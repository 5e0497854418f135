"""What is hidden in a rig: drawn as a share of what that joint or drive has to do, then given its size.

Ids and meanings are those of the generic catalogue (docs/twin.md); `outside:NAME` is what it lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .families import spread
from .plant import STEP
from .rig import Rig
from .trial import World

Values = dict[str, float]


@dataclass(frozen=True)
class Hidden:
    """An effect to hide."""

    effect: str  # its id
    joint: int  # index of the joint, of an actuator's the driven one
    share: float  # its size, as a share of what is usual there
    sign: float = 1.0  # of what may have either
    seed: int = 0  # of its further numbers
    sensor: bool = False  # whether it is the log of the torque that is wrong, not the torque

    @property
    def kind(self) -> str:
        """The effect without its place."""
        return self.effect.replace(":", ".").split(".")[1]

    @property
    def outside(self) -> bool:
        """Whether the catalogue lacks it."""
        return self.effect.startswith("outside:")


@dataclass(frozen=True)
class Scale:
    """What is usual along a log without anything hidden.

    Attributes:
        force: rms at each joint: the largest of the drive's, inertia's and gravity's, (n,) [N, N m].
        speed, spread, middle: rms velocity, standard deviation and median of position, (n,).
        carried: mean inertia, (n,) [kg, kg m²].
        inputs: (T, m).
        period: s.
    """

    force: np.ndarray
    speed: np.ndarray
    spread: np.ndarray
    middle: np.ndarray
    carried: np.ndarray
    inputs: np.ndarray
    period: float

    @property
    def input(self) -> np.ndarray:
        """Rms of the inputs, (m,)."""
        return np.sqrt(np.mean(self.inputs**2, axis=0))


FORCES, FREE = (0.02, 0.6), (0.003, 0.1)
"""Shares of a joint's typical force: where a drive keeps it moving, and where friction soon brings it to rest."""
JOINT_KINDS = ("coulomb", "stiction", "viscous", "bias", "spring", "inertia")
OFFSET = (0.01, 0.2)
"""Span of the angle by which a hinge's encoder reads too much [rad]."""
DRIVE_KINDS = {
    "gain": (0.03, 0.36), "delay": (0.005, 0.06), "lag": (0.005, 0.06), "backlash": (0.05, 0.6),
    "rate_limit": (0.03, 0.5), "saturation": (0.03, 0.5),
}  # fmt: skip
"""Actuator effects → span: logarithm of the gain, seconds, play over the rms input, share of time at the limit."""
LATER_KINDS = {"cogging": (0.05, 0.5), "tight_spot": (0.1, 0.8), "rate_bias": (0.02, 0.2), "rate_scale": (0.03, 0.2),
               "fade": (0.05, 0.5)}  # fmt: skip
"""Kinds that came into the catalogue after the sessions of every seed were fixed → span, as a share of what is usual.
They are hidden where somebody asks for them; `ripple` and `drag`, drawn from outside the catalogue, are in it now."""
NOW_INSIDE = {"ripple": "cogging", "drag": "drag"}
"""Kinds that were outside when the sessions of every seed were fixed → what they are called in the catalogue."""
OUTSIDE = ("ripple", "drag", "place_friction", "hysteresis", "memory", "periodic", "sudden", "cable")
OUTSIDE_DRIVEN = ("sensor_dead_band", "quantised_torque")
KINDS, KINDS_OUTSIDE = (*JOINT_KINDS, "offset", *DRIVE_KINDS), (*OUTSIDE, *OUTSIDE_DRIVEN, "cross_coupling")
EITHER = ("bias", "gain")
FAINT, FAINTER = 0.2, (0.15, 0.6)
"""Share of effects that are drawn fainter than these spans, and how much."""


def list_kinds(rig: Rig, outside: bool) -> list[tuple[str, int]]:
    """Kinds and joints at which a rig can have them."""
    driven = np.flatnonzero(rig.driven)
    joints = range(len(rig.links))
    if not outside:
        hinges = [("offset", j) for j in joints if rig.links[j].rotary]
        found = [(k, j) for k in JOINT_KINDS for j in joints] + hinges
        return found + [(k, int(j)) for k in DRIVE_KINDS for j in driven]
    found = [(k, j) for k in OUTSIDE for j in joints] + [(k, int(j)) for k in OUTSIDE_DRIVEN for j in driven]
    return found + [("cross_coupling", j) for j in joints if len(rig.links) > 1 and set(driven) - {j}]


def draw_hidden(rng: np.random.Generator, rig: Rig, outside: bool = False, turn: str = "") -> Hidden:
    """An effect that this rig can have: the kind whose turn it is, or else any, all equally likely; then a joint."""
    known = list_kinds(rig, outside)
    if turn in LATER_KINDS:
        known = [(turn, j) for j in range(len(rig.links)) if turn != "fade" or rig.driven[j]]
    kinds = sorted({kind for kind, _ in known})
    kind = turn if turn in kinds else str(rng.choice(kinds))
    joint = int(rng.choice([j for k, j in known if k == kind]))
    driven = bool(rig.driven[joint])
    low, high = FORCES if driven else FREE
    if kind == "inertia":
        low, high = 0.05, 0.6
    if kind == "stiction":
        low = 1.5 * low
    if outside:
        low = 2.5 * low
    low, high = OFFSET if kind == "offset" else DRIVE_KINDS.get(kind, LATER_KINDS.get(kind, (low, high)))
    sensor = kind in EITHER and driven and rng.random() < 0.3
    share = spread(rng, low, high) * (spread(rng, *FAINTER) if not outside and rng.random() < FAINT else 1.0)
    return Hidden(
        name_effect(rig, kind, joint, outside), joint, share, float(rng.choice([-1.0, 1.0])),
        int(rng.integers(2**31)), sensor,
    )  # fmt: skip


def name_effect(rig: Rig, kind: str, joint: int, outside: bool = False) -> str:
    """Its id."""
    if kind in NOW_INSIDE:
        kind, outside = NOW_INSIDE[kind], False
    if outside:
        return f"outside:{kind}"
    names = {drive.joint: drive.name for drive in rig.drives}
    return f"{names[joint] if kind in DRIVE_KINDS else rig.joints[joint]}.{kind}"


def size_effect(hidden: Hidden, rig: Rig, scale: Scale) -> Values:
    """Its parameters by the catalogue's names, SI; of what is outside the catalogue, by names of its own."""
    rng, j, share = np.random.default_rng(hidden.seed), hidden.joint, hidden.share
    i = next((i for i, drive in enumerate(rig.drives) if drive.joint == j), -1)
    force, speed, far = scale.force[j], scale.speed[j], scale.spread[j]
    signed, size = hidden.sign * share * force, share * force
    low, high, reach = (0.02, 2.0, 3.2) if rig.links[j].rotary else (0.005, 0.5, 2.0)
    wave, phase = 2.0 * np.pi / (far * rng.uniform(0.3, 1.5)), rng.uniform(0.0, 6.28)
    makers: Mapping[str, Callable[[], Values]] = {
        "coulomb": lambda: {"torque" if rig.links[j].rotary else "force": size},
        "stiction": lambda: {"force": size, "velocity": float(np.clip(speed * rng.uniform(0.03, 0.2), low, high))},
        "viscous": lambda: {"damping": size / speed},
        "bias": lambda: {"force": signed},
        "spring": lambda: {"stiffness": size / far,
                           "rest": float(np.clip(scale.middle[j] + far * rng.uniform(-1.5, 1.5), -reach, reach))},
        "inertia": lambda: {"inertia": (hidden.sign if share < 0.2 and len(rig.links) == 1 else 1.0)
                            * share * scale.carried[j]},
        "offset": lambda: {"angle": hidden.sign * share},
        "gain": lambda: {"gain": float(np.exp(hidden.sign * share))},
        "delay": lambda: {"delay": STEP * round(share / STEP)},
        "lag": lambda: {"time_constant": share},
        "backlash": lambda: {"gap": share * scale.input[i]},
        "rate_limit": lambda: {"rate": bound(np.diff(scale.inputs[:, i]) / scale.period, share)},
        "saturation": lambda: {"limit": bound(scale.inputs[:, i], share)},
        "cogging": lambda: {"force": 1.4 * size, "waves": wave / (2.0 * np.pi), "phase": phase},
        "tight_spot": lambda: {"force": size, "place": scale.middle[j] + far * rng.uniform(-1.0, 1.0),
                               "width": far * rng.uniform(0.15, 0.4)},
        "fade": lambda: {"slope": share / speed},
        "rate_bias": lambda: {"bias": hidden.sign * share * speed},
        "rate_scale": lambda: {"scale": 1.0 + hidden.sign * share},
        "drag": lambda: {"drag": size / speed**2},
        "place_friction": lambda: {"place": size, "place_rate": wave},
        "hysteresis": lambda: {"hysteresis": size, "reach": far * rng.uniform(0.2, 1.0)},
        "memory": lambda: {"memory": size / far, "memory_time": rng.uniform(0.2, 2.0)},
        "periodic": lambda: {"hum": 1.4 * size, "hum_rate": 2.0 * np.pi * spread(rng, 0.3, 5.0)},
        "cable": lambda: {"cable": 2.0 * size / far, "slack": scale.middle[j] + far * rng.uniform(-0.2, 0.8)},
        "cross_coupling": lambda: cross_couple(rng, rig, scale, j, signed),
        "sudden": lambda: {"at": rng.uniform(0.35, 0.65), **change_suddenly(rng, size, signed, speed)},
        "sensor_dead_band": lambda: {"sensor_dead": 0.8 * share * scale.input[i]},
        "quantised_torque": lambda: {"quantum": 3.0 * share * scale.input[i]},
    }  # fmt: skip
    return {name: float(f"{value:.6g}") for name, value in makers[hidden.kind]().items()}


def bound(values: np.ndarray, share: float) -> float:
    """A limit that so much of (T,) is beyond; for less than is ever drawn, a limit beyond which there is ever less."""
    least = DRIVE_KINDS["saturation"][0]
    return float(np.quantile(np.abs(values), 1.0 - max(share, least))) * max(least / share, 1.0)


def cross_couple(rng: np.random.Generator, rig: Rig, scale: Scale, joint: int, force: float) -> Values:
    """Force at this joint per drive force at another."""
    i = int(rng.choice([i for i, drive in enumerate(rig.drives) if drive.joint != joint]))
    return {"from": float(rig.drives[i].joint), "coupling": force / (scale.input[i] * rig.drives[i].gear)}


def change_suddenly(rng: np.random.Generator, size: float, signed: float, speed: float) -> Values:
    """A law that is there from some instant on."""
    laws = ({"coulomb": 1.5 * size}, {"viscous": 1.5 * size / speed}, {"bias": 1.5 * signed})
    return laws[rng.integers(len(laws))]


LAWS = {
    "loss": "fade",
    "force": "coulomb",
    "torque": "coulomb",
    "damping": "viscous",
    "rest": "rest",
    "inertia": "inertia",
}
"""Names of parameters → laws, where those differ."""
PLACED = {"cogging": ("ripple", "ripple_rate", "ripple_phase"), "tight_spot": ("spot", "spot_at", "spot_width")}
"""Kinds → laws."""
DRIVES = {"gain": "gain", "time_constant": "lag", "gap": "gap", "rate": "rate", "limit": "limit", "dead": "dead"}


def hide(world: World, hidden: Hidden, values: Values) -> World:
    """Put an effect into a world; what its sensors get wrong is not done here. Arrays are written in place."""
    j, change = hidden.joint, world.change
    if hidden.sensor:
        return world
    if hidden.kind in ("rate_bias", "rate_scale"):
        return world
    if hidden.kind in ("cogging", "tight_spot"):
        given = (
            (values["force"], 2.0 * np.pi * values["waves"], values["phase"])
            if hidden.kind == "cogging" else tuple(values.values())
        )  # fmt: skip
        for laws in (world.laws, world.later):
            for name, value in zip(PLACED[hidden.kind], given):
                laws[name][j] = value
        return world
    own = np.flatnonzero(world.drives["joint"] == j)
    if hidden.kind == "sudden":
        change = values["at"]
    for name, value in values.items():
        if hidden.kind in ("bias", "stiction") and name in ("force", "velocity"):
            name = {"force": hidden.kind, "velocity": "stribeck"}[name]
        name = LAWS.get(name, name)
        for laws in (world.later,) if hidden.kind == "sudden" else (world.laws, world.later):
            if name in (laws.dtype.names or ()):
                adds = name in ("coulomb", "viscous", "bias", "inertia", "stiction")
                laws[name][j] = value + (laws[name][j] if adds else 0.0)
        for drives in (world.drives, world.drives_later):
            if name in DRIVES:
                drives[DRIVES[name]][own] = value
            elif name == "delay":
                drives["delay"][own] = round(value / STEP)
    if hidden.kind == "cross_coupling":
        world.cross[j, int(values["from"])] = values["coupling"]
    return World(world.rig, world.laws, world.drives, world.cross, world.later, world.drives_later, change)
