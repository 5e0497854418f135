"""A user's effect called on trial: it compiles, returns numbers, and does nothing while it is off."""

from __future__ import annotations

import difflib
import math
import re
import threading
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mujoco.batch import MODEL_FIELDS
from numba import njit
from numba.core.errors import NumbaError

from vpptwin.actuators.layer import constants_dtype, nominal_constants
from vpptwin.effects import Craft, Effect, Motion, Rotor, Stage
from vpptwin.system.errors import InputError
from vpptwin.twin.robot.robot import Robot

CASES = 24
"""States and parameter values that an effect is tried at."""
LONGEST = 30.0
"""Time for all of them, and for compiling [s]: it takes one or two."""
TRIAL_STEP = 0.001
"""Inner step of a trial [s]."""
FAST = 'only numbers, math and numpy functions of numbers; functions that it calls decorated with "@numba.njit"'


def try_effect(effect: Effect, where: str, rig: Robot) -> None:
    """Call an effect within its bounds and at its off values.

    Raises:
        InputError: if it does not compile, raises, does not end, returns something else than finite numbers, or
            changes anything while off.
    """
    failed: list[BaseException] = []

    def work() -> None:
        try:
            try_cases(effect, where, rig)
        except BaseException as error:
            failed.append(error)

    worker = threading.Thread(target=work, daemon=True)  # which nothing can end, but the process does not wait for it
    worker.start()
    worker.join(LONGEST)
    if worker.is_alive():
        found = f"{where} has not returned within {LONGEST:g} s"
        raise InputError(found, "a result at once, everywhere within the bounds", "look for a loop that does not end")
    for error in failed:
        raise error


def try_cases(effect: Effect, where: str, rig: Robot) -> None:
    """The calls of `try_effect`."""
    if effect.stage is Stage.CONSTANT:
        try_constants(effect, where, rig)
        return
    function = compile_effect(effect, where)
    forces = 3 if effect.stage is Stage.FORCE and not effect.target else 1
    wanted, states = forces + len(effect.states), start_states(effect, next(draw_cases(effect))[0])
    for inputs, values in draw_cases(effect):
        own = (*states, TRIAL_STEP) if states else ()
        result = call(effect, where, partial(function, *inputs, *own, *values))
        numbers = result if isinstance(result, tuple) else (result,)
        given = ", ".join(f"{p.name} {value:g}" for p, value in zip(effect.parameters, values))
        if len(numbers) != wanted or not all(isinstance(number, (int, float)) for number in numbers):
            expected = "three numbers (f_x, f_z, moment)" if forces == 3 else "a number"
            expected += "".join(f", then {state.name}" for state in effect.states)
            raise InputError(f"{where} returns {result!r}", expected, "correct what it returns")
        if not all(map(math.isfinite, numbers)):
            expected = "finite numbers everywhere within the bounds"
            raise InputError(f"{where} returns {result} at {given}", expected, "correct it, or narrow the bounds")
        if effect.stage is Stage.FRICTION and numbers[0] < 0.0:
            expected = "0 or more: friction does not push"
            raise InputError(f"{where} returns {result} at {given}", expected, "correct it, or narrow the bounds")
        states = numbers[forces:]  # only what it gets to counts
        if effect.stage is Stage.SLIP:  # which is not called while it is off
            continue
        untouched = 0.0 if effect.stage is Stage.FORCE else inputs[0]
        if values == [p.off for p in effect.parameters] and any(number != untouched for number in numbers[:forces]):
            refuse_active(where, f"{result} for {untouched:g}", given)


def refuse_active(where: str, change: str, given: str) -> None:
    """Refuse an effect that acts while it is off."""
    expected = "nothing changed, to the last bit"
    found = f"{where} is not off at its off values ({given}): {change}"
    raise InputError(found, expected, "correct `off` or the function")


def compile_effect(effect: Effect, where: str) -> Callable[..., Any]:
    """The function as numba compiles it for numbers."""
    function = getattr(effect.apply, "py_func", effect.apply)
    compiled = njit(function, error_model="numpy", nogil=True)  # without: nobody could stop waiting for it
    inputs, values = next(draw_cases(effect))
    states = start_states(effect, inputs)
    try:
        compiled(*inputs, *states, *([TRIAL_STEP] if states else []), *values)
    except NumbaError as error:
        name = Path(function.__code__.co_filename).name
        place = re.search(r'File "[^"]*' + re.escape(name) + r'", line (\d+)', str(error))
        plain = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
        lines = [line.strip() for line in plain.splitlines() if line.strip()]
        telling = [line for line in lines if not line.startswith(("Failed in", "File ", "-", "<source"))]
        reason = (f"{name}:{place[1]}: " if place else "") + (telling or ["numba refuses it"])[0].rstrip(".:")
        raise InputError(f"{where} does not compile: {reason}", FAST, "rewrite it") from error
    except Exception:  # what it raises is told with the other cases
        return compiled
    return compiled


def call(effect: Effect, where: str, action: Callable[[], Any]) -> Any:  # noqa: ANN401
    """Call it; what it raises becomes one line."""
    try:
        return action()
    except Exception as error:
        code = getattr(effect.apply, "py_func", effect.apply).__code__
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == code.co_filename]
        place = f" in line {lines[-1]}" if lines else ""
        found = f"{where} raises {type(error).__name__}: {error}{place}"
        raise InputError(found, "a result everywhere within the bounds", "correct it") from error


