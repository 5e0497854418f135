"""Signals of a body that flies or floats: attitude, gyro, accelerometer, position, each tested against the others."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from vpptwin.estimation.checks.held import tell_held
from vpptwin.logs.channels import EULER, SPATIAL
from vpptwin.logs.streams.samples import euler_to_quaternion
from vpptwin.logs.topic_map import GEODETIC
from vpptwin.mapping.alike import compare_slope, resample
from vpptwin.mapping.guess import CLOSE, SLOPE, Guess, guess_signals
from vpptwin.mapping.survey import Signal
from vpptwin.mapping.turning import (
    AXES,
    Told,
    choose_unit,
    find_groups,
    find_quaternions,
    find_rates,
    number_groups,
    stack,
    tell_gyro,
    tell_quaternion,
)
from vpptwin.mapping.words import TRACKED, is_commanded, rank_source, split_words
from vpptwin.system.fields import UNITS
from vpptwin.twin.robot.manifold import BALL, FREE, read_angles
from vpptwin.twin.robot.model import find_floating

REST_S = 1.0
"""The stillest stretch of so long is taken for rest [s]."""
ROS_POSITIONS = [f"{columns['position']}." for columns in SPATIAL.values() if "position" in columns]
"""What vectors of positions are called in messages of poses."""
RATES = {"p": "v", "pos": "vel", "position": "velocity"}
"""Word in names of positions → in those of the velocities beside them."""
NAMED = {*RATES, "pose"}
"""Words in names of positions besides the body's."""
BESIDE = ("q", "q_", "quat_", "orientation_")
"""What the name of an attitude has beyond that of a position beside it."""
ANGLES = (("rad", 1.0), ("deg", UNITS["deg"][1]))
TURN, UNIT_AT_END = 2.2 * np.pi, r"(?:[_.\s\[(]*(?:deg|degrees|rad|radians)[\])]*)?"
"""Angles that go farther are in degrees [rad]; what may stand behind their names."""
GRAVITIES = (("m/s^2", 1.0), ("g", UNITS["g"][1]), ("mg", UNITS["mg"][1]))


def guess_all(model: mujoco.MjModel, signals: Sequence[Signal]) -> list[Guess]:
    """The likeliest signals of every joint, actuator, free body and IMU."""
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers beyond all measure, which reading leaves out
        plain = guess_signals(model, signals)
        known = {guess.target for guess in plain if guess.group == "actuators" and guess.fields}
        return [*plain, *guess_bodies(model, signals, known)]


def guess_bodies(model: mujoco.MjModel, signals: Sequence[Signal], actuators: Container[str] = ()) -> list[Guess]:
    """The likeliest signals of every free body, or one on a ball joint, and of the IMU that is a site on it.

    What a tracker saw comes before what an estimator made of it. Of a free body that something holds or drives, which
    neither the model nor the actuators with a signal do, that is said.
    """
    guesses = []
    for body_name, joint in find_floating(model).items():
        index, wanted = int(model.jnt_bodyid[joint]), ("position", "attitude")[int(model.jnt_type[joint] == BALL) :]
        told = list(tell_body(signals, body_name))
        sites = [model.site(i).name for i in range(model.nsite) if model.site_bodyid[i] == index]
        imus = [name for name in sites if "imu" in split_words(name)] or sites[: len(sites) == 1]
        body = Guess(body_name, "bodies")
        take(body, [each for each in told if each.quantity in wanted], wanted)
        missing = set(wanted) - set(body.vectors)
        for kind in sorted(missing):
            own = {signals[0].topic for signals in body.vectors.values()}
            beside = sorted({each.signals[0].topic for each in told if each.quantity == kind} - own)
            far = f", only in {' and '.join(beside)}: one topic has to have both" if beside and own else ""
            part = tell_partial(signals) if kind == "attitude" and not beside else ""
            body.doubts.append(f"no {kind} in {' '.join(own) or 'the log'} looks like its{far}{part}")
        body.doubts += list_degrees(signals) if "position" in missing else []
        if not missing and model.jnt_type[joint] == FREE:
            held = tell_held(model, joint, actuators, *stack_pose(body))
            body.reasons += [held] * bool(held)
        if not imus:
            take(body, [each for each in told if each.quantity == "rate"])
        guesses.append(body)
        for name in imus[:1]:
            guess = Guess(name, "sites")
            take(guess, [each for each in told if each.quantity == "rate"])
            guesses += [guess] * bool(guess.vectors)
        body.reasons += [f"{'also' if each.sure else 'perhaps'} {each.text}" for each in told if not each.quantity]
    for guess in guesses:
        guess.sure = not guess.doubts
    return guesses


