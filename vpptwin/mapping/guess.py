"""Which signal of a log is which joint and actuator of a model: by name, order and kind, tested against physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from vpptwin.estimation.checks.turns import TURN, follow_turns, unwrap_turns
from vpptwin.estimation.checks.units import TRAVEL, LoggedPosition, find_normalised
from vpptwin.estimation.dynamics import find_driven_joint
from vpptwin.logs.flight import Stream
from vpptwin.mapping.likeness import compare_lag, compare_slope, measure_roughness
from vpptwin.mapping.survey import Signal
from vpptwin.mapping.words import (
    COMMANDED,
    PLACES,
    is_commanded,
    is_derived,
    is_slope_of,
    is_spin,
    names_it,
    part_index,
    split_name,
    split_words,
    tell_quantity,
)
from vpptwin.system.fields import UNITS, UNSAID
from vpptwin.twin.robot.actuation import tell_control

NEAR_UNIT = 1.2
"""Within this factor of a unit a target is in it: what follows a target may fall short of it."""
SLOPE = 0.8
"""Correlation of a velocity with the slope of its position below which they are strangers."""
ALIKE = 0.95
"""That of two columns at some lag from which on they are one motion, asked for and measured."""
ROUGHER = 1.5
"""How much rougher than another a signal is of which that may be a filtered copy."""
CLOSE = 0.6, 1.6
"""What a velocity may be of the slope: those of `docs/logs.md`."""
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
    more: dict[str, dict[str, Any]] = field(default_factory=dict)  # likewise, what else a twin says: scale, frame
    sure: bool = False  # whether there is no doubt
    reasons: list[str] = field(default_factory=list)  # what speaks for it, with numbers
    doubts: list[str] = field(default_factory=list)  # what speaks against it, or what else it may be
    motion: Signal | None = None  # the position, if it is a joint's, as it goes on beyond a turn [m, rad]
    leading: list[Signal] = field(default_factory=list)  # what the position of a joint follows
    rivals: list[Signal] = field(default_factory=list)  # what else its position may be


def guess_signals(model: mujoco.MjModel, signals: Sequence[Signal]) -> list[Guess]:
    """The likeliest signals of every hinge, slide and actuator.

    Nothing is sure that rests on the order of columns alone, that has a rival, or that physics contradicts.
    """
    plain = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    joints = [model.joint(i) for i in range(model.njnt) if model.jnt_type[i] in plain]
    names = [joint.name for joint in joints]
    measured = [signal for signal in signals if not is_commanded(signal)]
    guesses, spelled = [Guess(name, "joints") for name in names], [split_name(name) for name in names]
    for quantity in ("position", "velocity"):
        pool = [signal for signal in measured if tell_quantity(signal) == quantity]
        if quantity == "position":  # a column that is called like a joint, and nothing more
            bare = [s for s in measured if not tell_quantity(s)]
            stems = [(s, (s.label, part_index(s)[0].split(" ", 1)[1])) for s in bare]
            pool += [s for s, texts in stems if any(split_name(text) in spelled for text in texts)]
        assign(guesses, names, pool, quantity)
        if quantity == "position":
            for length, kind in zip(PLACES, plain):
                assign_kind([g for g, joint in zip(guesses, joints) if joint.type[0] == kind], measured, length)
        else:
            for guess in guesses:
                slopes = [s for s in pool if "position" in guess.fields and is_slope_of(s, guess.fields["position"])]
                if "velocity" not in guess.fields:
                    settle(guess, "velocity", slopes, "its name")
    for guess, joint in zip(guesses, joints):
        check_joint(guess, model, int(joint.id))
    for guess in guesses:
        follow_leader(guess, guesses, model)
    motors = [model.actuator(i).name for i in range(model.nu)]
    commands = [Guess(name, "actuators") for name in motors]
    taken = [signal for guess in guesses for signal in (*guess.fields.values(), *guess.rivals)]
    bare = [s for s in signals if not tell_quantity(s) and s not in taken and not s.name]
    kinds = [tell_drive(model, i) for i in range(model.nu)]
    for asked in ("position", "velocity", "effort", "lift"):
        chosen = [guess for guess, kind in zip(commands, kinds) if kind == asked]
        pool = [s for s in signals if is_control(s, asked)]
        # As of joints: a column that is called like one of them, and nothing more but that it was asked for.
        called = [split_name(guess.target) for guess in chosen]
        pool += [s for s in bare if s not in pool and [w for w in split_name(s.label) if w not in COMMANDED] in called]
        moved = [find_moved(model, motors.index(guess.target)) for guess in chosen]
        assign(chosen, [guess.target for guess in chosen], pool, "effort", moved)
    for i, guess in enumerate(commands):
        driven = next((g for g in guesses if g.target == find_moved(model, i)), Guess("", "joints"))
        if kinds[i] == "position" and not guess.fields:
            settle(guess, "effort", driven.leading, f"comes before what {driven.target} does")
        check_actuator(guess, model, i, driven.motion)
        wanted = "a force or moment" if kinds[i] in ("effort", "lift") else f"a {kinds[i]}"
        asked_for = [s for s in signals if not guess.fields and is_commanded(s) and not s.name]
        near = [s.label for s in asked_for if names_it(s, guess.target, motors)
                or (driven.target and names_it(s, driven.target, names))]  # fmt: skip
        guess.doubts += [f"{', '.join(near[:4])}: the model's actuator takes {wanted}"] * bool(near)
        target, seen = guess.fields.get("effort"), driven.fields.get("position")
        if target and seen and not target.is_constant and np.array_equal(target.values, seen.values, True):
            guess.doubts.append(f"{target.label} and {seen.label} are identical: commanded, or measured?")
            guess.sure = False
    for guess in guesses if not any(command.fields for command in commands) else ():
        position = guess.fields.get("position")
        if position is not None and position.alone and COMMANDED & set(split_words(position.topic)):
            guess.doubts.append(f"the log is called {position.topic}: was {position.label} measured, or commanded?")
            guess.sure = False
    doubt_travel(model, guesses, commands)
    return [*guesses, *commands]


def follow_leader(guess: Guess, guesses: Sequence[Guess], model: mujoco.MjModel) -> None:
    """Read a joint that was not logged and follows another by an equality, as <mimic> says, from that one's columns."""
    coupled = model.eq_active0.astype(bool) & (model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)) & (model.eq_obj2id >= 0)
    for i in np.flatnonzero(coupled & (model.eq_obj1id == model.joint(guess.target).id)) if not guess.fields else ():
        offset, factor, *curved = model.eq_data[i, :5]
        leader = next((g for g in guesses if g.target == model.joint(int(model.eq_obj2id[i])).name), guess)
        text = f"it follows {leader.target}, of which it is {factor:g} times" + (f" plus {offset:g}" if offset else "")
        if np.any(curved) or not leader.fields or any(signal.name for signal in leader.fields.values()):
            guess.doubts.append(f"{text}: log it, or fix it in the model")
            continue
        guess.fields, guess.units = dict(leader.fields), dict(leader.units)
        guess.more = {quantity: {"scale": float(factor)} for quantity in leader.fields}
        guess.more["position"] |= {"offset": float(offset)} if offset else {}
        guess.doubts, guess.reasons = list(leader.doubts), [text]
        guess.sure = not guess.doubts