def draw_cases(effect: Effect) -> Iterator[tuple[tuple[Any, ...], list[float]]]:
    """Inputs and parameter values: off first, then strength alone, then anything within the bounds."""
    rng = np.random.default_rng(1)
    off = [float(p.off) for p in effect.parameters]
    for case in range(CASES):
        values = off if case < CASES // 3 else [float(rng.uniform(p.low, p.high)) for p in effect.parameters]
        if CASES // 3 <= case < CASES // 2:
            values = [values[0], *off[1:]]
        yield draw_inputs(effect, rng), list(values)


def start_states(effect: Effect, inputs: tuple[Any, ...]) -> tuple[float, ...]:
    """Its states at the start, on a joint that is where the inputs say."""
    motion = inputs[1] if effect.stage is Stage.FRICTION else inputs[0]
    starts = [state.start for state in effect.states]
    return tuple(float(getattr(motion, start) if isinstance(start, str) else start) for start in starts)


def draw_inputs(effect: Effect, rng: np.random.Generator) -> tuple[Any, ...]:
    """What its stage gives, in any state that a rig may be in, at rest now and then."""

    def draw(low: float, high: float) -> float:
        return float(rng.choice([np.clip(0.0, low, high), *rng.uniform(low, high, 4)]))

    side = float(rng.choice([-1.0, 1.0]))
    if effect.stage is Stage.THRUST:
        rotor = Rotor(side, draw(0, 550), draw(-0.25, 0.25), draw(-0.1, 3), draw(-5, 5))
        return draw(-6, 6), rotor
    if effect.target:
        motion = Motion(draw(-2, 2), draw(-4, 4), side, draw(-10, 10), draw(0, 25), float(rng.uniform(0.005, 2)))
        if effect.stage is Stage.SLIP:
            return motion, draw(0, 2), draw(0, 2)
        return (draw(0, 2), motion) if effect.stage is Stage.FRICTION else (motion,)
    angle, speeds = draw(-np.pi, np.pi), (draw(0, 550), draw(0, 550))
    pose, velocity = (draw(-2, 2), draw(-1, 3)), (draw(-4, 4), draw(-4, 4), draw(-15, 15))
    return (Craft(*pose, *velocity, float(np.sin(angle)), float(np.cos(angle)), 0.2, *speeds, draw(0, 60)),)


def try_constants(effect: Effect, where: str, rig: Robot) -> None:
    """Apply a CONSTANT effect to the rig's nominal constants.

    Raises:
        InputError: if it writes what there is not or what it does not declare, or as `try_effect`.
    """
    rng = np.random.default_rng(1)
    site, nominal = rig.locate(effect), list_constants(effect, where, rig)
    off = [float(p.off) for p in effect.parameters]
    for case in range(CASES):
        values = off if case == 0 else [float(rng.uniform(p.low, p.high)) for p in effect.parameters]
        table = {name: value[None].copy() for name, value in nominal.items()}
        arguments = {p.name: np.array([value]) for p, value in zip(effect.parameters, values)}
        given = ", ".join(f"{p.name} {value:g}" for p, value in zip(effect.parameters, values))
        try:
            call(effect, where, partial(effect.apply, table, site, **arguments))
        except InputError as error:
            if isinstance(error.__cause__, KeyError):
                refuse_undeclared(effect, where, str(error.__cause__.args[0]))
            raise
        for name in [*table]:
            changed = not np.array_equal(table[name], nominal[name][None]) if name in nominal else True
            if name not in nominal or (changed and name not in effect.writes):
                refuse_undeclared(effect, where, name)
            if np.shape(table[name]) != (1, *nominal[name].shape):
                found = f"{where} makes {name} of shape {np.shape(table[name])}"
                raise InputError(found, f"{(1, *nominal[name].shape)}", "write into it: constants[name][:] = ...")
            if not np.isfinite(table[name]).all():
                expected = "finite numbers everywhere within the bounds"
                raise InputError(f"{where} makes {name} {table[name][0]} at {given}", expected, "correct it")
            if case == 0 and changed:
                refuse_active(where, f"{name} {table[name][0]} for {nominal[name]}", given)


def refuse_undeclared(effect: Effect, where: str, name: str) -> None:
    """Refuse the use of a constant that the effect does not declare."""
    found = f"{where} uses {name!r}, which is not among its writes ({', '.join(effect.writes) or 'none'})"
    raise InputError(found, "a declaration of every constant that it changes", f"writes=({name!r},) in its Effect")


def list_constants(effect: Effect, where: str, rig: Robot) -> dict[str, np.ndarray]:
    """Nominal values of one simulation: of actuators and sensors, and of the model's fields that the effect writes."""
    records = np.zeros(1, constants_dtype(int(rig.model.nu), int(rig.model.nv)))
    constants = nominal_constants(rig.servo_lag, records)
    for name in effect.writes:
        if name not in constants and name not in MODEL_FIELDS:
            close = difflib.get_close_matches(name, [*constants, *MODEL_FIELDS], n=3, cutoff=0.4)
            expected = ", ".join(close or ["dof_damping", "body_mass"])
            raise InputError(f"{where}: writes {name!r}", f"a constant such as {expected}", "correct it")
        if name not in constants:
            holder = rig.model.opt if name.startswith("opt.") else rig.model
            constants[name] = np.array(getattr(holder, name.removeprefix("opt.")))
    if not effect.writes:
        raise InputError(f"{where}: writes nothing", "the constants that it changes, as writes=(...)", "declare them")
    return constants
