"""Signals of a body that flies or floats: position, attitude, rates, accelerometer, each tested against the others.

Quaternions are told in order and sense, rates in unit and axes.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from vpptwin.estimation.checks.orientation import ABOUT, Convention, find_convention, turn_rates_to_body
from vpptwin.estimation.checks.support import tell_held
from vpptwin.estimation.series import Sampled, interpolate
from vpptwin.logs.channels import EULER, SPATIAL
from vpptwin.logs.streams.samples import euler_to_quaternion
from vpptwin.logs.topic_map import GEODETIC
from vpptwin.mapping.guess import CLOSE, SLOPE, Guess, guess_signals
from vpptwin.mapping.likeness import STILL, compare_lag, compare_slope, resample
from vpptwin.mapping.survey import Signal
from vpptwin.mapping.words import TRACKED, is_commanded, part_index, rank_source, split_words
from vpptwin.system.fields import UNITS
from vpptwin.twin.robot.manifold import BALL, FREE, difference_attitudes, follow_sign, read_angles
from vpptwin.twin.robot.model import find_floating

AXES = ("x", "y", "z")
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
RATE_UNITS = (("rad/s", 1.0), ("deg/s", UNITS["deg/s"][1]), ("mrad/s", 1e-3))
GRAVITIES = (("m/s^2", 1.0), ("g", UNITS["g"][1]), ("mg", UNITS["mg"][1]))
MAX_ANGLE, UNIT_AT_END = 2.2 * np.pi, r"(?:[_.\s\[(]*(?:deg|degrees|rad|radians)[\])]*)?"
"""Angles that go farther are in degrees [rad]; what may stand behind their names."""
NORM_ERROR = 0.02
"""What a quaternion's norm may be off by."""
SMOOTH = 0.05
"""Over so long rates are compared with attitudes [s]."""


@dataclass(frozen=True)
class BodyCandidate:
    """What signals of a body may be: `quantity`, in `unit` ("" for SI or none), in words, and whether that is sure."""

    quantity: str
    text: str
    sure: bool
    signals: tuple[Signal, ...]
    unit: str = ""
    more: Mapping[str, object] = field(default_factory=dict)  # what else the twin says of them: scale, frame


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
        candidates = list(tell_body(signals, body_name))
        rates = [each for each in candidates if each.quantity == "rate"]
        sites = [model.site(i).name for i in range(model.nsite) if model.site_bodyid[i] == index]
        imus = [name for name in sites if "imu" in split_words(name)] or sites[: len(sites) == 1]
        body = Guess(body_name, "bodies")
        take(body, [each for each in candidates if each.quantity in wanted], wanted)
        missing = set(wanted) - set(body.vectors)
        for kind in sorted(missing):
            topics = {vector[0].topic for vector in body.vectors.values()}
            beside = sorted({each.signals[0].topic for each in candidates if each.quantity == kind} - topics)
            far = f", only in {' and '.join(beside)}: one topic has to have both" if beside and topics else ""
            part = tell_partial(signals) if kind == "attitude" and not beside else ""
            body.doubts.append(f"no {kind} in {' '.join(topics) or 'the log'} looks like its{far}{part}")
        globe = [s.label for s in signals if set(split_words(s.label)) & GEODETIC] if "position" in missing else []
        if len(globe) > 1:
            degrees = f"{' and '.join(globe[:2])} are degrees on the globe, no metres"
            body.doubts.append(f"{degrees}: convert them to metres north and east of a place")
        if not missing and model.jnt_type[joint] == FREE:
            held = tell_held(model, joint, actuators, *stack_pose(body))
            body.reasons += [held] * bool(held)
        guesses.append(body)
        if imus:
            imu = Guess(imus[0], "sites")
            take(imu, rates)
            guesses += [imu] * bool(imu.vectors)
        else:
            take(body, rates)
        also = [each for each in candidates if not each.quantity]
        body.reasons += [f"{'also' if each.sure else 'perhaps'} {each.text}" for each in also]
    for guess in guesses:
        guess.sure = not guess.doubts
    return guesses


