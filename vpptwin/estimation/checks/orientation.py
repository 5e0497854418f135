"""In which order, sense and frame attitudes and rates were logged, told by each other, by thrust or by gravity.

What the twin reads otherwise than it was logged is refused, with the line that mends it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product as every
from typing import Any

import mujoco
import numpy as np
import yaml

from vpptwin.estimation.series import Measurements, Sampled, integrate, interpolate
from vpptwin.logs.channels import EULER
from vpptwin.logs.check import MIN_TURN
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.streams.samples import euler_to_quaternion
from vpptwin.system.doubt import object_to
from vpptwin.system.errors import InputError
from vpptwin.system.fields import FRAMES, FieldEntry, SignalEntry, dump_entry
from vpptwin.twin.robot.manifold import conjugate, difference_attitudes, follow_sign, read_angles, turn_to_world
from vpptwin.twin.robot.signals import Tracked, find_base
from vpptwin.twin.spec import TwinSpec

ABOUT = {"body": "the body's axes", "world": "the world's axes", "euler": "roll, pitch and yaw"}

MAX_STEP, STEPS, MIN_STEPS = 0.25, 60, 20
"""Turns are compared over steps of this length [s], or of so much of the log; with fewer steps nothing is told."""
LAGS = np.linspace(-0.2, 0.2, 21)
"""By how much attitudes may be later than rates [s]."""
FITS, CLEAR = 0.2, 2.0
"""Residual share below which a convention fits; the given one is worse if it has so many times as much."""
SLIGHT = {"turns": 0.01, "pushes": 0.005}
"""Residual shares of either that are too slight for the given convention to be wrong."""
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
NEAR = np.deg2rad(30.0)
"""Axes that are turned by less are taken for the same."""
BEND = 0.1
"""Accelerations are differences of positions so long before and after an instant [s]."""
MIN_BORNE = 0.3
"""Share of a body's weight from which on the push of its actuators tells where it points."""
MIN_SAMPLES = 50
"""Sampled below which no actuator's push is looked at."""


@dataclass(frozen=True)
class Convention:
    """A way to read the numbers of an attitude or of rates: in another order, with other signs, about other axes.

    Attributes:
        of: attitude, rate or frame: what is read otherwise.
        order: which of the numbers given come first, second, ..., all of them.
        signs: factors on them, in their new order.
        frame: what rates are about, of `FRAMES`.
        residual, given: share of the turns or directions that it leaves unexplained, and that the numbers as given do.
        turned: by how much axes are turned even so [rad].
    """

    of: str
    order: tuple[int, ...] = ()
    signs: tuple[float, ...] = ()
    frame: str = "body"
    residual: float = 1.0
    given: float = 1.0
    turned: float = 0.0

    def read(self, numbers: np.ndarray) -> np.ndarray:
        """Numbers (n, k) as given, read so."""
        return np.asarray(numbers[:, self.order] * self.signs)

    def read_attitude(self, attitude: np.ndarray) -> np.ndarray:
        """Attitudes w, x, y, z, (n, 4), as given, read so."""
        if len(self.order) == attitude.shape[1]:
            return self.read(attitude)
        return euler_to_quaternion(self.read(read_angles(attitude)))


QUATERNIONS = tuple(
    Convention("attitude", tuple(int(i) for i in np.roll(range(4), shift)), (1.0, sense, sense, sense))
    for shift, sense in every((1, 0, 3, 2), (1.0, -1.0))
    if (shift, sense) != (0, 1.0)
)
"""Orders other than w, x, y, z that are cyclic, and the vector part with the other sign."""
ANGLES = tuple(Convention("attitude", (0, 1, 2), signs) for signs in every((1.0, -1.0), repeat=3) if min(signs) < 0.0)
"""Roll, pitch and yaw, of which some have the other sign."""
MIRRORS = (
    *(each for each in (replace(angles, of="rate") for angles in ANGLES) if np.prod(each.signs) < 0.0),
    *(Convention("rate", order, (1.0, 1.0, 1.0)) for order in ((1, 0, 2), (2, 1, 0), (0, 2, 1))),
)
"""Rates of which one or all have the other sign, or two are swapped: none that an IMU's mount could be."""


