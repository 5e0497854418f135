"""Whether a user's effect is one that the rig at hand can have: its declaration, place and arguments."""

from __future__ import annotations

import difflib
import inspect
import math
import re
from collections.abc import Callable

from vpptwin.effects import Effect, Parameter, Prior, Stage, State
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.model import missing_parts
from vpptwin.twin.robot.robot import Robot

FOLLOWS = ("velocity", "position", "command", "command change")
KINDS = ("normal", "uniform", "halfnormal")
STARTS = ("position", "velocity")
SEE = "see docs/own_effects.md"


def check_effect(effect: Effect, where: str, rig: Robot, known: tuple[str, ...]) -> None:
    """Refuse an effect that is not one, or not one of this rig.

    Args:
        effect: off values bound to the vehicle.
        where: file and effect, for messages.
        rig: at hand.
        known: ids of all effects that it may name as look-alikes.

    Raises:
        InputError: naming the first mistake.
    """
    check_declaration(effect, where, known)
    for parameter in effect.parameters:
        check_parameter(parameter, f"{where}: parameter {parameter.name}")
    check_place(effect, where, rig)
    check_arguments(effect, where)


def check_declaration(effect: Effect, where: str, known: tuple[str, ...]) -> None:
    """Check id, stage, parameters' names and the names of other effects."""
    if not re.fullmatch(r"[A-Za-z]\w*(\.\w+)+", str(effect.id), flags=re.ASCII):
        expected = "two words with a dot between, such as rail_x.cogging"
        raise InputError(f"{where}: id {effect.id!r}", expected, "rename it")
    for what in ("summary", "equation"):
        check_text(getattr(effect, what), f"{where}: {what}")
    if isinstance(effect.shows, str):
        raise InputError(f"{where}: shows {effect.shows!r}", f"a tuple of topics: ({effect.shows!r},)", SEE)
    for topic in effect.shows:
        check_text(topic, f"{where}: shows")
    if not isinstance(effect.stage, Stage):
        raise InputError(f"{where}: stage {effect.stage!r}", f"one of {', '.join(map(str, Stage))}", SEE)
    if not callable(effect.apply):
        raise InputError(f"{where}: apply {effect.apply!r}", "a function", SEE)
    if isinstance(effect.parameters, str) or not effect.parameters:
        raise InputError(f"{where}: no parameters", "a tuple with at least one Parameter", SEE)
    for parameter in effect.parameters:
        if not isinstance(parameter, Parameter):
            raise InputError(f"{where}: parameter {parameter!r}", "a Parameter", SEE)
        if not re.fullmatch(r"[A-Za-z]\w*", str(parameter.name), flags=re.ASCII):
            raise InputError(f"{where}: parameter {parameter.name!r}", "a word, such as force", "rename it")
    if not isinstance(effect.states, tuple) or not all(isinstance(state, State) for state in effect.states):
        raise InputError(f"{where}: states {effect.states!r}", "a tuple of State objects", SEE)
    if effect.states and effect.stage is Stage.CONSTANT:
        raise InputError(f"{where}: states of {effect.stage}", "a stage that acts every step", "leave them out")
    for state in effect.states:
        if not re.fullmatch(r"[A-Za-z]\w*", str(state.name), flags=re.ASCII) or not isinstance(state.unit, str):
            raise InputError(f"{where}: state {state.name!r}, unit {state.unit!r}", "a word and a text", "correct it")
        number = isinstance(state.start, (int, float)) and math.isfinite(state.start)
        if not number and not (effect.target and effect.stage is not Stage.THRUST and state.start in STARTS):
            expected = f"a finite number{', or ' + ' or '.join(STARTS) if effect.target else ''}"
            raise InputError(f"{where}: state {state.name} starts at {state.start!r}", expected, "correct it")
    names = [*(state.name for state in effect.states), *(parameter.name for parameter in effect.parameters)]
    if len(set(names)) < len(names):
        raise InputError(f"{where}: {', '.join(names)}", "each name once", "rename one")
    if effect.follows not in FOLLOWS:
        raise InputError(f"{where}: follows {effect.follows!r}", f"one of {', '.join(FOLLOWS)}", "correct it")
    for kind, ids in (("look_alikes", effect.look_alikes), ("modifies", effect.modifies)):
        if isinstance(ids, str):
            raise InputError(f"{where}: {kind} {ids!r}", f"a tuple of ids: ({ids!r},)", "add brackets and a comma")
        for other in ids:
            if other not in known:
                close = difflib.get_close_matches(other, known, n=1) or ["rail_x.coulomb"]
                raise InputError(f"{where}: {kind} {other!r}", f"an id such as {close[0]}", "correct it")


