"""The actuator layer: everything between a command and the force it makes, one inner step of one simulation at a time.

Its state is an explicit record; rows of an array of them are copied, saved and put back like any numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vpptwin.actuators.adaptive import SIZE
from vpptwin.actuators.controller import run_cascade
from vpptwin.actuators.motor import compute_current, step_speed
from vpptwin.actuators.numbers import Number, VehicleNumbers
from vpptwin.actuators.servo import limit_rate, read_delayed, step_lag, take_up_play
from vpptwin.effects import UNLIMITED
from vpptwin.engine.compile import compilable

Record = Any
"""One row of a structured array: fields by name, written in place."""
NO_LIMIT = 1e3 * UNLIMITED
"""Stands for no limit of an actuator's rate or output: far above those of effects, even where these are off."""
PITCH = 2
"""Degree of freedom whose rate the drone's gyro shows."""
SUPPLY = ("battery.sag",)
"""Constants of the battery, which telemetry of motors shows as it shows sensors."""
PACES = tuple(f"actuator.{name}" for name in ("delay", "time_constant", "rate_limit", "gap", "trim"))
"""Constants by which actuators move."""
NOMINAL = {"actuator.gain": 1.0, "actuator.rate_limit": NO_LIMIT, "actuator.limit": NO_LIMIT,
           "rotor.drag_gain": 1.0, "pose.scale": 1.0, "rate.scale": 1.0}  # fmt: skip
"""Constants of actuators and sensors that are not zero by themselves."""


def layer_dtype(actuators: int, depth: int, adaptive: bool = False) -> np.dtype:
    """State of the actuator layer of one simulation.

    Fields:
        horn: where the servos are, (nu,): blade pitch [rad] on the drone, control input on other rigs.
        output: where the actuators are, behind the play of their linkages and with trim, (nu,).
        mean: their mean over the last step, (nu,), which is what the engine's step applies.
        blade: `output` without trim, (nu,).
        history: ring of commands on their way, (depth, nu).
        newest: index of the last one.
        rotor_speed: (nu,) rad/s; zero on other rigs.
        mean_speed: its mean over the last step, (nu,), which thrust goes by.
        governor: integral of the speed error, (nu,) rad.
        throttle: last throttle, (nu,), 0..1.
        gyro: low-passed rate [rad/s].
        adaptive: what the adaptive controller has learned, (nu, `vpptwin.actuators.adaptive.SIZE`), or (nu, 0) without.
    """
    pair = (np.float64, (actuators,))
    return np.dtype(
        [
            *((name, *pair) for name in ("horn", "blade", "output", "mean")),
            ("history", np.float64, (depth, actuators)),
            ("newest", np.int64),
            *((name, *pair) for name in ("rotor_speed", "mean_speed", "governor", "throttle")),
            ("gyro", np.float64),
            ("adaptive", np.float64, (actuators, SIZE if adaptive else 0)),
        ]
    )


def constants_dtype(actuators: int, dofs: int) -> np.dtype:
    """Constants of actuators and sensors of one simulation, which effects may change.

    Fields:
        actuator.delay, actuator.time_constant: s. actuator.rate_limit: 1/s. actuator.gap, actuator.trim: in the
        unit of the command. actuator.gain, actuator.limit, actuator.dead_band: of the control that the engine gets,
        actuator.sag: of it 1/s. All (nu,).
        rotor.drag_gain: factor on drag torque. battery.sag: 1/s.
        Of what sensors say of every degree of freedom, (nv,): pose.delay, rate.delay: s. pose.drift, rate.drift: s/s.
        pose.scale, rate.scale: factors. pose.offset: m, rad. rate.bias: m/s, rad/s. rate.turn: rad.
    """
    of_actuators = (*PACES, *(f"actuator.{name}" for name in ("gain", "limit", "dead_band", "sag")))
    of_sensors = ("pose.delay", "pose.drift", "pose.offset", "pose.scale", "rate.delay", "rate.drift", "rate.bias",
                  "rate.scale", "rate.turn")  # fmt: skip
    return np.dtype(
        [
            *((name, np.float64, (actuators,)) for name in of_actuators),
            *((name, np.float64) for name in ("rotor.drag_gain", "battery.sag")),
            *((name, np.float64, (dofs,)) for name in of_sensors),
        ]
    )


def nominal_constants(lag: float, records: np.ndarray) -> dict[str, np.ndarray]:
    """Constants of one simulation's actuators, of nominal time constant `lag` [s], and sensors: name → (...)."""
    nominal = {name: np.full(records[name].shape[1:], NOMINAL.get(name, 0.0)) for name in records.dtype.names or ()}
    nominal["actuator.time_constant"][:] = lag
    return nominal


