"""Attitudes and rates of a body that the twin reads otherwise than they were logged: refused, with the line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import yaml

from vpptwin.estimation.checks.frames import ABOUT, BEND, Reading, look_up, read_attitude, tell_push, tell_rates
from vpptwin.estimation.checks.sound import FASTEST, FEW, SLOWEST
from vpptwin.estimation.series import Measurements, integrate
from vpptwin.logs.channels import EULER
from vpptwin.logs.check import MIN_R_SQUARED, MIN_TURN, compare_steps
from vpptwin.logs.flight import Flight, Stream
from vpptwin.system.errors import InputError
from vpptwin.system.fields import FieldEntry, SignalEntry, dump_entry
from vpptwin.twin.robot.manifold import turn_to_world
from vpptwin.twin.robot.signals import Tracked, find_base
from vpptwin.twin.spec import TwinSpec

BORNE = 0.3
"""Share of a body's weight from which on the push of its actuators tells where it points."""
UNITS = {"deg/s": 180.0 / np.pi, "mrad/s": 1000.0}
"""Units of rates besides rad/s, and how many of them that is."""
ALIKE = 1.3
"""A factor that is off by less is that of a unit."""


def find_entry(spec: TwinSpec, topic: str, name: str) -> SignalEntry | None:
    """What a twin says of a body or an IMU out of fields; None where it names no more than a topic."""
    return spec.robot.signals.entries.get(topic, {}).get(name)


def is_angled(entry: SignalEntry | None) -> bool:
    """Whether its attitude is logged as roll, pitch and yaw."""
    return entry is not None and entry.attitude is not None and len(entry.attitude.path) == len(EULER)


def vet_turns(
    spec: TwinSpec, label: str, tracked: Tracked, pose: Stream, source: tuple[str, str], rates: Stream, plain: bool
) -> None:  # fmt: skip
    """Refuse attitudes in another order or sense than rates turn, rates about other axes, and those of a mirrored gyro.

    Args:
        spec: the twin.
        label: of the log.
        tracked: the body.
        pose: its `attitude` as logged.
        source: topic and name of where its rates come from: the body's own, or those of a site.
        rates: `rate` as logged, about what the entry of its source says.
        plain: whether axes are those that were logged, not turned as a site is.

    Raises:
        InputError: with the line that mends it, if another reading is clearly better.
    """
    body, entry = find_entry(spec, tracked.topic, tracked.name), find_entry(spec, *source)
    frame = "body" if entry is None or entry.rate is None else entry.rate.frame
    base = find_base(spec.model, tracked)
    found = tell_rates(pose.time, pose["attitude"], rates.time, rates["rate"], frame, is_angled(body), base)
    if found is None:
        return
    told = f"{1.0 - found.missed:.0%} of the turning, {1.0 - found.given:.0%} as given"
    if found.of == "attitude":
        raise refuse_attitude(label, tracked, body, found, f"turn as its rates do ({told})")
    where, given = f"{label}: rates of {tracked.name}", entry.rate if entry is not None else None
    axes = [f"{'twist.twist.angular' if source[1] == tracked.name else 'angular_velocity'}.{axis}" for axis in "xyz"]
    if found.of == "frame":
        line = compose_line("rate", given, axes, frame=found.frame)
        raise InputError(
            f"{where} turn as its attitudes do only if they are about {ABOUT[found.frame]} ({told})",
            f"rates about {ABOUT[frame]}", f"write `{line}` for {source[1]} in the twin's signals",
        )  # fmt: skip
    line = compose_line("rate", given, axes, found)
    raise InputError(
        f"{where} are mirrored: they turn as its attitudes do only with an axis turned round, or two swapped ({told})",
        "x, y, z of right-handed axes",
        f"write `{line}` for {source[1]} in the twin's signals" if plain else "correct signs and order of its axes",
    )


def vet_pushes(spec: TwinSpec, flight: Flight, tracked: Tracked, found: Measurements) -> None:
    """Refuse attitudes in which a free body does not go where its actuators push it, or where its accelerometer says.

    Raises:
        InputError: with the line that mends it, if another reading is clearly better and rates do not contradict.
    """
    dof = int(spec.model.jnt_dofadr[tracked.joint])
    pushes = [find_thrust(spec, tracked, found), find_felt(spec, flight, tracked)]
    if dof + 3 not in found.attitudes or dof not in found.positions:
        return
    pose, body = found.attitudes[dof + 3], find_entry(spec, tracked.topic, tracked.name)
    place = np.stack([found.positions[dof + axis].value for axis in range(3)], axis=1)
    place = look_up(pose.time, found.positions[dof].time, place)
    for push, what in zip(pushes, ("push of its actuators", "accelerometer")):
        if push is None:
            continue
        reading = tell_push(
            pose.time, (place, pose.value), push.time, push["force"], spec.model.opt.gravity, is_angled(body)
        )
        if reading is None:
            continue
        rates = [found.velocities.get(dof + 3 + axis) for axis in range(3)]
        told = [rate for rate in rates if rate is not None]
        attitude = read_attitude(reading, pose.value)
        if len(told) == 3 and tell_rates(pose.time, attitude, told[0].time, np.stack([r.value for r in told], axis=1)):
            continue
        shares = f"{1.0 - reading.missed:.1%} of its directions, {1.0 - reading.given:.1%} as given"
        raise refuse_attitude(str(flight.path), tracked, body, reading, f"fit the {what} ({shares})")


