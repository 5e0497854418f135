"""Kinds of logs that people bring, drawn over sizes and seeds: one step, a decay, a sweep, a load, wrong zeros.

Every kind is one joint or a chain of two, integrated in steps of 0.1 ms without MuJoCo (proving/short_chains.py).
`write_kind` writes model, logs and twin as their owner would have them. The twin lacks what `truth` says, and what is
said to be small. No twin YAML can state the noise of its sensors, so that `noisy` and `quiet` draw the noise itself,
over two orders of magnitude.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from proving.mechanisms.families import pick, spread
from proving.short_chains import CHAIN, DRIVES, GRAVITY, Chain, Control, Encoder, Joint, Log, ride, swing

DRY = ("coulomb", "stiction", "tight_spot", "lugre")
"""Laws of dry friction: one kind."""


@dataclass(frozen=True)
class Kind:
    """A case on disk, and what is right of it.

    Attributes:
        model: MJCF.
        twin: twin YAML; None where names of columns tell all, and `--model` is enough.
        logs: CSV files.
        truth: "effect.parameter" → value, of all that is wrong with the twin.
        right: ids of effects that are of the kind of what is wrong.
        also: ids of what is there, but small, or says the same in part: neither right nor wrong.
        horizon_s: at which its owner feels the error [s].
        unit: of that error, `m` or `rad`.
    """

    model: Path
    twin: Path | None
    logs: list[Path]
    truth: dict[str, float]
    right: frozenset[str]
    also: frozenset[str]
    horizon_s: float
    unit: str

    @property
    def effects(self) -> frozenset[str]:
        """Ids of the effects that are there, of these laws."""
        return frozenset(name.rsplit(".", 1)[0] for name in self.truth)


@dataclass(frozen=True)
class Draft:
    """A kind before it is written; `truth`, `right`, `also`, `horizon_s`, `unit` as in `Kind`."""

    mjcf: str
    joints: Sequence[str]
    drives: Sequence[str]
    logs: Sequence[Log]
    truth: Mapping[str, float]
    right: Sequence[str]
    also: Sequence[str]
    horizon_s: float
    unit: str


def count_samples(duration: float, period: float) -> np.ndarray:
    """Times of the samples [s]."""
    return period * np.arange(round(duration / period))


def draw_encoder(rng: np.random.Generator, low: float, high: float) -> Encoder:
    """An encoder with steps between these, in half of the draws with noise of up to two steps."""
    step = spread(rng, low, high)
    return Encoder(step, spread(rng, 0.3, 2.0) * step if rng.random() < 0.5 else 0.0)


def draw_steps(rng: np.random.Generator, steps: int) -> Draft:
    """A cart under a proportional controller goes to `steps` places; its damping is missing from the twin."""
    mass, gear, ratio, settle = spread(rng, 0.3, 5.0), spread(rng, 1.0, 6.0), rng.uniform(0.3, 0.6), rng.uniform(1, 2)
    pace, reach = 4.0 / (ratio * settle), rng.uniform(0.1, 0.4)
    stiffness, damping = mass * pace**2, 2.0 * ratio * mass * pace
    twin = Joint(True, mass, gear=gear)
    dry, ripple = stiffness * reach * rng.uniform(0.006, 0.02), rng.uniform(0.02, 0.05)
    cart = replace(twin, viscous=damping, dry=dry, ripple=ripple, wave=rng.uniform(0.02, 0.05))
    time = count_samples(rng.uniform(6.0, 9.0) if steps == 1 else 2.0 * steps * settle, period := choose_period(rng))
    at = rng.uniform(0.5, 2.0) if steps == 1 else 0.5 * settle
    done = np.minimum(np.floor((time - at) / (2.0 * settle)), 0 if steps == 1 else steps - 1).astype(int)
    places = reach * np.append(np.resize([1.0, rng.uniform(-0.5, 0.2), -1.0], steps), 0.0)  # the last before the first
    control = Control(np.zeros((len(time), 1)), places[np.maximum(done, -1)][:, None], (stiffness / gear,))
    log = ride(rng, cart, control, period, draw_encoder(rng, 2e-5, 1e-4))
    also = [f"slide.{law}" for law in (*DRY, "cogging")]
    return Draft(twin.describe(True), ["slide"], ["motor"], [log], {"slide.viscous.damping": damping},
                 ["slide.viscous"], also, 0.5, "m")  # fmt: skip


def choose_period(rng: np.random.Generator) -> float:
    """Of log and controller [s]."""
    return float(rng.choice([0.001, 0.002, 0.005]))


def draw_step(rng: np.random.Generator) -> Draft:
    """One step response, most of the log at rest."""
    return draw_steps(rng, 1)


def draw_two_steps(rng: np.random.Generator) -> Draft:
    """Two or three steps, half of the time at rest."""
    return draw_steps(rng, int(rng.integers(2, 4)))


def draw_pendulum(rng: np.random.Generator) -> Joint:
    """A pendulum without friction."""
    mass, length = spread(rng, 0.1, 2.0), rng.uniform(0.15, 0.6)
    return Joint(False, mass * length**2 / 0.9, mass * GRAVITY * length)


def release(rng: np.random.Generator, hinge: Joint, encoder: Encoder, logs: int) -> list[Log]:
    """Logs of a pendulum that is let go."""
    time = count_samples(rng.uniform(8.0, 15.0), period := float(rng.choice([0.005, 0.01])))
    rest = np.zeros((len(time), 1))
    starts = (rng.uniform(0.8, 1.3), rng.uniform(0.3, 0.7))[:logs]
    found = [ride(rng, hinge, Control(rest, rest), period, encoder, start) for start in starts]
    return [replace(log, effort=log.effort[:, :0]) for log in found]


def draw_decay(rng: np.random.Generator, encoder: Encoder | None = None) -> Draft:
    """A pendulum let go once or twice, with dry and viscous friction, and no gusts."""
    twin = draw_pendulum(rng)
    dry = twin.weight * spread(rng, 0.0015, 0.006)
    damping = 2.0 * spread(rng, 0.001, 0.005) * np.sqrt(twin.weight * twin.inertia)
    hinge = replace(twin, viscous=float(damping), dry=dry)
    logs = release(rng, hinge, encoder or Encoder(spread(rng, 1e-4, 5e-4)), int(rng.integers(1, 3)))
    truth = {"hinge.coulomb.torque": dry, "hinge.viscous.damping": float(damping)}
    return Draft(twin.describe(False), ["hinge"], [], logs, truth,
                 [f"hinge.{law}" for law in (*DRY, "viscous")], [], 1.0, "rad")  # fmt: skip


def chirp(rng: np.random.Generator, rig: Joint, encoder: Encoder) -> Log:
    """The log of a chirp force on a cart or joint; a cart is pulled to its middle."""
    time, first = count_samples(rng.uniform(10.0, 20.0), period := choose_period(rng)), rng.uniform(0.25, 0.5)
    rate = 2.0 * np.pi * first
    force = find_force(rig, rate)
    growth = np.log(rng.uniform(3.0, 6.0)) / time[-1]
    feed = force / rig.gear * np.cos(rate * np.expm1(growth * time) / growth)[:, None]
    centre = rig.inertia * (0.5 * rate) ** 2 / rig.gear if rig.slide else 0.0
    return ride(rng, rig, Control(feed, 0.0 * feed, (centre,)), period, encoder)


def find_force(rig: Joint, rate: float) -> float:
    """Of a chirp that begins at `rate` [rad/s]: a cart moves by 0.15 m, a pendulum's weight is lifted by a quarter."""
    return 0.15 * rig.inertia * rate**2 if rig.slide else 0.25 * rig.weight