def doubt_travel(model: mujoco.MjModel, guesses: Sequence[Guess], commands: Sequence[Guess]) -> None:
    """Doubt the unit of positions, and of targets of them, that are held where per cents of a travel end."""
    owners, positions = dict[str, Guess](), list[LoggedPosition]()
    for guess in (*guesses, *(c for c in commands if tell_control(model, model.actuator(c.target).id) == "position")):
        joint = guess.target if guess.group == "joints" else find_moved(model, model.actuator(guess.target).id)
        signal = guess.fields.get("position" if guess.group == "joints" else "effort")
        if signal is not None and joint:
            low, high = model.joint(joint).range if model.jnt_limited[model.joint(joint).id] else (-np.inf, np.inf)
            size = UNITS[
                name_length(model, model.joint(joint).id) if not guess.units else next(iter(guess.units.values()))
            ][1]
            positions.append(LoggedPosition(signal.title, signal.values, (low / size, high / size)))
            owners[signal.title] = guess
    for ends in find_normalised(positions):
        owners[ends.name].doubts.append(f"{ends}: {TRAVEL}?")
        owners[ends.name].sure = False


def is_control(signal: Signal, kind: str) -> bool:
    """Whether a signal may be what a servo is asked for, or what a motor is driven by; a rotor lifts as it turns."""
    if kind in ("effort", "lift") and is_spin(signal):
        return kind == "lift"
    if kind in ("effort", "lift"):
        return signal.field == "effort" if signal.name else tell_quantity(signal) in ("effort", "drive")
    if signal.name:
        return signal.field == (kind if is_commanded(signal) else "effort")
    return is_commanded(signal) and tell_quantity(signal) in (kind, "")


def find_moved(model: mujoco.MjModel, actuator: int) -> str:
    """Name of the joint that an actuator acts on itself; "" for none."""
    joint = find_driven_joint(model, actuator)
    return "" if joint is None else str(model.joint(joint).name)


