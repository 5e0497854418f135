"""The compiled step of a twin: a C function that finds a simulation's rows, runs one step and writes its forces."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from ctypes import CFUNCTYPE, c_int64
from dataclasses import dataclass
from functools import cached_property, lru_cache
from textwrap import indent
from typing import Any

import mujoco
import numpy as np
from numba import njit, types

from vpptwin.actuators.layer import constants_dtype, layer_dtype, move_actuator, push_commands
from vpptwin.actuators.numbers import vehicle_dtype
from vpptwin.effects import Effect
from vpptwin.engine.callback import FUNCTION, MARK, WORDS
from vpptwin.engine.check import check_step
from vpptwin.engine.compile import INNER, KEPT, array_at, c_function
from vpptwin.engine.store import open_entry, seal_entry
from vpptwin.engine.structs import data_offset, mirror_size, model_offset
from vpptwin.engine.tree import FUNCTIONS, Pose, Reach, Shape, Tree
from vpptwin.engine.view import COLUMNS, DATA_ARRAYS, MODEL_ARRAYS, View, foresee_actuators, foresee_drag
from vpptwin.system.cores import in_parts
from vpptwin.system.progress import tell_wait
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.stepping.fused import write_fused
from vpptwin.twin.stepping.layout import TreeLayout
from vpptwin.twin.stepping.pipeline import Function, Pipeline, fingerprint, write_pipeline
from vpptwin.twin.stepping.step import PastStep, Rig, Row, Tape

CONTEXT = np.dtype(
    [(name, np.int64) for name in (
        "vehicle", "layer", "constants", "parameters", "memory", "effects", "scratch", "active", "dry", "driven",
        "counter", "policy", "steps", "segments", "command", "speed", "throttle", "push", "lead", "qpos", "qvel",
        "rotor_speed", "fields", "static", "time", "state_qpos", "state_qvel", "warmstart", "stuck",
    )]
)  # fmt: skip
"""Addresses of the arrays that a call works on (0 for none), and its numbers of steps and of force segments."""
COMPILING = "compiling the step of this rig, once, 10 to 30 s"
CALLS = {
    "step_drone": "step_drone(vehicle, rig, view, row, tape, k)",
    "step_rig": "step_rig(rig, view, row, tape, k)",
}
"""Inner steps of `vpptwin.twin.stepping.step` by name, as the callback calls them."""
FLY = CFUNCTYPE(None, c_int64, c_int64, c_int64, c_int64)
"""A function that steps a range of simulations."""

ROW = """\
vehicle = array_at(context.vehicle, (1,), VEHICLE)[0]
row = Row(
    array_at(context.layer, (i + 1,), LAYER)[i],
    array_at(context.constants, (i + 1,), CONSTANTS)[i],
    array_at(context.parameters + {parameters} * 8 * i, ({parameters},), np.float64),
    array_at(context.memory + (2 + {nv}) * 8 * i, (2 + {nv},), np.float64),
    array_at(context.effects + {states} * 8 * i, ({states},), np.float64),
    array_at(context.scratch + {scratch} * {nv} * 8 * i, ({scratch}, {nv}), np.float64),
)
steps = context.steps
commands = 1 if context.policy else steps
tape = Tape(
    context.policy != 0,
    array_at(context.command + commands * {nu} * 8 * i, (commands, {nu}), np.float64),
    array_at(context.speed + steps * {nu} * 8 * i, (steps if context.speed else 0, {nu}), np.float64),
    array_at(context.throttle + steps * {nu} * 8 * i, (steps if context.throttle else 0, {nu}), np.float64),
    array_at(context.push + context.segments * {nv} * 8 * i, (context.segments, {nv}), np.float64),
    array_at(context.lead + steps * {nv} * 8 * i, (steps if context.lead else 0, {nv}), np.float64),
    array_at(context.driven, ({nv},), np.float64),
    steps,
)
"""
"""Lines that make the row and the tape of simulation i out of a context."""

# As text, since sizes and offsets of a model are numbers in it: loops over joints unroll, numba keeps a file per model.
# MuJoCo calls it in the middle of a step: passive forces and bias are there, actuators' and constraints' are to come.
ENTRY = """
def control(m, d):
    model = array_at(m, ({model_words},), np.int64)
    if model[{nuserdata}] != {words}:
        return
    data = array_at(d, ({data_words},), np.int64)
    marks = array_at(data[{userdata}], ({words},), np.int64)
    if marks[0] != {mark}:
        return
    context = array_at(marks[1], (1,), CONTEXT)[0]
    i = marks[2]
    model_numbers, data_numbers = array_at(m, ({model_words},), np.float64), array_at(d, ({data_words},), np.float64)
    data_halves = array_at(d, ({data_words} * 2,), np.int32)
    constraints, colliding = data_halves[{nefc}], data_halves[{ncon}] > 0
    gravity = model_numbers[{gravity} : {gravity} + 3]
    view = View(
        data_numbers[{time}], model_numbers[{timestep}],
{view}
    )
{row}
    counter = array_at(context.counter, (i + 1,), np.int64)
    k = counter[i]
    counter[i] = k + 1
    if context.qpos:
        kept_qpos = array_at(context.qpos + steps * {nq} * 8 * i, (steps, {nq}), np.float64)
        kept_qvel = array_at(context.qvel + steps * {nv} * 8 * i, (steps, {nv}), np.float64)
        for j in range({nq}):
            kept_qpos[k, j] = view.qpos[j]
        for j in range({nv}):
            kept_qvel[k, j] = view.qvel[j]
    rig = Rig(array_at(context.active, ({places},), np.bool_), array_at(context.dry, ({nv},), np.float64), {carriage})
    {step}
    if context.rotor_speed:
        kept_speed = array_at(context.rotor_speed + steps * {nu} * 8 * i, (steps, {nu}), np.float64)
        for a in range({nu}):
            kept_speed[k, a] = row.layer.rotor_speed[a]
