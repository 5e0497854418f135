"""Recording a session: the rig is built, moved, measured, written down with the twin, and what is true of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from proving.logs import START_NS, Log, Stream, write_log

from .hidden import Hidden, Scale, Values, hide, size_effect
from .measure import Evidence, Visibility, measure_visibility
from .plant import build_drives, build_laws
from .rig import Rig
from .sensors import measure_inputs, measure_motion, push
from .tree import choose_dynamics
from .trial import Track, World, perform, plan_trial

if TYPE_CHECKING:
    from .session import Session

ORDINARY, STILL = 3.0, 0.04
"""Times its usual travel beyond which a rig has run away, share of its usual spread below which it stands still: nobody
keeps such a log."""
TRIES, LESS, GENTLER, STUBBORN = 9, 0.5, 0.8, 5
"""How often a session is tried until its rig moves as a rig should: what is hidden is made smaller, to what share of it
each time; where nothing is, or after so many tries, the rig is moved less far."""


@dataclass(frozen=True)
class Truth:
    """What is true of recorded logs.

    Attributes:
        hidden: effect → parameter → value; `outside:NAME` where the catalogue lacks it.
        small: likewise, deviations that nobody asks for: named or not, neither is wrong.
        true: like `hidden` of the catalogue's effects, against the MJCF: what the build's jitter adds included.
        joints: effect → the joint where it is, also of those outside the catalogue.
        by_sensor: effects that are errors of the logged torque.
        visibility: effect → how visible it is.
        unasked: what jitter and small effects make of free predictions, in sigma of what noise and disturbances make.
    """

    hidden: dict[str, Values]
    small: dict[str, Values]
    true: dict[str, Values]
    joints: dict[str, str]
    by_sensor: list[str]
    visibility: dict[str, Visibility]
    unasked: float

    @property
    def detectable(self) -> bool:
        """Whether the logs show all that is hidden."""
        return all(v.detectable for v in self.visibility.values())

    @property
    def separable(self) -> bool:
        """Whether they tell all of it from its look-alikes."""
        return all(v.separable for v in self.visibility.values())

    @property
    def alike(self) -> list[str]:
        """Look-alikes that these logs cannot tell from what is hidden."""
        return sorted({name for v in self.visibility.values() for name in v.alike} - set(self.hidden))

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"detectable": self.detectable, "separable": self.separable, "alike": self.alike}


@dataclass(frozen=True)
class Recorded:
    """Files of a session: its logs, its twin, and what is true."""

    logs: list[Path]
    twin: Path
    truth: Truth


def build_world(session: Session, rig: Rig, found: Sequence[tuple[Hidden, Values]]) -> World:
    """The rig that is really there, with effects in it."""
    n, laws, drives = len(rig.links), build_laws(rig), build_drives(rig)
    for j, link in enumerate(session.told.links):
        laws["known_viscous"][j], laws["known_dry"][j] = link.damping, link.dry
    world = World(rig, laws, drives, np.zeros((n, n)), laws.copy(), drives.copy())
    for hidden, values in found:
        if not (session.forgotten and hidden.kind == "viscous"):
            world = hide(world, hidden, values)
    return world


def find_scale(session: Session) -> Scale:
    """What is usual in the first log without anything hidden, on a coarse simulation; of the inputs, noise included."""
    rig, period = session.rig, 1.0 / session.rate
    trial = plan_trial(rig, session.motions[0], period)
    world = build_world(replace(session, forgotten=False), rig, [])
    track = perform(world, rig, trial, step=0.001)
    find, n = choose_dynamics(rig), len(rig.links)
    speed = np.diff(track.moved[:, 1], axis=0) / period
    rows = np.unique(np.linspace(0, len(speed) - 1, 400).astype(int))
    inertial, weight, carried = (np.empty((len(rows), n)) for _ in range(3))
    for i, k in enumerate(rows):
        M, h = find(track.moved[k, 0], np.zeros(n))
        inertial[i], weight[i], carried[i] = M @ speed[k], h, M.diagonal()
    drive = np.zeros((len(track.given), n))
    for i, d in enumerate(rig.drives):
        drive[:, d.joint] = d.gear * track.given[:, i]
    force = np.max([np.sqrt(np.mean(f**2, axis=0)) for f in (drive, inertial, weight)], axis=0)
    position, faster = track.moved[:, 0], np.sqrt(np.mean(track.moved[:, 1] ** 2, axis=0))
    clean = Scale(force, faster, position.std(0), np.median(position, 0), carried.mean(0), track.given, period)
    if not rig.drives:
        return clean
    noise, disturbing = draw_noise(session, clean, 0, len(trial.feed))
    return replace(clean, inputs=perform(world, rig, trial, noise, disturbing, step=0.001).given)


def draw_noise(session: Session, scale: Scale, log: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Noise of what a log's feedback sees, (T, 2, n), and the disturbing force, (T, n)."""
    rng = np.random.default_rng([session.seed, 4, session.number, log])
    shape = samples, len(scale.force)
    position = session.sensors.noise * scale.spread * rng.standard_normal(shape)
    velocity = 0.3 * session.sensors.velocity_noise * scale.speed * rng.standard_normal(shape)
    return np.stack([position, velocity], axis=1), push(rng, session.disturbance, scale.force, samples, scale.period)