@compilable()
def command_from_policy(
    vehicle: VehicleNumbers, state: Record, constants: Record, thrust: float, rate: float, turn: float, time: float,
    dt: float,
) -> tuple[float, float]:  # fmt: skip
    """The flight controller on what the sensors say, which is free of noise.

    Args:
        vehicle: the believed vehicle.
        state: of the layer; the controller's part of it advances.
        constants: of the layer: the gyro's errors, and the battery's.
        thrust: commanded by the policy [N].
        rate: likewise [rad/s].
        turn: true rate q [rad/s].
        time: since the battery was full [s].
        dt: inner step [s].

    Returns:
        Blade-pitch commands of rotors 1 and 2 [rad].
    """
    speed = state.rotor_speed[0], state.rotor_speed[1]
    current = 0.0, 0.0
    if state.adaptive.shape[1] > 0:
        full = vehicle.motor.battery * supply(constants, time)
        current = (
            compute_current(vehicle.motor, state.throttle[0] * full, speed[0]),
            compute_current(vehicle.motor, state.throttle[1] * full, speed[1]),
        )
    measured = constants["rate.scale"][PITCH] * turn + constants["rate.bias"][PITCH]
    return run_cascade(vehicle, state, thrust, rate, measured, speed, current, dt)


@compilable()
def supply(constants: Record, time: Number) -> Number:
    """Share of its voltage that the battery still has at a time [s]."""
    return np.maximum(1.0 - constants["battery.sag"] * time, 0.0)


@compilable()
def push_commands(state: Record) -> None:
    """Make room for the commands issued now, at `state.newest` of the ring."""
    if state.history.shape[0] > 0:
        state.newest = (state.newest + 1) % state.history.shape[0]


@compilable()
def move_actuator(state: Record, constants: Record, i: int, command: float, dt: float) -> None:
    """Delay, lag limited in rate, play and trim: actuator i follows the command issued now for one step."""
    lag, rate, start = constants["actuator.time_constant"][i], constants["actuator.rate_limit"][i], state.horn[i]
    arriving, part, late = command, 0.0, 0.0
    if state.history.shape[0] > 0:
        state.history[state.newest, i] = command
        older, arriving, part = read_delayed(state.history[:, i], state.newest, constants["actuator.delay"][i], dt)
        if part > 0.0:  # until the new command arrives
            begin = start
            start, late = step_lag(begin, older, lag, part * dt)
            start, late = limit_rate(begin, start, late, rate, part * dt)
    rest = (1.0 - part) * dt
    end, mean = step_lag(start, arriving, lag, rest)
    end, mean = limit_rate(start, end, mean, rate, rest)
    mean = part * late + (1.0 - part) * mean
    gap, trim = constants["actuator.gap"][i], constants["actuator.trim"][i]
    state.horn[i] = end
    state["mean"][i] = take_up_play(state.blade[i], mean, gap) + trim
    state.blade[i] = take_up_play(state.blade[i], end, gap)
    state.output[i] = state.blade[i] + trim


@compilable()
def spin_rotor(vehicle: VehicleNumbers, state: Record, constants: Record, i: int, time: float, dt: float) -> None:
    """Advance the speed of rotor i under its throttle, from `time` [s] since the battery was full."""
    # U = throttle U_0 (1 - rate t), at the middle of the step.
    voltage = state.throttle[i] * vehicle.motor.battery * supply(constants, time + 0.5 * dt)
    before, pitch = state.rotor_speed[i], state["mean"][i]
    after = step_speed(vehicle.motor, vehicle.rotor, before, pitch, voltage, constants["rotor.drag_gain"], dt)
    state.rotor_speed[i] = after
    state.mean_speed[i] = 0.5 * (before + after)


@compilable()
def limit_control(constants: Record, i: int, control: float) -> float:
    """What the engine gets of actuator i: times its gain, within its limit."""
    limit = constants["actuator.limit"][i]
    return np.minimum(np.maximum(control * constants["actuator.gain"][i], -limit), limit)


@compilable()
def weaken_control(constants: Record, i: int, control: float, idle: float, time: float) -> float:
    """What a supply that sags leaves of it at a time [s], but for a dead band around `idle`, where it does nothing."""
    band, sag = constants["actuator.dead_band"][i], constants["actuator.sag"][i]
    if sag > 0.0:
        control *= np.maximum(1.0 - sag * time, 0.0)
    if band > 0.0:
        control -= np.minimum(np.maximum(control - idle, -band), band)
    return control