def find_convention(
    pose: Sampled, rates: Sampled, frame: str = "body", angled: bool = False, base: np.ndarray = UPRIGHT
) -> Convention | None:
    """How attitudes or rates must be read to turn alike, whichever way an IMU is mounted; None where they do as given.

    Or where none of the conventions is clearly better than the given one.

    Args:
        pose: times (n,) s of attitudes w, x, y, z (n, 4) as given.
        rates: times (m,) s of rates (m, 3) about what `frame` says, in any unit.
        frame: of `FRAMES`.
        angled: whether attitudes came as roll, pitch and yaw.
        base: attitude in the world, (4,), of what they are from.
    """
    (time, attitude), (clock, rate) = pose, rates
    begin, end = max(time[0], clock[0]) - LAGS[0], min(time[-1], clock[-1]) - LAGS[-1]
    step = max(min(MAX_STEP, (end - begin) / STEPS), 2.0 * float(np.median(np.diff(time))))
    at = np.arange(begin, end, step)
    tracks = sum_turns(attitude, base)
    if len(at) <= MIN_STEPS or np.ptp(tracks["body"], axis=0).max() < MIN_TURN:
        return None
    turned = np.diff(interpolate(at, clock, integrate(rate, clock)), axis=0)

    def fit(track: np.ndarray, fixed: bool, rates: np.ndarray = turned) -> tuple[float, float]:
        """Residual share of the rates and by how much axes are turned, at the lag at which they are alike."""
        return min(fit_turn(np.diff(interpolate(at - lag, time, track), axis=0), rates, fixed) for lag in LAGS)

    given = fit(tracks[frame], frame == "euler")[0]
    if given < SLIGHT["turns"]:
        return None
    others: list[tuple[Convention, tuple[Any, ...]]]
    others = [(Convention("frame", frame=name), (tracks[name], name == "euler")) for name in FRAMES if name != frame]
    if frame != "euler":
        read = [(each, each.read_attitude(attitude)) for each in (ANGLES if angled else QUATERNIONS)]
        others += [(each, (sum_turns(numbers, base)[frame], False)) for each, numbers in read]
        others += [(each, (tracks[frame], False, each.read(turned))) for each in MIRRORS]
    fitted = []
    for other, compared in others:
        residual, angle = fit(*compared)
        if angle < NEAR or other.of == "attitude" or other.frame == "body" != frame:  # an IMU may be mounted so
            fitted.append(replace(other, residual=residual, given=given, turned=angle))
    return choose(fitted)


def choose(fitted: Sequence[Convention]) -> Convention | None:
    """The one that is clearly better than what was given; of those that are alike the one that turns axes least."""
    best = min(fitted, key=lambda each: each.residual, default=None)
    if best is None or best.residual > FITS or best.given < CLEAR * best.residual:
        return None
    good = [each for each in fitted if each.residual <= CLEAR * best.residual]
    good = [each for each in good if each.turned < NEAR] or good
    # About one axis a gyro of which all signs are turned is an attitude that is: that is the commoner of the two.
    good = [each for each in good if each.of != "rate"] or good
    kind = min(good, key=lambda each: each.residual).of
    return min((each for each in good if each.of == kind), key=lambda each: (each.turned, each.residual))


def compare_push(
    pose: tuple[np.ndarray, np.ndarray, np.ndarray], push: Sampled, gravity: np.ndarray, angled: bool = False
) -> Convention | None:
    """How attitudes must be read for a body to go where it is pushed; None where they do as given, or none is better.

    Args:
        pose: times (n,) s, positions (n, 3) m and attitudes w, x, y, z (n, 4) as given.
        push: times (m,) s and force or specific force without weight in the body's axes, (m, 3) in any unit.
        gravity: in the world's axes (3,) m/s².
        angled: whether attitudes came as roll, pitch and yaw.
    """
    (time, place, attitude), (clock, force) = pose, push
    at = np.arange(max(time[0], clock[0]) + BEND, min(time[-1], clock[-1]) - BEND, BEND)
    if len(at) <= MIN_STEPS or not gravity.any():
        return None
    before, place, after = (interpolate(at + late, time, place) for late in (-BEND, 0.0, BEND))
    acceleration = (before - 2.0 * place + after) / BEND**2  # second difference
    attitude = interpolate(at, time, follow_sign(attitude))
    pushed = np.mean([interpolate(at + late, clock, force) for late in (-0.5 * BEND, 0.0, 0.5 * BEND)], axis=0)
    size = np.linalg.norm(pushed, axis=1)
    clear = size > 0.3 * np.median(size)
    pushed = pushed[clear] / np.maximum(size[clear, None], 1e-300)
    if len(pushed) <= MIN_STEPS:
        return None

    def fit(read: np.ndarray, weight: np.ndarray, fixed: bool) -> float:
        """Residual share of the pushes' directions; specific force in the body's axes is Rᵀ(a - g)."""
        seen = turn_to_world(conjugate(read), acceleration - weight)[clear]
        return fit_turn(seen / np.linalg.norm(seen, axis=1, keepdims=True), pushed, fixed, False)[0]

    given = min(fit(attitude, gravity, fixed) for fixed in (True, False))
    if np.median(place @ gravity) > 0.0:  # heights below zero, as where z points down: then it is that which is wrong
        given = min(given, fit(attitude, -gravity, False))
    if given < SLIGHT["pushes"]:
        return None
    others = ANGLES if angled else QUATERNIONS
    return choose(
        [replace(each, residual=fit(each.read_attitude(attitude), gravity, True), given=given) for each in others]
    )


