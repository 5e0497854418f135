"""Flying: a pilot and N twins in closed loop, through the sensors, and the tracks that they leave."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from vpptwin.robots.planar_drone.kalman import FilterNoise, KalmanFilter
from vpptwin.robots.planar_drone.pilot.gusts import GustProcess
from vpptwin.twin import Twin
from vpptwin.twin.health import find_diverged
from vpptwin.twin.sensors import body_force, measure_rate, read_sensors, sensor_noise
from vpptwin.twin.state import TwinState
from vpptwin.twin.stepping.past import history_depth, record_poses, start_sensors

SETTLING = 1.0
"""Flown before the log starts [s], so that it starts in flight."""


class Pilot(Protocol):
    """Who flies N crafts, `ticks` policy periods long; `command` as that of `scripted.ScriptedPilot`."""

    count: int
    ticks: int

    def target(self, tick: int) -> np.ndarray:
        """Target x, z, θ of a tick, (N, 3) m, m, rad."""

    def command(
        self, tick: int, pose: np.ndarray, velocity: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Thrust [N] and rate [rad/s], (N, 2), and what to remember until the next tick, (N, 2)."""


@dataclass(frozen=True)
class ReadingNoise:
    """Readings' errors of N flights at unit variance, each flight's its own."""

    fast: np.ndarray  # gyro, accelerometer x and z, rotor speeds, currents, at every sample of the IMU, (N, K, 7)
    pose: np.ndarray  # x, z, θ at every tick, (N, T, 3)


@dataclass(frozen=True)
class SimulatedFlights:
    """What N flights did: K samples of the IMU, T ticks of the policy; the log starts with sample and tick `lead`."""

    twin: Twin  # that flew them
    step: float  # time between samples [s]
    period: float  # time between ticks [s]
    lead: tuple[int, int]  # samples and ticks before the log, (2,)
    pose: np.ndarray  # (N, K, 3) m, m, rad
    velocity: np.ndarray  # (N, K, 3) m/s, rad/s
    blade_pitch: np.ndarray  # commanded, (N, K, 2) rad
    throttle: np.ndarray  # (N, K, 2)
    speed: np.ndarray  # of the rotors, (N, K, 2) rad/s
    command: np.ndarray  # of the policy, (N, T, 2) N, rad/s
    target: np.ndarray  # (N, T, 3) m, m, rad
    noise: ReadingNoise  # of the readings
    diverged: np.ndarray  # when numbers stopped making sense, (N,) s; infinite where they never did
    actuators: np.ndarray  # their state at the end, (N,) records


def draw_noise(seed: int, count: int, samples: int, ticks: int) -> ReadingNoise:
    """Errors of `count` flights; those of the first few do not depend on how many there are."""
    rngs = [np.random.default_rng([seed, i]) for i in range(count)]
    fast = np.stack([rng.standard_normal((samples, 7)) for rng in rngs])
    return ReadingNoise(fast, np.stack([rng.standard_normal((ticks, 3)) for rng in rngs]))


def make_tracks(twin: Twin, pilot: Pilot, seed: int, settling: float) -> SimulatedFlights:
    """Room for the tracks of flights that settle for so long [s] before the log starts, and the noise on them."""
    control, n = twin.vehicle.control, twin.num_sims
    period, every = 1.0 / control.policy_rate, max(round(1.0 / (twin.vehicle.sensors.imu.rate * twin.dt)), 1)
    step = every * twin.dt
    each, lead = round(period / step), round(settling / period)
    ticks = pilot.ticks + lead
    pose, velocity = np.empty((2, n, ticks * each, 3))
    blade, throttle, speed = np.empty((3, n, ticks * each, 2))
    command, target = np.empty((n, ticks, 2)), np.empty((n, ticks, 3))
    noise, diverged = draw_noise(seed, n, ticks * each, ticks), np.full(n, np.inf)
    return SimulatedFlights(
        twin, step, period, (lead * each, lead), pose, velocity, blade, throttle, speed, command, target, noise,
        diverged, np.empty(0),
    )  # fmt: skip