def check_text(text: object, where: str) -> None:
    """Refuse what is no line of text: it stands in lists, verdicts and pages."""
    if not isinstance(text, str) or not text.isprintable():
        raise InputError(f"{where} {text!r}", "a line of text", "correct it")


def check_parameter(parameter: Parameter, where: str) -> None:
    """Check that the numbers of a parameter are numbers and in order."""
    p, prior = parameter, parameter.prior
    for what in ("unit", "source"):
        check_text(getattr(p, what), f"{where}: {what}")
    if not isinstance(prior, Prior) or prior.kind not in KINDS:
        raise InputError(f"{where}: prior {prior}", 'one such as Prior("normal", 0.0, 0.1)', "correct it")
    numbers = {"off": p.off, "low": p.low, "high": p.high, "size": p.size, "tolerance": p.tolerance, "prior": prior.a,
               "spread of the prior": prior.b}  # fmt: skip
    for name, value in numbers.items():
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            raise InputError(f"{where}: {name} {value!r}", "a finite number", "correct it")
    if not p.low <= p.off <= p.high or p.low == p.high:
        bounds = f"low {p.low:g}, off {p.off:g}, high {p.high:g}"
        raise InputError(f"{where}: {bounds}", "low ≤ off ≤ high, and room between", "correct the bounds")
    if not 0.0 < p.size <= p.high - p.low:
        expected = "a typical size above 0 that fits between the bounds"
        raise InputError(f"{where}: size {p.size:g}", expected, "correct it")
    if p.tolerance < 0.0:
        raise InputError(f"{where}: tolerance {p.tolerance:g}", "0 or more", "correct it")


def check_place(effect: Effect, where: str, rig: Robot) -> None:
    """Check that the rig has what the effect acts on."""
    model, target = rig.model, effect.target
    joints = [model.joint(i).name for i in range(model.njnt)]
    actuators = [model.actuator(i).name for i in range(model.nu)]
    bodies = [model.body(i).name for i in range(model.nbody)]
    on_joint = effect.stage in (Stage.FRICTION, Stage.SLIP) or (effect.stage is Stage.FORCE and bool(target))
    if on_joint and target not in joints:
        listed = ", ".join(filter(None, joints)) or "none, as the MJCF names no joint"
        action = "correct it, or leave the file out"
        raise InputError(f"{where}: target {target!r}", f"a joint of the rig: {listed}", action)
    if on_joint and target in rig.signals.driven:
        found = f"{where}: target {target!r}, which follows its log"
        raise InputError(found, "a joint that is simulated", "list it under joints in the twin, not under driven")
    if effect.stage is Stage.CONSTANT and target and target not in [*joints, *actuators, *bodies]:
        listed = ", ".join(filter(None, [*joints, *actuators, *bodies]))
        raise InputError(f"{where}: target {target!r}", f"a joint, actuator or body of the rig: {listed}", "correct it")
    if not on_joint and effect.stage is not Stage.CONSTANT and rig.body < 0:
        acts = "thrust" if effect.stage is Stage.THRUST else "the craft"
        expected = "effects on joints, as the rig is not the drone"
        raise InputError(f"{where} acts on {acts}", expected, "give it a target")
    missing = missing_parts(model, effect)
    if missing:
        raise InputError(f"{where} needs {' and '.join(missing)}", "a model with it", "leave the file out")


def check_arguments(effect: Effect, where: str) -> None:
    """Check that the function takes what its stage gives, its states, and then the parameters in their order."""
    names = [*(s.name for s in effect.states), *(["dt"] if effect.states else []), *(p.name for p in effect.parameters)]
    inputs = {
        Stage.CONSTANT: ["constants", "site"], Stage.THRUST: ["thrust", "rotor"], Stage.FRICTION: ["level", "motion"],
        Stage.FORCE: ["motion" if effect.target else "craft"], Stage.SLIP: ["motion", "forward", "backward"],
    }[effect.stage]  # fmt: skip
    taken = list_arguments(effect.apply)
    if len(taken) != len(inputs) + len(names) or taken[len(inputs) :] != names:
        found = f"{where}: {getattr(effect.apply, '__name__', 'apply')}({', '.join(taken)})"
        own = "the states, dt and the parameters" if effect.states else "the parameters"
        expected = f"({', '.join([*inputs, *names])}), what {effect.stage} gives and {own} in their order"
        raise InputError(found, expected, "correct its arguments")


def list_arguments(function: Callable[..., object]) -> list[str]:
    """Names of a function's arguments, `*` before those that stand for many; of a compiled one those of its Python."""
    stars = {"VAR_POSITIONAL": "*", "VAR_KEYWORD": "**"}
    given = inspect.signature(getattr(function, "py_func", function)).parameters.values()
    return [stars.get(argument.kind.name, "") + argument.name for argument in given]