def sum_turns(attitude: np.ndarray, base: np.ndarray = UPRIGHT) -> dict[str, np.ndarray]:
    """What attitudes (n, 4) from a `base` have turned by since the first, about what rates may be, (n, 3) rad each."""
    attitude = follow_sign(attitude)
    steps = difference_attitudes(attitude[:-1], attitude[1:])
    summed = (
        np.concatenate([np.zeros((1, 3)), np.cumsum(way, axis=0)])
        for way in (steps, turn_to_world(base, turn_to_world(attitude[:-1], steps)))
    )
    return dict(zip(FRAMES, (*summed, np.unwrap(read_angles(attitude), axis=0)), strict=True))


def turn_rates_to_body(attitude: np.ndarray, rate: np.ndarray, frame: str) -> np.ndarray:
    """Rates (n, 3) about the axes of `frame`, about those of the body, which has attitudes (n, 4)."""
    if frame == "world":
        return turn_to_world(conjugate(attitude), rate)
    if frame == "euler":
        # p = φ' - ψ' sin θ, q = θ' cos φ + ψ' cos θ sin φ, r = ψ' cos θ cos φ - θ' sin φ (Diebel 2006, 5.6)
        (roll, pitch, _), (rolled, pitched, yawed) = read_angles(attitude).T, rate.T
        level = yawed * np.cos(pitch)
        return np.column_stack([
            rolled - yawed * np.sin(pitch), pitched * np.cos(roll) + level * np.sin(roll),
            level * np.cos(roll) - pitched * np.sin(roll),
        ])  # fmt: skip
    return rate


def fit_turn(inputs: np.ndarray, target: np.ndarray, fixed: bool, centred: bool = True) -> tuple[float, float]:
    """Share of `target` (n, 3) that `inputs`, turned and scaled as they fit best, leave over; the turn's angle [rad].

    The rotation is that of Kabsch's algorithm (Acta Cryst. A32, 1976): R = U diag(1, 1, det UV) V of targetᵀ inputs.

    Args:
        inputs: what explains, (n, 3).
        target: what is explained, (n, 3).
        fixed: whether axes are those given, not turned.
        centred: whether what is constant is left out of it, such as a bias.
    """
    if centred:
        inputs, target = inputs - inputs.mean(axis=0), target - target.mean(axis=0)
    product = target.T @ inputs
    u, sizes, v = np.linalg.svd(product)
    handed = np.array([1.0, 1.0, -1.0 if np.linalg.det(u @ v) < 0.0 else 1.0])  # no turn is a reflection
    turn, sizes = (u * handed) @ v, sizes * handed
    alike = np.trace(product) if fixed else sizes.sum()
    alike = alike / max(float(np.linalg.norm(inputs) * np.linalg.norm(target)), 1e-300)  # correlation of the two
    angle = 0.0 if fixed else np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))  # tr R = 1 + 2 cos φ
    return float(1.0 - alike * abs(alike)), float(angle)


@dataclass(frozen=True)
class RateSource:
    """Where rates of a body come from.

    Attributes:
        name: of the body, or of the site of an IMU on it.
        entry: what the twin's signals say of it; None where they name no more than a topic.
        stream: its `rate` (n, 3) as logged.
        imu: whether it is an IMU.
    """

    name: str
    entry: SignalEntry | None
    stream: Stream
    imu: bool

    @property
    def frame(self) -> str:
        """What its rates are about, of `FRAMES`."""
        return "body" if self.entry is None or self.entry.rate is None else self.entry.rate.frame


def find_rate_source(spec: TwinSpec, flight: Flight, tracked: Tracked, pose: Stream) -> RateSource | None:
    """The first IMU on a body, or the rates beside its pose; None where neither is logged."""
    for site, topic in spec.robot.signals.sites.items():
        if spec.model.site(site).bodyid[0] == spec.model.jnt_bodyid[tracked.joint]:
            return RateSource(site, find_entry(spec, topic, site), find_spatial(flight, topic, "rate"), True)
    if "rate" not in pose.values:
        return None
    return RateSource(tracked.name, find_entry(spec, tracked.topic, tracked.name), pose, False)