"""


MANY = 10_000
"""Past commands for which another thread pays."""
SIZES = np.dtype([(name, np.int64) for name in ("count", "steps", "rows", "first")] + [("dt", np.float64)])
"""Of past commands: numbers of simulations and steps, addresses of whose row is which and of first steps, step [s]."""
WARM_UP = """
def warm_up(layer, constants, commands, sizes):
    size = array_at(sizes, (1,), SIZES)[0]
    layers = array_at(layer, (size.count,), LAYER)
    known = array_at(constants, (size.count,), CONSTANTS)
    rows = array_at(size.rows, (size.count,), np.int64)
    for i in range(size.count):
        given = array_at(commands + size.steps * {nu} * 8 * rows[i], (size.steps, {nu}), np.float64)
        first = array_at(size.first + {nu} * 8 * i, ({nu},), np.int64)
        for k in range(size.steps):
            push_commands(layers[i])
            for j in range({nu}):
                if k >= first[j]:
                    move_actuator(layers[i], known[i], j, given[k, j], size.dt)
"""


@dataclass(frozen=True)
class Kernel:
    """The compiled step for one model and catalogue; compiled when it is first asked for."""

    pipeline: Pipeline  # the effects' part of it
    layer: np.dtype  # dtype of the actuators' state
    constants: np.dtype  # dtype of the constants
    entry: str  # text of the function that MuJoCo's control callback is
    fused: str | None  # text of the function that steps without MuJoCo; None for a model that needs it

    @cached_property
    def callback(self) -> Any:  # noqa: ANN401
        """The C function for MuJoCo's control callback."""
        return self._compile(self.entry, "control", FUNCTION)

    @cached_property
    def fly(self) -> Any:  # noqa: ANN401
        """The C function that steps a range of simulations: address of a context, first, one past the last, room."""
        assert self.fused is not None
        return self._compile(self.fused, "fly", FLY)

    def _compile(self, entry: str, name: str, kind: Any) -> Any:  # noqa: ANN401
        dtypes = {"LAYER": self.layer, "CONSTANTS": self.constants}
        return compile_once(entry, name, self.pipeline, dtypes, kind)


def scratch_rows(nv: int) -> int:
    """Rows of the room that a simulation's friction needs, each (nv,)."""
    return 7 + 2 * nv


_KERNELS: dict[str, tuple[Any, Any]] = {}