def draw_swept(rng: np.random.Generator) -> Joint:
    """A cart or a pendulum with a drive, as its twin knows it: damped by 3 to 10 %."""
    slide = bool(rng.random() < 0.5)
    rig = Joint(True, spread(rng, 0.3, 10.0)) if slide else draw_pendulum(rng)
    pace = 2.0 if slide else np.sqrt(rig.weight / rig.inertia)
    damping = 2.0 * rng.uniform(0.03, 0.1) * rig.inertia * float(pace)
    return replace(rig, gear=spread(rng, 1.0, 6.0), viscous=damping)


def draw_sweep(rng: np.random.Generator, encoder: Encoder | None = None) -> Draft:
    """A chirp force; viscous or dry friction is missing, or the gain of the drive is wrong."""
    twin, what = draw_swept(rng), pick(rng, ("viscous", "dry", "gain"))
    name, force = twin.name, find_force(twin, 2.0)
    if what == "viscous":
        size = twin.viscous * spread(rng, 2.0, 5.0)
        rig, truth, right = replace(twin, viscous=twin.viscous + size), {f"{name}.viscous.damping": size}, ["viscous"]
    elif what == "dry":
        size = force * spread(rng, 0.05, 0.25)
        rig, law = replace(twin, dry=size), f"{name}.coulomb.{'force' if twin.slide else 'torque'}"
        truth, right = {law: size}, list(DRY)
    else:
        size = spread(rng, 0.7, 0.9) if rng.random() < 0.5 else spread(rng, 1.1, 1.4)
        rig, truth, right = replace(twin, gear=size * twin.gear), {"motor.gain.gain": size}, []
    # the mass of a rig of one slide is its drive's gain: nearly the same motion
    named = [f"{name}.{law}" for law in right] or ["motor.gain", *["slide.inertia"] * twin.slide]
    log = chirp(rng, rig, encoder or draw_encoder(rng, 2e-5, 4e-4))
    return Draft(twin.describe(True), [name], ["motor"], [log], truth, named, [], 1.0, "m" if twin.slide else "rad")