def find_spatial(flight: Flight, topic: str, *columns: str) -> Stream:
    """The poses, or the IMU, on a topic.

    Raises:
        InputError: if there is none, or it lacks a column.
    """
    stream = flight.spatial.get(topic)
    if stream is None:
        known = ", ".join(flight.spatial) or "no topic of poses, odometry or an IMU at all"
        raise InputError(f"{flight.path}: no topic {topic}", f"it in the log, which has {known}", "correct `signals`")
    for column in columns:
        if column not in stream.values:
            had = ", ".join(stream.values)
            raise InputError(f"{flight.path}: {topic} has {had}", f"{' and '.join(columns)}", "name another topic")
    return stream


def find_entry(spec: TwinSpec, topic: str, name: str) -> SignalEntry | None:
    """What a twin says of a body or an IMU out of fields; None where it names no more than a topic."""
    return spec.robot.signals.entries.get(topic, {}).get(name)


def is_angled(entry: SignalEntry | None) -> bool:
    """Whether its attitude is logged as roll, pitch and yaw."""
    return entry is not None and entry.attitude is not None and len(entry.attitude.path) == len(EULER)


def vet_turns(spec: TwinSpec, label: str, tracked: Tracked, pose: Stream, source: RateSource, rate: np.ndarray) -> None:
    """Refuse attitudes in another order or sense than rates turn, rates about other axes, and those of a mirrored gyro.

    Args:
        spec: the twin.
        label: of the log.
        tracked: the body.
        pose: its `attitude` as logged.
        source: of its rates.
        rate: about what the source says (n, 3), in the body's axes where that is `body`.

    Raises:
        InputError: with the line that mends it, if another convention is clearly better.
    """
    body, frame, time = find_entry(spec, tracked.topic, tracked.name), source.frame, source.stream.time
    base = find_base(spec.model, tracked)
    better = find_convention((pose.time, pose["attitude"]), (time, rate), frame, is_angled(body), base)
    if better is None:
        return
    shares = f"{1.0 - better.residual:.0%} of the turning, {1.0 - better.given:.0%} as given"
    if better.of == "attitude":
        object_to(refuse_attitude(label, tracked, body, better, f"turn as its rates do ({shares})"))
        return
    where, given = f"{label}: rates of {tracked.name}", source.entry.rate if source.entry is not None else None
    axes = [f"{'twist.twist.angular' if source.name == tracked.name else 'angular_velocity'}.{axis}" for axis in "xyz"]
    if better.of == "frame":
        line = compose_line("rate", given, axes, frame=better.frame)
        object_to(InputError(
            f"{where} turn as its attitudes do only if they are about {ABOUT[better.frame]} ({shares})",
            f"rates about {ABOUT[frame]}", f"write `{line}` for {source.name} in the twin's signals",
        ))  # fmt: skip
        return
    line = compose_line("rate", given, axes, better)
    plain = rate is source.stream["rate"]  # axes are those that were logged, not turned as a site is
    object_to(InputError(
        f"{where} are mirrored: they turn as its attitudes do only with an axis turned round, or two swapped "
        f"({shares})",
        "x, y, z of right-handed axes",
        f"write `{line}` for {source.name} in the twin's signals" if plain else "correct signs and order of its axes",
    ))  # fmt: skip