def take(guess: Guess, told: Sequence[Told], wanted: Sequence[str] = ()) -> None:
    """Give a body or an IMU the likeliest of what its signals may be, all from the topic that has most of it."""

    def rank(each: Told) -> tuple[int, bool, int]:
        topic = each.signals[0].topic
        beside = {other.quantity for other in told if other.signals[0].topic == topic}
        return -len(beside & set(wanted)), not each.sure, max(map(rank_source, each.signals))

    for each in sorted(told, key=rank):
        topics = {signals[0].topic for signals in guess.vectors.values()}
        if each.quantity in guess.vectors or topics - {each.signals[0].topic}:
            continue
        guess.vectors[each.quantity] = each.signals
        (guess.reasons if each.sure else guess.doubts).append(each.text)
        if each.unit:
            guess.units[each.quantity] = each.unit
        if each.more:
            guess.more[each.quantity] = dict(each.more)


def turn_signals(angles: Sequence[Signal], size: float) -> list[Signal]:
    """The quaternion x, y, z, w of roll, pitch and yaw in a unit of that size [rad], at the times of roll."""
    known = np.stack([np.interp(angles[0].time, s.time, size * s.values) for s in angles], axis=1)
    return [replace(angles[0], values=column) for column in np.roll(euler_to_quaternion(known), -1, axis=1).T]


def stack_pose(body: Guess) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) s and poses (n, 7) of a body as its signals have them."""
    place, turned = (body.vectors[kind] for kind in ("position", "attitude"))
    scale = UNITS[body.units.get("position", "m")][1]
    if len(turned) == len(EULER):
        x, y, z, w = turn_signals(turned, dict(ANGLES)[body.units.get("attitude", "rad")])
        turned = (w, x, y, z)
    time, pose = stack([*place, *turned])
    return time, pose * [*(3 * [scale]), *np.broadcast_to(body.more.get("attitude", {}).get("scale", 1.0), 4)]


def list_degrees(signals: Sequence[Signal]) -> list[str]:
    """What is said of a log that tells where a body is by latitude and longitude alone."""
    found = [s for s in signals if set(split_words(s.label)) & GEODETIC]
    told = f"{' and '.join(s.label for s in found[:2])} are degrees on the globe, no metres: convert them to metres"
    return [f"{told} north and east of a place"] if len(found) > 1 else []


def tell_partial(signals: Sequence[Signal]) -> str:
    """Which two of roll, pitch and yaw there are without the third, in words; "" for none."""
    measured = [signal for signal in signals if not is_commanded(signal)]
    for lost in EULER:
        pair = [name for name in EULER if name != lost]
        for stem in find_groups(measured, pair, UNIT_AT_END):
            return f": {stem}{' and '.join(pair)} without {lost}"
    return ""


def tell_body(signals: Sequence[Signal], body: str) -> Iterator[Told]:
    """What a body's signals are: position, attitude and rate, and, without a quantity, what shows the same."""
    attitudes: dict[str, list[Signal]] = {}
    measured = [signal for signal in signals if not is_commanded(signal)]
    turning = find_rates(measured)
    for stem, group, named in find_quaternions(measured):
        told, attitudes[stem] = tell_quaternion(stem, group, named, turning)
        yield told
    angles = {} if attitudes else find_groups(measured, EULER, UNIT_AT_END)
    for stem, group in angles.items():
        if not all(signal.is_constant for signal in group):
            unit = group[0].unit
            said, small = unit in dict(ANGLES), all(np.ptp(signal.finite) < TURN for signal in group)
            unit = unit if said else "rad" if small else "deg"
            attitudes[stem] = turn_signals(group, dict(ANGLES)[unit])
            text = f"attitude: {stem}roll, pitch, yaw in {unit}{'' if said else ' by how far they go'}"
            yield Told("attitude", text, False, tuple(group), "" if unit == "rad" else unit)
    triples = {**number_groups(measured, 3), **find_groups(measured, AXES)}
    places = {stem: group for stem, group in triples.items() if angles or stem not in attitudes}
    yield from tell_positions(places, body, attitudes)
    for stem, group in find_groups(signals, EULER).items():
        if attitudes and not angles and not any(is_commanded(signal) for signal in group):
            yield tell_angles(stem, group, next(iter(attitudes.values())))
    for stem, group in triples.items():
        words = set(split_words(stem.split(" ", 1)[1]))
        told_by = words & {"acc", "accel", "acceleration"} and words & {"imu", "accel", "accelerometer"}
        if stem not in turning and told_by:
            yield tell_gravity(stem, group)
    for stem, group in turning.items() if attitudes else ():
        yield tell_gyro(stem, group, next(iter(attitudes.values())))