def draw_either(rng: np.random.Generator, low: float, high: float) -> Draft:
    """A decay or a sweep whose encoder's noise lies between these [m, rad]."""
    encoder = Encoder(1e-6, spread(rng, low, high))
    return (draw_decay if rng.random() < 0.5 else draw_sweep)(rng, encoder)


def draw_noisy(rng: np.random.Generator) -> Draft:
    """White noise of 0.5 to 5 mrad or mm."""
    return draw_either(rng, 5e-4, 5e-3)


def draw_quiet(rng: np.random.Generator) -> Draft:
    """White noise of 0.05 to 0.5 mrad or mm."""
    return draw_either(rng, 5e-5, 5e-4)


def draw_relay(rng: np.random.Generator) -> Draft:
    """A cart that a relay drives to and fro; only its damping is missing."""
    mass, gear, settle, push = spread(rng, 0.3, 5.0), spread(rng, 1.0, 6.0), rng.uniform(0.3, 0.8), rng.uniform(2, 5)
    twin = Joint(True, mass, gear=gear)
    time = count_samples(rng.uniform(8.0, 16.0), period := choose_period(rng))
    rest = np.zeros((len(time), 1))
    control = Control(rest, rest, relay=mass * push / gear, band=rng.uniform(0.01, 0.03))
    log = ride(rng, replace(twin, viscous=mass / settle), control, period, draw_encoder(rng, 2e-5, 1e-4))
    return Draft(twin.describe(True), ["slide"], ["motor"], [log], {"slide.viscous.damping": mass / settle},
                 ["slide.viscous"], [], 1.0, "m")  # fmt: skip


def draw_waves(rng: np.random.Generator, time: np.ndarray, slow: float, fast: float) -> np.ndarray:
    """Three sines for each of two joints, rates between these [rad/s], within ±1, zero at first, (n, 2)."""
    waves = np.zeros((len(time), 2))
    for j in range(2):
        for share in (0.5, 0.3, 0.2):
            waves[:, j] += share * np.sin(spread(rng, slow, fast) * time) * rng.choice([-1.0, 1.0])
    return waves


def draw_links(rng: np.random.Generator) -> Chain:
    """A double pendulum with a little damping."""
    length, masses = rng.uniform(0.2, 0.4), (spread(rng, 0.3, 1.5), spread(rng, 0.3, 1.0))
    centre = (length * rng.uniform(0.5, 0.9), rng.uniform(0.12, 0.3))
    spin = tuple(m * c**2 * rng.uniform(0.05, 0.3) for m, c in zip(masses, centre))
    pace = np.sqrt(GRAVITY / length)
    viscous = tuple(float(0.1 * m * c**2 * pace) for m, c in zip(masses, centre))
    return Chain(masses, centre, (spin[0], spin[1]), length, viscous=(viscous[0], viscous[1]))


def draw_two_zeros(rng: np.random.Generator) -> Draft:
    """A double pendulum with logged torques; both encoders' zeros are off, in a third of the draws only one."""
    chain = draw_links(rng)
    time = count_samples(rng.uniform(8.0, 14.0), period := float(rng.choice([0.002, 0.005])))
    most = np.array(chain.numbers[3:]) * rng.uniform(0.15, 0.3)
    feed = most * draw_waves(rng, time, 2.0, 12.0)
    zeros = rng.uniform(0.03, 0.12, 2) * rng.choice([-1.0, 1.0], 2)
    if rng.random() < 1.0 / 3.0:
        zeros[rng.integers(2)] = 0.0
    log = swing(rng, chain, Control(feed, 0.0 * feed), period, draw_encoder(rng, 1e-4, 1e-3), rng.uniform(-0.3, 0.3, 2))
    truth = {f"{name}.offset.angle": float(zero) for name, zero in zip(CHAIN, zeros) if zero}
    right = [name.removesuffix(".angle") for name in truth]
    return Draft(chain.describe(None, ("upper", "lower")), CHAIN, DRIVES, [replace(log, position=log.position + zeros)],
                 truth, right, [], 1.0, "rad")  # fmt: skip