def vet_pushes(spec: TwinSpec, flight: Flight, tracked: Tracked, measured: Measurements) -> None:
    """Refuse attitudes in which a free body does not go where its actuators push it, or where its accelerometer says.

    Raises:
        InputError: with the line that mends it, if another convention is clearly better and rates do not contradict.
    """
    dof = int(spec.model.jnt_dofadr[tracked.joint])
    pushes = {"push of its actuators": find_thrust(spec, tracked, measured), "accelerometer": None}
    for site, topic in spec.robot.signals.sites.items():
        imu = flight.spatial.get(topic)
        here = spec.model.site(site).bodyid[0] == spec.model.jnt_bodyid[tracked.joint]
        if here and imu is not None and "acceleration" in imu.values:
            pushes["accelerometer"] = imu.time, turn_from_site(spec, site, imu["acceleration"])
            break
    if dof + 3 not in measured.attitudes or dof not in measured.positions:
        return
    pose, body = measured.attitudes[dof + 3], find_entry(spec, tracked.topic, tracked.name)
    place = np.stack([measured.positions[dof + axis].value for axis in range(3)], axis=1)
    place = interpolate(pose.time, measured.positions[dof].time, place)
    rates = [measured.velocities[dof + 3 + axis] for axis in range(3) if dof + 3 + axis in measured.velocities]
    for what, push in pushes.items():
        if push is None:
            continue
        better = compare_push((pose.time, place, pose.value), push, spec.model.opt.gravity, is_angled(body))
        if better is None:
            continue
        if len(rates) == 3:
            rate = np.stack([each.value for each in rates], axis=1)
            if find_convention((pose.time, better.read_attitude(pose.value)), (rates[0].time, rate)):
                continue
        shares = f"{1.0 - better.residual:.1%} of its directions, {1.0 - better.given:.1%} as given"
        object_to(refuse_attitude(str(flight.path), tracked, body, better, f"fit the {what} ({shares})"))


def find_thrust(spec: TwinSpec, tracked: Tracked, measured: Measurements) -> Sampled | None:
    """What actuators push a free body by in its own axes, (n, 3) N; None where that does not bear it."""
    model, command = spec.model, measured.command
    address, dof = int(model.jnt_qposadr[tracked.joint]), int(model.jnt_dofadr[tracked.joint])
    time = np.arange(measured.start, measured.end, 0.5 * BEND)
    if not spec.robot.signals.actuators or len(time) < MIN_SAMPLES:
        return None
    data, force = mujoco.MjData(model), np.zeros((len(time), 3))
    data.qpos[address + 3 : address + 7] = UPRIGHT
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    for row, inputs in zip(force, interpolate(time, command.time, command.value)):
        data.ctrl[:] = inputs
        mujoco.mj_fwdActuation(model, data)
        row[:] = data.qfrc_actuator[dof : dof + 3]
    weight = model.body_subtreemass[model.jnt_bodyid[tracked.joint]] * np.linalg.norm(model.opt.gravity)
    return (time, force) if np.median(np.linalg.norm(force, axis=1)) > MIN_BORNE * weight else None


def turn_from_site(spec: TwinSpec, site: str, vector: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) in the axes of a site, in those of its body."""
    turn = spec.model.site(site).quat
    return vector if turn[0] == 1.0 else turn_to_world(np.broadcast_to(turn, (len(vector), 4)), vector)


def refuse_attitude(
    label: str, tracked: Tracked, entry: SignalEntry | None, better: Convention, why: str
) -> InputError:
    """The error for attitudes that fit only when they are read otherwise."""
    order = "" if better.order == tuple(range(len(better.order))) else "in another order"
    turned = [name for name, sign in zip("wxyz" if len(better.order) == 4 else EULER, better.signs) if sign < 0.0]
    signs = f"with {' and '.join(turned)} of the other sign" if turned else ""
    given = None if entry is None else entry.attitude
    line = compose_line("attitude", given, [f"pose.orientation.{axis}" for axis in "wxyz"], better)
    return InputError(
        f"{label}: attitudes of {tracked.name} {why} only {' and '.join(filter(None, (order, signs)))}",
        f"w, x, y, z of the body {'in the world' if tracked.posed else 'from its parent'}"
        if len(better.order) == 4
        else "its roll, pitch and yaw in the world",
        f"write `{line}` for {tracked.name} in the twin's signals",
    )


def compose_line(
    name: str, entry: FieldEntry | None, paths: Sequence[str], convention: Convention | None = None, **more: str
) -> str:  # fmt: skip
    """An entry of a twin's signals with its numbers read otherwise; `paths` where it names none."""
    content: dict[str, Any] = {"path": list(paths)} if entry is None else dump_entry(entry)
    if convention is not None:
        scale = np.broadcast_to(content.get("scale", 1.0), len(convention.order))
        content["path"] = [content["path"][i] for i in convention.order]
        factors = [float(scale[i]) * sign for i, sign in zip(convention.order, convention.signs)]
        if len(factors) == 4 and factors[0] < 0.0:  # a quaternion and its negative are one rotation
            factors = [-factor for factor in factors]
        content["scale"] = [int(factor) if factor.is_integer() else factor for factor in factors]
        if content["scale"] == [1] * len(convention.order):
            del content["scale"]
    content |= more
    if content.get("frame") == "body":
        del content["frame"]
    written = content if len(content) > 1 else content["path"]
    text = yaml.safe_dump({name: written}, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True)
    return text.strip()[1:-1]
