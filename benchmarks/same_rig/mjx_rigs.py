"""The rig in MJX on the CPU: controller and ten physics steps in one jitted function, vectorised over rigs."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from same_rig.cascade import GOVERNOR_KI, GOVERNOR_KP
from same_rig.rig import EPISODE, START_POSE, START_VELOCITY, SUBSTEPS, TRAVEL
from vpptwin.robots.planar_drone.vehicle import Vehicle

ITERATIONS = (2, 6)
"""Iterations of the solver and of its line search. In float32 the rig's tolerance is out of reach and all rigs of a
batch wait for the slowest, so that the rig's own 20 and 50 are always used up: nine times slower, 0.04 mm closer."""


class Layer(NamedTuple):
    """Controller and actuators: gyro (N,) rad/s; pitch [rad], speed [rad/s], speed integral [rad], each (N, 2)."""

    gyro: jax.Array
    pitch: jax.Array
    speed: jax.Array
    integral: jax.Array


def power_on(vehicle: Vehicle, count: int) -> Layer:
    """Blades flat, rotors at their governed speed."""
    zeros = jnp.zeros((count, 2))
    return Layer(jnp.zeros(count), zeros, jnp.full((count, 2), vehicle.rotor.speed), zeros)


def allocate(vehicle: Vehicle, thrust: jax.Array, torque: jax.Array) -> jax.Array:
    """Thrusts asked of the rotors [N], (N, 2), rate control first."""
    limit = vehicle.rotor.k_t * vehicle.rotor.speed * vehicle.rotor.pitch_max
    difference = jnp.clip(0.5 * torque / vehicle.airframe.half_length, -limit, limit)
    room = limit - jnp.abs(difference)
    common = jnp.clip(0.5 * thrust, -room, room)
    return jnp.stack([common - difference, common + difference], axis=1)


def select(done: jax.Array, fresh: jax.Array | int, now: jax.Array) -> jax.Array:
    """Rows of `fresh`, one for all or one each, where `done`, (N,), else of `now`, (N, ...)."""
    return jnp.where(done.reshape(-1, *[1] * (now.ndim - 1)), fresh, now)


def step_layer(vehicle: Vehicle, layer: Layer, thrust: jax.Array, rate: jax.Array, gyro: jax.Array) -> tuple:
    """The layer and the rotors' mean thrusts [N], (N, 2), one inner step later."""
    rotor, motor, control = vehicle.rotor, vehicle.motor, vehicle.control
    dt = 1.0 / control.inner_rate

    def drag(speed: jax.Array | float, pitch: jax.Array) -> jax.Array:
        return speed * (rotor.k_d1 * speed + rotor.k_d2 * speed * pitch**2 + rotor.k_d3 * jnp.abs(pitch))

    filtered = layer.gyro + control.gyro_filter * (gyro - layer.gyro)
    torque = control.rate_kp * (rate - filtered) - control.rate_kd / dt * (filtered - layer.gyro)
    wanted = allocate(vehicle, thrust, torque) / (rotor.k_t * rotor.speed)
    command = jnp.clip(wanted, -rotor.pitch_max, rotor.pitch_max)
    error = rotor.speed - layer.speed
    grown = layer.integral + dt * error
    voltage = rotor.speed / motor.k_v + motor.resistance * (
        motor.no_load_current + motor.k_q * drag(rotor.speed, command)
    )
    throttle = (voltage + GOVERNOR_KP * error + GOVERNOR_KI * grown) / motor.battery
    integral = jnp.where((throttle < 0.0) | (throttle > 1.0), layer.integral, grown)
    ratio = vehicle.servo.time_constant / dt
    left = math.exp(-1.0 / ratio)
    gap = command - layer.pitch
    pitch = command - left * gap
    current = (jnp.clip(throttle, 0.0, 1.0) * motor.battery - layer.speed / motor.k_v) / motor.resistance
    drive = (current - motor.no_load_current) / motor.k_q - drag(layer.speed, pitch)
    speed = jnp.maximum(layer.speed + dt * drive / rotor.inertia, 0.0)
    mean = command - ratio * (1.0 - left) * gap
    return Layer(filtered, pitch, speed, integral), rotor.k_t * speed * mean


class MjxRigs:
    """`jax.vmap` over rigs and `jax.jit`, float32 as MJX has it by default."""

    title = "MJX on CPU, vmap and jit"
    leaves_out = "no observation, reward of one line, no non-finite guard; float32, two solver iterations"
    controlled = True
    workers = 0

    def __init__(self, rig: Path, vehicle: Vehicle, envs: int, seed: int) -> None:
        self.envs, self._vehicle = envs, vehicle
        compiled = mujoco.MjModel.from_xml_path(str(rig))
        compiled.opt.iterations, compiled.opt.ls_iterations = ITERATIONS
        model = mjx.put_model(compiled)
        blank = mjx.make_data(model).replace(qpos=jnp.array(START_POSE), qvel=jnp.array(START_VELOCITY))
        self._blank = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (envs, *leaf.shape)), blank)
        self._ready = ready = power_on(vehicle, envs)
        physics = jax.vmap(mjx.step, in_axes=(None, 0))
        low, high = jnp.array(TRAVEL).T

        def substep(carry: tuple, command: jax.Array) -> tuple:
            data, layer = carry
            layer, thrust = step_layer(vehicle, layer, command[:, 0], command[:, 1], data.qvel[:, 2])
            return physics(model, data.replace(ctrl=thrust)), layer

        def control_step(data: mjx.Data, layer: Layer, elapsed: jax.Array, actions: jax.Array) -> tuple:
            command = actions * jnp.array([vehicle.control.thrust_max, vehicle.control.rate_max])
            data, layer = jax.lax.fori_loop(0, SUBSTEPS, lambda _, carry: substep(carry, command), (data, layer))
            position = data.qpos[:, :2]
            reward = -jnp.linalg.norm(position - jnp.array(START_POSE[:2]), axis=1)
            done = ((position <= low) | (position >= high)).any(axis=1) | (elapsed + 1 >= EPISODE)
            evolves = ("qpos", "qvel", "qacc_warmstart", "time")
            now = {name: getattr(data, name) for name in evolves}, layer, elapsed + 1
            fresh = {name: getattr(blank, name) for name in evolves}, ready, 0
            kept, layer, elapsed = jax.tree.map(partial(select, done), fresh, now)
            return data.replace(**kept), layer, elapsed, reward

        self._control_step = jax.jit(control_step)
        self.start()

    def start(self) -> None:
        """Put every rig at the start state."""
        self._data, self._layer, self._elapsed = self._blank, self._ready, jnp.zeros(self.envs, jnp.int32)

    def step(self, actions: np.ndarray) -> None:
        """One step of all rigs; those that ended start anew."""
        stepped = self._control_step(self._data, self._layer, self._elapsed, jnp.asarray(actions))
        self._data, self._layer, self._elapsed, reward = stepped
        reward.block_until_ready()

    def positions(self) -> np.ndarray:
        """x, z, θ, (envs, 3)."""
        return np.asarray(self._data.qpos, dtype=float)

    def close(self) -> None:
        """Nothing to end."""