def draw_arm(rng: np.random.Generator) -> Chain:
    """Two links of an arm with geared drives."""
    length, masses = rng.uniform(0.25, 0.45), (rng.uniform(1.5, 4.0), rng.uniform(0.6, 2.0))
    centre = (0.5 * length, rng.uniform(0.1, 0.2))
    spin = (masses[0] * length**2 / 12.0, masses[1] * centre[1] ** 2 / 3.0)
    return Chain(masses, centre, spin, length, (0.05, 0.02), (rng.uniform(0.3, 1.0), rng.uniform(0.1, 0.4)))


def hold_arm(rng: np.random.Generator, chain: Chain, servo: bool) -> tuple[Log, Control]:
    """The log of an arm that follows sines under a stiff controller, gravity and all."""
    time = count_samples(rng.uniform(10.0, 16.0), period := float(rng.choice([0.002, 0.004, 0.008])))
    base, about, couple, *_ = chain.numbers
    inertia, rate = np.array([base + about + couple + chain.rotor[0], about + chain.rotor[1]]), np.array([12.0, 20.0])
    middle = np.array([rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5), rng.uniform(-0.8, 0.8)])
    goal = middle + np.array([0.5, 0.7]) * draw_waves(rng, time, 0.8, 6.0)
    stiff, damp = inertia * rate**2, 1.4 * inertia * rate
    control = Control(0.0 * goal, goal, tuple(map(float, stiff)), tuple(map(float, damp)), servo=servo)
    log = swing(rng, chain, control, period, draw_encoder(rng, 2e-5, 4e-4), middle)
    return log, control


def draw_current(rng: np.random.Generator) -> Draft:
    """An arm whose column of efforts is current: torque is 5 to 15 times that, of either joint otherwise."""
    chain, factors = draw_arm(rng), rng.uniform(5.0, 15.0, 2)
    log, _ = hold_arm(rng, chain, False)
    gains = [f"{name}.gain" for name in DRIVES]
    truth = {f"{name}.gain": float(factor) for name, factor in zip(gains, factors)}
    return Draft(chain.describe(None, ("upper", "lower")), CHAIN, DRIVES, [replace(log, effort=log.effort / factors)],
                 truth, [*gains, "actuators.gain"], [], 0.25, "rad")  # fmt: skip


def draw_load(rng: np.random.Generator) -> Draft:
    """An arm under torques or position servos, with a load of ten times its flange's mass."""
    arm, flange = draw_arm(rng), rng.uniform(0.15, 0.35)
    twin = replace(arm, mass=(arm.mass[0], flange), centre=(arm.centre[0], 0.05), spin=(arm.spin[0], 2e-4 * flange))
    loaded = replace(twin, load=flange * rng.uniform(8.0, 12.0), place=rng.uniform(0.08, 0.15))
    servo = bool(rng.random() < 0.5)
    log, control = hold_arm(rng, loaded, servo)
    truth = {"flange.payload.mass": loaded.load, "flange.payload.place_z": -loaded.place}
    gains = (control.stiffness, control.damping) if servo else None
    return Draft(twin.describe(gains, ("upper", "flange")), CHAIN, DRIVES, [log], truth,
                 [f"flange.{law}" for law in ("payload", "mass", "com")], ["elbow.inertia"], 0.25, "rad")  # fmt: skip


def draw_wrist(rng: np.random.Generator) -> Draft:
    """One joint under logged torque that follows sines and stops; dry friction is missing."""
    twin = Joint(False, spread(rng, 0.008, 0.05), spread(rng, 0.2, 1.0), viscous=rng.uniform(0.01, 0.04))
    time = count_samples(rng.uniform(8.0, 15.0), period := float(rng.choice([0.002, 0.004, 0.008])))
    dry, pace = spread(rng, 0.08, 0.4), 25.0
    moving = 3.0 * np.floor(time / 4.0) + np.minimum(time % 4.0, 3.0)  # one second of four it stands still
    goal = 0.9 * draw_waves(rng, moving, 1.5, 6.0)[:, :1]
    control = Control(0.0 * goal, goal, (twin.inertia * pace**2,), (1.2 * twin.inertia * pace,))
    log = ride(rng, replace(twin, dry=dry), control, period, draw_encoder(rng, 2e-5, 4e-4))
    return Draft(twin.describe(True), ["hinge"], ["motor"], [log], {"hinge.coulomb.torque": dry},
                 [f"hinge.{law}" for law in DRY], [], 0.25, "rad")  # fmt: skip


