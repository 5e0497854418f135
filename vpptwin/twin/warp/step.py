"""Steps of many simulations in one Warp kernel: the pipeline of `vpptwin.twin.stepping.fused`, a thread per simulation.

`engine.trace` runs the pipeline's Python on what all simulations share and writes down the rest, so that
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

from vpptwin.effects import Effect
from vpptwin.engine.trace.paths import drop_unused
from vpptwin.engine.trace.specialize import Writer, keep_source
from vpptwin.engine.trace.terms import REAL, WHOLE, Cells, Record, Repeat, Ring, Scope, Term, Unwritable
from vpptwin.engine.tree import FUNCTIONS, Pose, Shape
from vpptwin.engine.view import View, foresee_actuators, foresee_drag
from vpptwin.system.errors import InputError
from vpptwin.twin.state import TwinState
from vpptwin.twin.stepping.fused import FIELDS, FLIGHT, list_room, list_statics
from vpptwin.twin.stepping.kernel import CALLS, scratch_rows
from vpptwin.twin.stepping.layout import PER_SIMULATION, make_pose, read_matrices
from vpptwin.twin.stepping.pipeline import keep_plain
from vpptwin.twin.stepping.step import Rig, Row, Tape
from vpptwin.twin.twin import Twin
from vpptwin.twin.warp.device import NEED, load_warp

EVERY = slice(None)
UNDERSTOOD = "numbers, arithmetic, if, loops over what is known, and numpy's functions of numbers"
SETTLED = 1e-6
"""Stands for `vpptwin.twin.stepping.friction.SETTLED` in float32, which holds seven digits."""
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
def fly(s: wp.array2d(dtype=Real), c: wp.array2d(dtype=Real), {inputs}, touched: wp.array(dtype=wp.int32)):
    i = wp.tid()
"""
# Warp's sign of zero is 1. expm1: Kahan's way, exact to rounding (Higham, Accuracy and Stability, 2002, section 1.14).


@dataclass(frozen=True)
class TableLayout:
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
        """TableLayout of the table."""
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


