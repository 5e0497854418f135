"""The effects of a catalogue as one step that numba compiles: a page of plain Python that one can read and print."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any

import mujoco
import numpy as np

from vpptwin.effects import Effect, Stage
from vpptwin.effects.base import Motion
from vpptwin.twin import step

STEP_STAGES = (Stage.THRUST, Stage.FORCE, Stage.FRICTION)


CHAIN = ("shape_thrust", "push_craft", "push_joints", "muster_friction")
"""The functions of `vpptwin.twin.step` that stand for the effects of a catalogue."""
Function = Callable[..., Any]
Transform = Callable[..., Function]


@dataclass(frozen=True)
class Pipeline:
    """The per-step effects of a catalogue on one model.

    Attributes:
        source: Python text of the functions of `CHAIN`.
        functions: names in the text → the effects' functions.
        columns: (effect id, parameter) → column of a simulation's parameters.
        places: effect id → place among the switches.
    """

    source: str
    functions: dict[str, Function]
    columns: dict[tuple[str, str], int]
    places: dict[str, int]

    def build(self, transform: Transform, file: str = "<pipeline>") -> dict[str, Function]:
        """The steps with this chain in them, `step_drone` and `step_rig`.

        Args:
            transform: applied to every function, told whether to be inlined: numba's `njit`, or `keep_plain`.
            file: where the text is said to come from.
        """
        namespace: dict[str, Any] = {"__name__": __name__, "Motion": Motion}
        namespace |= {name: transform(function) for name, function in self.functions.items()}
        exec(compile(self.source, file, "exec"), namespace)
        chain = {name: transform(namespace[name], inline=True) for name in CHAIN}
        return {f.__name__: transform(bind_names(f, chain), inline=True) for f in (step.step_drone, step.step_rig)}


def keep_plain(function: Function, inline: bool = False) -> Function:
    """The function as it is: for a pipeline in plain Python."""
    return function


def bind_names(function: Function, names: dict[str, Any]) -> Function:
    """The function with other things behind some of its global names."""
    # numba freezes globals as it compiles, so each catalogue needs functions of its own that find its chain there.
    assert isinstance(function, FunctionType)
    bound = FunctionType(function.__code__, function.__globals__ | names, function.__name__)
    bound.__module__ = function.__module__
    return bound


def write_pipeline(model: mujoco.MjModel, catalogue: Sequence[Effect]) -> Pipeline:
    """Write the pipeline of a catalogue, in its order, for a model's joints."""
    effects = [e for e in catalogue if e.stage in STEP_STAGES]
    columns: dict[tuple[str, str], int] = {}
    for effect in effects:
        for parameter in effect.parameters:
            columns[effect.id, parameter.name] = len(columns)
    places = {effect.id: i for i, effect in enumerate(effects)}
    functions = {function_name(e): e.apply for e in effects}

    def call(effect: Effect, *inputs: str) -> str:
        given = [*inputs, *(f"p[{columns[effect.id, p.name]}]" for p in effect.parameters)]
        return f"{function_name(effect)}({', '.join(given)})"

    def of(stage: Stage, target: str | None = None) -> list[Effect]:
        return [e for e in effects if e.stage is stage and (target is None or e.target == target)]

    # Switches are looked up in the step, not written into it: all twins of a catalogue share what is compiled.
    lines = ["def shape_thrust(on, p, thrust, rotor):"]
    for effect in of(Stage.THRUST):
        lines += [f"    if on[{places[effect.id]}]:", f"        thrust = {call(effect, 'thrust', 'rotor')}"]
    lines += ["    return thrust", "", "def push_craft(on, p, craft):", "    f_x = f_z = moment = 0.0"]
    for effect in of(Stage.FORCE, ""):
        lines += [
            f"    if on[{places[effect.id]}]:",
            f"        more_x, more_z, more_moment = {call(effect, 'craft')}",
            "        f_x, f_z, moment = f_x + more_x, f_z + more_z, moment + more_moment",
        ]
    lines += ["    return f_x, f_z, moment", "", "def push_joints(on, p, view, load, lever, force):"]
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    for joint, i in joints.items():
        q, dof = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i])
        for effect in of(Stage.FORCE, joint) if joint else ():
            motion = f"Motion(view.qpos[{q}], view.qvel[{dof}], 0.0, load, lever)"
            lines += [f"    if on[{places[effect.id]}]:", f"        force[{dof}] += {call(effect, motion)}"]
    lines += ["    return None", "", "def muster_friction(on, p, dry, view, load, lever, forward, backward):"]
    lines += ["    most = 0.0", "    for i in range(len(forward)):", "        forward[i] = backward[i] = dry[i]"]
    lines += ["        most = max(most, dry[i])"]
    for joint, i in joints.items():
        q, dof = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i])
        rubbing = of(Stage.FRICTION, joint) if joint else []
        if not rubbing:
            continue
        lines += [f"    ahead, back = dry[{dof}], dry[{dof}]"]
        # Each sense of motion has a level, which passes through the joint's effects in their order: they add or scale.
        for effect in rubbing:
            lines += [f"    if on[{places[effect.id]}]:"]
            for level, sense in (("ahead", "1.0"), ("back", "-1.0")):
                motion = f"Motion(view.qpos[{q}], view.qvel[{dof}], {sense}, load, lever)"
                lines += [f"        {level} = {call(effect, level, motion)}"]
        lines += [f"    forward[{dof}], backward[{dof}] = ahead, back", "    most = max(most, ahead, back)"]
    lines += ["    return most > 0.0", ""]
    return Pipeline("\n".join(lines), functions, columns, places)