def draw_nothing(rng: np.random.Generator) -> Draft:
    """A sweep or a decay of which the twin knows all but noise and a rail that is uneven by 1 %."""
    wave = rng.uniform(0.02, 0.05)
    if rng.random() < 0.5:
        twin = draw_swept(rng)
        log = chirp(rng, replace(twin, ripple=0.01, wave=wave), draw_encoder(rng, 2e-5, 4e-4))
        return Draft(twin.describe(True), [twin.name], ["motor"], [log], {}, [], [], 1.0, "m" if twin.slide else "rad")
    bare = draw_pendulum(rng)
    damping = 2.0 * spread(rng, 0.001, 0.005) * float(np.sqrt(bare.weight * bare.inertia))
    twin = replace(bare, dry=bare.weight * spread(rng, 0.0015, 0.006), viscous=damping)
    logs = release(rng, replace(twin, ripple=0.01, wave=wave), draw_encoder(rng, 1e-4, 5e-4), int(rng.integers(1, 3)))
    return Draft(twin.describe(False), ["hinge"], [], logs, {}, [], [], 1.0, "rad")


KINDS: dict[str, Callable[[np.random.Generator], Draft]] = {
    "step": draw_step, "two_steps": draw_two_steps, "decay": draw_decay, "sweep": draw_sweep, "noisy": draw_noisy,
    "quiet": draw_quiet, "relay": draw_relay, "two_zeros": draw_two_zeros, "current": draw_current, "load": draw_load,
    "wrist": draw_wrist, "nothing": draw_nothing,
}  # fmt: skip


def draw_kind(kind: str, seed: int) -> Draft:
    """The case of a seed, in memory."""
    return KINDS[kind](np.random.default_rng([seed, zlib.crc32(kind.encode())]))


def write_kind(kind: str, seed: int, folder: Path) -> Kind:
    """Write the case of a seed into a folder: rig.xml, CSV files and, unless names of columns tell all, twin.yaml."""
    draft, rng = draw_kind(kind, seed), np.random.default_rng([seed, zlib.crc32(kind.encode()), 1])
    folder.mkdir(parents=True, exist_ok=True)
    model, twin = folder / "rig.xml", folder / "twin.yaml"
    model.write_text(draft.mjcf)
    bare = not draft.drives and rng.random() < 0.5
    degrees, fast = draft.unit == "rad" and not bare and rng.random() < 0.3, not bare and rng.random() < 0.3
    clock, mark = pick(rng, ("time", "t", "timestamp")), pick(rng, (",", ";", "\t"))
    before, behind = ("", "") if bare else (pick(rng, ("", "enc_", "q_")), pick(rng, ("", "_cmd")))
    scale, unit = (np.degrees(1.0), ", unit: deg") if degrees else (1.0, "")
    names = [clock, *(before + name for name in draft.joints), *(f"v_{name}" for name in draft.joints if fast),
             *(name + behind for name in draft.drives)]  # fmt: skip
    logs = [folder / f"run_{i + 1}.csv" for i in range(len(draft.logs))]
    for path, log in zip(logs, draft.logs):
        time = log.period * np.arange(len(log.position))
        speeds = log.velocity[:, : len(draft.joints) * fast]
        table = np.column_stack((time, scale * log.position, scale * speeds, log.effort))
        np.savetxt(path, table, delimiter=mark, header=mark.join(names), comments="", fmt="%.9g")
    rates = {name: f", velocity: {{path: v_{name}{unit + '/s' * bool(unit)}}}" if fast else "" for name in draft.joints}
    joints = [
        f"    {name}: {{topic: run_1, position: {{path: {before}{name}{unit}}}{rates[name]}}}" for name in draft.joints
    ]
    drives = [f"    {name}: {{topic: run_1, effort: {name}{behind}}}" for name in draft.drives]
    lines = ["model: rig.xml", "signals:", "  joints:", *joints, *["  actuators:"] * bool(drives), *drives, ""]
    if not bare:
        twin.write_text("\n".join(lines))
    return Kind(model, None if bare else twin, logs, dict(draft.truth), frozenset(draft.right), frozenset(draft.also),
                draft.horizon_s, draft.unit)  # fmt: skip
