"""The effects of a catalogue as one step that numba compiles: a page of plain Python that one can read and print."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any

import mujoco
import numpy as np

from vpptwin.effects import Effect, Stage
from vpptwin.effects.base import Body, Motion
from vpptwin.twin.robot.manifold import BALL, FREE, find_place, list_attitudes
from vpptwin.twin.stepping import step

STEP_STAGES = (Stage.THRUST, Stage.FORCE, Stage.FRICTION, Stage.SLIP)


CHAIN = ("shape_thrust", "push_craft", "push_joints", "muster_friction")
"""The functions of `vpptwin.twin.stepping.step` that stand for the effects of a catalogue."""
STEPS = step.step_drone, step.step_rig, step.recall
"""Those that call them."""
Function = Callable[..., Any]
Transform = Callable[..., Function]


@dataclass(frozen=True)
class Pipeline:
    """The per-step effects of a catalogue on one model."""

    source: str  # Python text of the functions of `CHAIN`
    functions: dict[str, Function]  # names in the text → the effects' functions
    columns: dict[tuple[str, str], int]  # (effect id, parameter) → column of a simulation's parameters
    places: dict[str, int]  # effect id → place among the switches
    # of every column of the effects' states, a number, or which position or velocity: ("position", 0)
    starts: tuple[float | tuple[str, int], ...]

    def start_effects(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """States of the effects at the start, (N, S), from positions (N, nq) and velocities (N, nv)."""
        of_joints = {"position": qpos, "velocity": qvel}
        states = np.empty((len(qpos), len(self.starts)))
        for column, start in enumerate(self.starts):
            states[:, column] = of_joints[start[0]][:, start[1]] if isinstance(start, tuple) else start
        return states

    def build(self, transform: Transform, file: str = "<pipeline>") -> dict[str, Function]:
        """The steps with this chain in them, `step_drone` and `step_rig`, and what recalls a past, `recall`.

        Args:
            transform: applied to every function, told whether to be inlined: numba's `njit`, or `keep_plain`.
            file: where the text is said to come from.
        """
        namespace: dict[str, Any] = {"__name__": __name__, "Motion": Motion, "Body": Body}
        shared = {function: transform(function) for function in self.functions.values()}
        namespace |= {name: shared[function] for name, function in self.functions.items()}
        exec(compile(self.source, file, "exec"), namespace)
        chain = {name: transform(namespace[name], inline=True) for name in CHAIN}
        bound = {}
        for f in STEPS:
            # numba freezes globals as it compiles, so each catalogue has functions of its own that find its chain there
            own = FunctionType(f.__code__, f.__globals__ | chain, f.__name__)
            own.__module__ = f.__module__
            bound[f.__name__] = transform(own, inline=True)
        return bound


def keep_plain(function: Function, inline: bool = False) -> Function:
    """The function as it is: for a pipeline in plain Python."""
    return function


def write_pipeline(model: mujoco.MjModel, catalogue: Sequence[Effect], only: frozenset[str] | None = None) -> Pipeline:
    """Write the pipeline of a catalogue, in its order, for a model's joints.

    With `only` the text has these effects alone; columns, switches and states are those of the whole catalogue.
    """
    effects = [e for e in catalogue if e.stage in STEP_STAGES]
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    addresses = {"position": model.jnt_qposadr, "velocity": model.jnt_dofadr}
    columns: dict[tuple[str, str], int] = {}
    states: dict[str, list[str]] = {}
    starts: list[float | tuple[str, int]] = []
    for effect in effects:
        for parameter in effect.parameters:
            columns[effect.id, parameter.name] = len(columns)
        copies = 2 if effect.stage is Stage.THRUST else 1  # one for each rotor
        rotor = " + rotor_2" if effect.stage is Stage.THRUST else ""
        first = len(starts)
        states[effect.id] = [f"s[{first + copies * i}{rotor}]" for i in range(len(effect.states))]
        for state in effect.states:
            start = state.start
            joint = joints.get(effect.target, -1)
            starts += copies * [(start, int(addresses[start][joint])) if isinstance(start, str) else float(start)]
    places = {effect.id: i for i, effect in enumerate(effects)}
    written = [e for e in effects if only is None or e.id in only]
    functions = {name_function(places[e.id], e): e.apply for e in written}

    writer = ChainWriter(model, written, columns, places, states)
    parts = writer.shape_thrust(), writer.push_craft(), writer.push_joints(joints), writer.muster_friction(joints)
    source = "\n".join(line for part in parts for line in (*part, ""))
    return Pipeline(source, functions, columns, places, tuple(starts))


@dataclass(frozen=True)
class ChainWriter:
    """Writes the functions of `CHAIN`, lines of text each, for the effects of a catalogue that act every step.

    Switches are looked up in the step, not written into it: all twins of a catalogue share what is compiled.
    """

    model: mujoco.MjModel  # whose joints they act on
    effects: Sequence[Effect]  # in the order of the catalogue
    columns: Mapping[tuple[str, str], int]  # (effect id, parameter) → column of a simulation's parameters
    places: Mapping[str, int]  # effect id → place among the switches
    states: Mapping[str, list[str]]  # effect id → what its states are called in the text

    def of(self, stage: Stage, target: str) -> list[Effect]:
        """The effects of a stage on a joint, or on the craft ("")."""
        return [e for e in self.effects if e.stage is stage and (e.target == target or target in e.members)]

    def when(self, effect: Effect) -> str:
        """The condition under which an effect acts; what evolves stands still while the strength is off."""
        strength = effect.parameters[0]
        evolves = effect.states or effect.stage is Stage.SLIP
        off = f" and p[{self.columns[effect.id, strength.name]}] != {float(strength.off)!r}" if evolves else ""
        return f"    if on[{self.places[effect.id]}]{off}:"

    def call(self, effect: Effect, result: str, *inputs: str, kept: Sequence[str] | None = None) -> str:
        """The call of an effect's function, its new states under their own names or under those `kept`."""
        own = self.states[effect.id]
        parameters = [f"p[{self.columns[effect.id, p.name]}]" for p in effect.parameters]
        given = [*inputs, *own, *(["dt"] if own else []), *parameters]
        returned = ", ".join([result, *(own if kept is None else kept)])
        return f"        {returned} = {name_function(self.places[effect.id], effect)}({', '.join(given)})"

    def moves(self, dof: int, direction: str) -> str:
        """The motion of a joint as its effects see it."""
        q = find_place(self.model, dof)
        diagonal = int(self.model.M_rowadr[dof] + self.model.M_rownnz[dof]) - 1
        return f"Motion(view.qpos[{q}], view.qvel[{dof}], {direction}, load[{dof}], lever, view.inertia[{diagonal}])"

    def shape_thrust(self) -> list[str]:
        """Thrust passes through the THRUST effects, whatever they act on."""
        lines = ["def shape_thrust(on, p, s, thrust, rotor, dt):", "    rotor_2 = int(rotor.side > 0.0)"]
        for effect in (e for e in self.effects if e.stage is Stage.THRUST):
            lines += [self.when(effect), self.call(effect, "thrust", "thrust", "rotor")]
        return [*lines, "    return thrust"]

    def push_craft(self) -> list[str]:
        """Forces on the craft add up."""
        lines = ["def push_craft(on, p, s, craft, dt):", "    f_x = f_z = moment = 0.0"]
        for effect in self.of(Stage.FORCE, ""):
            lines += [self.when(effect), self.call(effect, "more_x, more_z, more_moment", "craft")]
            lines += ["        f_x, f_z, moment = f_x + more_x, f_z + more_z, moment + more_moment"]
        return [*lines, "    return f_x, f_z, moment"]

    def push_joints(self, joints: Mapping[str, int]) -> list[str]:
        """Forces on every joint add up."""
        lines = ["def push_joints(on, p, s, view, load, lever, force):", "    dt = view.timestep"]
        lines += self.push_bodies()
        for joint, i in joints.items():
            dof = int(self.model.jnt_dofadr[i])
            pushing = self.of(Stage.FORCE, joint) if joint else []
            lines += [f"    still = {self.moves(dof, '0.0')}"] if pushing else []
            for effect in pushing:
                lines += [self.when(effect), self.call(effect, "more", "still"), f"        force[{dof}] += more"]
        return [*lines, "    return None"]

    def push_bodies(self) -> list[str]:
        """Forces and moments on every body that turns any way add up; on a ball joint's but moments."""
        lines, more = [], [f"more_{i}" for i in range(6)]
        for q, turn in list_attitudes(self.model):
            joint = int(self.model.dof_jntid[turn])
            name, free = self.model.body(int(self.model.jnt_bodyid[joint])).name, self.model.jnt_type[joint] == FREE
            place = [f"view.qpos[{q - 3 + i}]" if free or i > 2 else "0.0" for i in range(7)]
            speed = [f"view.qvel[{turn - 3 + i}]" if free or i > 2 else "0.0" for i in range(6)]
            pushing = self.of(Stage.FORCE, name) if name else []
            lines += [f"    body = Body({', '.join([*place, *speed])}, view.time)"] if pushing else []
            for effect in pushing:
                lines += [self.when(effect), self.call(effect, ", ".join(more), "body")]
                lines += [f"        force[{turn - 3 + i}] += {more[i]}" for i in range(0 if free else 3, 6)]
        return lines

    def muster_friction(self, joints: Mapping[str, int]) -> list[str]:
        """Levels of every joint that rubs, and the force that takes their place where one slips by a law of its own."""
        lines = ["def muster_friction(on, p, s, dry, view, load, lever, forward, backward, force):"]
        lines += ["    dt, most = view.timestep, 0.0", "    for i in range(len(forward)):"]
        lines += ["        forward[i] = backward[i] = dry[i]", "        most = max(most, dry[i])"]
        for joint, i in joints.items():
            rubbing, slipping = (self.of(stage, joint) if joint else [] for stage in (Stage.FRICTION, Stage.SLIP))
            dofs = int(self.model.jnt_dofadr[i]) + np.arange(3 if self.model.jnt_type[i] == BALL else 1)
            for dof in map(int, dofs) if rubbing or slipping else ():
                lines += [f"    ahead, back = dry[{dof}], dry[{dof}]"]
                lines += [f"    still = {self.moves(dof, '0.0')}"]
                lines += [f"    onward, backward_on = {self.moves(dof, '1.0')}, {self.moves(dof, '-1.0')}"]
                for effect in rubbing:
                    lines += self.muster(effect, dof)
                for effect in slipping:
                    lines += [self.when(effect), self.call(effect, "more", "still", "ahead", "back")]
                    lines += [f"        force[{dof}] += more", "        ahead = back = 0.0"]
                lines += [f"    forward[{dof}], backward[{dof}] = ahead, back", "    most = max(most, ahead, back)"]
        return [*lines, "    return most > 0.0"]

    def muster(self, effect: Effect, dof: int) -> list[str]:
        """Either sense of motion has a level, which passes through the joint's effects in order: they add or scale."""
        ways = {"ahead": "onward", "back": "backward_on"}
        after = {level: [f"{level}_{k}" for k in range(len(effect.states))] for level in ways}
        lines = [self.when(effect)]
        lines += [self.call(effect, way, way, s, kept=after[way]) for way, s in ways.items()]
        for own, *pair in zip(self.states[effect.id], *after.values()):
            lines += [f"        {own} = {pair[0]} if view.qvel[{dof}] >= 0.0 else {pair[1]}"]
        return lines


def name_function(place: int, effect: Effect) -> str:
    """What an effect's function is called in the text, whatever its joint is called: rigs of one form share a step."""
    kind = effect.id.rpartition(".")[2]
    return f"effect_{place}_" + "".join(c if c.isalnum() else "_" for c in kind)


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
    own, versions = describe_compilers()
    files = {inspect.getsourcefile(f) or "" for f in reached} | own
    for file in sorted(files):
        digest.update(Path(file).read_bytes() if Path(file).is_file() else b"")
    digest.update(versions.encode())
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


COMPILED = (
    "effects/base.py",
    "robots/planar_drone/effects/laws.py",
    "actuators/*.py",
    "engine/*.py",
    *(f"twin/stepping/{name}.py" for name in ("step", "friction", "kernel", "fused", "pipeline")),
)
"""Files of this project whose functions are compiled, besides those of the effects."""


@cache
def describe_compilers() -> tuple[frozenset[str], str]:
    """The files that `COMPILED` names, and versions of what compiles."""
    root = Path(__file__).parents[2]
    files = frozenset(str(file) for pattern in COMPILED for file in root.glob(pattern))
    return files, " ".join([*map(version, ("numba", "llvmlite", "mujoco", "numpy")), sys.version])
