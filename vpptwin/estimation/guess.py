"""Which signal of a log is which joint and actuator of a model: by name, order and kind, tested against physics."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from vpptwin.estimation.turns import TURN, follow_turns, unwrap_turns
from vpptwin.fields import UNITS
from vpptwin.logs.flight import Stream
from vpptwin.logs.survey import Signal
from vpptwin.twin.actuation import tell_control

WORDS = {
    "acceleration": "acc accel acceleration ax ay az ddot",
    "velocity": "vel velocity velocities qd dq qdot qvel speed omega rate dot gyro vx vy vz wx wy wz",
    "effort": "tau torque torques effort efforts force forces moment moments thrust thrusts current",
    "position": "pos position positions q qpos angle angles theta phi psi alpha beta gamma state",
    "drive": "pwm throttle duty voltage volt volts u motor motors rotor rotors",
}
"""Quantity → words in names that tell it, the first that matches."""
MEASURED = {"rad": "position", "m": "position", "rad/s": "velocity", "m/s": "velocity", "m/s^2": "acceleration",
            "N": "effort", "N m": "effort", "A": "effort", "V": "drive"}  # fmt: skip
"""What a signal is whose name tells nothing, by its unit."""
PLACES = {"m": {"x", "y", "z", "pos", "position"}, "rad": {"theta", "phi", "psi", "alpha", "beta", "gamma", "angle"}}
"""Unit of a slide or hinge → words that tell positions of that kind."""
COMMANDED = {
    "control", "controller", "cmd", "command", "commands", "target", "setpoint", "sp", "des", "desired", "ref",
    "reference", "goal", "action", "con", "ctrl",
}  # fmt: skip
DERIVED = {"filt", "filtered", "smooth", "fric", "friction", "comp", "err", "error", "ff", "diff", "est"}
UNIT_WORDS = {"deg", "degs", "degps", "dps", "rad", "rads", "radps", "m", "mm", "cm", "mps", "s", "sec", "per"}
"""Words at the end of names that tell a unit."""
SLOPE = 0.8
"""Correlation of a velocity with the slope of its position below which they are strangers."""
CLOSE = 0.6, 1.6
"""What a velocity may be of the slope: those of `docs/logs.md`."""
STILL = 1e-9
FAR = {"rad": 2.0 * np.pi, "m": 5.0}
"""Travel without a said unit that may be in a smaller one."""


@dataclass
class Guess:
    """What one joint, actuator, free body or IMU may be in the log."""

    target: str  # its name; `group` is joints, actuators, bodies or sites
    group: str
    fields: dict[str, Signal] = field(default_factory=dict)  # position, velocity or effort → the signal
    # position, attitude or rate of a body → its signals, in one topic
    vectors: dict[str, tuple[Signal, ...]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)  # likewise, where it is not SI
    sure: bool = False  # whether there is no doubt
    reasons: list[str] = field(default_factory=list)  # what speaks for it, with numbers
    doubts: list[str] = field(default_factory=list)  # what speaks against it, or what else it may be
    motion: Signal | None = None  # the position, if it is a joint's, as it goes on beyond a turn [m, rad]


def split_words(text: str) -> list[str]:
    """Small words of a name; digits part from letters."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)
    return re.findall(r"[a-z]+|\d+", parted.lower())


def strip_unit(text: str) -> list[str]:
    """Small words of a name without those of a unit at its end."""
    words = split_words(text)
    while len(words) > 1 and words[-1] in UNIT_WORDS:
        words.pop()
    return words


def tell_quantity(signal: Signal) -> str:
    """position, velocity, effort, acceleration, or "" where the name tells nothing."""
    if signal.name:
        return signal.field
    words = split_words(signal.label)
    if words[:1] == ["data"]:  # of an array without names: its topic tells what it is
        words = split_words(signal.topic)
    places = {*WORDS["position"].split(), *PLACES["m"]}
    rates = {f"d{word}" for word in places} | {f"{word}dot" for word in places}
    if rates & set(words):
        return "velocity"
    told = next((kind for kind, known in WORDS.items() if set(words) & set(known.split())), "")
    return told or MEASURED.get(UNITS.get(signal.unit, ("",))[0], "")


