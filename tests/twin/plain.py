"""The twin in plain Python, one simulation and stepped by `mj_step`: the slow reference of the compiled one."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from vpptwin.engine.view import View, look_at
from vpptwin.twin import Twin, TwinState
from vpptwin.twin.stepping.kernel import scratch_rows
from vpptwin.twin.stepping.pipeline import keep_plain, write_pipeline
from vpptwin.twin.stepping.step import Rig, Row, Tape


@dataclass(frozen=True)
class Inputs:
    """What drives the simulations of a twin: a policy's command (N, 2), or tapes of one row per step, (N, steps, ...).

    Attributes:
        steps: how many.
        policy: thrust [N] and rate [rad/s], held, (N, 2); None to replay.
        commands: blade pitch [rad] or control, (N, steps, nu).
        speed: of the rotors, (N, steps, 2) rad/s.
        throttle: (N, steps, 2).
        push: generalized force, (N, segments, nv) N, N m.
    """

    steps: int
    policy: np.ndarray | None = None
    commands: np.ndarray | None = None
    speed: np.ndarray | None = None
    throttle: np.ndarray | None = None
    push: np.ndarray | None = None

    def fly(self, twin: Twin, state: TwinState) -> TwinState:
        """Where the compiled twin gets."""
        if self.policy is not None:
            return twin.step_policy(state, self.policy, self.steps * twin.dt)
        assert self.commands is not None
        return twin.replay_commands(state, self.commands, self.speed, self.throttle, self.push)[0]

    def tape(self, i: int, nv: int) -> Tape:
        """The inputs of simulation i."""
        none = np.zeros((0, 2))

        def row(array: np.ndarray | None) -> np.ndarray:
            return none if array is None else array[i]

        command = row(self.commands) if self.policy is None else self.policy[i : i + 1]
        return Tape(
            self.policy is not None, command, row(self.speed), row(self.throttle), row(self.push), none,
            np.zeros(nv), self.steps,
        )  # fmt: skip


def fly_plain(twin: Twin, state: TwinState, inputs: Inputs) -> TwinState:
    """Where plain Python gets, from the same parameters and state; the state is not modified."""
    result, drone = state.copy(), twin.spec.robot.step == "step_drone"
    model = twin.spec.model
    pipeline = write_pipeline(model, twin.spec.catalogue)
    steps = pipeline.build(keep_plain)

    def step(rig: Rig, row: Row, tape: Tape, view: View, k: int) -> None:
        if drone:
            steps["step_drone"](twin.vehicle, rig, view, row, tape, k)
        else:
            steps["step_rig"](rig, view, row, tape, k)

    bodies = [model.body(i).name for i in range(model.nbody)]
    active = np.array([name in twin.effects for name in pipeline.places], dtype=bool)
    parameters = np.zeros((twin.num_sims, len(pipeline.columns)))
    for (effect_id, name), column in pipeline.columns.items():
        if effect_id in twin.effects:
            parameters[:, column] = twin.parameter(effect_id, name)
    carriage = bodies.index("carriage") if "carriage" in bodies and drone else -1
    rig = Rig(active, np.array(model.dof_frictionloss), carriage)
    layers, constants = result.actuators.view(np.recarray), twin.constants.view(np.recarray)
    for i in range(twin.num_sims):
        own = twin._batch.get_model(i)
        nv, data = int(own.nv), mujoco.MjData(own)
        room = np.zeros((scratch_rows(nv), nv))
        row = Row(layers[i], constants[i], parameters[i], result.memory[i], result.effects[i], room)
        tape = inputs.tape(i, nv)
        data.time, data.qpos[:], data.qvel[:] = state.time[i], state.qpos[i], state.qvel[i]
        data.qacc_warmstart[:] = state.warmstart[i]
        with called_by_engine(partial(step, rig, row, tape)):
            mujoco.mj_step(own, data, inputs.steps)
        result.time[i], result.qpos[i], result.qvel[i] = data.time, data.qpos, data.qvel
        result.warmstart[i], result.memory[i, 2:] = data.qacc_warmstart, data.qfrc_constraint
    return result


@contextmanager
def called_by_engine(step: Callable[[View, int], None]) -> Iterator[None]:
    """Let the engine call a Python function in every step, with what it sees and the number of the step."""
    count = itertools.count()
    mujoco.set_mjcb_control(lambda model, data: step(look_at(model, data), next(count)))
    try:
        yield
    finally:
        mujoco.set_mjcb_control(None)
