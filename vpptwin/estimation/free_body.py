"""Signals of a body that flies or floats: attitude, gyro, accelerometer, position, each tested against the others."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from vpptwin.estimation.alike import compare_lag, compare_slope, resample
from vpptwin.estimation.guess import CLOSE, SLOPE, Guess
from vpptwin.estimation.words import TRACKED, is_commanded, part_index, rank_source, split_words
from vpptwin.fields import UNITS
from vpptwin.logs.channels import EULER, SPATIAL
from vpptwin.logs.samples import turn_by_angles
from vpptwin.logs.survey import Signal
from vpptwin.twin.manifold import BALL
from vpptwin.twin.model import find_floating

AXES = ("x", "y", "z")
REST_S = 1.0
"""The stillest stretch of so long is taken for rest [s]."""
ROS_POSITIONS = [f"{columns['position']}." for columns in SPATIAL.values() if "position" in columns]
"""What vectors of positions are called in messages of poses."""
RATES = {"p": "v", "pos": "vel", "position": "velocity"}
"""Word in names of positions → in those of the velocities beside them."""
NAMED = {*RATES, "pose"}
"""Words in names of positions besides the body's."""
ORDERS = {"w, x, y, z": (0, 1, 2, 3), "x, y, z, w": (3, 0, 1, 2)}
"""In which order people number an attitude → where w, x, y, z are then; PX4, ArduPilot and MuJoCo have the first."""
BESIDE = ("q", "q_", "quat_", "orientation_")
"""What the name of an attitude has beyond that of a position beside it."""
TURNS = (("rad/s", 1.0), ("deg/s", UNITS["deg/s"][1]), ("mrad/s", 1e-3))
ANGLES = (("rad", 1.0), ("deg", UNITS["deg"][1]))
TURN, UNIT_AT_END = 2.2 * np.pi, r"(?:[_.\s\[(]*(?:deg|degrees|rad|radians)[\])]*)?"
"""Angles that go farther are in degrees [rad]; what may stand behind their names."""
GRAVITIES = (("m/s^2", 1.0), ("g", UNITS["g"][1]), ("mg", UNITS["mg"][1]))


@dataclass(frozen=True)
class Told:
    """What signals of a body are: `quantity`, in `unit` ("" for SI or none), in words, and whether that is sure."""

    quantity: str
    text: str
    sure: bool
    signals: tuple[Signal, ...]
    unit: str = ""


def guess_bodies(model: mujoco.MjModel, signals: Sequence[Signal]) -> list[Guess]:
    """The likeliest signals of every free body, or one on a ball joint, and of the IMU that is a site on it.

    What a tracker saw comes before what an estimator made of it.
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
            body.doubts.append(f"no {kind} in {' '.join(own) or 'the log'} looks like its{far}")
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


def turn_signals(angles: Sequence[Signal], size: float) -> list[Signal]:
    """The quaternion x, y, z, w of roll, pitch and yaw in a unit of that size [rad], at the times of roll."""
    known = np.stack([np.interp(angles[0].time, s.time, size * s.values) for s in angles], axis=1)
    return [replace(angles[0], values=column) for column in np.roll(turn_by_angles(known), -1, axis=1).T]


def find_groups(signals: Sequence[Signal], axes: Sequence[str], end: str = "") -> dict[str, list[Signal]]:
    """Signals that differ in the end of their name alone, by what they share; an `end` matches what is beyond that."""
    groups: dict[str, dict[str, Signal]] = {}
    for signal in signals:
        match = re.fullmatch(rf"(.*?)({'|'.join(axes)}){end}", signal.label.lower())
        if match:
            groups.setdefault(f"{signal.topic} {match.group(1)}", {})[match.group(2)] = signal
    return {stem: [group[axis] for axis in axes] for stem, group in groups.items() if len(group) == len(axes)}


def number_groups(signals: Sequence[Signal], count: int) -> dict[str, list[Signal]]:
    """Vectors of so many numbered signals, `q[0]` to `q[3]` or `Q1` to `Q4`, by the topic and name that they share."""
    groups: dict[str, dict[int, Signal]] = {}
    for signal in signals:
        stem, index = part_index(signal)
        if index is not None and re.search(r"\d\]?$", signal.label):
            groups.setdefault(stem, {})[index] = signal
    runs = tuple(range(count)), tuple(range(1, count + 1))
    return {stem: [group[i] for i in sorted(group)] for stem, group in groups.items() if tuple(sorted(group)) in runs}


def tell_numbered(signals: Sequence[Signal]) -> Iterator[Told]:
    """Attitudes as four numbers; which of them is w is sure if a gyro turns so and not otherwise."""
    gyros = [group for stem, group in number_groups(signals, 3).items() if is_gyro(stem)]
    gyros += [group for stem, group in find_groups(signals, AXES).items() if is_gyro(stem)]
    for stem, group in number_groups(signals, 4).items():
        norms = np.sqrt(np.sum([signal.values**2 for signal in group], axis=0))
        if np.nanmax(np.abs(norms - 1.0)) >= 0.02 or all(signal.is_constant for signal in group):
            continue
        orders = {name: tuple(group[place] for place in places) for name, places in ORDERS.items()}
        turned = [name for name, (w, *xyz) in orders.items() if gyros and tell_gyro("", gyros[0], [*xyz, w]).sure]
        name = turned[0] if len(turned) == 1 else next(iter(ORDERS))
        text = f"attitude: {stem} of four numbers is a quaternion (norm 1)"
        if len(turned) == 1:
            yield Told("attitude", f"{text}, {name} as the gyro turns", True, orders[name])
        else:
            yield Told("attitude", f"{text}: {name}, or {' or '.join([*ORDERS][1:])}?", False, orders[name])


def is_gyro(stem: str) -> bool:
    """Whether what three signals share says that they are rates of an IMU."""
    words = set(split_words(stem.split(" ", 1)[1]))
    return bool(words & {"gyro", "gyr"}) or words in ({"angular", "velocity"}, {"angular", "velocity", "xyz"})


def tell_body(signals: Sequence[Signal], body: str) -> Iterator[Told]:
    """What a body's signals are: position, attitude and rate, and, without a quantity, what shows the same."""
    attitudes: dict[str, list[Signal]] = {}
    measured = [signal for signal in signals if not is_commanded(signal)]
    for each in tell_numbered(measured):
        attitudes[each.text.split(" ", 1)[1].split(" of four")[0]] = [*each.signals[1:], each.signals[0]]
        yield each
    for stem, group in find_groups(measured, (*AXES, "w")).items():
        norms = np.sqrt(np.sum([signal.values**2 for signal in group], axis=0))
        off = float(np.nanmax(np.abs(norms - 1.0)))
        if off < 0.02 and not all(signal.is_constant for signal in group):
            attitudes[stem] = group
            text = f"attitude: {stem}x, y, z, w is a quaternion (norm within {off:.1g} of 1)"
            yield Told("attitude", text, True, (group[3], *group[:3]))
    angles = {} if attitudes else find_groups(measured, EULER, UNIT_AT_END)
    for stem, group in angles.items():
        if not all(signal.is_constant for signal in group):
            unit = group[0].unit
            told, small = unit in dict(ANGLES), all(np.ptp(signal.finite) < TURN for signal in group)
            unit = unit if told else "rad" if small else "deg"
            attitudes[stem] = turn_signals(group, dict(ANGLES)[unit])
            text = f"attitude: {stem}roll, pitch, yaw in {unit}{'' if told else ' by how far they go'}"
            yield Told("attitude", text, False, tuple(group), "" if unit == "rad" else unit)
    triples = {**number_groups(measured, 3), **find_groups(measured, AXES)}
    places = {stem: group for stem, group in triples.items() if angles or stem not in attitudes}
    yield from tell_positions(places, body, attitudes)
    for stem, group in find_groups(signals, EULER).items():
        if attitudes and not angles and not any(is_commanded(signal) for signal in group):
            yield tell_angles(stem, group, next(iter(attitudes.values())))
    for stem, group in triples.items():
        words = set(split_words(stem.split(" ", 1)[1]))
        if is_gyro(stem) and attitudes:
            yield tell_gyro(stem, group, next(iter(attitudes.values())))
        elif words & {"acc", "accel", "acceleration"} and words & {"imu", "accel", "accelerometer"}:
            yield tell_gravity(stem, group)


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