def write_kernel(spec: TwinSpec, model: mujoco.MjModel, layout: TreeLayout | None) -> Kernel:
    """The step of a twin's catalogue on the model that it steps, effects on or off, compiled once per process.

    Where files last it is compiled once per machine. With a `layout` it steps without MuJoCo, too.
    """
    pipeline, step, carriage = write_pipeline(model, spec.catalogue), spec.robot.step, spec.robot.carriage
    nu, depth, fused = int(model.nu), delay_depth(spec.catalogue, float(model.opt.timestep)), None
    if layout is not None:
        row = indent(write_row(model, pipeline), 8 * " ")
        fused = write_fused(layout, model, len(pipeline.places), carriage, CALLS[step], row)
    layer, constants = layer_dtype(nu, depth, spec.controller == "adaptive"), constants_dtype(nu, int(model.nv))
    return Kernel(pipeline, layer, constants, write_entry(model, pipeline, step, carriage), fused)


def write_row(model: mujoco.MjModel, pipeline: Pipeline) -> str:
    """The lines of `ROW` for a model's sizes."""
    nv = int(model.nv)
    return ROW.format(
        parameters=len(pipeline.columns), states=len(pipeline.starts), scratch=scratch_rows(nv), nv=nv, nu=int(model.nu)
    )


