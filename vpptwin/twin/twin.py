"""N simulations of one twin on `mujoco.batch.Batch`, with parameters that can differ in every simulation."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterable, Sequence
from typing import cast

import mujoco
import numpy as np
from mujoco.batch import Batch

from vpptwin.actuators.adaptive import start_memory
from vpptwin.actuators.layer import PACES
from vpptwin.effects import Effect
from vpptwin.engine.callback import installed, mark_rows
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.twin.robot.manifold import difference_poses, find_places, integrate_pose
from vpptwin.twin.robot.model import hold_joints
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.state import Driven, Trajectory, TwinState
from vpptwin.twin.stepping.constants import ConstantTable
from vpptwin.twin.stepping.fused import Stepper
from vpptwin.twin.stepping.kernel import CONTEXT, scratch_rows, warm_up, write_kernel
from vpptwin.twin.stepping.layout import read_layout
from vpptwin.twin.stepping.pipeline import Pipeline
from vpptwin.twin.stepping.recall import Past, Recollection, evolves, write_recollection
from vpptwin.twin.stepping.stepped import leave_out

MANY = 256
"""Simulations from which policies too are flown without MuJoCo: for fewer, compiling that costs more than it saves."""


class Twin:
    """N simulations that share a rig and differ in parameters and state.

    A twin holds parameters; whatever evolves is in the `TwinState` that its functions take and return. The whole inner
    loop runs compiled inside the engine's step (`stepping.step`): one call, however many steps. Simulations that
    touch nothing during a call, and reach no end stop, are stepped without MuJoCo where the rig allows it
    (`stepping.fused`): equal but for rounding, and faster. Under policies that is so from `MANY` simulations on.

    The engine's semi-implicit Euler step is second-order accurate if read as a leapfrog: `qvel` belongs to the state's
    time, `qpos` leads it by half a step, and forces are means over the step. `pose_at_time` undoes the lead where half
    a millisecond matters, which it does when a delay is to be told from nothing.

    A simulation that diverges runs on with what it has (the engine's own silent restart is off): its numbers are not
    finite, which `TwinState.finite` tells.

    Args:
        spec: the twin to simulate.
        num_sims: number of simulations N.
        active: ids of effects to switch on besides those of `spec`, starting at their off values.
        num_threads: threads of the engine, 0 for all cores.

    Attributes:
        effects: the effects that are switched on, by id.
        dt: inner step [s].
        model: that is stepped.
        layout: of it, where it can be stepped without MuJoCo.
        switches: which effects of the pipeline are on, (E,).
        dry: friction that joints have without any effect, (nv,) N, N m.
    """

    def __init__(self, spec: TwinSpec, num_sims: int, active: Iterable[str] = (), num_threads: int = 0) -> None:
        wanted = {*spec.effects, *active}
        unknown = wanted - {effect.id for effect in spec.catalogue}
        if unknown:
            raise KeyError(f"no effect {sorted(unknown)[0]} in the catalogue of {spec.name}")
        self.spec = spec
        self.num_sims = num_sims
        self.effects: dict[str, Effect] = {e.id: e for e in spec.catalogue if e.id in wanted}
        self.dt = float(spec.model.opt.timestep)
        robot, driven = spec.robot, spec.robot.driven
        model = hold_joints(spec.stepped, driven) if driven.size else copy.copy(spec.stepped)
        self.dry = np.array(model.dof_frictionloss)
        model.dof_frictionloss[:] = 0.0  # the compiled step holds joints itself
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        leave_out(model, {name for effect in spec.catalogue for name in effect.writes})
        self.model = model
        self.layout = layout = read_layout(model, {name for e in self.effects.values() for name in e.writes})
        self._kernel = write_kernel(spec, model, layout)
        self._batch = Batch(model, num_sims, num_threads)
        self._model, self._recollection = model, cast("Recollection | None", None)
        self._constants = ConstantTable(spec, self.effects, num_sims, self._batch, self._kernel)
        self._stepper: Stepper | None = None
        self._many = num_sims >= MANY
        if layout is not None:
            threads = num_threads or os.cpu_count() or 1
            self._stepper = Stepper(layout, model, self._constants.table, num_sims, threads)
        names = ("time", "qpos", "qvel", "qacc_warmstart", "qfrc_constraint")
        self._live = {name: self._batch.bind(name) for name in names}
        places = self._kernel.pipeline.places
        self.switches = np.array([name in self.effects for name in places], dtype=np.bool_)
        self.led = np.zeros(model.nv)
        self.led[driven] = model.dof_armature[driven]
        self._numbers = robot.numbers
        self._scratch = np.zeros((num_sims, scratch_rows(int(model.nv)), int(model.nv)))
        self._context = np.zeros(1, CONTEXT)
        mark_rows(self._batch.bind("userdata"), self._context)

    @property
    def vehicle(self) -> Vehicle:
        """The believed vehicle; InputError on other rigs than the drone."""
        return self.spec.vehicle

    def set_parameter(
        self, effect_id: str, parameter: str, values: np.ndarray | float, ids: np.ndarray | None = None
    ) -> None:
        """Set a parameter of a switched-on effect, starting from nominal constants each time.

        Args:
            effect_id: an id of `effects`.
            parameter: its parameter.
            values: a scalar, or one value per simulation of the call, in the parameter's unit and bounds.
            ids: simulations, None for all.

        Raises:
            KeyError: if the effect is not switched on or has no such parameter.
            ValueError: if a value lies outside the parameter's bounds.
        """
        given = np.asarray(values, dtype=float)
        self._constants.set_parameters([(effect_id, parameter)], given[:, None] if given.ndim else given, ids)

    def set_parameters(
        self, keys: Sequence[tuple[str, str]], values: np.ndarray | float, ids: np.ndarray | None = None
    ) -> None:
        """Set many parameters at once: as `set_parameter` for each (effect id, parameter) of `keys`.

        Args:
            keys: K parameters of switched-on effects.
            values: (n, K), or anything that broadcasts to it.
            ids: n simulations, None for all.

        Raises:
            KeyError, ValueError: as `set_parameter`.
        """
        self._constants.set_parameters(keys, values, ids)

    def parameter(self, effect_id: str, parameter: str) -> np.ndarray:
        """Values of a parameter, (N,); a copy."""
        return self._constants.values[effect_id, parameter].copy()

    def constant(self, name: str) -> np.ndarray:
        """A per-simulation constant after the effects, e.g. `mocap.delay`, (N, ...); a copy."""
        self._constants.refresh()
        return self._constants.table[name].copy()

    @property
    def constants(self) -> np.ndarray:
        """Constants of actuators and sensors after the effects, (N,) records, to read only; they follow parameters."""
        self._constants.refresh()
        view = self._constants.records.view()
        view.flags.writeable = False
        return view

    @property
    def pipeline(self) -> Pipeline:
        """The effects that act every step."""
        return self._kernel.pipeline

    @property
    def parameters(self) -> np.ndarray:
        """Those of the effects that act every step, (N, P) in the order of the pipeline, to read only."""
        return self._constants.parameters

    @property
    def table(self) -> dict[str, np.ndarray]:
        """All constants after the effects, name → (N, ...), to read only."""
        self._constants.refresh()
        return self._constants.table

    def derived(self, name: str) -> np.ndarray | None:
        """A field of the model that MuJoCo derives from what effects write, (N, ...); None where all share it."""
        self._constants.refresh()
        return self._batch.expanded(name)

    def initial_state(
        self, qpos: np.ndarray | None = None, qvel: np.ndarray | None = None, time: np.ndarray | float = 0.0,
        ids: np.ndarray | None = None,
    ) -> TwinState:  # fmt: skip
        """A state at rest by default, actuators neutral, rotors at their governed speed.

        Args:
            qpos: (N, nq) or (nq,); by default the model's reference pose, on the drone hovering height 1 m.
            qvel: (N, nv) or (nv,), zero by default.
            time: s since the start of the log, (N,) or one for all.
            ids: simulations that the rows are for, in the place of all N.
        """
        self._constants.refresh()
        rows = np.arange(self.num_sims) if ids is None else ids
        robot, model, n = self.spec.robot, self.spec.model, len(rows)
        layer = np.zeros(n, self._kernel.layer)
        layer["output"] = layer["mean"] = self._constants.table["actuator.trim"][rows]
        layer["rotor_speed"] = layer["mean_speed"] = robot.rotor_speed
        if self.spec.controller == "adaptive":
            layer["adaptive"] = start_memory(robot.rotor_speed)
        pose = np.array(
            np.broadcast_to(robot.start_pose if qpos is None else qpos, (n, model.nq)), dtype=float, order="C"
        )
        velocity = np.array(np.broadcast_to(0.0 if qvel is None else qvel, (n, model.nv)), dtype=float, order="C")
        return TwinState(
            time=np.array(np.broadcast_to(time, n), dtype=float),
            qpos=pose,
            qvel=velocity,
            warmstart=np.zeros((n, model.nv)),
            memory=np.zeros((n, 2 + model.nv)),
            effects=self._kernel.pipeline.start_effects(pose, velocity),
            actuators=layer,
        )

    def pose_at_time(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Positions at the state's time: `qpos` less the half step by which it leads, same shape as qpos."""
        return integrate_pose(self.spec.model, qpos, -0.5 * self.dt * qvel)

    def pose_for_engine(self, pose: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Engine positions `qpos` for a pose and velocity at one time: the inverse of `pose_at_time`."""
        return integrate_pose(self.spec.model, pose, 0.5 * self.dt * qvel)

    def step_policy(self, state: TwinState, command: np.ndarray, duration: float = 0.01) -> TwinState:
        """Fly under a policy command through the whole cascade: allocation, rate loop, servos, motors.

        Args:
            state: N simulations; not modified.
            command: thrust [N] and rate [rad/s], (N, 2), held for `duration`.
            duration: s, rounded to whole inner steps.

        Returns:
            The state `duration` later.
        """
        result = state.copy()
        self.advance_policy(result, command, duration)
        return result

    def advance_policy(self, state: TwinState, command: np.ndarray, duration: float = 0.01) -> None:
        """As `step_policy`, in place: `state` becomes the state `duration` later."""
        self._run(state, round(duration / self.dt), self._hold(command), policy=True)

    def trace_policy(
        self, state: TwinState, command: np.ndarray, duration: float = 0.01
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `advance_policy`; positions and velocities before every inner step, (N, steps, nq) and (N, steps, nv)."""
        steps, model = round(duration / self.dt), self.spec.model
        way = np.empty((self.num_sims, steps, model.nq)), np.empty((self.num_sims, steps, model.nv))
        self._run(state, steps, self._hold(command) | {"qpos": way[0], "qvel": way[1]}, policy=True)
        return way

    def _hold(self, command: np.ndarray) -> dict[str, np.ndarray]:
        """A policy's command on the tape, for the drone only."""
        _ = self.vehicle
        return {"command": np.array(np.broadcast_to(command, (self.num_sims, 2)), dtype=float)}

    def warm_up(self, layer: np.ndarray, commands: np.ndarray, number: np.ndarray | None = None) -> np.ndarray:
        """Run delay, lag and play of the actuators alone over past commands, (N, steps, nu), oldest first.

        With `number`, (N,), those of a simulation are in that row of the commands, (R, steps, nu). Simulations of one
        number have equal layers: of those whose actuators move alike one is run for all.
        """
        rows = self.num_sims if number is None else max(len(commands), int(number.max(initial=-1)) + 1)
        number = np.arange(rows) if number is None else number
        expected = (rows, commands.shape[1] if commands.ndim > 1 else 0, self.spec.model.nu)
        if commands.shape != expected or layer.shape != (self.num_sims,):
            raise ValueError(f"commands have shape {commands.shape}, the layer {layer.shape}; expected {expected}")
        self._constants.refresh()
        records = self._constants.records
        paces = np.concatenate([records[name] for name in PACES], axis=1)
        kinds = np.unique(paces.view(f"V{paces[0].nbytes}"), return_inverse=True)[1].ravel() if paces.size else 0
        _, first, back = np.unique(kinds * rows + number, return_index=True, return_inverse=True)
        return warm_up(layer[first], records[first], commands, number[first], self.dt)[back]

    @property
    def remembers(self) -> bool:
        """Whether any effect that is switched on evolves with the motion of a joint or body."""
        return any(evolves(effect) for effect in self.effects.values())

    def recall_effects(self, past: Past, ids: np.ndarray) -> np.ndarray:
        """Run what evolves of the effects alone over how flights moved, for the parameters of simulations `ids` (n,).

        Returns:
            How far it is, where each of K windows starts, from what a simulation starts with there, (n, K, S).
        """
        if self._recollection is None:
            self._recollection = write_recollection(self._model, self._kernel.pipeline, self.spec.catalogue, self.dry)
        return self._recollection.run(self._constants.parameters[ids], self.switches, past)

    def replay_commands(
        self, state: TwinState, commands: np.ndarray, rotor_speed: np.ndarray | None = None,
        throttle: np.ndarray | None = None, disturbance: np.ndarray | None = None, driven: Driven | None = None,
    ) -> Trajectory:  # fmt: skip
        """Run under logged actuator commands, one per inner step.

        Args:
            state: N simulations; not modified.
            commands: blade pitch [rad] (control input on other rigs), (N, steps, nu).
            rotor_speed: measured rotor speed, (N, steps, 2) rad/s, which thrust goes by; None simulates it.
            throttle: (N, steps, 2), 0..1, by which motors are simulated, beside measured speeds where these are given.
                Without either, speeds stay as they are.
            disturbance: generalized force added, (N, segments, nv) N, N m, each held for an equal part of the steps.
            driven: joints that follow given tracks instead of the engine.

        Returns:
            The final state, and positions, velocities and simulated rotor speeds after every step.
        """
        after, qpos, qvel, speed = self.trace_commands(state, commands, rotor_speed, throttle, disturbance, driven)
        qpos = np.concatenate([qpos[:, 1:], after.qpos[:, None]], axis=1)
        qvel = np.concatenate([qvel[:, 1:], after.qvel[:, None]], axis=1)
        return Trajectory(after, qpos, qvel, speed)

    def trace_commands(
        self, state: TwinState, commands: np.ndarray, rotor_speed: np.ndarray | None = None,
        throttle: np.ndarray | None = None, disturbance: np.ndarray | None = None, driven: Driven | None = None,
    ) -> Trajectory:  # fmt: skip
        """As `replay_commands`; positions and velocities *before* every step, as they are kept on the way."""
        result, steps, model = state.copy(), commands.shape[1], self.spec.model
        shape = self.num_sims, steps
        tape = {"command": commands, "qpos": np.empty((*shape, model.nq)), "qvel": np.empty((*shape, model.nv))}
        if rotor_speed is not None:
            tape["speed"] = rotor_speed
        if throttle is not None:
            tape |= {"throttle": throttle, "rotor_speed": np.empty((*shape, model.nu))}
        if disturbance is not None:
            tape["push"] = disturbance
        if driven is not None:
            tape["lead"] = self._lead_joints(result, driven, steps)
        self._run(result, steps, tape)
        return Trajectory(result, tape["qpos"], tape["qvel"], tape.get("rotor_speed"))

    def _lead_joints(self, state: TwinState, driven: Driven, steps: int) -> np.ndarray:
        """Put driven joints at the start of their tracks; the velocities that lead them along, (N, steps, nv)."""
        model, dofs = self.spec.model, driven.dofs
        track, places = self.pose_for_engine(driven.pose, driven.velocity), find_places(model, dofs)
        state.qpos[:, places], state.qvel[:, dofs] = track[:, 0][:, places], driven.velocity[:, 0][:, dofs]
        ahead = difference_poses(model, track[:, :-1], track[:, 1:]) / self.dt
        return np.concatenate([ahead, driven.velocity[:, -1:]], axis=1)

    def _run(self, state: TwinState, steps: int, tape: dict[str, np.ndarray], policy: bool = False) -> None:
        """Advance `state` in place by a number of inner steps under the inputs of a tape."""
        self._check_shapes(state, steps, tape, policy)
        self._constants.refresh()
        context, stuck = np.zeros((), CONTEXT), np.ones(self.num_sims, np.int64)
        held = {name: np.ascontiguousarray(values, dtype=np.float64) for name, values in tape.items()}
        rows = {
            "vehicle": self._numbers, "layer": state.actuators, "constants": self._constants.records,
            "parameters": self._constants.parameters, "memory": state.memory, "effects": state.effects,
            "scratch": self._scratch, "active": self.switches, "dry": self.dry, "driven": self.led,
            "counter": np.zeros(self.num_sims, np.int64), "stuck": stuck, "time": state.time, "state_qpos": state.qpos,
            "state_qvel": state.qvel, "warmstart": state.warmstart,
        }  # fmt: skip
        for name, array in (rows | held).items():
            context[name] = array.ctypes.data
        context["policy"], context["steps"] = int(policy), steps
        context["segments"] = held["push"].shape[1] if "push" in held else 0
        touching = np.arange(self.num_sims)
        if self._stepper is not None and (self._many or not policy):
            before = state.copy()
            self._fly(state, context, held, stuck)
            touching = np.flatnonzero(stuck)
            state.write_rows(touching, before.take(touching))
        if len(touching):
            self._step(state, steps, context, touching)

    def _fly(self, state: TwinState, context: np.ndarray, tape: dict[str, np.ndarray], stuck: np.ndarray) -> None:
        """Run all simulations without MuJoCo, in place; tell in `stuck`, (N,), which stopped as they might touch."""
        assert self._stepper is not None
        self._stepper.run(self._kernel.fly, context)

    def _step(self, state: TwinState, steps: int, context: np.ndarray, ids: np.ndarray) -> None:
        """Run the simulations `ids` of a context in MuJoCo's steps."""
        live, whole = self._live, len(ids) == self.num_sims
        rows = slice(None) if whole else ids
        with installed(self._kernel.callback):  # and under its lock
            self._context[0] = context
            for name, array in (("time", state.time), ("qpos", state.qpos), ("qvel", state.qvel)):
                live[name][rows] = array[rows]
            live["qacc_warmstart"][rows] = state.warmstart[rows]
            self._batch.step(None if whole else ids, nstep=steps)
            for name, array in (("time", state.time), ("qpos", state.qpos), ("qvel", state.qvel)):
                array[rows] = live[name][rows]
            state.warmstart[rows], state.memory[rows, 2:] = live["qacc_warmstart"][rows], live["qfrc_constraint"][rows]

    def _check_shapes(self, state: TwinState, steps: int, tape: dict[str, np.ndarray], policy: bool) -> None:
        """Refuse arrays of other shapes than compiled code will read and write, as it does so unchecked.

        Raises:
            ValueError: with what was found and what was expected.
        """
        n, model = self.num_sims, self.spec.model
        own = {"memory": state.memory, "effects": state.effects, "actuators": state.actuators}
        given = own | tape
        expected: dict[str, tuple[int, ...]] = {"memory": (n, 2 + model.nv), "actuators": (n,)}
        expected["effects"] = (n, len(self._kernel.pipeline.starts))
        for name in tape:
            expected[name] = (n, steps, model.nv if name in ("lead", "qvel") else model.nu)
        if policy:
            expected["command"] = (n, 2)
        if "qpos" in tape:
            expected["qpos"] = (n, steps, model.nq)
        if "push" in tape:
            expected["push"] = (n, tape["push"].shape[1] if tape["push"].ndim > 1 else 0, model.nv)
        for name, shape in expected.items():
            if given[name].shape != shape:
                raise ValueError(f"{name} has shape {given[name].shape}; expected {shape} for {n} simulations")
        kinds = state.actuators.dtype, state.memory.dtype, state.effects.dtype
        if kinds != (self._kernel.layer, np.dtype(float), np.dtype(float)):
            raise ValueError("a state of another rig or another catalogue; expected one that this twin has made")
        moving = [state.time, state.qpos, state.qvel, state.warmstart]
        if not all(array.flags.c_contiguous for array in [*own.values(), *moving]):
            raise ValueError("a state whose arrays are views; expected arrays of its own, as TwinState.copy makes them")