def tell_gyro(stem: str, group: Sequence[Signal], attitude: Sequence[Signal]) -> Told:
    """In which unit a gyro turns with the attitude."""
    time = attitude[0].time
    period = float(np.median(np.diff(time)))
    width = max(round(0.05 / period), 1)
    q = np.stack([signal.values for signal in attitude], axis=1)
    a, b = q[:-width], q[width:]
    vector = a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(a[:, :3], b[:, :3])
    scalar = np.sum(a * b, axis=1)
    angle = 2.0 * np.arctan2(np.linalg.norm(vector, axis=1), np.abs(scalar))
    size = np.maximum(np.linalg.norm(vector, axis=1), 1e-12)
    rates = vector / size[:, None] * (np.sign(scalar) * angle)[:, None] / (width * period)
    middle = 0.5 * (time[width:] + time[:-width])
    results, lag = [], 0.0
    for axis, signal in enumerate(group):
        turning = Signal("", "", "", "", "", "", middle, rates[:, axis])
        smooth = replace(signal, values=np.convolve(signal.values, np.ones(width) / width, "same"))
        _, lag = compare_lag(turning, smooth) if axis == 0 else (0.0, lag)  # three axes have one clock
        _step, shown, turned = resample(replace(smooth, time=smooth.time - lag), turning)
        r = float(np.corrcoef(shown, turned)[0, 1]) if len(shown) else np.nan
        results.append((r, float(shown @ turned / (turned @ turned)) if len(shown) else np.nan))
    unit, sure, numbers = choose_unit(results, TURNS)
    text = f"gyro: {stem}x, y, z in {unit or 'no known unit'}; shares of the turning {numbers}"
    text += f", {1e3 * lag:.0f} ms after the attitude" if lag else ""
    return Told("rate", text, sure, tuple(group), "" if unit == "rad/s" else unit)


def tell_angles(stem: str, group: Sequence[Signal], attitude: Sequence[Signal]) -> Told:
    """In which unit roll, pitch and yaw show the attitude, and which of them with the other sign."""
    x, y, z, w = (signal.values for signal in attitude)
    euler = (
        np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
        np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))),
    )
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


def choose_unit(tests: Sequence[tuple[float, float]], units: Sequence[tuple[str, float]]) -> tuple[str, bool, str]:
    """The unit in which three axes show what they should, "" for none; whether all do; the numbers.

    Tests are correlation and share of each axis, units their size in SI.
    """
    strong = [share for r, share in tests if r > SLOPE]
    fits = (u for u, one in units if strong and all(CLOSE[0] < share * one < CLOSE[1] for share in strong))
    unit = next(fits, "")
    numbers = ", ".join(f"{share:.3g} (r {r:.2f})" for r, share in tests)
    return unit, bool(unit) and len(strong) == len(tests), numbers


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