def is_commanded(signal: Signal) -> bool:
    """Whether a signal's name says that it was asked for, not measured; or its topic's, where it is one of several."""
    return bool(COMMANDED & {*split_words(signal.label), *([] if signal.alone else split_words(signal.topic))})


def is_derived(signal: Signal) -> bool:
    """Whether it was made of another signal."""
    return bool(DERIVED & set(split_words(signal.label)))


def part_index(signal: Signal) -> tuple[str, int | None]:
    """Topic and name without the index in it, and the index."""
    match = re.fullmatch(r"(.*?)[_\[]?(\d+)\]?", signal.label)
    stem, index = (match.group(1), int(match.group(2))) if match else (signal.label, None)
    return f"{signal.topic} {stem}", index


def guess_signals(model: mujoco.MjModel, signals: Sequence[Signal]) -> list[Guess]:
    """The likeliest signals of every hinge, slide and actuator.

    Nothing is sure that rests on the order of columns alone, that has a rival, or that physics contradicts.
    """
    plain = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    joints = [model.joint(i) for i in range(model.njnt) if model.jnt_type[i] in plain]
    names = [joint.name for joint in joints]
    measured = [signal for signal in signals if not is_commanded(signal)]
    guesses = [Guess(name, "joints") for name in names]
    for quantity in ("position", "velocity"):
        pool = [signal for signal in measured if tell_quantity(signal) == quantity]
        if quantity == "position":  # a column that is called like a joint, and nothing more
            pool += [s for s in measured if not tell_quantity(s) and split_words(s.label) in map(split_words, names)]
        assign(guesses, names, pool, quantity)
        if quantity == "position":
            for length, kind in zip(PLACES, plain):
                assign_kind([g for g, joint in zip(guesses, joints) if joint.type[0] == kind], measured, length)
        else:
            for guess in guesses:
                own = [s for s in pool if "position" in guess.fields and is_slope_of(s, guess.fields["position"])]
                if "velocity" not in guess.fields:
                    settle(guess, "velocity", own, "its name")
    for guess, joint in zip(guesses, joints):
        check_joint(guess, model, int(joint.id))
    motors = [model.actuator(i).name for i in range(model.nu)]
    commands = [Guess(name, "actuators") for name in motors]
    taken = [signal for guess in guesses for signal in guess.fields.values()]
    bare = [s for s in signals if not tell_quantity(s) and s not in taken and not s.name]
    for asked in ("position", "velocity", "effort"):
        chosen = [guess for i, guess in enumerate(commands) if tell_control(model, i) == asked]
        pool = [s for s in signals if is_control(s, asked)]
        # As of joints: a column that is called like one of them, and nothing more but that it was asked for.
        called = [split_words(guess.target) for guess in chosen]
        pool += [s for s in bare if s not in pool and [w for w in split_words(s.label) if w not in COMMANDED] in called]
        assign(chosen, [guess.target for guess in chosen], pool, "effort")
        for guess in (guess for guess in chosen if not guess.fields):
            joint_words = split_words(find_moved(model, motors.index(guess.target)))
            own = [s for s in pool if [w for w in split_words(s.label) if w not in COMMANDED] == joint_words]
            settle(guess, "effort", own, "the name of the joint that it moves")
    for i, guess in enumerate(commands):
        driven = find_moved(model, i)
        moved = next((g.motion for g in guesses if g.target == driven), None)
        check_actuator(guess, model, i, moved)
    for guess in guesses if not any(command.fields for command in commands) else ():
        position = guess.fields.get("position")
        if position is not None and position.alone and COMMANDED & set(split_words(position.topic)):
            guess.doubts.append(f"the log is called {position.topic}: was {position.label} measured, or asked for?")
            guess.sure = False
    return [*guesses, *commands]


def is_control(signal: Signal, kind: str) -> bool:
    """Whether a signal may be what a servo is asked for, or what a motor is driven by."""
    if kind == "effort":
        return signal.field == "effort" if signal.name else tell_quantity(signal) in ("effort", "drive")
    if signal.name:
        return signal.field == (kind if is_commanded(signal) else "effort")
    return is_commanded(signal) and tell_quantity(signal) in (kind, "")


def find_moved(model: mujoco.MjModel, actuator: int) -> str:
    """Name of the joint that an actuator acts on itself; "" for none."""
    return str(model.joint(model.actuator_trnid[actuator, 0]).name) if model.actuator_trntype[actuator] == 0 else ""


