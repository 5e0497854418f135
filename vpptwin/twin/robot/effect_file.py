"""Effects of the user's own: a Python file that defines them, read, checked and put beside those of the catalogue."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from vpptwin.effects import CATALOGUE, Effect
from vpptwin.system.errors import InputError, suggest
from vpptwin.system.installed import list_installed
from vpptwin.twin.robot.effect_check import check_effect
from vpptwin.twin.robot.effect_trial import try_effect
from vpptwin.twin.robot.robot import Robot

BUILD = "build_effects"
"""Name of the function that makes effects for the rig at hand."""
EXPECTED = f"Effect objects at its top level, or a function {BUILD}(model) that returns some"
SEE = "see docs/own_effects.md"
Result = TypeVar("Result")


def extend_catalogue(catalogue: tuple[Effect, ...], files: Sequence[Path], rig: Robot) -> tuple[Effect, ...]:
    """A rig's catalogue, and after it the effects of the user's files in their order.

    Args:
        catalogue: effects that the rig has without the files.
        files: Python files. They are run.
        rig: at hand, whose nominal numbers give off values.

    Raises:
        InputError: if a file is missing, does not run or defines no effect, or an effect is not one of this rig's.
    """
    sources = {effect.id: "the catalogue" for effect in (*CATALOGUE, *catalogue)}
    extended = list(catalogue)
    for file in files:
        for effect in read_effects(file, rig):
            check_name(effect, file, sources)
            sources[effect.id] = str(file)
            try:
                extended.append(effect.bind(rig.nominal))
            except KeyError as error:
                known = "none: no vehicle here"
                if rig.rotorcraft is not None:
                    known = "a key of the vehicle file, such as servo.time_constant"
                found = f"{file}: effect {effect.id}: nominal {error}"
                raise InputError(found, known, "give `off` itself") from error
    for i, effect in enumerate(extended[len(catalogue) :], len(catalogue)):
        where = f"{sources[effect.id]}: effect {effect.id}"
        check_effect(effect, where, rig, tuple(sources))
        try_effect(effect, where, rig)
        extended[i] = replace(effect, apply=getattr(effect.apply, "py_func", effect.apply))  # compiled with the others
    return tuple(extended)


def read_effects(file: Path, rig: Robot) -> list[Effect]:
    """Run a file and list the effects it defines: those at its top level, then those that it builds for this rig.

    Raises:
        InputError: if it cannot be read or run, or defines none.
    """
    module = run_file(file)
    known = {id(effect) for effect in CATALOGUE}
    own = [v for v in vars(module).values() if isinstance(v, Effect) and id(v) not in known]
    effects = list({id(effect): effect for effect in own}.values())
    build = getattr(module, BUILD, None)
    if callable(build):
        built = blame_file(file, lambda: list(build(rig.model)))
        strange = [value for value in built if not isinstance(value, Effect)]
        if strange:
            raise InputError(f"{file}: {BUILD} returns a {type(strange[0]).__name__}", "a list of Effect objects", SEE)
        effects += built
    if not effects:
        raise InputError(f"{file}: no effects in it", EXPECTED, SEE)
    return effects


def run_file(file: Path) -> ModuleType:
    """The module that a file makes; once per process while its text stays the same.

    Raises:
        InputError: if there is no such file or it does not run.
    """
    try:
        text = file.read_bytes()
    except OSError as error:
        advice = suggest(str(file), list_installed(), "check the path")
        raise InputError(f"no readable effects file {file}", "a Python file with effects", advice) from error
    # Its place and its text are in its name: files of the same name don't clash, and an edited one is run anew.
    name = "vpptwin_effects_" + sha256(str(file.resolve()).encode() + b"\0" + text).hexdigest()[:16]
    if name in sys.modules:
        return sys.modules[name]
    try:
        code = compile(text, str(file.resolve()), "exec")
    except SyntaxError as error:
        place = f"{file}:{error.lineno}" if error.lineno else f"{file}"
        raise InputError(f"{place}: {error.msg}", "a Python file with effects", "correct its syntax") from error
    except ValueError as error:
        raise InputError(f"{file}: {error}", "a Python file with effects", "check the path") from error
    module = ModuleType(name)
    module.__file__ = str(file.resolve())
    sys.modules[name] = module  # where numba and pickle look for the functions
    try:
        blame_file(file, lambda: exec(code, vars(module)))
    except InputError:
        del sys.modules[name]
        raise
    return module


def blame_file(file: Path, action: Callable[[], Result]) -> Result:
    """Run something of a user's file; what it raises becomes one line that names the line of the file.

    Raises:
        InputError: if it raises.
    """
    try:
        return action()
    except (Exception, SystemExit) as error:
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(file.resolve())]
        place = f"{file}:{lines[-1]}" if lines else f"{file}"
        raise InputError(f"{place}: {type(error).__name__}: {error}", "a file that runs", "correct it") from error


def check_name(effect: Effect, file: Path, sources: dict[str, str]) -> None:
    """Refuse an id that another effect has, or one that could not be told from another's in compiled code."""
    taken = {other.replace(".", "_"): other for other in sources}
    other = taken.get(str(effect.id).replace(".", "_"))
    if other is not None:
        found = f"{file}: effect {effect.id!r}, like {other!r} of {sources[other]}"
        raise InputError(found, "an id of its own", "rename it")