def fly(
    twin: Twin,
    pilot: Pilot,
    seed: int,
    gusts: GustProcess | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
) -> SimulatedFlights:
    """Fly from rest at the first target, settling first, or at once from given states.

    What the pilot sees is the estimate of a Kalman filter from motion capture, gyro and accelerometer, with the twin's
    errors of them, late as its poses are, and the noise of the vehicle's sensors.

    Args:
        twin: the drone, one simulation a flight.
        pilot: of as many flights.
        seed: of the noise.
        gusts: that blow; None for still air.
        start: poses and velocities, (N, 3) m, m, rad and m/s, rad/s; None for rest at the first target.
    """
    tracks = make_tracks(twin, pilot, seed, SETTLING if start is None else 0.0)
    (_, lead), period, n = tracks.lead, tracks.period, twin.num_sims
    begin, speeds = (pilot.target(0), None) if start is None else start
    state = twin.initial_state(begin, speeds, time=-lead * period)
    ticks = tracks.target.shape[1]
    depth = history_depth(twin.effects.values(), period, ticks * period)
    past = start_sensors(state.qpos, state.qvel, depth, period)
    estimate = KalmanFilter(n, tracks.step, twin.vehicle.gravity, FilterNoise.of_vehicle(twin.vehicle))
    memory = np.zeros((n, 2))
    if start is not None:
        estimate.start(np.arange(n), *start)
    pose_std = sensor_noise(twin.vehicle)[0]
    frames = max(round(twin.vehicle.control.policy_rate / twin.vehicle.sensors.mocap.rate), 1)
    for tick in range(ticks):
        here = twin.pose_at_time(state.qpos, state.qvel)
        if tick:
            record_poses(past, here, state.qvel)
        if tick % frames == 0:
            seen, _ = read_sensors(twin.constants, past, here, state.qvel, state.time, period)
            estimate.correct(seen + tracks.noise.pose[:, tick] * pose_std)
        tracks.target[:, tick] = pilot.target(tick - lead)
        command, memory = pilot.command(tick - lead, estimate.pose, estimate.velocity, memory)
        tracks.command[:, tick] = command
        if gusts is not None:
            gusts.blow(twin, tick)
        fly_tick(tracks, tick, state, estimate)
        broken = find_diverged(state) & np.isinf(tracks.diverged)
        tracks.diverged[broken] = (tick + 1 - lead) * period
    return replace(tracks, actuators=state.actuators)


def fly_tick(tracks: SimulatedFlights, tick: int, state: TwinState, estimate: KalmanFilter) -> None:
    """Carry `state` and the filter through a tick under its command, one IMU sample after the other; keep the track."""
    twin, step, imu = tracks.twin, tracks.step, tracks.twin.vehicle.sensors.imu
    imu_std = np.array([imu.gyro_std, imu.accel_std, imu.accel_std])
    each = round(tracks.period / step)
    for k in range(tick * each, (tick + 1) * each):
        before = tracks.pose[:, k], tracks.velocity[:, k]
        before[0][:], before[1][:] = twin.pose_at_time(state.qpos, state.qvel), state.qvel
        tracks.speed[:, k] = state.rotor_speed
        twin.advance_policy(state, tracks.command[:, tick], step)
        after = twin.pose_at_time(state.qpos, state.qvel), state.qvel
        way = [np.stack(ends, axis=1) for ends in zip(before, after)]
        error = tracks.noise.fast[:, k, :3] * imu_std
        gyro = measure_rate(twin.constants, (after[0][:, 2] - before[0][:, 2]) / step) + error[:, 0]
        estimate.predict(gyro, body_force(way[0], way[1], step, twin.vehicle.gravity)[:, 0] + error[:, 1:])
        layer = state.actuators
        tracks.blade_pitch[:, k] = layer["history"][np.arange(twin.num_sims), layer["newest"]]
        tracks.throttle[:, k] = state.throttle