def tell_drive(model: mujoco.MjModel, actuator: int) -> str:
    """Which quantity its control input is, "lift" for the effort of what acts on no joint alone, as rotors do."""
    kind = tell_control(model, actuator)
    return "lift" if kind == "effort" and not find_moved(model, actuator) else kind


def assign(
    guesses: Sequence[Guess], names: Sequence[str], pool: Sequence[Signal], quantity: str, moved: Sequence[str] = ()
) -> None:
    """Give each of them its signal of a pool: by name, by the joint that it alone moves, as the only one, or by order.

    Where anything in the pool was asked for, a joint's name tells that alone: a joint's effort may be measured.
    """
    for guess in guesses:
        settle(guess, quantity, [s for s in pool if names_it(s, guess.target, names)], "its name")
    among = [s for s in pool if is_commanded(s)] or pool
    for guess, joint in zip(guesses, moved):
        if quantity not in guess.fields and joint and moved.count(joint) == 1:
            called = [s for s in among if names_it(s, joint, moved)]
            settle(guess, quantity, called, "the name of the joint that it moves")
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
    of_kind = [s for s in measured if not s.name and tell_quantity(s) in ("position", "")
             and (UNITS.get(s.unit, ("",))[0] == length or PLACES[length] & set(split_words(s.label)))]  # fmt: skip
    if len(of_kind) != len(guesses) or any("position" in guess.fields for guess in guesses):
        return
    for guess, signal in zip(guesses, of_kind):
        settle(guess, "position", [signal], "the only one of that kind" if len(of_kind) == 1 else "kind and order")
        guess.doubts.append(f"only that says that {signal.label} is {guess.target}")


def settle(guess: Guess, quantity: str, candidates: Sequence[Signal], basis: str) -> None:
    """Take the likeliest signal, and note its rivals.

    Raw signals come before those made of others, commands before measurements of effort, speeds of rotors before what
    drives them; of positions that show one motion the one that comes last was measured.
    """
    if not candidates:
        return

    def rank(s: Signal) -> tuple[bool, ...]:
        measured = quantity == "effort" and not (is_commanded(s) or is_spin(s))
        return is_derived(s), s.is_constant, measured, tell_quantity(s) == "drive" and not is_spin(s)

    ranked = sorted(candidates, key=rank)
    best = ranked[0]
    guess.reasons.append(f"{best.label}: {basis}")
    rivals = [s for s in ranked[1:] if is_derived(s) == is_derived(best)]
    if is_spin(best):
        rivals = [s for s in rivals if is_spin(s)]
    if quantity == "position":
        guess.rivals += [best, *rivals]
        best, rivals = part_by_time(guess, [best, *rivals])
    guess.fields[quantity] = best
    if rivals:
        guess.doubts.append(f"or {', '.join(s.title for s in rivals[:4])}")
    if is_derived(best):
        guess.doubts.append(f"{best.label} may be made of another signal")
    if best.is_constant:
        guess.doubts.append(f"{best.label} is constant")


def part_by_time(guess: Guess, rivals: Sequence[Signal]) -> tuple[Signal, list[Signal]]:
    """Of signals that may be one position that which is measured, and its rivals; those that it follows are targets.

    A target is no rougher than what follows it. What is may be the raw signal of a filtered one, which is asked.
    """
    last, others = rivals[0], []
    for other in rivals[1:]:
        correlation, lag = compare_lag(last, other)
        first, second = (last, other) if lag > 0.0 else (other, last)
        if correlation > ALIKE and abs(lag) > 0.5 / min(last.rate, other.rate):
            text = f"{second.label} follows {first.label} by {1e3 * abs(lag):.0f} ms (r {correlation:.2f})"
            if measure_roughness(first) > ROUGHER * measure_roughness(second):
                guess.doubts.append(f"{text}: which was commanded, or is {second.label} a filtered {first.label}?")
            else:
                guess.leading.append(first)
                guess.reasons.append(text)
            last = second
        else:
            others.append(other)
    return last, others


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
    known = np.isfinite(position.values)
    stream = Stream(position.time[known], {"position": scale * position.values[known]})
    stream, mended = unwrap_turns(stream, position.label, limits, length == "rad")
    guess.motion = replace(position, time=stream.time, values=stream["position"])
    guess.reasons += mended
    if velocity is not None:
        guess.units |= check_unit(guess, "velocity", velocity, f"{length}/s")
        of_rate = UNITS[guess.units.get("velocity", f"{length}/s")][1]
        correlation, share = compare_slope(guess.motion, velocity)
        share *= of_rate
        text = f"{velocity.label} is {share:.2f} of the slope of {position.label} (r {correlation:.2f})"
        if not np.isfinite(correlation):
            guess.doubts.append("too little motion to test the velocity")
        elif correlation < SLOPE or not CLOSE[0] < share < CLOSE[1]:
            guess.doubts.append(f"left out: {text}")
            guess.fields.pop("velocity")
            guess.units.pop("velocity", None)
        else:
            guess.reasons.append(text)
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
    if signal.unit == UNSAID:
        guess.doubts.append(f"the log does not state the unit of {signal.label}: {expected}, deg, or {TRAVEL}?")
        return {}
    if signal.unit in UNITS and UNITS[signal.unit][0] == expected:
        guess.reasons.append(f"{signal.label} is in {signal.unit}")
        return {quantity: signal.unit}
    guess.doubts.append(f"{signal.label} is in {signal.unit}, where {expected} was expected")
    return {}


