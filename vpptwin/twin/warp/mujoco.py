"""Steps of rigs that touch something, or that only MuJoCo steps, on a device: `mujoco_warp` with the pipeline in it.

What MuJoCo calls on the processor's cores, in C, is here the control callback of `mujoco_warp`: the same inner step as
one Warp kernel, written down by `engine.trace`. It reads and writes the arrays of all simulations where
`mujoco_warp` keeps them. The table of what evolves is that of `WarpStep`: it is copied in before the inner steps, and
out after them; constants in which simulations differ are copied in.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np

from vpptwin.engine.trace.terms import REAL, TRUTH, WHOLE, Cells, Term
from vpptwin.engine.view import COLUMNS, DATA_ARRAYS, MODEL_ARRAYS, View
from vpptwin.system.errors import InputError, load_extra
from vpptwin.twin.stepping.kernel import CALLS
from vpptwin.twin.stepping.layout import is_of_model
from vpptwin.twin.twin import Twin
from vpptwin.twin.warp.device import NEED, load_warp, muted
from vpptwin.twin.warp.step import WarpStep

READ = {field for field, kind, _ in DATA_ARRAYS.values() if kind is np.float64} - {"actuator_moment"}
ARRAYS = {
    **dict.fromkeys([*sorted(READ), "actuator_moment"], "wp.array2d(dtype=Real)"),
    "time": "wp.array(dtype=Real)", "moment_rowadr": "wp.array2d(dtype=wp.int32)",
    **dict.fromkeys(("nefc", "ne", "nf", "nl"), "wp.array(dtype=wp.int32)"),
}  # fmt: skip
"""Arrays of `mujoco_warp.Data` that the callback reads or writes, with their types; (N, ...) each."""
MOVING = {"qpos": "qpos", "qvel": "qvel", "time": "time", "warmstart": "qacc_warmstart"}
"""Arrays of the state → what `mujoco_warp.Data` calls them."""
DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "tendon_length0", "tendon_invweight0",
           "actuator_acc0")  # fmt: skip
"""Fields that MuJoCo derives from those that effects write."""


class WarpMujoco(WarpStep):
    """The step of a twin by `mujoco_warp`, in float32, with the inner step as its control callback.

    Args:
        twin, steps: as `WarpStep`.
        single: numbers are float32, as `mujoco_warp` has them.

    Raises:
        InputError: if an effect does what Warp cannot compile, as of `WarpStep`, or `mujoco_warp` is not installed.
    """

    inputs = ", ".join(["command: wp.array2d(dtype=Real)", *(f"{name}: {kind}" for name, kind in ARRAYS.items())])
    rigs = tuple(CALLS)
    lines = "{step}\n"

    def __init__(self, twin: Twin, steps: int = 10, single: bool = True) -> None:
        assert single
        load_mujoco_warp()
        self._steps, self._moments = steps, find_moments(twin.model)
        super().__init__(twin, steps, single)

    def _check_rig(self) -> None:
        """Any that MuJoCo steps."""

    def _list_constants(self, twin: Twin, written: list[str]) -> dict[str, np.ndarray]:
        listed = {name: twin.table[name] for name in written}
        if any(is_of_model(twin.model, name) for name in written):
            for name in DERIVED:
                derived = twin.derived(name)
                if derived is not None and derived.size:
                    listed[name] = derived
        return listed

    def _name_all(self, steps: int | str) -> dict[str, Any]:
        model = self.twin.model

        def known(name: str, field: str) -> Any:  # noqa: ANN401
            """A field of the model: a simulation's own, or the same for all."""
            if field in self.numbers.shapes:
                return self.numbers.terms(field, "c")
            array = np.array(getattr(model, field))
            return array.reshape(-1, COLUMNS[name]) if name in COLUMNS else array

        fields = {name: known(name, field) for name, (field, *_) in MODEL_ARRAYS.items()}
        for name, (field, _, size) in DATA_ARRAYS.items():
            fields[name] = read(field, int(getattr(model, size))) if field in READ else None
        lengths = [len(columns) for columns in self._moments]
        moments = [f"actuator_moment[i, moment_rowadr[i, {a}] + {k}]" for a, n in enumerate(lengths) for k in range(n)]
        fields |= {
            "moment": Cells.of([Term(text, REAL, lasting=True) for text in moments]),
            "moment_start": np.cumsum([0, *lengths])[:-1], "moment_length": np.array(lengths, int),
            "moment_column": np.concatenate([*self._moments, np.zeros(0, int)]),
            "ctrl": Cells.of(np.zeros(int(model.nu))), "qfrc_applied": Cells.of(np.zeros(int(model.nv))),
            "time": Term("time[i]", REAL, lasting=True), "timestep": self.twin.dt,
            "constraints": Term("nefc[i]", WHOLE, lasting=True),
            "colliding": Term("(nefc[i] > ne[i] + nf[i] + nl[i])", TRUTH, lasting=True),
            "gravity": self.numbers.terms("opt.gravity", "c") if "opt.gravity" in self.numbers.shapes
            else np.array(model.opt.gravity),
        }  # fmt: skip
        # In the first step of a call, too, the constraints' forces of the step before lie where the engine has them.
        return self._name_row() | {"view": View(**fields), "k": 1, "touches": False}

    def _list_ends(self, names: Mapping[str, Any]) -> list[tuple[list[str], Cells]]:
        view = names["view"]
        written = {"ctrl": view.ctrl, "qfrc_applied": view.qfrc_applied}
        own = [([f"{name}[i, {k}]" for k in range(cells.shape[0])], cells) for name, cells in written.items()]
        return super()._list_ends(names) + own

    def record(self, table: Any, numbers: Any, command: Any, touched: Any) -> Any:  # noqa: ANN401
        """As `WarpStep.record`; on a card all inner steps are captured in one graph."""
        wp, engine, device, count = load_warp(), load_mujoco_warp(), table.device, table.shape[1]
        wp.synchronize_device(device)
        with wp.ScopedDevice(device):
            model, data = self._put(engine, count)
            inputs = [table, numbers, command, *(getattr(data, name) for name in ARRAYS), touched]
            model.callback.control = lambda m, d: wp.launch(self.kernel, dim=count, inputs=inputs, device=device)
            constants, moving = self._pair_constants(model, numbers, count), self._pair_state(data, table)
            # Equalities of points go by how fast bodies move, which the engine works out later than them: a step late.
            points = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
            late = np.isin(self.twin.model.eq_type, points).any()
            calls = (*((engine.kinematics, engine.com_pos, engine.com_vel) if late else ()), engine.step)

            def run() -> None:
                for own, rows in constants + moving:
                    wp.copy(own, rows)
                for _ in range(self._steps):
                    for call in calls:
                        call(model, data)
                for own, rows in moving:
                    wp.copy(rows, own)

            before = wp.clone(table)
            run()  # which compiles all that is left to be compiled
            wp.copy(table, before)
        wp.synchronize_device(device)
        self._check_moments(data)
        return Recorded(run, device)

    def _put(self, engine: Any, count: int) -> tuple[Any, Any]:  # noqa: ANN401
        """The engine's model and data of so many simulations."""
        stepped = copy.copy(self.twin.model)
        stepped.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # which it does not know, nor do
        try:
            model, data = engine.put_model(stepped), engine.make_data(stepped, nworld=count)
        except (NotImplementedError, ValueError) as error:
            found = f"{NEED}: {self.twin.spec.name}, of which mujoco_warp says {error}"
            raise InputError(found, "a rig that it steps", self.way_out) from None
        model.opt.warn_overflow &= ~int(engine.OverflowType.ITERATIONS)  # of what diverges, which begins anew
        return model, data

    def _pair_state(self, data: Any, table: Any) -> list[tuple[Any, Any]]:  # noqa: ANN401
        """Arrays of the engine's data that evolve, and the rows that hold them between calls."""
        forces = slice(self.state["memory"].start + 2, self.state["memory"].stop)
        rows = {field: self.state[name] for name, field in MOVING.items()} | {"qfrc_constraint": forces}
        return [(flatten(getattr(data, field)), pick(table, where)) for field, where in rows.items()]

    def _check_moments(self, data: Any) -> None:  # noqa: ANN401
        """Refuse an engine whose sparse moments are others than those that the kernel reads."""
        starts, columns = data.moment_rowadr.numpy()[0], data.moment_colind.numpy()[0]
        for own, start, length in zip(self._moments, starts, data.moment_rownnz.numpy()[0], strict=True):
            if own.tolist() != columns[start : start + length].tolist():
                found = f"{NEED}: actuators of {self.twin.spec.name} whose moments mujoco_warp keeps otherwise"
                raise InputError(found, "them as MuJoCo keeps them", self.way_out)

    def _pair_constants(self, model: Any, numbers: Any, count: int) -> list[tuple[Any, Any]]:  # noqa: ANN401
        """Arrays of the engine's model in which simulations differ, and the rows that hold them."""
        wp, pairs = load_warp(), []
        written = {name for e in self.effects.values() for name in e.writes} | set(DERIVED)
        for name in self.numbers.shapes:
            if name not in written or not is_of_model(self.twin.model, name):
                continue
            home, field = (model.opt, name[4:]) if name.startswith("opt.") else (model, name)
            shared = getattr(home, field, None)
            if shared is None or shared.shape[0] != 1 or (home is model.opt and field != "gravity"):
                raise InputError(f"{NEED}: effects on {name}", "what mujoco_warp has for each simulation", self.way_out)
            own = wp.zeros((count, *shared.shape[1:]), dtype=shared.dtype)
            setattr(home, field, own)
            pairs.append((flatten(own), pick(numbers, self.numbers[name])))
        return pairs


