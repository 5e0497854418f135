"""N simulations of one twin on `mujoco.batch.Batch`, with parameters that can differ in every simulation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from mujoco.batch import Batch

from vpptwin.actuators.layer import (
    ActuatorConstants,
    ActuatorState,
    command_from_policy,
    move_actuators,
    rotor_thrust,
    spin_rotors,
)
from vpptwin.effects import Effect, Stage
from vpptwin.effects.base import Plant
from vpptwin.twin.constants import ConstantTable
from vpptwin.twin.model import hold_joints
from vpptwin.twin.spec import TwinSpec
from vpptwin.twin.state import TwinState
from vpptwin.vehicle import Vehicle


@dataclass(frozen=True)
class Driven:
    """Joints that follow a log: their degrees of freedom (D,), poses and velocities at every step, (N, steps, D)."""

    dofs: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray


class Twin:
    """N simulations that share a rig and differ in parameters and state.

    A twin holds parameters; whatever evolves is in the `TwinState` that its functions take and return.

    The engine's semi-implicit Euler step is second-order accurate if read as a leapfrog: `qvel` belongs to the state's
    time, `qpos` leads it by half a step, and forces are means over the step. `pose_at_time` undoes the lead where half
    a millisecond matters, which it does when a delay is to be told from nothing.

    Args:
        spec: the twin to simulate.
        num_sims: number of simulations N.
        active: ids of effects to switch on besides those of `spec`, starting at their off values.
        num_threads: threads of the engine, 0 for all cores.

    Attributes:
        effects: the effects that are switched on, by id.
        dt: inner step [s].
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
        driven = spec.signals.driven if spec.signals is not None else {}
        model = hold_joints(spec.model, driven) if driven else spec.model
        self._armature = np.array(model.dof_armature)
        self._batch = Batch(model, num_sims, num_threads)
        self._constants = ConstantTable(spec, self.effects, num_sims, self._batch)
        names = ("time", "qpos", "qvel", "qacc_warmstart", "ctrl", "qfrc_applied")
        self._live = {name: self._batch.bind(name) for name in names}
        self._per_step = [e for e in self.effects.values() if e.stage is not Stage.CONSTANT]

    @property
    def vehicle(self) -> Vehicle:
        """The believed vehicle; only the drone has one."""
        if self.spec.vehicle is None:
            raise AttributeError(f"{self.spec.name} is not the drone: it has no vehicle")
        return self.spec.vehicle

    def set_parameter(
        self, effect_id: str, parameter: str, values: np.ndarray | float, ids: np.ndarray | None = None
    ) -> None:
        """Set a parameter of a switched-on effect, starting from nominal constants each time.

        Args:
            effect_id: an id of `effects`.
            parameter: its parameter.
            values: a scalar, or one value per simulation of the call, in the parameter's unit.
            ids: simulations, None for all.
        """
        self._constants.set_parameter(effect_id, parameter, values, ids)

    def parameter(self, effect_id: str, parameter: str) -> np.ndarray:
        """Values of a parameter, (N,); a copy."""
        return self._constants.values[effect_id, parameter].copy()

    def constant(self, name: str) -> np.ndarray:
        """A per-simulation constant after the effects, e.g. `mocap.delay`, (N, ...); a copy."""
        self._constants.refresh()
        return self._constants.table[name].copy()

    def initial_state(self, qpos: np.ndarray | None = None, qvel: np.ndarray | None = None) -> TwinState:
        """A state at rest by default, actuators neutral, rotors at their governed speed.

        Args:
            qpos: (N, nq) or (nq,); by default the model's reference pose, on the drone hovering height 1 m.
            qvel: (N, nv) or (nv,), zero by default.
        """
        self._constants.refresh()
        model, n = self.spec.model, self.num_sims
        start = np.array(model.qpos0)
        if self.spec.vehicle is not None:
            start[1] = 1.0
        layer = ActuatorState(
            output=np.zeros((n, model.nu)),
            mean=np.zeros((n, model.nu)),
            history=np.zeros((n, self._constants.delay_depth, model.nu)),
            rotor_speed=np.full((n, model.nu), self.spec.vehicle.rotor.speed if self.spec.vehicle else 0.0),
            governor=np.zeros((n, model.nu)),
            gyro=np.zeros(n),
            throttle=np.zeros((n, model.nu)),
        )
        return TwinState(
            time=np.zeros(n),
            qpos=np.array(np.broadcast_to(start if qpos is None else qpos, (n, model.nq)), dtype=float),
            qvel=np.array(np.broadcast_to(0.0 if qvel is None else qvel, (n, model.nv)), dtype=float),
            warmstart=np.zeros((n, model.nv)),
            actuators=layer,
        )

    def pose_at_time(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Positions at the state's time: `qpos` less the half step by which it leads, same shape as qpos."""
        return qpos - 0.5 * self.dt * qvel

    def pose_for_engine(self, pose: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Engine positions `qpos` for a pose and velocity at one time: the inverse of `pose_at_time`."""
        return pose + 0.5 * self.dt * qvel

    def step_policy(self, state: TwinState, command: np.ndarray, duration: float = 0.01) -> TwinState:
        """Fly under a policy command through the whole cascade (SPEC 2).

        Args:
            state: N simulations; not modified.
            command: thrust [N] and rate [rad/s], (N, 2), held for `duration`.
            duration: s, rounded to whole inner steps.

        Returns:
            The state `duration` later.
        """
        vehicle = self.vehicle
        self._load(state)
        layer = state.actuators
        for _ in range(round(duration / self.dt)):
            rate = self._live["qvel"][:, 2]
            pitch, throttle, layer = command_from_policy(vehicle, layer, command, rate, layer.rotor_speed, self.dt)
            layer = move_actuators(layer, self._actuator_constants(), pitch, self.dt)
            layer = spin_rotors(vehicle, layer, throttle, self.dt)
            self._step_engine(layer)
        return self._unload(layer)

    def warm_up(self, layer: ActuatorState, commands: np.ndarray) -> ActuatorState:
        """Run the delay and lag of the actuators alone over past commands, (N, steps, nu), oldest first."""
        self._constants.refresh()
        for k in range(commands.shape[1]):
            layer = move_actuators(layer, self._actuator_constants(), commands[:, k], self.dt)
        return layer

    def replay_commands(
        self,
        state: TwinState,
        commands: np.ndarray,
        rotor_speed: np.ndarray | None = None,
        throttle: np.ndarray | None = None,
        disturbance: np.ndarray | None = None,
        driven: Driven | None = None,
    ) -> tuple[TwinState, np.ndarray, np.ndarray]:
        """Run under logged actuator commands, one per inner step.

        Args:
            state: N simulations; not modified.
            commands: blade pitch [rad] (control input on other rigs), (N, steps, nu).
            rotor_speed: measured rotor speed, (N, steps, 2) rad/s; None simulates it from `throttle`.
            throttle: (N, steps, 2), 0..1; used when `rotor_speed` is None.
            disturbance: generalized force added, (N, segments, nv) N, N m, each held for an equal part of the steps.
            driven: joints that follow given tracks instead of the engine.

        Returns:
            The final state, and qpos, qvel after every step, (N, steps, nq) and (N, steps, nv).
        """
        self._load(state)
        layer = state.actuators
        steps = commands.shape[1]
        qpos = np.empty((self.num_sims, steps, self.spec.model.nq))
        qvel = np.empty((self.num_sims, steps, self.spec.model.nv))
        for k in range(steps):
            layer = move_actuators(layer, self._actuator_constants(), commands[:, k], self.dt)
            if self.spec.vehicle is not None and rotor_speed is not None:
                layer = replace(layer, rotor_speed=rotor_speed[:, k])
            elif self.spec.vehicle is not None and throttle is not None:
                layer = spin_rotors(self.spec.vehicle, layer, throttle[:, k], self.dt)
            extra = None if disturbance is None else disturbance[:, k * disturbance.shape[1] // steps]
            if driven is not None:
                extra = self._lead_joints(driven, k, extra)
            self._step_engine(layer, extra)
            qpos[:, k], qvel[:, k] = self._live["qpos"], self._live["qvel"]
        return self._unload(layer).copy(), qpos, qvel  # a copy, as the layer still holds arrays of the arguments

    def _lead_joints(self, driven: Driven, k: int, extra: np.ndarray | None) -> np.ndarray:
        """Put driven joints where their tracks are at step k; `extra` with the force that leads them to the next."""
        dofs, last = driven.dofs, max(driven.velocity.shape[1] - 2, 0)
        self._live["qpos"][:, dofs] = self.pose_for_engine(driven.pose[:, k], driven.velocity[:, k])
        self._live["qvel"][:, dofs] = driven.velocity[:, k]
        ahead = np.diff(driven.velocity[:, min(k, last) : min(k, last) + 2], axis=1).sum(axis=1)
        force = np.zeros_like(self._live["qfrc_applied"]) if extra is None else extra.copy()
        force[:, dofs] += self._armature[dofs] * ahead / self.dt
        return force

    def _actuator_constants(self) -> ActuatorConstants:
        table = self._constants.table
        return ActuatorConstants(table["actuator.delay"], table["actuator.time_constant"], table["actuator.gain"])

    def _step_engine(self, layer: ActuatorState, extra: np.ndarray | None = None) -> None:
        live, values = self._live, self._constants.values
        drone = self.spec.vehicle is not None
        control = rotor_thrust(self.spec.vehicle, layer) if self.spec.vehicle else layer.mean
        control = control * self._constants.table["actuator.gain"]
        plant = Plant(live["qpos"], live["qvel"], layer.rotor_speed, layer.mean)
        force = np.zeros_like(live["qfrc_applied"]) if extra is None else extra
        for effect in self._per_step:
            parameters = {p.name: values[effect.id, p.name] for p in effect.parameters}
            site = self._constants.sites[effect.id]
            if effect.stage is Stage.THRUST and drone:
                control = effect.apply_step(control, plant, site, parameters)
            elif effect.stage is Stage.FORCE:
                force = effect.apply_step(force, plant, site, parameters)
        live["ctrl"][:] = control
        live["qfrc_applied"][:] = force
        self._batch.step()

    def _load(self, state: TwinState) -> None:
        self._constants.refresh()
        live = self._live
        live["time"][:], live["qpos"][:], live["qvel"][:] = state.time, state.qpos, state.qvel
        live["qacc_warmstart"][:] = state.warmstart

    def _unload(self, layer: ActuatorState) -> TwinState:
        live = self._live
        return TwinState(
            live["time"].copy(), live["qpos"].copy(), live["qvel"].copy(), live["qacc_warmstart"].copy(), layer
        )