def function_name(effect: Effect) -> str:
    """The effect's name in the text: its id as an identifier."""
    return "effect_" + "".join(c if c.isalnum() else "_" for c in effect.id)


def fingerprint(*texts: str, functions: Sequence[Callable[..., Any]] = ()) -> str:
    """A hash of texts, of the files that functions come from, of values that they use, and of what compiles them."""
    digest = hashlib.sha256()
    for text in texts:
        digest.update(text.encode())
    reached: dict[FunctionType, str] = {}
    for function in functions:
        reach(function, reached)
    for captured in reached.values():
        digest.update(captured.encode())
    files = {inspect.getsourcefile(f) or "" for f in reached} | own_sources()
    for file in sorted(files):
        digest.update(Path(file).read_bytes() if Path(file).is_file() else b"")
    digest.update(versions().encode())
    return digest.hexdigest()[:20]


def reach(function: Function, reached: dict[FunctionType, str]) -> None:
    """Add to `reached` a function and those that it calls, with the closure's and the globals' values that they use.

    Those are frozen into machine code, and a function made for one rig may have others than the same for the next.
    The module's name goes with it: numba keeps it, and a user's file has another in another place.
    """
    plain = getattr(inspect.unwrap(function), "py_func", inspect.unwrap(function))
    if not isinstance(plain, FunctionType) or plain in reached or plain.__module__.split(".")[0] in ("numpy", "numba"):
        return
    used = inspect.getclosurevars(plain)
    held = {**used.globals, **used.nonlocals}
    values = {name: value for name, value in held.items() if isinstance(value, (int, float, complex, str, tuple))}
    arrays = {name: value.tobytes().hex() for name, value in held.items() if isinstance(value, np.ndarray)}
    reached[plain] = f"{plain.__module__} {plain.__qualname__} {sorted((values | arrays).items())!r}"
    for value in held.values():
        if callable(value) and not isinstance(value, type):
            reach(value, reached)


@cache
def versions() -> str:
    """Versions of what compiles."""
    return " ".join([*map(version, ("numba", "llvmlite", "mujoco", "numpy")), sys.version])


COMPILED = ("effects/base.py", "actuators/*.py", "engine/*.py", "twin/step.py", "twin/friction.py", "twin/kernel.py",
            "twin/pipeline.py")  # fmt: skip
"""Files of this project whose functions are compiled, besides those of the effects."""


@cache
def own_sources() -> frozenset[str]:
    """The files that `COMPILED` names."""
    root = Path(__file__).parents[1]
    return frozenset(str(file) for pattern in COMPILED for file in root.glob(pattern))