def take(guess: Guess, candidates: Sequence[BodyCandidate], wanted: Sequence[str] = ()) -> None:
    """Give a body or an IMU the likeliest of what its signals may be, all from the topic that has most of it."""

    def rank(each: BodyCandidate) -> tuple[int, bool, int]:
        topic = each.signals[0].topic
        beside = {other.quantity for other in candidates if other.signals[0].topic == topic}
        return -len(beside & set(wanted)), not each.sure, max(map(rank_source, each.signals))

    for each in sorted(candidates, key=rank):
        topics = {signals[0].topic for signals in guess.vectors.values()}
        if each.quantity in guess.vectors or topics - {each.signals[0].topic}:
            continue
        guess.vectors[each.quantity] = each.signals
        (guess.reasons if each.sure else guess.doubts).append(each.text)
        if each.unit:
            guess.units[each.quantity] = each.unit
        if each.more:
            guess.more[each.quantity] = dict(each.more)


def stack(signals: Sequence[Signal]) -> Sampled:
    """Times (n,) s of the first, where all have numbers, and values (n, k)."""
    time = signals[0].time
    values = np.stack([s.values if s.time is time else np.interp(time, s.time, s.values) for s in signals], axis=1)
    known = np.isfinite(values).all(axis=1)
    return time[known], values[known]


def stack_pose(body: Guess) -> Sampled:
    """Times (n,) s and poses (n, 7) of a body as its signals have them."""
    place, turned = (body.vectors[kind] for kind in ("position", "attitude"))
    scale = UNITS[body.units.get("position", "m")][1]
    if len(turned) == len(EULER):
        x, y, z, w = turn_signals(turned, dict(ANGLES)[body.units.get("attitude", "rad")])
        turned = (w, x, y, z)
    time, pose = stack([*place, *turned])
    return time, pose * [*(3 * [scale]), *np.broadcast_to(body.more.get("attitude", {}).get("scale", 1.0), 4)]


def turn_signals(angles: Sequence[Signal], size: float) -> list[Signal]:
    """The quaternion x, y, z, w of roll, pitch and yaw in a unit of that size [rad], at the times of roll."""
    known = np.stack([np.interp(angles[0].time, s.time, size * s.values) for s in angles], axis=1)
    return [replace(angles[0], values=column) for column in np.roll(euler_to_quaternion(known), -1, axis=1).T]


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


def find_rates(signals: Sequence[Signal], triples: Mapping[str, list[Signal]]) -> dict[str, list[Signal]]:
    """Rates about three axes, by what their names share; what is called wx only where nothing is a gyro's."""
    plain = find_groups(signals, ("wx", "wy", "wz"), r"(?:_[a-z]+)?")
    gyros = {stem: group for stem, group in triples.items() if is_gyro(stem)}
    return gyros or {f"{stem}w": group for stem, group in plain.items()}


def is_gyro(stem: str) -> bool:
    """Whether what three signals share says that they are rates of an IMU."""
    words = set(split_words(stem.split(" ", 1)[1]))
    return bool(words & {"gyro", "gyr"}) or words in ({"angular", "velocity"}, {"angular", "velocity", "xyz"})


def find_quaternions(signals: Sequence[Signal]) -> Iterator[tuple[str, list[Signal], bool]]:
    """Signals w, x, y, z of norm 1, by what their names share, and whether these say the order; numbers do not."""
    groups = [(stem, group, True) for stem, group in find_groups(signals, ("w", *AXES)).items()]
    groups += [(stem, group, False) for stem, group in number_groups(signals, 4).items()]
    for stem, group, named in groups:
        norms = np.linalg.norm(stack(group)[1], axis=1)
        if len(norms) and np.abs(norms - 1.0).max() < NORM_ERROR and not all(signal.is_constant for signal in group):
            yield stem, group, named


