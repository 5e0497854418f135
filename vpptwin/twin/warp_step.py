"""Steps of many simulations in one Warp kernel: the pipeline of `vpptwin.twin.fused`, a thread per simulation.

`vpptwin.twin.specialize` runs the pipeline's Python on what all simulations share and writes down the rest, so that
there is no second list of effects and no second formula. What evolves lies in one table, (rows, N), what differs by
simulation in another; a thread reads its column, keeps it in variables for all inner steps, and writes it back.
"""

from __future__ import annotations

import ast
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from vpptwin.engine.tree import FUNCTIONS, Pose, Shape
from vpptwin.engine.view import View, foresee_actuators
from vpptwin.errors import InputError, load_extra
from vpptwin.twin.fused import FIELDS, FLIGHT, list_room, list_statics
from vpptwin.twin.kernel import CALLS, scratch_rows
from vpptwin.twin.layout import PER_SIMULATION, make_pose, read_matrices
from vpptwin.twin.paths import drop_unused
from vpptwin.twin.pipeline import keep_plain
from vpptwin.twin.specialize import Writer, keep_source
from vpptwin.twin.state import TwinState
from vpptwin.twin.step import Rig, Row, Tape
from vpptwin.twin.terms import REAL, WHOLE, Cells, Frame, Record, Repeat, Ring, Term, Unwritable
from vpptwin.twin.twin import Twin

EVERY = slice(None)
NEED = "a twin on Warp"
WAY_OUT = "write it so, or fly it on the processor (engine=numba), which compiles it with numba"
UNDERSTOOD = "numbers, arithmetic, if, loops over what is known, and numpy's functions of numbers"
SETTLED = 1e-6
"""Stands for `vpptwin.twin.friction.SETTLED` in float32, which holds seven digits."""
HEAD = """\
@wp.func
def sign(x: Real):
    return wp.where(x > Real(0.0), Real(1.0), wp.where(x < Real(0.0), Real(-1.0), Real(0.0)))


@wp.func
def expm1(x: Real):
    grown = wp.exp(x)
    if grown == Real(1.0):
        return x
    less = grown - Real(1.0)
    if less == Real(-1.0):
        return less
    return less * x / wp.log(grown)


@wp.kernel
def fly(s: wp.array2d(dtype=Real), c: wp.array2d(dtype=Real), command: wp.array2d(dtype=Real),
        touched: wp.array(dtype=wp.int32)):
    i = wp.tid()
"""
# Warp's sign of zero is 1. expm1: Kahan's way, exact to rounding (Higham, Accuracy and Stability, 2002, section 1.14).