def write_entry(model: mujoco.MjModel, pipeline: Pipeline, step: str, carriage: int) -> str:
    """The text of the C function for a model's sizes."""
    nv = int(model.nv)
    model_words = {"nuserdata": "nuserdata", "gravity": "opt.gravity", "timestep": "opt.timestep"}
    arguments = {
        "model_words": mirror_size("mjModel") // 8, "data_words": mirror_size("mjData") // 8,
        **{name: model_offset(field) // 8 for name, field in model_words.items()},
        **{name: data_offset(name) // 8 for name in ("userdata", "time")},
        **{name: data_offset(name) // 4 for name in ("nefc", "ncon")},
        "words": WORDS, "mark": MARK, "view": write_view(model), "carriage": carriage, "step": CALLS[step],
        "places": len(pipeline.places), "nq": int(model.nq), "nv": nv, "nu": int(model.nu),
        "row": indent(write_row(model, pipeline), 4 * " "),
    }  # fmt: skip
    return ENTRY.format(**arguments)


def write_view(model: mujoco.MjModel) -> str:
    """The lines that look up every array of a `View`."""
    lines = []
    for name in View._fields:
        if name in ("time", "timestep"):
            continue
        if name in ("constraints", "colliding", "gravity"):
            lines.append(f"        {name},")
            continue
        table, offset, struct = (
            (MODEL_ARRAYS, model_offset, "model") if name in MODEL_ARRAYS else (DATA_ARRAYS, data_offset, "data")
        )
        field, dtype, size = table[name]
        address, count = f"{struct}[{offset(field) // 8}]", int(getattr(model, size))
        shape = f"({count}, {COLUMNS[name]})" if name in COLUMNS else f"({count},)"
        lines.append(f"        array_at({address}, {shape}, np.{np.dtype(dtype).name}),")
    return "\n".join(lines)


def compile_once(entry: str, name: str, pipeline: Pipeline | None, dtypes: dict[str, np.dtype], kind: Any) -> Any:  # noqa: ANN401
    """The C function of a name that a text defines, with the effects of a pipeline, compiled once per process."""
    source = pipeline.source + entry if pipeline else entry
    key = name_entry(source, tuple(sorted(dtypes.items())), tuple(pipeline.functions.values()) if pipeline else ())
    if key not in _KERNELS:
        if kind is FUNCTION:
            check_step()
        function = compile_entry(source, name, key, pipeline, dtypes)
        _KERNELS[key] = kind(int(function.address or 0)), function
    return _KERNELS[key][0]


@lru_cache(maxsize=64)
def name_entry(source: str, dtypes: tuple[tuple[str, np.dtype], ...], functions: tuple[Callable[..., Any], ...]) -> str:
    """What a compiled text is kept under: hashing it and all that it calls takes as long as a run through windows."""
    return fingerprint(source, str(dict(dtypes)), functions=functions)


def compile_entry(source: str, name: str, key: str, pipeline: Pipeline | None, dtypes: dict[str, np.dtype]) -> Any:  # noqa: ANN401
    """The C function of a name that a text defines, kept on disk under a key."""
    file = open_entry(key, source)

    # numpy's error model: nothing can be raised in C; a division by zero gives inf, which `vpptwin.twin.health` tells.
    def compiled(function: Function, inline: bool = False) -> Function:
        return njit(function, error_model="numpy", forceinline=inline, **INNER)

    namespace: dict[str, Any] = {
        "__name__": __name__, "np": np, "array_at": array_at,
        **{thing.__name__: thing for thing in (Tree, Shape, Reach, Pose, View, Row, Rig, Tape, PastStep)},
        **{function.__name__: function for function in FUNCTIONS}, "foresee_actuators": foresee_actuators,
        "foresee_drag": foresee_drag,
        "CONTEXT": CONTEXT, "VEHICLE": vehicle_dtype(), "SIZES": SIZES, "push_commands": push_commands,
        "move_actuator": move_actuator, **(pipeline.build(compiled) if pipeline else {}), **dtypes,
    }  # fmt: skip
    exec(compile(source, str(file or "<kernel>"), "exec"), namespace)
    signature = types.void(types.voidptr, types.voidptr) if name == "control" else types.void(*(types.int64,) * 4)
    known = pipeline is None or (file is not None and any(file.parent.glob(KEPT)))
    with nullcontext() if known else tell_wait(COMPILING, always=True):
        function = c_function(signature, keep=file is not None, error_model="numpy")(namespace[name])
    if file is not None:
        seal_entry(file)
    return function


def delay_depth(effects: Iterable[Effect], dt: float) -> int:
    """Commands that a delay line must hold for these effects at a step of `dt` [s]; 0 when none delays.

    Delays of one actuator and of all together add up.
    """
    longest = defaultdict[str, float](float)
    for effect in (effect for effect in effects if "actuator.delay" in effect.writes):
        for place in effect.places:
            longest[place] += sum(p.high for p in effect.parameters)
    return int(np.ceil(max(longest.values()) / dt)) + 2 if longest else 0


def warm_up(layer: np.ndarray, constants: np.ndarray, commands: np.ndarray, rows: np.ndarray, dt: float) -> np.ndarray:
    """The actuators' state after past commands, those of its row of (R, steps, nu), oldest first.

    Args:
        layer: (N,), which is not changed.
        constants: (N,).
        commands: (R, steps, nu).
        rows: (N,).
        dt: inner step [s].
    """
    result, known = layer.copy(), np.ascontiguousarray(constants)
    given, own = np.ascontiguousarray(commands, float), np.ascontiguousarray(rows, np.int64)
    first = find_first(layer, constants, given, dt)
    text, dtypes = WARM_UP.format(nu=given.shape[2]), {"LAYER": result.dtype, "CONSTANTS": constants.dtype}
    move = compile_once(text, "warm_up", None, dtypes, FLY)

    def move_some(begin: int, end: int) -> None:
        part, same, number, since = (array[begin:end] for array in (result, known, own, first))
        sizes = np.array([(end - begin, given.shape[1], number.ctypes.data, since.ctypes.data, dt)], SIZES)
        move(*(array.ctypes.data for array in (part, same, given, sizes)))

    in_parts(move_some, len(own), least=max(MANY // max(given.shape[1], 1), 1))
    return result


def find_first(layer: np.ndarray, constants: np.ndarray, commands: np.ndarray, dt: float) -> np.ndarray:
    """The first of past commands, (R, steps, nu), that each actuator may still know of, (N, nu).

    One without lag, play and a rate that limits it remembers those alone that are on their way, to the last digit.
    """
    steps, depth, horn = commands.shape[1], layer.dtype["history"].shape[0], layer["horn"]
    way = np.maximum(commands.max(initial=-np.inf), horn) - np.minimum(commands.min(initial=np.inf), horn)
    forgets = (constants["actuator.time_constant"] == 0.0) & (constants["actuator.gap"] == 0.0)
    forgets &= constants["actuator.rate_limit"] * dt > 2.0 * way
    return np.where(forgets, max(steps - 2 * depth - 4, 0), 0)