def assign(guesses: Sequence[Guess], names: Sequence[str], pool: Sequence[Signal], quantity: str) -> None:
    """Give each of them its signal of a pool: by name, as the only one, or by order."""
    for guess in guesses:
        settle(guess, quantity, [s for s in pool if names_it(s, guess.target, names)], "its name")
    open_guesses = [guess for guess in guesses if quantity not in guess.fields]
    if len(open_guesses) < len(guesses) or not guesses:
        return
    groups: dict[str, dict[int, Signal]] = {}
    for signal in pool:
        stem, index = part_index(signal)
        groups.setdefault(stem, {})[-1 if index is None or len(guesses) == 1 else index] = signal
    fitting = [[group[k] for k in sorted(group)] for group in groups.values() if len(group) == len(guesses)]
    fitting = [group for group in fitting if not any(signal.is_constant for signal in group)] or fitting
    for i, guess in enumerate(guesses):
        basis = "the only one there is" if len(guesses) == 1 else f"order: number {i + 1} of {len(guesses)}"
        settle(guess, quantity, [group[i] for group in fitting], basis)
        if len(guesses) > 1 and quantity in guess.fields and quantity != "velocity":
            guess.doubts.append(f"only the order says that {guess.fields[quantity].label} is {guess.target}")


def assign_kind(guesses: Sequence[Guess], measured: Sequence[Signal], length: str) -> None:
    """Give all slides, or all hinges, for which nothing was found, the positions of that kind, if there are as many."""
    found = [s for s in measured if not s.name and tell_quantity(s) in ("position", "")
             and (UNITS.get(s.unit, ("",))[0] == length or PLACES[length] & set(split_words(s.label)))]  # fmt: skip
    if len(found) != len(guesses) or any("position" in guess.fields for guess in guesses):
        return
    for guess, signal in zip(guesses, found):
        settle(guess, "position", [signal], "the only one of that kind" if len(found) == 1 else "kind and order")
        guess.doubts.append(f"only that says that {signal.label} is {guess.target}")


def is_slope_of(velocity: Signal, position: Signal) -> bool:
    """Whether a velocity is called as a position is but for what says that it is one: `dx`, `theta_dot`, `pos_vel`."""
    stem = [word for word in strip_unit(velocity.label) if word not in WORDS["velocity"].split()]
    if velocity.topic != position.topic or velocity.name or not stem:
        return False
    return [*stem[:-1], stem[-1].removeprefix("d").removesuffix("dot")] == strip_unit(position.label)


def names_it(signal: Signal, name: str, others: Sequence[str]) -> bool:
    """Whether a signal is called by a name, word by word, and by no longer one that holds it."""
    if signal.name:
        return signal.name == name

    def holds(words: Sequence[str], part: Sequence[str]) -> bool:
        return bool(part) and any(words[i : i + len(part)] == part for i in range(len(words) - len(part) + 1))

    called, own = split_words(signal.label), split_words(name)
    longer = [split_words(other) for other in others if other != name]
    return holds(called, own) and not any(holds(other, own) and holds(called, other) for other in longer)


def settle(guess: Guess, quantity: str, own: Sequence[Signal], basis: str) -> None:
    """Take the likeliest signal, and note its rivals: commands before measurements of effort, raw ones first."""
    if not own:
        return
    ranked = sorted(own, key=lambda s: (is_derived(s), s.is_constant, quantity == "effort" and not is_commanded(s)))
    best = ranked[0]
    guess.fields[quantity] = best
    guess.reasons.append(f"{best.label}: {basis}")
    rivals = [s for s in ranked[1:] if is_derived(s) == is_derived(best)]
    if rivals:
        guess.doubts.append(f"or {', '.join(s.title for s in rivals[:4])}")
    if is_derived(best):
        guess.doubts.append(f"{best.label} may be made of another signal")
    if best.is_constant:
        guess.doubts.append(f"{best.label} is constant")


def name_length(model: mujoco.MjModel, joint: int) -> str:
    """SI unit of where a hinge or slide is."""
    return "rad" if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_HINGE) else "m"