def run_logs(
    session: Session, real: Rig, scale: Scale, found: Sequence[tuple[Hidden, Values]]
) -> list[tuple[Track, np.ndarray]]:
    """Simulate all logs: what happened, and the noise of the encoders (T, n)."""
    logs = []
    for i, motion in enumerate(session.motions):
        trial = plan_trial(session.rig, motion, scale.period)
        noise, disturbing = draw_noise(session, scale, i, len(trial.feed))
        track = perform(build_world(session, real, found), session.told, trial, noise, disturbing)
        logs.append((track, noise[:, 0]))
    return logs


def is_ordinary(track: Track, rig: Rig, scale: Scale) -> bool:
    """Whether a log is one that anybody would keep: the rig neither ran away nor stood still."""
    position = track.moved[:, 0]
    usual = np.array(rig.travel) + 3.0 * scale.spread
    if not np.isfinite(track.moved).all() or (np.abs(position - scale.middle) > ORDINARY * usual).any():
        return False
    return bool((position.std(0) > STILL * scale.spread).all())


def record(session: Session, folder: Path) -> Recorded:
    """Record a session; see `Session.record`."""
    folder.mkdir(parents=True, exist_ok=True)
    logs, truth, _ = simulate(session)
    (folder / "rig.xml").write_text(session.told.write_mjcf())
    (folder / "rig.yaml").write_text(session.told.write_twin("rig.xml"))
    names = [f"{i}_{motion.kind}.mcap" for i, motion in enumerate(session.motions)]
    return Recorded([write_log(log, folder / name) for log, name in zip(logs, names)], folder / "rig.yaml", truth)


def simulate(session: Session, held_out: int = 0) -> tuple[list[Log], Truth, Scale]:
    """The logs of a session, what is true of them, and what is usual there.

    How visible effects are is worked out from all logs but the last `held_out`.

    Raises:
        RuntimeError: where the rig does not move as it should, however it is tried.
    """
    scale = find_scale(session)
    real = session.rig.jitter(np.random.default_rng([session.seed, 5, session.number]))
    hidden = session.hidden
    for tried in range(TRIES):
        found = [(h, size(session, h, scale)) for h in hidden]
        small = [(h, size_effect(h, session.rig, scale)) for h in session.small]
        logs = run_logs(session, real, scale, [*found, *small])
        if all(is_ordinary(track, session.rig, scale) for track, _ in logs):
            break
        hidden = tuple(replace(h, share=LESS * h.share) for h in hidden)
        if not hidden or tried >= STUBBORN:
            gentler = tuple(replace(motion, reach=GENTLER * motion.reach) for motion in session.motions)
            session = replace(session, motions=gentler)
    else:
        raise RuntimeError(f"session {session.number} of seed {session.seed}: the rig does not move as it should")
    faults = find_faults(session, found)
    evidence = [Evidence(track, measure_inputs(track.given, faults)) for track, _ in logs]
    visible, unasked = measure_visibility(
        session.told, scale, evidence[: len(logs) - held_out], found, session.sensors, session.disturbance, real, small
    )
    truth = Truth(
        {h.effect: v for h, v in found},
        {h.effect: v for h, v in small},
        {h.effect: add_jitter(session.told, real, h, v, scale) for h, v in found if not h.outside},
        {h.effect: session.rig.joints[h.joint] for h, _ in found},
        [h.effect for h, _ in found if h.sensor],
        {h.effect: v for (h, _), v in zip(found, visible)},
        unasked,
    )
    measured, zero = [], np.zeros(len(session.rig.links))
    for hidden_one, values in found:
        if hidden_one.kind == "offset":
            zero[hidden_one.joint] += values["angle"]
    for i, ((track, noise), seen) in enumerate(zip(logs, evidence)):
        rng = np.random.default_rng([session.seed, 6, session.number, i])
        path = Path(f"{i}_{session.motions[i].kind}.mcap")
        measured.append(measure_log(session, path, scale, track, noise + zero, seen, rng, found))
    return measured, truth, scale


