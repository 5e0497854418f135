"""Signals that show how a body turns: quaternions and rates, in which order, sense, unit and about which axes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vpptwin.estimation.checks.frames import ABOUT, Reading, look_up, tell_rates, turn_rates_to_body
from vpptwin.mapping.alike import compare_lag, resample
from vpptwin.mapping.guess import CLOSE, SLOPE
from vpptwin.mapping.survey import Signal
from vpptwin.mapping.words import part_index, split_words
from vpptwin.system.fields import UNITS
from vpptwin.twin.robot.manifold import difference_attitudes, follow_sign

AXES = ("x", "y", "z")
TURNS = (("rad/s", 1.0), ("deg/s", UNITS["deg/s"][1]), ("mrad/s", 1e-3))
STILL = 1e-9
"""Rates that vary by less do not turn [rad/s]."""
UNIT = 0.02
"""What a quaternion's norm may be off by."""


@dataclass(frozen=True)
class Told:
    """What signals of a body are: `quantity`, in `unit` ("" for SI or none), in words, and whether that is sure."""

    quantity: str
    text: str
    sure: bool
    signals: tuple[Signal, ...]
    unit: str = ""
    more: Mapping[str, object] = field(default_factory=dict)  # what else the twin says of them: scale, frame


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


def stack(signals: Sequence[Signal]) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) s of the first, where all have numbers, and values (n, k)."""
    time = signals[0].time
    values = np.stack([s.values if s.time is time else np.interp(time, s.time, s.values) for s in signals], axis=1)
    known = np.isfinite(values).all(axis=1)
    return time[known], values[known]


def find_rates(signals: Sequence[Signal]) -> dict[str, list[Signal]]:
    """Rates about three axes, by what their names share; what is called wx only where nothing is a gyro's."""
    triples = {**number_groups(signals, 3), **find_groups(signals, AXES)}
    found = {stem: group for stem, group in triples.items() if is_gyro(stem)}
    plain = find_groups(signals, ("wx", "wy", "wz"), r"(?:_[a-z]+)?")
    return found or {f"{stem}w": group for stem, group in plain.items()}


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
        if len(norms) and np.abs(norms - 1.0).max() < UNIT and not all(signal.is_constant for signal in group):
            yield stem, group, named


def tell_quaternion(
    stem: str, group: Sequence[Signal], named: bool, turning: Mapping[str, Sequence[Signal]]
) -> tuple[Told, list[Signal]]:
    """What a quaternion is, and its x, y, z, w; where rates say so, in another order or sense than its names do."""
    time, numbers = stack(group)
    rates = [stack(rate) for rate in turning.values()]

    def ask(order: Sequence[int]) -> Reading | None:
        """Which other reading of it rates ask for."""
        answers = (tell_rates(time, numbers[:, order], *rate) for rate in rates)
        return next((answer for answer in answers if answer is not None and answer.of == "attitude"), None)

    off = float(np.abs(np.linalg.norm(numbers, axis=1) - 1.0).max())
    called = f"{stem}x, y, z, w" if named else f"{stem} of four numbers"
    text, first, last = f"attitude: {called} is a quaternion (norm within {off:.1g} of 1)", (0, 1, 2, 3), (3, 0, 1, 2)
    reading, sure = ask(first), named
    if reading is not None:
        sure = not named and reading.order == last and min(reading.signs) > 0.0
        letters = [f"{'-' * (sign < 0.0)}{group[i].label}" for i, sign in zip(reading.order, reading.signs)]
        text += f", of which w, x, y, z are {', '.join(letters)}: as its rates turn ({1.0 - reading.missed:.0%}"
        text += f" of the turning, {1.0 - reading.given:.0%} as {'named' if named else 'numbered'})"
    elif not named and ask(last) is not None:
        sure, text = True, f"{text}, w first: as its rates turn"
    elif not named:
        text += ": w, x, y, z, or x, y, z, w?"
    reading = reading or Reading("attitude", first, 4 * (1.0,))
    ordered = [group[i] for i in reading.order]
    more = {"scale": [int(sign) for sign in reading.signs]} if min(reading.signs) < 0.0 else {}
    w, x, y, z = (replace(signal, values=sign * signal.values) for signal, sign in zip(ordered, reading.signs))
    return Told("attitude", text, sure, tuple(ordered), "", more), [x, y, z, w]


def tell_gyro(stem: str, group: Sequence[Signal], attitude: Sequence[Signal]) -> Told:
    """In which unit rates turn with the attitude, and about which axes."""
    (time, q), (clock, values) = stack([attitude[3], *attitude[:3]]), stack(group)
    found, about, ordered = tell_rates(time, q, clock, values), "", list(group)
    more: dict[str, object] = {}
    if found is not None and found.of == "frame":
        turned = look_up(clock, time, follow_sign(q))
        values = turn_rates_to_body(turned / np.linalg.norm(turned, axis=1, keepdims=True), values, found.frame)
        more = {"frame": found.frame}
        shares = f"{1.0 - found.missed:.1%} of the turning, {1.0 - found.given:.1%} about the body's"
        about = f" about {ABOUT[found.frame]} ({shares})"
    elif found is not None and found.of == "rate":
        values, ordered = found.read(values), [group[i] for i in found.order]
        more = {"scale": [int(sign) for sign in found.signs]}
        about = " with an axis turned round, or two swapped"
    period = float(np.median(np.diff(time)))
    width = max(round(0.05 / period), 1)
    rates = difference_attitudes(q[:-width], q[width:]) / (width * period)
    middle = 0.5 * (time[width:] + time[:-width])
    smooth = [np.convolve(column, np.ones(width) / width, "same") for column in values.T]
    pairs = [
        (Signal("", "", "", "", "", "", middle, rates[:, axis]), replace(group[axis], time=clock, values=smooth[axis]))
        for axis in range(3)
    ]
    _, lag = compare_lag(*pairs[int(np.argmax(rates.std(axis=0)))])  # three axes have one clock
    lag, results = lag if np.isfinite(lag) else 0.0, []
    for turning, shown_by in pairs:
        _step, shown, turned = resample(replace(shown_by, time=shown_by.time - lag), turning)
        still = not len(shown) or min(shown.std(), turned.std()) < STILL
        share = (np.nan, np.nan) if still else (np.corrcoef(shown, turned)[0, 1], shown @ turned / (turned @ turned))
        results.append((float(share[0]), float(share[1])))
    unit, sure, numbers = choose_unit(results, TURNS)
    kind = "gyro" if is_gyro(stem) else "rates"
    text = f"{kind}: {stem}x, y, z{about} in {unit or 'no known unit'}; shares of the turning {numbers}"
    text += f", {1e3 * lag:.0f} ms after the attitude" if lag else ""
    sure = sure and (found is None or found.of == "frame")
    return Told("rate", text, sure, tuple(ordered), "" if unit == "rad/s" else unit, more)


def choose_unit(tests: Sequence[tuple[float, float]], units: Sequence[tuple[str, float]]) -> tuple[str, bool, str]:
    """The unit in which three axes show what they should, "" for none; whether all do; the numbers.

    Tests are correlation and share of each axis, units their size in SI.
    """
    strong = [share for r, share in tests if r > SLOPE]
    fits = (u for u, one in units if strong and all(CLOSE[0] < share * one < CLOSE[1] for share in strong))
    unit = next(fits, "")
    numbers = ", ".join(f"{share:.3g} (r {r:.2f})" for r, share in tests)
    return unit, bool(unit) and len(strong) == len(tests), numbers