def check_joint(guess: Guess, model: mujoco.MjModel, joint: int) -> None:
    """Hold a joint's signals against each other, its kind and its range."""
    position, velocity = guess.fields.get("position"), guess.fields.get("velocity")
    length = name_length(model, joint)
    if position is None:
        guess.doubts.append("no position in the log looks like it")
        if velocity is not None:
            guess.units |= check_unit(guess, "velocity", velocity, f"{length}/s")
            guess.doubts.append("its velocity is integrated, which does for a wheel")
        return
    guess.units |= check_unit(guess, "position", position, length)
    scale = UNITS[guess.units.get("position", length)][1]
    limits = model.jnt_range[joint] if model.jnt_limited[joint] else None
    guess.motion, mended = straighten(position, scale, limits, length == "rad")
    guess.reasons += mended
    if velocity is not None:
        guess.units |= check_unit(guess, "velocity", velocity, f"{length}/s")
        of_rate = UNITS[guess.units.get("velocity", f"{length}/s")][1]
        correlation, share = compare_slope(guess.motion, velocity)
        share *= of_rate
        told = f"{velocity.label} is {share:.2f} of the slope of {position.label} (r {correlation:.2f})"
        if not np.isfinite(correlation):
            guess.doubts.append("too little motion to test the velocity")
        elif correlation < SLOPE or not CLOSE[0] < share < CLOSE[1]:
            guess.doubts.append(f"left out: {told}")
            guess.fields.pop("velocity")
            guess.units.pop("velocity", None)
        else:
            guess.reasons.append(told)
    check_range(guess, position, guess.motion.values, limits, length)
    travel = float(np.ptp(position.finite)) if len(position.finite) else 0.0
    if not (model.jnt_limited[joint] or position.name or position.unit) and travel > FAR[length]:
        guess.doubts.append(
            f"{position.label} travels {travel:.3g}: {length}, or {'deg' if length == 'rad' else 'mm'}?"
        )
    if "velocity" not in guess.fields and not position.name and "its name" not in " ".join(guess.reasons):
        guess.doubts.append("no velocity tests it")
    guess.sure = not guess.doubts


def check_unit(guess: Guess, quantity: str, signal: Signal, expected: str) -> dict[str, str]:
    """The unit that the log says, if it is one of that kind and not SI."""
    if not signal.unit or signal.unit == expected:
        return {}
    if signal.unit in UNITS and UNITS[signal.unit][0] == expected:
        guess.reasons.append(f"{signal.label} is in {signal.unit}")
        return {quantity: signal.unit}
    guess.doubts.append(f"{signal.label} is in {signal.unit}, where {expected} was expected")
    return {}


def check_range(guess: Guess, signal: Signal, values: np.ndarray, limits: np.ndarray | None, length: str = "") -> None:
    """Hold a signal, whose values (n,) these are in SI units, against limits; say which unit would fit."""
    if limits is None or not len(values):
        return
    margin = 0.05 * float(limits[1] - limits[0])

    def lie_outside(factor: float) -> float:
        scaled = values * factor
        return float(np.mean((scaled < limits[0] - margin) | (scaled > limits[1] + margin)))

    outside = lie_outside(1.0)
    if outside <= 0.01:
        return
    told = f"{outside:.0%} of {signal.label} lie outside {limits[0]:.3g} to {limits[1]:.3g}"
    smaller, size = ("deg", np.pi / 180.0) if length == "rad" else ("mm", 1e-3)
    fits = length and np.ptp(values) > FAR[length] and lie_outside(size) <= 0.01
    counted = length == "rad" and np.ptp(values) > FAR[length] and not np.any(signal.finite % 1.0)
    otherwise = "counts of an encoder, of which 4096 a turn have scale: 0.001534" if counted else "another sign or zero"
    guess.doubts.append(f"{told}: {f'in {smaller}' if fits else otherwise}?")


