"""Replays on a device: logged commands drive many simulations in one Warp kernel, a thread each, in float64.

The kernel is that of `vpptwin.twin.warp.step` with another tape. All effects of the catalogue are in it, switched as it
runs, as in numba's: a diagnosis tries many sets of effects, and each would have to be compiled.
"""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from vpptwin.effects import Effect
from vpptwin.engine.trace.terms import WHOLE, Cells, Ring, Term
from vpptwin.system.errors import InputError
from vpptwin.system.progress import tell_wait
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.state import TwinState
from vpptwin.twin.stepping.kernel import CALLS, COMPILING
from vpptwin.twin.stepping.step import Tape
from vpptwin.twin.twin import Twin
from vpptwin.twin.warp.device import find_device, load_warp
from vpptwin.twin.warp.step import WarpStep

TABLES = ("command", "speed", "throttle", "push", "lead", "qpos", "qvel", "rotor_speed")
"""Arrays of a tape, (N, rows, ...), in the order of the kernel's arguments."""
KEPT = TABLES[5:]
"""Those that the kernel writes."""
PROCESSOR = "leave out --device: the processor's cores step it"


class Given(NamedTuple):
    """Which arrays a tape has: kernels differ by it."""

    names: frozenset[str]  # of those
    segments: int  # of the disturbance


class WarpReplay(WarpStep):
    """The step of every twin of a rig under logged commands, for as many simulations and steps as a tape has.

    Args:
        spec: the rig.
        given: what its tapes have.

    Raises:
        InputError: as `WarpStep`.
    """

    inputs = ", ".join(
        ["steps: wp.int32", "on: wp.array(dtype=wp.int32)", *(f"{name}: wp.array3d(dtype=Real)" for name in TABLES)]
    )
    rigs, known = tuple(CALLS), "one of hinges and slides, which vpptwin steps without MuJoCo"
    way_out = PROCESSOR

    def __init__(self, spec: TwinSpec, given: Given) -> None:
        self._given = given
        super().__init__(Twin(spec, 1, num_threads=1), "steps")

    def _list_effects(self) -> dict[str, Effect]:
        return {effect.id: effect for effect in self.twin.spec.catalogue}

    def _read_switches(self) -> Any:  # noqa: ANN401
        return Cells.of([Term(f"on[{k}]", WHOLE, lasting=True) for k in range(len(self.twin.switches))])

    def _name_inputs(self) -> dict[str, Any]:
        def table(name: str, width: int, rows: int = 1) -> Any:  # noqa: ANN401
            """An array of a tape; of its number of rows no more is asked than whether there are any."""
            there = name in self._given.names
            return Ring(lambda k, j: f"{name}[i, {k}, {j}]", (rows, width)) if there else np.zeros((0, width))

        nu, nv = int(self.twin.model.nu), int(self.twin.model.nv)
        steps: Any = Term("steps", WHOLE)
        tape = Tape(
            False, table("command", nu), table("speed", nu), table("throttle", nu),
            table("push", nv, self._given.segments), table("lead", nv), self.twin.led, steps,
        )  # fmt: skip
        kept = {"kept_qpos": table("qpos", nv), "kept_qvel": table("qvel", nv), "kept_speed": table("rotor_speed", nu)}
        return {"tape": tape, "context": SimpleNamespace(**{name: name in self._given.names for name in KEPT})} | kept

    def run(self, twin: Twin, state: TwinState, tape: dict[str, np.ndarray], device: str) -> np.ndarray:
        """Run a twin's state and tape, both changed in place; which simulations came near something, (N,)."""
        wp, none = load_warp(), np.empty((1, 1, 1))
        numbers = {name: tape.get(name, none) for name in TABLES}
        arrays = {
            name: wp.empty(values.shape, dtype=wp.float64, device=device) if name in KEPT
            else wp.array(values, dtype=wp.float64, device=device, copy=False)  # on the processor it is the same
            for name, values in numbers.items()
        }  # fmt: skip
        tables = [
            wp.array(table, dtype=wp.float64, device=device)
            for table in (self.pack_state(state), self.pack_numbers(twin=twin))
        ]
        on = wp.array(twin.switches.astype(np.int32), device=device)
        touched = wp.zeros(twin.num_sims, dtype=wp.int32, device=device)
        inputs = [*tables, tape["command"].shape[1], on, *arrays.values(), touched]
        wp.launch(self.kernel, dim=twin.num_sims, inputs=inputs, device=device)
        for name in self._given.names.intersection(KEPT):
            tape[name][...] = arrays[name].numpy()
        state.overwrite(self.unpack_state(tables[0].numpy()))
        return touched.numpy()


class WarpTwin(Twin):
    """A twin whose replays run on a device; what touches something there is MuJoCo's on the processor, as ever.

    Args:
        twins: that it is one of.
        spec, num_sims, active: as `Twin`.
    """

    def __init__(self, twins: WarpTwins, spec: TwinSpec, num_sims: int, active: Iterable[str] = ()) -> None:
        super().__init__(spec, num_sims, active)
        self._twins = twins

    def _fly(self, state: TwinState, context: np.ndarray, tape: dict[str, np.ndarray], stuck: np.ndarray) -> None:
        if context["policy"]:
            super()._fly(state, context, tape, stuck)
            return
        segments = tape["push"].shape[1] if "push" in tape else 0
        replay = self._twins.find(self.spec, Given(frozenset(tape), segments))
        stuck[:] = replay.run(self, state, tape, self._twins.device)


def choose_maker(spec: TwinSpec, device: str | None) -> type[Twin] | WarpTwins:
    """What makes twins of a rig that a diagnosis drives, on a device or, without, on the processor's cores.

    Raises:
        InputError: if there is no such device, Warp is not installed, or only MuJoCo steps the rig.
    """
    if device is None:
        return Twin
    twins = WarpTwins(find_device(device, PROCESSOR))
    if Twin(spec, 1, num_threads=1).layout is None:
        raise InputError(f"device {device}, and {spec.name}, a rig that only MuJoCo steps", WarpReplay.known, PROCESSOR)
    return twins


class WarpTwins:
    """Makes twins whose replays run on a device; they share what is compiled.

    Args:
        device: as `find_device` gives it.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self._replays: dict[tuple[int, Given], tuple[TwinSpec, WarpReplay]] = {}

    def __call__(self, spec: TwinSpec, num_sims: int, active: Iterable[str] = ()) -> WarpTwin:
        """A twin, as `Twin` makes it."""
        return WarpTwin(self, spec, num_sims, active)

    def find(self, spec: TwinSpec, given: Given) -> WarpReplay:
        """The kernel for a rig's tapes."""
        key = id(spec), given
        if key not in self._replays:
            made = WarpReplay(spec, given)
            with tell_wait(COMPILING):
                load_warp().load_module(made.kernel.module, device=self.device)
            self._replays[key] = spec, made  # holding on to the rig keeps its id its own
        return self._replays[key][1]