def tell_positions(triples: Mapping[str, list[Signal]], body: str, attitudes: Container[str]) -> Iterator[Told]:
    """Positions, by the name of the message, the body or its attitude, or each with the velocity that is its slope."""
    for stem, group in triples.items():
        topic, _, name = stem.partition(" ")
        axes = f"{stem} of three numbers" if group[0].label[-1:] in "0123]" else f"{stem}x, y, z"
        bare = name.rstrip("._")
        if bare and any(f"{stem}{turned}" in attitudes for turned in BESIDE):
            yield Told("position", f"position: {axes}: called as its attitude", True, tuple(group))
            continue
        if name in ROS_POSITIONS:
            yield Told("position", f"position: {axes}, of a message of poses", True, tuple(group))
        words = [word for word in split_words(name) if word not in NAMED]
        if words and (words == split_words(body) or set(words) <= TRACKED):
            yield Told("position", f"position: {axes}: its name", True, tuple(group))
            continue
        place = re.fullmatch(r"(|.*[._])(p|pos|position)([._]?)", name)
        if place is None and bare and not bare.endswith(("state", "estimate")):
            continue
        base = place.group(1) + RATES[place.group(2)] + place.group(3) if place else f"{name}v"
        velocity = triples.get(f"{topic} {base}")
        if velocity is None:
            yield Told("position", f"position: {axes} by name alone", False, tuple(group))
            continue
        tests = [compare_slope(p, v) for p, v in zip(group, velocity)]
        shares = [share for r, share in tests if np.isfinite(r) and r > SLOPE]
        good = len(shares) >= 2 and all(CLOSE[0] < share < CLOSE[1] for share in shares)
        numbers = ", ".join(f"{share:.2f} (r {r:.2f})" for r, share in tests)
        beside = base if axes.endswith("numbers") else f"{base}x, vy, vz" if base.endswith("v") else f"{base}x, y, z"
        text = f"position: {axes}, velocity {beside}; shares of the slope {numbers}"
        yield Told("position", text, good, tuple(group))


def tell_angles(stem: str, group: Sequence[Signal], attitude: Sequence[Signal]) -> Told:
    """In which unit roll, pitch and yaw show the attitude, and which of them with the other sign."""
    x, y, z, w = (signal.values for signal in attitude)
    roll, pitch, yaw = read_angles(np.stack([w, x, y, z], axis=1)).T
    euler = roll, pitch, np.unwrap(yaw)
    shares = []
    for angle, signal in zip(euler, group):
        _, shown, seen = resample(signal, replace(attitude[0], values=angle))
        good = len(shown) and min(shown.std(), seen.std()) > 1e-6
        shares.append(
            (float(np.corrcoef(shown, seen)[0, 1]), float(shown.std() / seen.std())) if good else (np.nan, np.nan)
        )
    unit, sure, numbers = choose_unit([(abs(r), share) for r, share in shares], ANGLES)
    turned = [name for name, (r, _) in zip(("roll", "pitch", "yaw"), shares) if r < -SLOPE]
    told = f"angles: {stem}roll, pitch, yaw in {unit or 'no known unit'}"
    told += f", {' and '.join(turned)} with the other sign" if turned else ""
    return Told("", f"{told}; shares of the attitude {numbers}", sure, tuple(group))


def tell_gravity(stem: str, group: Sequence[Signal]) -> Told:
    """In which unit an accelerometer shows gravity where it is stillest."""
    norm = np.sqrt(np.sum([signal.values**2 for signal in group], axis=0))
    width = max(round(REST_S * group[0].rate), 2)
    starts = range(0, max(len(norm) - width, 1), max(width // 4, 1))
    spread, rest = min(
        (float(np.std(norm[i : i + width])), float(np.median(norm[i : i + width])))
        for i in starts
        if np.median(norm[i : i + width]) > 0.0
    )
    unit = next((unit for unit, one in GRAVITIES if 0.9 < rest * one / 9.80665 < 1.1), "")
    told = f"accelerometer: {stem}x, y, z shows {rest:.4g} at rest (spread {spread:.2g})"
    return Told(
        "", f"{told}, so it is in {unit}" if unit else f"{told}: no gravity in any unit", bool(unit), tuple(group)
    )