class WarpStep:
    """The step of a twin as a Warp kernel, for as many simulations as its tables have columns.

    Args:
        twin: whose rig and effects it steps; its parameters may change, what it has switched on stays.
        steps: inner steps of a launch.
        single: numbers are float32 instead of float64.

    Attributes:
        effects: that are in the kernel, by id.
        state: rows of the table of what evolves, of `TwinState.arrays`.
        numbers: rows of the table of what differs by simulation.
        source: the kernel's text.

    Raises:
        InputError: if the rig is one that only MuJoCo steps, or an effect does what Warp cannot compile: its id, the
            file and the line.
    """

    inputs = "command: wp.array2d(dtype=Real)"
    """The kernel's arguments beside its tables."""
    rigs: tuple[str, ...] = ("step_drone",)
    """Inner steps that it has."""
    known, way_out = "the drone on its rig", "fly it on the processor (engine=numba)"
    """What rigs those are of, and what to do with others."""
    lines = FLIGHT
    """What the kernel does."""

    def __init__(self, twin: Twin, steps: int | str = 10, single: bool = False) -> None:
        self.twin, self.single = twin, single
        self._check_rig()
        self.effects = self._list_effects()
        one = twin.initial_state(ids=np.zeros(1, int)).arrays()
        self.state = TableLayout({name: array.shape[1:] for name, array in one.items()})
        self.numbers = TableLayout({name: array.shape[1:] for name, array in self._list_numbers(twin).items()})
        head = HEAD.format(inputs=self.inputs)
        self.source = head + "".join(f"    {line}\n" for line in self._write(steps))

    def _check_rig(self) -> None:
        twin = self.twin
        if twin.layout is None or twin.spec.robot.step not in self.rigs:
            found = f"{twin.spec.name}, a rig that only MuJoCo steps" if twin.layout is None else f"{twin.spec.name}"
            raise InputError(f"{NEED}: {found}", self.known, self.way_out)

    def _list_numbers(self, twin: Twin) -> dict[str, np.ndarray]:
        """What differs by simulation, by name, (N, ...): parameters and constants that effects write."""
        listed = self._list_constants(twin, sorted({name for e in self.effects.values() for name in e.writes}))
        for (effect, name), column in twin.pipeline.columns.items():
            if effect in self.effects:
                listed[f"{effect}.{name}"] = twin.parameters[:, column]
        return listed

    def _list_constants(self, twin: Twin, written: list[str]) -> dict[str, np.ndarray]:
        """Constants that effects write, as the kernel calls them."""
        layout, listed = twin.layout, dict[str, np.ndarray]()
        assert layout is not None
        for name in written:
            own = PER_SIMULATION.get(name, name)
            if name in twin.table:
                listed[own] = read_matrices(twin.table[name]) if own == "body_imat" else twin.table[name]
            elif own in layout.numbers:
                listed[own] = np.broadcast_to(layout.numbers[own], (twin.num_sims, *layout.numbers[own].shape))
        return listed

    def pack_numbers(self, ids: slice = EVERY, twin: Twin | None = None) -> np.ndarray:
        """Parameters and constants of now as a table, (rows, N), or those of some simulations.

        With nothing that differs it has one row, which nothing reads.

        Args:
            ids: simulations.
            twin: another one of the same rig.
        """
        twin = twin or self.twin
        listed = {name: array[ids] for name, array in self._list_numbers(twin).items()}
        return self.numbers.pack(listed) if listed else np.zeros((1, len(range(twin.num_sims)[ids])))

    def pack_state(self, state: TwinState) -> np.ndarray:
        """A state as a table, (rows, N)."""
        return self.state.pack(state.arrays())

    def unpack_state(self, table: np.ndarray) -> TwinState:
        """The state that a table holds."""
        arrays = self.state.unpack(np.asarray(table, float))
        arrays["actuators.newest"] = arrays["actuators.newest"].astype(np.int64)
        return TwinState.from_arrays(arrays)

    def _write(self, steps: int | str) -> list[str]:
        """The lines of the kernel's body."""
        twin, model = self.twin, self.twin.model
        file = f"<pipeline {hashlib.sha256(twin.pipeline.source.encode()).hexdigest()[:16]}>"
        keep_source(twin.pipeline.source, file)
        names: dict[str, Any] = {"SWEEPS": Repeat(100)} | ({"SETTLED": SETTLED} if self.single else {})
        writer = Writer(self.single, names)
        scope = Scope(None, self._name_all(steps) | twin.pipeline.build(keep_plain, file), 0)
        text = self.lines.format(
            nv=int(model.nv),
            nu=int(model.nu),
            step=CALLS[twin.spec.robot.step],
            implicit=bool(twin.layout and twin.layout.implicit),
        )
        ends = self._list_ends(scope)
        try:
            writer.run(ast.parse(text).body, scope)
        except Unwritable as error:
            raise self._refuse(error) from None
        for places, cells in ends:
            for where, place in zip(places, cells.index.ravel().tolist(), strict=True):
                value = cells.store[place]
                if not isinstance(value, Term) or where not in value.text:
                    writer.lines.append(f"{where} = {writer.write_out(value)}")
        touches = writer.write_out(scope["touches"], "wp.int32")
        return drop_unused([*writer.lines, f"touched[i] = {touches}"])

    def _list_ends(self, names: Mapping[str, Any]) -> list[tuple[list[str], Cells]]:
        """What is written at the end, number by number, and where to."""
        row = names["row"]
        ends = {"time": names["clock"], "qpos": names["qpos"], "qvel": names["qvel"], "warmstart": names["warmstart"]}
        ends |= {"memory": row.memory, "effects": row.effects}
        ends |= {f"actuators.{name}": cells for name, cells in row.layer.fields.items() if isinstance(cells, Cells)}
        rows = {name: range(self.state[name].start, self.state[name].stop) for name in ends}
        return [([f"s[{k}, i]" for k in rows[name]], cells) for name, cells in ends.items()]

    def _name_all(self, steps: int | str) -> dict[str, Any]:
        """What the kernel's lines find by name."""
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
        return self._name_row() | {
            **{name: cells for name, cells in room.items() if "." not in name}, **shared,
            **{name: own[name] for name in FIELDS if name not in Shape._fields},
            "tree": layout.tree, "reach": layout.reach, "at": Pose(*room_of_pose),
            "shape": Shape(**{n: own[n] for n in Shape._fields}),
            "steps": Repeat(steps), "moment_flat": room["moment"].reshape(nu * nv), "dt": twin.dt, "View": View,
            "nothing": np.zeros(nv), "foresee_actuators": foresee_actuators, "foresee_drag": foresee_drag,
            **{f.__name__: f for f in FUNCTIONS},
        }  # fmt: skip

    def _name_row(self) -> dict[str, Any]:
        """What a simulation has of its own, what goes in, and what all share besides the model."""
        twin, nv = self.twin, int(self.twin.model.nv)
        state: dict[str, Any] = {name: self.state.terms(name, "s") for name in self.state.shapes}
        free: Any = Cells.of(np.zeros((scratch_rows(nv), nv)))
        row = Row(
            self._read_layer(state), self._read_constants(), self._read_parameters(), state["memory"],
            state["effects"], free,
        )  # fmt: skip
        return {
            "rig": Rig(self._read_switches(), twin.dry, twin.spec.robot.carriage), "row": row,
            "qpos": state["qpos"], "qvel": state["qvel"], "warmstart": state["warmstart"],
            "clock": state["time"].reshape(1),
            "vehicle": twin.vehicle if twin.spec.robot.step == "step_drone" else None, **self._name_inputs(),
        }  # fmt: skip

    def _list_effects(self) -> dict[str, Effect]:
        """The effects in the kernel: those that are switched on."""
        return self.twin.effects

    def _read_switches(self) -> Any:  # noqa: ANN401
        """Which effects act, (E,): they are known."""
        return self.twin.switches

    def _name_inputs(self) -> dict[str, Any]:
        """What goes in beside the tables, and what is kept on the way: a policy's command, held, and nothing."""
        nu, nv = int(self.twin.model.nu), int(self.twin.model.nv)
        none = np.zeros((0, nu))
        command: Any = Ring(lambda k, j: f"command[{j}, i]", (1, nu))
        tape = Tape(True, command, none, none, np.zeros((0, nv)), np.zeros((0, nv)), np.zeros(nv), 0)
        return {"tape": tape, "context": SimpleNamespace(qpos=0, rotor_speed=0)}

    def _read_layer(self, state: Mapping[str, Cells]) -> Record:
        """The actuators' state, whose commands on their way stay in memory."""
        layer = {n.removeprefix("actuators."): cells for n, cells in state.items() if n.startswith("actuators.")}
        first, shape = self.state.starts["actuators.history"], self.state.shapes["actuators.history"]
        where = self.state.starts["actuators.newest"]
        layer["newest"] = Cells.of(Term(f"wp.int32(s[{where}, i])", WHOLE, lasting=True))
        ring = Ring(lambda row, column: f"s[{first + column} + {shape[1]} * {row}, i]", shape)
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
            f"effect {effects[0]} {error} (line {where} of {Path(code.co_filename)})", UNDERSTOOD,
            f"write it so, or {self.way_out}, where numba compiles it",
        )  # fmt: skip

    def record(self, table: Any, numbers: Any, command: Any, touched: Any) -> Any:  # noqa: ANN401
        """What steps simulations that lie in these arrays of Warp's, each time that its `launch(stream)` is called.

        Args:
            table: what evolves, (rows, N).
            numbers: what differs by simulation, (rows, N).
            command: of the policy, thrust [N] and rate [rad/s], (2, N); on other rigs controls, (nu, N).
            touched: set to which have come near something and stopped, (N,).
        """
        wp, device = load_warp(), table.device
        wp.load_module(self.kernel.module, device=device)
        inputs = [table, numbers, command, touched]
        return wp.launch(self.kernel, dim=table.shape[1], inputs=inputs, device=device, record_cmd=True)

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