def check_actuator(guess: Guess, model: mujoco.MjModel, actuator: int, moved: Signal | None) -> None:
    """Hold a command against its range and, where it is a target, against what follows it."""
    command = guess.fields.get("effort")
    if command is None:
        guess.doubts.append("no command in the log looks like it")
        return
    limits = model.actuator_ctrlrange[actuator] if model.actuator_ctrllimited[actuator] else None
    kind, length = tell_control(model, actuator), ""
    if kind == "position" and model.actuator_trntype[actuator] == 0 and model.actuator_gear[actuator, 0] == 1.0:
        length = name_length(model, model.actuator_trnid[actuator, 0])
        guess.units |= check_unit(guess, "effort", command, length)
    raw = kind == "effort" and tell_quantity(command) == "drive"
    known, scale = np.isfinite(command.values), UNITS[guess.units.get("effort", length)][1] if length else 1.0
    asked = replace(command, time=command.time[known], values=command.values[known] * scale)
    if length == "rad" and moved is not None and len(moved.values):
        stops = model.jnt_range[joint] if model.jnt_limited[joint := model.actuator_trnid[actuator, 0]] else None
        track = asked.time, asked.values
        asked = replace(asked, values=follow_turns(track, (moved.time, moved.values), stops, TURN, False))
    if not raw:
        check_range(guess, command, asked.values, limits, length)
    if kind == "effort":
        if raw:
            low, high = command.whole.low, command.whole.high
            guess.doubts.append(
                f"{command.label} goes from {low:.4g} to {high:.4g}: how much force is that? a scale or polynomial"
            )
        elif not command.name and not is_commanded(command):
            guess.doubts.append(f"{command.label} may be measured, not commanded")
    elif moved is not None:
        if kind == "position":
            correlation, lag = compare_lag(asked, moved)
            told = f"{moved.label} follows {command.label} by {1e3 * lag:.0f} ms (r {correlation:.2f})"
        else:
            (correlation, share), lag = compare_slope(moved, command), 0.0
            told = f"{command.label} is {share:.2f} of the slope of {moved.label} (r {correlation:.2f})"
        if not np.isfinite(correlation):
            guess.doubts.append("too little motion to see the joint follow")
        elif correlation < SLOPE or lag < 0.0:
            guess.doubts.append(told)
        else:
            guess.reasons.append(told)
    guess.sure = not guess.doubts


def resample(first: Signal, second: Signal) -> tuple[float, np.ndarray, np.ndarray]:
    """Period [s] and both signals (n,) over the time that they share, finite and at a constant rate."""
    good = [(s.time[np.isfinite(s.values)], s.values[np.isfinite(s.values)]) for s in (first, second)]
    if not all(len(time) for time, _ in good):
        return 1.0, np.zeros(0), np.zeros(0)
    start, end = max(time[0] for time, _ in good), min(time[-1] for time, _ in good)
    period = max(1.0 / min(s.rate for s in (first, second)), (end - start) / 50_000.0)
    grid = np.arange(start, end, period)
    if len(grid) < 20:
        return period, np.zeros(0), np.zeros(0)
    return period, *(np.interp(grid, time, values) for time, values in good)


def straighten(position: Signal, scale: float, limits: np.ndarray | None, rotary: bool) -> tuple[Signal, list[str]]:
    """A position logged in units of `scale`, in SI units, that goes on where it was logged within one turn."""
    known = np.isfinite(position.values)
    stream = Stream(position.time[known], {"position": scale * position.values[known]})
    stream, told = unwrap_turns(stream, position.label, limits, rotary)
    return replace(position, time=stream.time, values=stream["position"]), told


def compare_slope(position: Signal, velocity: Signal) -> tuple[float, float]:
    """Correlation of a velocity with the slope of a position over 0.1 s, and its share of that; NaN if it is still."""
    period, place, rate = resample(position, velocity)
    width = max(round(0.1 / period), 1)
    if len(place) < 4 * width:
        return np.nan, np.nan
    moved = place[width:] - place[:-width]
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * period)])
    turned = summed[width:] - summed[:-width]
    if moved.std() < STILL or turned.std() < STILL:
        return np.nan, np.nan
    return float(np.corrcoef(moved, turned)[0, 1]), float(turned @ moved / (moved @ moved))


def compare_lag(target: Signal, position: Signal) -> tuple[float, float]:
    """Correlation of a position with its target at the lag at which it is greatest, and that lag [s]; NaN if still."""
    period, asked, found = resample(target, position)
    if len(asked) < 20 or asked.std() < STILL or found.std() < STILL:
        return np.nan, np.nan
    most = min(round(0.5 / period), len(asked) // 4)
    lags = list(range(-most, most + 1))
    values = [np.corrcoef(asked[max(-k, 0) : len(asked) - max(k, 0)], found[max(k, 0) : len(found) - max(-k, 0)])[0, 1]
              for k in lags]  # fmt: skip
    best = int(np.argmax(values))
    return float(values[best]), lags[best] * period