def tell_partial(signals: Sequence[Signal]) -> str:
    """Which two of roll, pitch and yaw there are without the third, in words; "" for none."""
    measured = [signal for signal in signals if not is_commanded(signal)]
    for lost in EULER:
        pair = [name for name in EULER if name != lost]
        for stem in find_groups(measured, pair, UNIT_AT_END):
            return f": {stem}{' and '.join(pair)} without {lost}"
    return ""


def tell_body(signals: Sequence[Signal], body: str) -> Iterator[BodyCandidate]:
    """What a body's signals are: position, attitude and rate, and, without a quantity, what shows the same."""
    attitudes: dict[str, list[Signal]] = {}
    measured = [signal for signal in signals if not is_commanded(signal)]
    triples = {**number_groups(measured, 3), **find_groups(measured, AXES)}
    turning = find_rates(measured, triples)
    for stem, group, named in find_quaternions(measured):
        candidate, attitudes[stem] = tell_quaternion(stem, group, named, turning)
        yield candidate
    angles = {} if attitudes else find_groups(measured, EULER, UNIT_AT_END)
    for stem, group in angles.items():
        if not all(signal.is_constant for signal in group):
            unit = group[0].unit
            said, small = unit in dict(ANGLES), all(np.ptp(signal.finite) < MAX_ANGLE for signal in group)
            unit = unit if said else "rad" if small else "deg"
            attitudes[stem] = turn_signals(group, dict(ANGLES)[unit])
            text = f"attitude: {stem}roll, pitch, yaw in {unit}{'' if said else ' by how far they go'}"
            yield BodyCandidate("attitude", text, False, tuple(group), "" if unit == "rad" else unit)
    places = {stem: group for stem, group in triples.items() if angles or stem not in attitudes}
    yield from tell_positions(places, body, attitudes)
    for stem, group in find_groups(signals, EULER).items():
        if attitudes and not angles and not any(is_commanded(signal) for signal in group):
            yield tell_angles(stem, group, next(iter(attitudes.values())))
    for stem, group in triples.items():
        words = set(split_words(stem.split(" ", 1)[1]))
        if (
            stem not in turning
            and words & {"acc", "accel", "acceleration"}
            and words & {"imu", "accel", "accelerometer"}
        ):
            yield tell_gravity(stem, group)
    for stem, group in turning.items() if attitudes else ():
        yield tell_gyro(stem, group, next(iter(attitudes.values())))


def tell_positions(
    triples: Mapping[str, list[Signal]], body: str, attitudes: Container[str]
) -> Iterator[BodyCandidate]:
    """Positions, by the name of the message, the body or its attitude, or each with the velocity that is its slope."""
    for stem, group in triples.items():
        topic, _, name = stem.partition(" ")
        axes = f"{stem} of three numbers" if group[0].label[-1:] in "0123]" else f"{stem}x, y, z"
        bare = name.rstrip("._")
        if bare and any(f"{stem}{turned}" in attitudes for turned in BESIDE):
            yield BodyCandidate("position", f"position: {axes}: called as its attitude", True, tuple(group))
            continue
        if name in ROS_POSITIONS:
            yield BodyCandidate("position", f"position: {axes}, of a message of poses", True, tuple(group))
        words = [word for word in split_words(name) if word not in NAMED]
        if words and (words == split_words(body) or set(words) <= TRACKED):
            yield BodyCandidate("position", f"position: {axes}: its name", True, tuple(group))
            continue
        place = re.fullmatch(r"(|.*[._])(p|pos|position)([._]?)", name)
        if place is None and bare and not bare.endswith(("state", "estimate")):
            continue
        base = place.group(1) + RATES[place.group(2)] + place.group(3) if place else f"{name}v"
        velocity = triples.get(f"{topic} {base}")
        if velocity is None:
            yield BodyCandidate("position", f"position: {axes} by name alone", False, tuple(group))
            continue
        tests = [compare_slope(p, v) for p, v in zip(group, velocity)]
        shares = [share for r, share in tests if np.isfinite(r) and r > SLOPE]
        good = len(shares) >= 2 and all(CLOSE[0] < share < CLOSE[1] for share in shares)
        numbers = ", ".join(f"{share:.2f} (r {r:.2f})" for r, share in tests)
        beside = base if axes.endswith("numbers") else f"{base}x, vy, vz" if base.endswith("v") else f"{base}x, y, z"
        text = f"position: {axes}, velocity {beside}; shares of the slope {numbers}"
        yield BodyCandidate("position", text, good, tuple(group))