class Recorded:
    """Steps of the engine: a graph on a card, calls one by one on the processor.

    Args:
        run: all of them.
        device: Warp's.
    """

    def __init__(self, run: Callable[[], None], device: Any) -> None:  # noqa: ANN401
        self._wp, self._run, self._device = load_warp(), run, device
        self._graph = None
        if device.is_cuda:
            with self._wp.ScopedDevice(device), self._wp.ScopedCapture() as capture:
                run()
            self._graph = capture.graph

    def launch(self, stream: Any = None) -> None:  # noqa: ANN401
        """Take them, on a stream of the card."""
        if self._graph is not None:
            self._wp.capture_launch(self._graph, stream=stream)
            return
        with self._wp.ScopedDevice(self._device):
            self._run()


def load_mujoco_warp() -> Any:  # noqa: ANN401
    """The module.

    Raises:
        InputError: if it, or Warp, is not installed.
    """
    load_warp()
    with muted():
        return load_extra("mujoco_warp", f"{NEED} that touches something")


def read(field: str, size: int) -> Cells:
    """A row of an array as it lies in memory."""
    return Cells.of([Term(f"{field}[i, {k}]", REAL, lasting=True) for k in range(size)])


def flatten(array: Any) -> Any:  # noqa: ANN401
    """An array of Warp's, (N, ...) of numbers or vectors, as the table of its numbers, (N, k), in the same memory."""
    wp = load_warp()
    shape = array.shape[0], array.strides[0] // 4
    return wp.array(ptr=array.ptr, shape=shape, dtype=wp.float32, device=array.device, copy=False)


def pick(table: Any, rows: slice) -> Any:  # noqa: ANN401
    """Rows of a table, (rows, N), as columns, in the same memory."""
    return table[rows.start : rows.stop].transpose()


def find_moments(model: mujoco.MjModel) -> list[np.ndarray]:
    """The degrees of freedom that each actuator acts on, as sparse moments name them."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    mujoco.mj_integratePos(model, data.qpos, rng.uniform(0.1, 1.0, model.nv), 1.0)  # where no moment happens to be zero
    mujoco.mj_fwdPosition(model, data)
    rows = zip(data.moment_rowadr, data.moment_rownnz)
    return [np.array(data.moment_colind[first : first + length]) for first, length in rows]