@dataclass(frozen=True)
class Rows:
    """Which rows of a table each array of numbers takes.

    Attributes:
        shapes: of the arrays of one simulation, by name.
    """

    shapes: Mapping[str, tuple[int, ...]]

    @cached_property
    def starts(self) -> dict[str, int]:
        """The first row of each."""
        firsts, total = {}, 0
        for name, shape in self.shapes.items():
            firsts[name] = total
            total += math.prod(shape)
        return firsts

    @property
    def count(self) -> int:
        """Rows of the table."""
        return sum(map(math.prod, self.shapes.values()))

    def __getitem__(self, name: str) -> slice:
        """The rows of an array."""
        first = self.starts[name]
        return slice(first, first + math.prod(self.shapes[name]))

    def pack(self, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
        """The table, (rows, N), of arrays (N, ...)."""
        parts = [np.asarray(arrays[name], float).reshape(len(arrays[name]), -1).T for name in self.shapes]
        return np.ascontiguousarray(np.concatenate(parts))

    def unpack(self, table: np.ndarray) -> dict[str, np.ndarray]:
        """The arrays, (N, ...), of a table."""
        count = table.shape[1]
        return {name: table[self[name]].T.reshape(count, *shape).copy() for name, shape in self.shapes.items()}

    def terms(self, name: str, table: str) -> Cells:
        """The numbers of an array as they lie in a column."""
        first, shape = self.starts[name], self.shapes[name]
        cells = np.empty(math.prod(shape), dtype=object)
        cells[:] = [Term(f"{table}[{first + k}, i]", REAL, lasting=True) for k in range(cells.size)]
        return Cells.of(cells.reshape(shape))


def load_warp() -> Any:  # noqa: ANN401
    """Warp, which says nothing but errors.

    Raises:
        InputError: if it is not installed.
    """
    wp = load_extra("warp", NEED)
    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    return wp


class WarpStep:
    """The step of a twin as a Warp kernel, for as many simulations as its tables have columns.

    Args:
        twin: whose rig and effects it steps; its parameters may change, what it has switched on stays.
        steps: inner steps of a launch.
        single: numbers are float32 instead of float64.

    Attributes:
        state: rows of the table of what evolves, of `TwinState.arrays`.
        numbers: rows of the table of what differs by simulation.
        source: the kernel's text.

    Raises:
        InputError: if the rig is one that only MuJoCo steps, or an effect does what Warp cannot compile: its id, the
            file and the line.
    """

    def __init__(self, twin: Twin, steps: int = 10, single: bool = False) -> None:
        if twin.layout is None or twin.spec.robot.step != "step_drone":
            found = f"{twin.spec.name}, a rig that only MuJoCo steps" if twin.layout is None else f"{twin.spec.name}"
            raise InputError(f"{NEED}: {found}", "the drone on its rig", "fly it on the processor")
        self.twin, self.single = twin, single
        one = twin.initial_state(ids=np.zeros(1, int)).arrays()
        self.state = Rows({name: array.shape[1:] for name, array in one.items()})
        self.numbers = Rows({name: array.shape[1:] for name, array in self._list_numbers().items()})
        self.source = HEAD + "".join(f"    {line}\n" for line in self._write(steps))

    def _list_numbers(self) -> dict[str, np.ndarray]:
        """What differs by simulation, by name, (N, ...): parameters and constants that effects write."""
        table = self.twin.table
        written = {name for effect in self.twin.effects.values() for name in effect.writes if name in table}
        listed = {PER_SIMULATION.get(name, name): table[name] for name in sorted(written)}
        if "body_imat" in listed:
            listed["body_imat"] = read_matrices(listed["body_imat"])
        for (effect, name), column in self.twin.pipeline.columns.items():
            if effect in self.twin.effects:
                listed[f"{effect}.{name}"] = self.twin.parameters[:, column]
        return listed

    def pack_numbers(self, ids: slice = EVERY) -> np.ndarray:
        """The twin's parameters and constants of now as a table, (rows, N), or those of some simulations.

        With nothing that differs it has one row, which nothing reads.
        """
        listed = {name: array[ids] for name, array in self._list_numbers().items()}
        return self.numbers.pack(listed) if listed else np.zeros((1, len(range(self.twin.num_sims)[ids])))

    def pack_state(self, state: TwinState) -> np.ndarray:
        """A state as a table, (rows, N)."""
        return self.state.pack(state.arrays())

    def unpack_state(self, table: np.ndarray) -> TwinState:
        """The state that a table holds."""
        arrays = self.state.unpack(np.asarray(table, float))
        arrays["actuators.newest"] = arrays["actuators.newest"].astype(np.int64)
        return TwinState.from_arrays(arrays)

    def _write(self, steps: int) -> list[str]:
        """The lines of the kernel's body."""
        twin, model = self.twin, self.twin.model
        file = f"<pipeline {hashlib.sha256(twin.pipeline.source.encode()).hexdigest()[:16]}>"
        keep_source(twin.pipeline.source, file)
        names: dict[str, Any] = {"SWEEPS": Repeat(100)} | ({"SETTLED": SETTLED} if self.single else {})
        writer = Writer(self.single, names)
        frame = Frame(None, self._name_all(steps) | twin.pipeline.build(keep_plain, file), 0)
        text = FLIGHT.format(nv=int(model.nv), nu=int(model.nu), step=CALLS["step_drone"])
        kept = {name: frame[name] for name in ("clock", "qpos", "qvel", "warmstart", "row")}
        try:
            writer.run(ast.parse(text).body, frame)
        except Unwritable as error:
            raise self._refuse(error) from None
        row = kept["row"]
        ends = {"time": kept["clock"], "qpos": kept["qpos"], "qvel": kept["qvel"], "warmstart": kept["warmstart"]}
        ends |= {"memory": row.memory, "effects": row.effects}
        ends |= {f"actuators.{name}": cells for name, cells in row.layer.fields.items() if isinstance(cells, Cells)}
        for name, cells in ends.items():
            for k, place in enumerate(cells.index.ravel().tolist()):
                value, where = cells.store[place], f"s[{self.state.starts[name] + k}, i]"
                if not isinstance(value, Term) or where not in value.text:
                    writer.lines.append(f"{where} = {writer.write_out(value)}")
        touches = writer.write_out(frame["touches"], "wp.int32")
        return drop_unused([*writer.lines, f"touched[i] = {touches}"])

    def _name_all(self, steps: int) -> dict[str, Any]:
        """What the lines of `FLIGHT` find by name."""
        twin, model = self.twin, self.twin.model
        layout, nv, nu = twin.layout, int(model.nv), int(model.nu)
        assert layout is not None
        own: dict[str, Any] = {
            n: self.numbers.terms(n, "c") if n in self.numbers.shapes else layout.numbers[n] for n in FIELDS
        }
        room = {
            name: Cells.of(np.zeros(shape))
            for name, shape in list_room(int(model.nbody), nv, nu, int(model.nC)).items()
        }
        shared = {n: a for n, a in list_statics(layout, model).items() if "." not in n}
        room_of_pose: list[Any] = [Cells.of(array) for array in make_pose(int(model.nbody), nv)]
        state: dict[str, Any] = {name: self.state.terms(name, "s") for name in self.state.shapes}
        free: Any = Cells.of(np.zeros((scratch_rows(nv), nv)))
        row = Row(
            self._read_layer(state),
            self._read_constants(),
            self._read_parameters(),
            state["memory"],
            state["effects"],
            free,
        )
        none = np.zeros((0, nu))
        command: Any = Cells.of(
            np.array([[Term(f"command[{k}, i]", REAL, lasting=True) for k in range(2)]], dtype=object)
        )
        return {
            **{name: cells for name, cells in room.items() if "." not in name}, **shared,
            **{name: own[name] for name in FIELDS if name not in Shape._fields},
            "tree": layout.tree, "reach": layout.reach, "at": Pose(*room_of_pose),
            "shape": Shape(**{n: own[n] for n in Shape._fields}),
            "rig": Rig(twin.switches, twin.dry, twin.spec.robot.carriage), "row": row, "steps": Repeat(steps),
            "tape": Tape(True, command, none, none, np.zeros((0, nv)), np.zeros((0, nv)), np.zeros(nv), 0),
            "qpos": state["qpos"], "qvel": state["qvel"], "warmstart": state["warmstart"],
            "clock": state["time"].reshape(1), "moment_flat": room["moment"].reshape(nu * nv),
            "vehicle": twin.vehicle, "context": SimpleNamespace(qpos=0, rotor_speed=0), "dt": twin.dt, "View": View,
            "nothing": np.zeros(nv), "foresee_actuators": foresee_actuators, **{f.__name__: f for f in FUNCTIONS},
        }  # fmt: skip

    def _read_layer(self, state: Mapping[str, Cells]) -> Record:
        """The actuators' state, whose commands on their way stay in memory."""
        layer = {n.removeprefix("actuators."): cells for n, cells in state.items() if n.startswith("actuators.")}
        first, shape = self.state.starts["actuators.history"], self.state.shapes["actuators.history"]
        where = self.state.starts["actuators.newest"]
        layer["newest"] = Cells.of(Term(f"wp.int32(s[{where}, i])", WHOLE, lasting=True))
        ring = Ring(lambda row, column: f"{first + column} + {shape[1]} * {row}", "s", shape)
        return Record(**layer | {"history": ring})

    def _read_constants(self) -> Record:
        """Constants of actuators and sensors: those that no effect writes are known."""
        known = self.twin.constants[0]
        return Record(**{
            name: self.numbers.terms(name, "c") if name in self.numbers.shapes else Cells.of(known[name])
            for name in known.dtype.names or ()
        })  # fmt: skip

    def _read_parameters(self) -> Any:  # noqa: ANN401
        """Parameters of the effects that act every step; those of the others are never read."""
        cells: list[Any] = []
        for effect, name in self.twin.pipeline.columns:
            key = f"{effect}.{name}"
            on = key in self.numbers.shapes
            cells.append(Term(f"c[{self.numbers.starts[key]}, i]", REAL, lasting=True) if on else 0.0)
        result = np.empty(len(cells), dtype=object)
        result[:] = cells
        return Cells.of(result)

    def _refuse(self, error: Unwritable) -> Exception:
        """The error for an effect that cannot be compiled; anything else is a mistake of ours."""
        functions = self.twin.pipeline.functions
        ids = zip(functions.values(), self.twin.pipeline.places, strict=True)
        plain = {getattr(f, "py_func", f): effect for f, effect in ids}
        effects = [plain[f] for f, _ in error.stack if f in plain]
        if not effects:
            return error
        function, line = error.stack[-1]
        assert function is not None
        code = function.__code__
        where = code.co_firstlineno + max(line, 1) - 1
        return InputError(
            f"effect {effects[0]} {error} (line {where} of {Path(code.co_filename)})", UNDERSTOOD, WAY_OUT
        )

    @cached_property
    def kernel(self) -> Any:  # noqa: ANN401
        """The Warp kernel; compiled at its first launch on a device, and kept on disk by Warp.

        Raises:
            InputError: if Warp is not installed.
        """
        wp = load_warp()
        namespace: dict[str, Any] = {"wp": wp, "Real": wp.float32 if self.single else wp.float64}
        digest = hashlib.sha256(f"{self.source} {self.single}".encode()).hexdigest()[:16]
        file = f"<warp {digest}>"
        namespace["__name__"] = f"vpptwin_warp_{digest}"  # Warp keeps compiled modules by name and text
        keep_source(self.source, file)
        exec(compile(self.source, file, "exec", dont_inherit=True), namespace)
        kernel = namespace["fly"]
        # A product and a sum fused would round once where numba rounds twice.
        wp.set_module_options({"enable_backward": False, "fuse_fp": self.single}, module=kernel.module)
        return kernel
