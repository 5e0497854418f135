"""Flying: a pilot and N twins in closed loop, through the sensors, and the tracks that they leave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vpptwin.estimation.kalman import FilterNoise, KalmanFilter
from vpptwin.pilot.gusts import Gusts
from vpptwin.twin import Twin
from vpptwin.twin.health import find_diverged
from vpptwin.twin.past import history_depth, record_poses, start_sensors
from vpptwin.twin.sensors import body_force, measure_rate, read_sensors, sensor_noise

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
class Noise:
    """Readings' errors of N flights at unit variance, each flight's its own.

    Attributes:
        fast: gyro, accelerometer x and z, rotor speeds, currents, at every sample of the IMU, (N, K, 7).
        pose: x, z, θ at every tick, (N, T, 3).
    """

    fast: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True)
class Tracks:
    """What N flights did: K samples of the IMU, T ticks of the policy; the log starts with sample and tick `lead`.

    Attributes:
        twin: that flew them.
        step: time between samples [s].
        period: time between ticks [s].
        lead: samples and ticks before the log, (2,).
        pose: (N, K, 3) m, m, rad.
        velocity: (N, K, 3) m/s, rad/s.
        blade_pitch: commanded, (N, K, 2) rad.
        throttle: (N, K, 2).
        speed: of the rotors, (N, K, 2) rad/s.
        command: of the policy, (N, T, 2) N, rad/s.
        target: (N, T, 3) m, m, rad.
        noise: of the readings.
        diverged: when numbers stopped making sense, (N,) s; infinite where they never did.
        actuators: their state at the end, (N,) records.
    """

    twin: Twin
    step: float
    period: float
    lead: tuple[int, int]
    pose: np.ndarray
    velocity: np.ndarray
    blade_pitch: np.ndarray
    throttle: np.ndarray
    speed: np.ndarray
    command: np.ndarray
    target: np.ndarray
    noise: Noise
    diverged: np.ndarray
    actuators: np.ndarray

    @property
    def logged_pose(self) -> np.ndarray:
        """True poses from the log's start on, (N, K', 3) m, m, rad."""
        return self.pose[:, self.lead[0] :]


def draw_noise(seed: int, count: int, samples: int, ticks: int) -> Noise:
    """Errors of `count` flights; those of the first few do not depend on how many there are."""
    rngs = [np.random.default_rng([seed, i]) for i in range(count)]
    fast = np.stack([rng.standard_normal((samples, 7)) for rng in rngs])
    return Noise(fast, np.stack([rng.standard_normal((ticks, 3)) for rng in rngs]))


def fly(
    twin: Twin, pilot: Pilot, seed: int, gusts: Gusts | None = None, start: tuple[np.ndarray, np.ndarray] | None = None
) -> Tracks:
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
    control, sensors = twin.vehicle.control, twin.vehicle.sensors
    period, every = 1.0 / control.policy_rate, max(round(1.0 / (sensors.imu.rate * twin.dt)), 1)
    step = every * twin.dt
    each, lead = round(period / step), round(SETTLING / period) if start is None else 0
    ticks, n = pilot.ticks + lead, twin.num_sims
    samples = ticks * each
    noise = draw_noise(seed, n, samples, ticks)
    pose, velocity = np.empty((n, samples, 3)), np.empty((n, samples, 3))
    blade, throttle, speed = (np.empty((n, samples, 2)) for _ in range(3))
    command, target = np.empty((n, ticks, 2)), np.empty((n, ticks, 3))
    diverged = np.full(n, np.inf)

    begin, speeds = (pilot.target(0), None) if start is None else start
    state = twin.initial_state(begin, speeds, time=-lead * period)
    depth = history_depth(twin.effects.values(), period, ticks * period)
    past = start_sensors(state.qpos, state.qvel, depth, period)
    estimate, memory = (
        KalmanFilter(n, step, twin.vehicle.gravity, FilterNoise.of_vehicle(twin.vehicle)),
        np.zeros((n, 2)),
    )
    if start is not None:
        estimate.start(np.arange(n), *start)
    pose_std = sensor_noise(twin.vehicle)[0]
    imu_std = np.array([sensors.imu.gyro_std, sensors.imu.accel_std, sensors.imu.accel_std])
    frames = max(round(control.policy_rate / sensors.mocap.rate), 1)
    for tick in range(ticks):
        now = tick * each
        here = twin.pose_at_time(state.qpos, state.qvel)
        if tick:
            record_poses(past, here, state.qvel)
        if tick % frames == 0:
            seen, _ = read_sensors(twin.constants, past, here, state.qvel, state.time, period)
            estimate.correct(seen + noise.pose[:, tick] * pose_std)
        target[:, tick] = pilot.target(tick - lead)
        command[:, tick], memory = pilot.command(tick - lead, estimate.pose, estimate.velocity, memory)
        if gusts is not None:
            gusts.blow(twin, tick)
        for k in range(now, now + each):
            pose[:, k], velocity[:, k] = twin.pose_at_time(state.qpos, state.qvel), state.qvel
            speed[:, k] = state.rotor_speed
            twin.advance_policy(state, command[:, tick], step)
            after = twin.pose_at_time(state.qpos, state.qvel)
            way = np.stack([pose[:, k], after], axis=1), np.stack([velocity[:, k], state.qvel], axis=1)
            error = noise.fast[:, k, :3] * imu_std
            gyro = measure_rate(twin.constants, (after[:, 2] - pose[:, k, 2]) / step) + error[:, 0]
            estimate.predict(gyro, body_force(*way, step, twin.vehicle.gravity)[:, 0] + error[:, 1:])
            layer = state.actuators
            blade[:, k] = layer["history"][np.arange(n), layer["newest"]]
            throttle[:, k] = state.throttle
        broken = find_diverged(state) & np.isinf(diverged)
        diverged[broken] = (tick + 1 - lead) * period
    return Tracks(
        twin, step, period, (lead * each, lead), pose, velocity, blade, throttle, speed, command, target, noise,
        diverged, state.actuators,
    )  # fmt: skip