def size(session: Session, hidden: Hidden, scale: Scale) -> Values:
    """Sizes of a hidden effect."""
    if session.forgotten and hidden.kind == "viscous":
        return {"damping": session.rig.links[0].damping}
    return size_effect(hidden, session.rig, scale)


def find_faults(session: Session, found: Sequence[tuple[Hidden, Values]]) -> dict[int, Values]:
    """Drive → what its torque sensor gets wrong."""
    faults: dict[int, Values] = {}
    for hidden, values in found:
        for i, drive in enumerate(session.rig.drives):
            if drive.joint != hidden.joint:
                continue
            if hidden.sensor and hidden.kind == "gain":
                faults.setdefault(i, {})["gain"] = 1.0 / values["gain"]
            elif hidden.sensor:
                faults.setdefault(i, {})["offset"] = -values["force"] / drive.gear
            faults.setdefault(i, {}).update({k: v for k, v in values.items() if k in ("sensor_dead", "quantum")})
    return faults


def add_jitter(told: Rig, real: Rig, hidden: Hidden, values: Values, scale: Scale) -> Values:
    """Sizes against the MJCF's numbers, as an ideal fit would find them."""
    true, j = dict(values), hidden.joint
    if hidden.kind == "inertia":
        q, zero = scale.middle, np.zeros(len(told.links))
        true["inertia"] += float((choose_dynamics(real)(q, zero)[0] - choose_dynamics(told)(q, zero)[0])[j, j])
    if hidden.kind == "gain":
        i = next(i for i, drive in enumerate(told.drives) if drive.joint == j)
        true["gain"] *= real.drives[i].gear / told.drives[i].gear
    if hidden.kind == "viscous":
        known = real.links[j].damping - told.links[j].damping
        true["damping"] = known + (values["damping"] if told.links[j].damping or not known else 0.0)
    if hidden.kind == "coulomb":
        name = next(iter(values))
        true[name] += real.links[j].dry - told.links[j].dry
    return true


def measure_log(
    session: Session, path: Path, scale: Scale, track: Track, noise: np.ndarray, seen: Evidence,
    rng: np.random.Generator, found: Sequence[tuple[Hidden, Values]],
) -> Log:  # fmt: skip
    """A log as the rig's own software would have it, with what is hidden in its velocities."""
    sensors, rig = session.sensors, session.rig
    position, velocity = measure_motion(rng, sensors, track.moved, noise, scale.spread, scale.speed, scale.period)
    if velocity is not None:
        for hidden, values in found:
            velocity[:, hidden.joint] *= values.get("scale", 1.0) if hidden.kind == "rate_scale" else 1.0
            velocity[:, hidden.joint] += values.get("bias", 0.0) if hidden.kind == "rate_bias" else 0.0
    inputs = seen.inputs + sensors.torque * scale.input * rng.standard_normal(seen.inputs.shape)
    time = scale.period * np.arange(len(position))
    told = {"position": position} if velocity is None else {"position": position, "velocity": velocity}
    joints = {name: Stream(time, {c: v[:, j] for c, v in told.items()}) for j, name in enumerate(rig.joints)}
    topics = {"/joint_states": joints}
    if rig.drives:
        topics["/actuator_command"] = {
            drive.name: Stream(time, {"effort": inputs[:, i]}) for i, drive in enumerate(rig.drives)
        }
    return Log(path, START_NS, {}, topics)
