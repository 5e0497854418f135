"""The actuator layer: everything between a command and the force it makes, one inner step at a time.

Its state is an explicit record of arrays; `replace_rows` in `vpptwin.twin.state` and a saved copy cover all there is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vpptwin.actuators.blade import compute_thrust, pitch_for_thrust
from vpptwin.actuators.cascade import allocate, compute_torque, filter_gyro
from vpptwin.actuators.motor import hold_speed, step_speed
from vpptwin.actuators.servo import push_command, read_delayed, step_lag
from vpptwin.vehicle import Vehicle


@dataclass(frozen=True)
class ActuatorState:
    """State of the actuator layer, leading axis N.

    Attributes:
        output: what the actuators do now, (N, nu): blade pitch [rad] on the drone, control input on other rigs.
        mean: their mean over the last step, (N, nu), which is what the engine's step applies.
        history: commands on their way, newest first, (N, depth, nu).
        rotor_speed: (N, nu) rad/s; zero on other rigs.
        governor: integral of the speed error, (N, nu) rad.
        gyro: low-passed rate, (N,) rad/s.
        throttle: last throttle, (N, nu), 0..1.
    """

    output: np.ndarray
    mean: np.ndarray
    history: np.ndarray
    rotor_speed: np.ndarray
    governor: np.ndarray
    gyro: np.ndarray
    throttle: np.ndarray


@dataclass(frozen=True)
class ActuatorConstants:
    """Per-simulation constants of the layer: delay and time_constant [s] and gain, each (N, nu)."""

    delay: np.ndarray
    time_constant: np.ndarray
    gain: np.ndarray


def command_from_policy(
    vehicle: Vehicle, state: ActuatorState, policy: np.ndarray, rate: np.ndarray, speed: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray, ActuatorState]:
    """Inner loop of the flight controller, on believed numbers only.

    Args:
        vehicle: the believed vehicle.
        state: layer state.
        policy: commanded thrust [N] and rate [rad/s], (N, 2).
        rate: gyro rate q, (N,) rad/s.
        speed: measured rotor speed, (N, 2) rad/s.
        dt: inner step, s.

    Returns:
        Blade-pitch command (N, 2) rad, throttle (N, 2), and the state with filter and governor advanced.
    """
    filtered = filter_gyro(vehicle, state.gyro, rate)
    torque = compute_torque(vehicle, policy[:, 1], filtered, state.gyro, dt)
    pitch_command = pitch_for_thrust(vehicle.rotor, allocate(vehicle, policy[:, 0], torque))
    throttle, governor = hold_speed(vehicle.motor, vehicle.rotor, speed, pitch_command, state.governor, dt)
    return pitch_command, throttle, replace(state, gyro=filtered, governor=governor)


def move_actuators(state: ActuatorState, constants: ActuatorConstants, command: np.ndarray, dt: float) -> ActuatorState:
    """Delay, then lag: the command issued now, (N, nu), shifts into the line and the actuators follow what arrives."""
    if state.history.shape[1] == 0:
        arriving = command
        history = state.history
    else:
        history = push_command(state.history, command)
        arriving = read_delayed(history, constants.delay, dt)
    output, mean = step_lag(state.output, arriving, constants.time_constant, dt)
    return replace(state, output=output, mean=mean, history=history)


def spin_rotors(vehicle: Vehicle, state: ActuatorState, throttle: np.ndarray, dt: float) -> ActuatorState:
    """Advance the rotors' speeds under a throttle (N, 2)."""
    voltage = throttle * vehicle.motor.battery
    speed = step_speed(vehicle.motor, vehicle.rotor, state.rotor_speed, state.output, voltage, dt)
    return replace(state, rotor_speed=speed, throttle=throttle)


def rotor_thrust(vehicle: Vehicle, state: ActuatorState) -> np.ndarray:
    """Nominal thrust of the rotors, mean over the last step, (N, 2) N."""
    return compute_thrust(vehicle.rotor, state.rotor_speed, state.mean)