def find_thrust(spec: TwinSpec, tracked: Tracked, found: Measurements) -> Stream | None:
    """What actuators push a free body by in its own axes, (n, 3) N; None where that does not bear it."""
    model, command = spec.model, found.command
    address, dof = int(model.jnt_qposadr[tracked.joint]), int(model.jnt_dofadr[tracked.joint])
    time = np.arange(found.start, found.end, 0.5 * BEND)
    if not spec.robot.signals.actuators or len(time) < FEW:
        return None
    data, force = mujoco.MjData(model), np.zeros((len(time), 3))
    data.qpos[address + 3 : address + 7] = 1.0, 0.0, 0.0, 0.0
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    for row, inputs in zip(force, look_up(time, command.time, command.value)):
        data.ctrl[:] = inputs
        mujoco.mj_fwdActuation(model, data)
        row[:] = data.qfrc_actuator[dof : dof + 3]
    weight = model.body_subtreemass[model.jnt_bodyid[tracked.joint]] * np.linalg.norm(model.opt.gravity)
    return Stream(time, {"force": force}) if np.median(np.linalg.norm(force, axis=1)) > BORNE * weight else None


def find_felt(spec: TwinSpec, flight: Flight, tracked: Tracked) -> Stream | None:
    """What the accelerometer of an IMU on a body says, in the body's axes, (n, 3); None without one."""
    for site, topic in spec.robot.signals.sites.items():
        stream = flight.spatial.get(topic)
        here = spec.model.site(site).bodyid[0] == spec.model.jnt_bodyid[tracked.joint]
        if here and stream is not None and "acceleration" in stream.values:
            return Stream(stream.time, {"force": turn_from_site(spec, site, stream["acceleration"])})
    return None


def turn_from_site(spec: TwinSpec, site: str, vector: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) in the axes of a site, in those of its body."""
    turn = spec.model.site(site).quat
    return vector if turn[0] == 1.0 else turn_to_world(np.broadcast_to(turn, (len(vector), 4)), vector)


def refuse_attitude(label: str, tracked: Tracked, entry: SignalEntry | None, reading: Reading, why: str) -> InputError:
    """The error for attitudes that fit only when they are read otherwise."""
    order = "" if reading.order == tuple(range(len(reading.order))) else "in another order"
    turned = [name for name, sign in zip("wxyz" if len(reading.order) == 4 else EULER, reading.signs) if sign < 0.0]
    signs = f"with {' and '.join(turned)} of the other sign" if turned else ""
    given = None if entry is None else entry.attitude
    line = compose_line("attitude", given, [f"pose.orientation.{axis}" for axis in "wxyz"], reading)
    return InputError(
        f"{label}: attitudes of {tracked.name} {why} only {' and '.join(filter(None, (order, signs)))}",
        f"w, x, y, z of the body {'in the world' if tracked.posed else 'from its parent'}"
        if len(reading.order) == 4
        else "its roll, pitch and yaw in the world",
        f"write `{line}` for {tracked.name} in the twin's signals",
    )


def compose_line(
    name: str, entry: FieldEntry | None, paths: Sequence[str], reading: Reading | None = None, **more: str
) -> str:  # fmt: skip
    """An entry of a twin's signals with its numbers read otherwise; `paths` where it names none."""
    content: dict[str, Any] = {"path": list(paths)} if entry is None else dump_entry(entry)
    if reading is not None:
        scale = np.broadcast_to(content.get("scale", 1.0), len(reading.order))
        content["path"] = [content["path"][i] for i in reading.order]
        factors = [float(scale[i]) * sign for i, sign in zip(reading.order, reading.signs)]
        if len(factors) == 4 and factors[0] < 0.0:  # a quaternion and its negative are one rotation
            factors = [-factor for factor in factors]
        content["scale"] = [int(factor) if factor.is_integer() else factor for factor in factors]
        if content["scale"] == [1] * len(reading.order):
            del content["scale"]
    content |= more
    if content.get("frame") == "body":
        del content["frame"]
    told = content if len(content) > 1 else content["path"]
    text = yaml.safe_dump({name: told}, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True)
    return text.strip()[1:-1]


def vet_rates(label: str, time: np.ndarray, turned: np.ndarray, rate: np.ndarray, aligned: np.ndarray) -> None:
    """Refuse rates (n, 3) that turn too far or not far enough for the attitudes of a body that `turned` so, (n, 3).

    What hardly turns, and what even the rates in the attitudes' axes, `aligned` (n, 3), do not explain, is not judged.

    Raises:
        InputError: if the two agree but for a factor, such as 57.3.
    """
    if len(time) < FEW or np.ptp(turned, axis=0).max() < MIN_TURN:
        return
    stride = max(round(BEND / float(np.median(np.diff(time)))), 1)
    tracks = turned, integrate(rate, time), integrate(aligned, time)
    seen, told, in_axes = (np.diff(track[::stride], axis=0) for track in tracks)
    factor = float(np.linalg.norm(told - told.mean(axis=0)) / np.linalg.norm(seen - seen.mean(axis=0)))
    if compare_steps(seen.ravel(), in_axes.ravel())[1] < MIN_R_SQUARED or SLOWEST < factor < FASTEST:
        return
    near = {unit: size for unit, size in UNITS.items() if abs(np.log(factor / size)) < np.log(ALIKE)}
    back = {unit: size for unit, size in UNITS.items() if abs(np.log(factor * size)) < np.log(ALIKE)}
    looks, mend = "", "correct the `scale` of the one that is wrong, or leave it out"
    for unit in near:
        looks, mend = f" and look like {unit}", f"correct its signal in the twin, for instance with `unit: {unit}`"
    for unit in back:
        looks = f" and look like rad/s that `unit: {unit}` makes too small"
        mend = "correct its signal in the twin, for instance with `unit: rad/s`"
    if not looks:
        looks = ", which is no unit: a heading that wheels which slip have turned, or a gyro of another range"
    raise InputError(
        f"{label} are {factor:.3g} times the turning of the attitudes{looks}", "rad/s of the same motion", mend
    )