def tell_quaternion(
    stem: str, group: Sequence[Signal], named: bool, turning: Mapping[str, Sequence[Signal]]
) -> tuple[BodyCandidate, list[Signal]]:
    """What a quaternion is, and its x, y, z, w; where rates say so, in another order or sense than its names do."""
    time, numbers = stack(group)
    rates = [stack(rate) for rate in turning.values()]

    def ask(order: Sequence[int]) -> Convention | None:
        """Which other convention rates ask for."""
        answers = (find_convention((time, numbers[:, order]), rate) for rate in rates)
        return next((answer for answer in answers if answer is not None and answer.of == "attitude"), None)

    off = float(np.abs(np.linalg.norm(numbers, axis=1) - 1.0).max())
    called = f"{stem}x, y, z, w" if named else f"{stem} of four numbers"
    text, first, last = f"attitude: {called} is a quaternion (norm within {off:.1g} of 1)", (0, 1, 2, 3), (3, 0, 1, 2)
    better, sure = ask(first), named
    if better is not None:
        sure = not named and better.order == last and min(better.signs) > 0.0
        letters = [f"{'-' * (sign < 0.0)}{group[i].label}" for i, sign in zip(better.order, better.signs)]
        text += f", of which w, x, y, z are {', '.join(letters)}: as its rates turn ({1.0 - better.residual:.0%}"
        text += f" of the turning, {1.0 - better.given:.0%} as {'named' if named else 'numbered'})"
    elif not named and ask(last) is not None:
        sure, text = True, f"{text}, w first: as its rates turn"
    elif not named:
        text += ": w, x, y, z, or x, y, z, w?"
    better = better or Convention("attitude", first, 4 * (1.0,))
    ordered = [group[i] for i in better.order]
    more = {"scale": [int(sign) for sign in better.signs]} if min(better.signs) < 0.0 else {}
    w, x, y, z = (replace(signal, values=sign * signal.values) for signal, sign in zip(ordered, better.signs))
    return BodyCandidate("attitude", text, sure, tuple(ordered), "", more), [x, y, z, w]


def tell_angles(stem: str, group: Sequence[Signal], attitude: Sequence[Signal]) -> BodyCandidate:
    """In which unit roll, pitch and yaw show the attitude, and which of them with the other sign."""
    x, y, z, w = (signal.values for signal in attitude)
    roll, pitch, yaw = read_angles(np.stack([w, x, y, z], axis=1)).T
    shares = []
    for angle, signal in zip((roll, pitch, np.unwrap(yaw)), group):
        _, shown, seen = resample(signal, replace(attitude[0], values=angle))
        good = len(shown) and min(shown.std(), seen.std()) > 1e-6
        shares.append(
            (float(np.corrcoef(shown, seen)[0, 1]), float(shown.std() / seen.std())) if good else (np.nan, np.nan)
        )
    unit, sure, numbers = choose_unit([(abs(r), share) for r, share in shares], ANGLES)
    turned = [name for name, (r, _) in zip(("roll", "pitch", "yaw"), shares) if r < -SLOPE]
    text = f"angles: {stem}roll, pitch, yaw in {unit or 'no known unit'}"
    text += f", {' and '.join(turned)} with the other sign" if turned else ""
    return BodyCandidate("", f"{text}; shares of the attitude {numbers}", sure, tuple(group))


