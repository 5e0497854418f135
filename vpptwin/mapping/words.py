"""What the name of a signal tells: which quantity it is, of what, and whether it was measured or asked for."""

from __future__ import annotations

import re
from collections.abc import Sequence

from vpptwin.mapping.survey import Signal
from vpptwin.system.fields import UNITS

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
TRACKED = {
    "vicon", "mocap", "optitrack", "qualisys", "vrpn", "motive", "tracker", "lighthouse", "marker", "markers",
    "external", "gt", "truth", "groundtruth",
}  # fmt: skip
"""Words in names of what was seen from outside, by cameras or the like."""
ESTIMATED = {"est", "estimate", "estimated", "estimator", "stateestimate", "ekf", "ekf2", "kf", "kalman", "fused"}
SYMBOLS = {"T", "F", "M"}
"""What thrusts, forces and moments are called by one letter, where a name says besides that they were asked for."""
OTHERS = {"temp", "temperature", "temperatures", "status", "mode", "flag", "flags"}
"""Words in names of what is none of these, whatever it is of."""
PARTS = {"joint", "motor", "servo", "actuator", "link"}
"""Words in names of joints and actuators that their columns may do without."""
SPINNING = {"rotor", "motor", "prop", "propeller", "esc"}
UNIT_WORDS = {"deg", "degs", "degps", "dps", "rad", "rads", "radps", "m", "mm", "cm", "mps", "s", "sec", "per"}
"""Words at the end of names that tell a unit."""


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
    if OTHERS & set(words):
        return ""
    places = {*WORDS["position"].split(), *PLACES["m"]}
    rates = {f"d{word}" for word in places} | {f"{word}dot" for word in places}
    if rates & set(words):
        return "velocity"
    kind = next((each for each, known in WORDS.items() if set(words) & set(known.split())), "")
    if not kind and is_commanded(signal) and SYMBOLS & set(re.findall(r"[A-Za-z]+", signal.label)):
        return "effort"
    return kind or MEASURED.get(UNITS.get(signal.unit, ("",))[0], "")


def is_commanded(signal: Signal) -> bool:
    """Whether a signal's name says that it was asked for, not measured; or its topic's, where it is one of several."""
    return bool(COMMANDED & {*split_words(signal.label), *([] if signal.alone else split_words(signal.topic))})


def is_derived(signal: Signal) -> bool:
    """Whether it was made of another signal."""
    return bool(DERIVED & set(split_words(signal.label)))


def rank_source(signal: Signal) -> int:
    """0 for what was seen from outside, 2 for what an estimator made of other signals, 1 for all else."""
    words = {*split_words(signal.label), *split_words(signal.topic)}
    return 0 if words & TRACKED else 2 if words & (ESTIMATED | DERIVED) else 1


def is_spin(signal: Signal) -> bool:
    """Whether a signal is how fast a rotor turns."""
    words = set(split_words(signal.label))
    return "rpm" in words or (UNITS.get(signal.unit, ("",))[0] == "rad/s" and bool(SPINNING & words))


def part_index(signal: Signal) -> tuple[str, int | None]:
    """Topic and name without the last number in it, and that."""
    match = re.fullmatch(r"(.*?)[_.\[]?(\d+)\]?(\D*)", signal.label)
    stem, index = (match.group(1) + match.group(3), int(match.group(2))) if match else (signal.label, None)
    return f"{signal.topic} {stem}", index


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
    if signal.called:
        return signal.called == name or split_name(signal.called) == split_name(name)

    def holds(words: Sequence[str], part: Sequence[str]) -> bool:
        return bool(part) and any(words[i : i + len(part)] == part for i in range(len(words) - len(part) + 1))

    called, wanted = split_words(signal.label), split_name(name)
    longer = [split_name(other) for other in others if other != name]
    return holds(called, wanted) and not any(holds(other, wanted) and holds(called, other) for other in longer)


def split_name(name: str) -> list[str]:
    """Small words of a joint's or actuator's name without those that say that it is one: `FL_hip_joint`."""
    words = [word for word in split_words(name) if word not in PARTS]
    return words if any(word.isalpha() for word in words) else split_words(name)