def tell_target_unit(guess: Guess, command: Signal, moved: Signal, length: str) -> dict[str, str]:
    """The unit in which a target is as large as the motion that follows it, where that is not SI."""
    correlation, _ = compare_lag(command, moved)
    size = float(np.nanstd(command.values)) / max(float(np.nanstd(moved.values)), 1e-300)
    for unit in ("deg",) if length == "rad" else ("mm", "cm"):
        if correlation > SLOPE and abs(np.log(max(size * UNITS[unit][1], 1e-300))) < np.log(NEAR_UNIT):
            guess.reasons.append(f"{command.label} is {size:.3g} times what follows it, so in {unit}")
            return {"effort": unit}
    return {}


def tell_force(model: mujoco.MjModel, actuator: int, unit: str) -> str:
    """SI unit of what an actuator makes on a joint or at a site; "" where its transmission decides.

    A motor that moves a slide by a pulley or a screw, its gear, may be logged as the torque that the `unit` says.
    """
    if moved := find_moved(model, actuator):
        torque = name_length(model, model.joint(moved).id) == "rad"
        geared = abs(model.actuator_gear[actuator, 0]) != 1.0 and UNITS.get(unit, ("",))[0] == "N m"
        return "N m" if torque or geared else "N"
    at_site = model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_SITE)
    return ("N" if model.actuator_gear[actuator, :3].any() else "N m") if at_site else ""


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
    text = f"{outside:.0%} of {signal.label} lie outside {limits[0]:.3g} to {limits[1]:.3g}"
    smaller, size = ("deg", np.pi / 180.0) if length == "rad" else ("mm", 1e-3)
    fits = length and np.ptp(values) > FAR[length] and lie_outside(size) <= 0.01
    counted = length == "rad" and np.ptp(values) > FAR[length] and not np.any(signal.finite % 1.0)
    otherwise = "counts of an encoder, of which 4096 a turn have scale: 0.001534" if counted else "another sign or zero"
    guess.doubts.append(f"{text}: {f'in {smaller}' if fits else otherwise}?")


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
        if not command.unit and moved is not None:
            guess.units |= tell_target_unit(guess, command, moved, length)
    raw = kind == "effort" and (tell_quantity(command) == "drive" or is_spin(command))
    if kind == "effort" and not raw and (force := tell_force(model, actuator, command.unit)):
        guess.units |= check_unit(guess, "effort", command, force)
    unit = guess.units.get("effort", length)
    known, scale = np.isfinite(command.values), UNITS[unit][1] if unit else 1.0
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
            how = "polynomial: [0, 0, N per square of it]" if is_spin(command) else "a scale or polynomial"
            guess.doubts.append(f"{command.label} goes from {low:.4g} to {high:.4g}: how much force is that? {how}")
        elif not command.name and not is_commanded(command):
            guess.doubts.append(f"{command.label} may be measured, not commanded")
    elif moved is not None:
        asked_for = command.title if command.label == moved.label else command.label
        if kind == "position":
            correlation, lag = compare_lag(asked, moved)
            text = f"{moved.label} follows {asked_for} by {1e3 * lag:.0f} ms (r {correlation:.2f})"
        else:
            (correlation, share), lag = compare_slope(moved, command), 0.0
            text = f"{asked_for} is {share:.2f} of the slope of {moved.label} (r {correlation:.2f})"
        if not np.isfinite(correlation):
            guess.doubts.append("too little motion to see the joint follow")
        elif correlation < SLOPE or lag < 0.0:
            guess.doubts.append(text)
        else:
            guess.reasons.append(text)
    guess.sure = not guess.doubts