def tell_gravity(stem: str, group: Sequence[Signal]) -> BodyCandidate:
    """In which unit an accelerometer shows gravity where it is stillest."""
    norm = np.sqrt(np.sum([signal.values**2 for signal in group], axis=0))
    width = max(round(REST_S * group[0].rate), 2)
    windows = [norm[i : i + width] for i in range(0, max(len(norm) - width, 1), max(width // 4, 1))]
    spread, rest = min((float(np.std(w)), float(np.median(w))) for w in windows if np.median(w) > 0.0)
    unit = next((unit for unit, one in GRAVITIES if 0.9 < rest * one / 9.80665 < 1.1), "")
    text = f"accelerometer: {stem}x, y, z shows {rest:.4g} at rest (spread {spread:.2g})"
    text += f", so it is in {unit}" if unit else ": no gravity in any unit"
    return BodyCandidate("", text, bool(unit), tuple(group))


def tell_gyro(stem: str, group: Sequence[Signal], attitude: Sequence[Signal]) -> BodyCandidate:
    """In which unit rates turn with the attitude, and about which axes."""
    (time, q), (clock, values) = stack([attitude[3], *attitude[:3]]), stack(group)
    better, about, ordered = find_convention((time, q), (clock, values)), "", list(group)
    more: dict[str, object] = {}
    if better is not None and better.of == "frame":
        turned = interpolate(clock, time, follow_sign(q))
        values = turn_rates_to_body(turned / np.linalg.norm(turned, axis=1, keepdims=True), values, better.frame)
        more = {"frame": better.frame}
        shares = f"{1.0 - better.residual:.1%} of the turning, {1.0 - better.given:.1%} about the body's"
        about = f" about {ABOUT[better.frame]} ({shares})"
    elif better is not None and better.of == "rate":
        values, ordered = better.read(values), [group[i] for i in better.order]
        more = {"scale": [int(sign) for sign in better.signs]}
        about = " with an axis turned round, or two swapped"
    period = float(np.median(np.diff(time)))
    width = max(round(SMOOTH / period), 1)
    rates = difference_attitudes(q[:-width], q[width:]) / (width * period)
    middle = 0.5 * (time[width:] + time[:-width])
    smooth = [np.convolve(column, np.ones(width) / width, "same") for column in values.T]
    pairs = [
        (Signal("", "", "", "", "", "", middle, rates[:, axis]), replace(group[axis], time=clock, values=smooth[axis]))
        for axis in range(3)
    ]
    _, lag = compare_lag(*pairs[int(np.argmax(rates.std(axis=0)))])  # three axes have one clock
    lag, results = lag if np.isfinite(lag) else 0.0, []
    for seen_by, shown_by in pairs:
        _, shown, seen = resample(replace(shown_by, time=shown_by.time - lag), seen_by)
        still = not len(shown) or min(shown.std(), seen.std()) < STILL
        share = (np.nan, np.nan) if still else (np.corrcoef(shown, seen)[0, 1], shown @ seen / (seen @ seen))
        results.append((float(share[0]), float(share[1])))
    unit, sure, numbers = choose_unit(results, RATE_UNITS)
    kind = "gyro" if is_gyro(stem) else "rates"
    text = f"{kind}: {stem}x, y, z{about} in {unit or 'no known unit'}; shares of the turning {numbers}"
    text += f", {1e3 * lag:.0f} ms after the attitude" if lag else ""
    sure = sure and (better is None or better.of == "frame")
    return BodyCandidate("rate", text, sure, tuple(ordered), "" if unit == "rad/s" else unit, more)


def choose_unit(tests: Sequence[tuple[float, float]], units: Sequence[tuple[str, float]]) -> tuple[str, bool, str]:
    """The unit in which three axes show what they should, "" for none; whether all do; the numbers.

    Tests are correlation and share of each axis, units their size in SI.
    """
    strong = [share for r, share in tests if r > SLOPE]
    fits = (u for u, one in units if strong and all(CLOSE[0] < share * one < CLOSE[1] for share in strong))
    unit = next(fits, "")
    numbers = ", ".join(f"{share:.3g} (r {r:.2f})" for r, share in tests)
    return unit, bool(unit) and len(strong) == len(tests), numbers
