"""Flights made by hand: a known motion seen by sensors with known noise, or a log of the twin's own flight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vpptwin.estimation.initial import HORIZON
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.logs.flight import Flight, Stream
from vpptwin.robots.planar_drone.topics import dead_reckon
from vpptwin.twin import Twin, TwinSpec

GRAVITY = 9.81
POSITION_STD, ANGLE_STD, GYRO_STD, ACCEL_STD = 4e-4, 3e-3, 0.02, 0.08

AMPLITUDE = np.array([0.5, 0.3, 0.8])
FREQUENCY = np.array([2.0, 3.0, 4.0])
"""Sines of x, z [m] and θ [rad] at these angular frequencies [rad/s]: up to 2.7 m/s² and 13 rad/s²."""


def locate(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True pose, velocity and acceleration of the motion, each (n, 3)."""
    phase = np.asarray(time)[:, None] * FREQUENCY
    pose = AMPLITUDE * np.sin(phase) + np.array([0.0, 1.5, 0.0])
    velocity = AMPLITUDE * FREQUENCY * np.cos(phase)
    return pose, velocity, -AMPLITUDE * FREQUENCY**2 * np.sin(phase)


def expect_noise(std: float, prior: float, causal: bool) -> tuple[float, float]:
    """Standard deviations of position and velocity at an instant, from 100 Hz samples within the horizon."""
    t = np.arange(-HORIZON, 1e-9 if causal else HORIZON + 1e-9, 0.01)
    design = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=1) / std
    information = design.T @ design + np.diag([0.0, 0.0, prior**-2])
    spread = np.sqrt(np.diag(np.linalg.inv(information)))
    return float(spread[0]), float(spread[1])


def expect_rate_noise(causal: bool) -> float:
    """Standard deviation [rad/s] of a line through 1 kHz gyro samples: at its end, 10 ms, or in its middle, 20 ms."""
    return float(GYRO_STD * (2 / np.sqrt(10) if causal else 1 / np.sqrt(20)))


@dataclass(frozen=True)
class Sensors:
    """What measures the motion: rates [Hz], noise in units of the nominal sensors' (0 for none), time of the first."""

    mocap_rate: float = 100.0
    imu_rate: float = 1000.0
    noise: float = 1.0
    mocap_start: float = 0.0
    imu_start: float = 0.0
    imu: bool = True

    def measure(self, duration: float, seed: int = 0) -> Measurements:
        """The motion as measured, commands all zero."""
        rng = np.random.default_rng(seed)
        slow = np.arange(self.mocap_start, duration, 1.0 / self.mocap_rate)
        fast = np.arange(self.imu_start, duration, 1.0 / self.imu_rate)
        pose = locate(slow)[0] + self.noise * rng.normal(size=(len(slow), 3)) * [POSITION_STD, POSITION_STD, ANGLE_STD]
        stds = (POSITION_STD, POSITION_STD, ANGLE_STD)
        positions = {i: Series("xzθ"[i], "", slow, pose[:, i], std) for i, std in enumerate(stds)}
        velocities, specific_force = {}, None
        if self.imu:
            truth, speed, accel = locate(fast)
            rate = speed[:, 2] + self.noise * GYRO_STD * rng.normal(size=len(fast))
            sin, cos, lift = np.sin(truth[:, 2]), np.cos(truth[:, 2]), accel[:, 1] + GRAVITY
            force = np.stack([accel[:, 0] * cos + lift * sin, lift * cos - accel[:, 0] * sin], axis=1)
            force += self.noise * ACCEL_STD * rng.normal(size=force.shape)
            velocities = {2: Series("θ rate", "rad/s", fast, rate, GYRO_STD)}
            specific_force = Series("specific force", "m/s²", fast, force, ACCEL_STD)
        command = Series("blade pitch", "rad", fast, np.zeros((len(fast), 2)), 0.0)
        start, end = max(slow[0], fast[0]), min(slow[-1], fast[-1])
        return Measurements(
            "made by hand", positions, velocities, specific_force, command, None, (0, 1, 2), start, end,
            dead_reckon=dead_reckon,
        )  # fmt: skip


@dataclass(frozen=True)
class OwnFlight:
    """A flight of the twin itself under blade pitches, as a log without noise, and its true states.

    Attributes:
        flight: the log.
        time: of the states [s].
        pose, velocity: true states, (n, 3).
    """

    flight: Flight
    time: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray

    def state_at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """True pose and velocity at any times, (K, 3), by the line between milliseconds."""
        pose, velocity = (
            np.stack([np.interp(times, self.time, series[:, i]) for i in range(3)], axis=1)
            for series in (self.pose, self.velocity)
        )
        return pose, velocity


def fly_own(spec: TwinSpec, commands: np.ndarray, imu: bool = True, rotors: bool = True) -> OwnFlight:
    """Fly the twin under blade pitches (n, 2) rad, one a millisecond, from hover, and log it without noise."""
    twin = Twin(spec, 1, num_threads=1)
    count, speed = len(commands), np.full((1, len(commands), 2), twin.vehicle.rotor.speed)
    start = np.array([0.0, 1.5, 0.0])
    _, qpos, qvel, _ = twin.replay_commands(twin.initial_state(qpos=start), commands[None], speed)
    pose = np.concatenate([start[None], twin.pose_at_time(qpos, qvel)[0]])
    velocity = np.concatenate([np.zeros((1, 3)), qvel[0]])
    time = np.arange(count + 1) / 1000.0
    slow, middle = slice(None, None, 10), time[:-1] + 0.0005  # specific force is the mean over a step: its middle
    streams = {
        "/mocap/pose": Stream(time[slow], {name: pose[slow, i] for i, name in enumerate(("x", "z", "theta"))}),
        "/rotor/command": Stream(time[:-1], {"blade_pitch": commands, "throttle": np.full_like(commands, 0.4)}),
    }
    if rotors:
        streams["/rotor/state"] = Stream(time[:-1], {"speed": speed[0], "current": np.zeros_like(commands)})
    if imu:
        accel, angle = np.diff(velocity, axis=0) * 1000.0, 0.5 * (pose[1:, 2] + pose[:-1, 2])
        lift, sin, cos = accel[:, 1] + GRAVITY, np.sin(angle), np.cos(angle)
        rate = 0.5 * (velocity[1:, 2] + velocity[:-1, 2])
        force = {"accel_x": accel[:, 0] * cos + lift * sin, "accel_z": lift * cos - accel[:, 0] * sin}
        streams["/imu/data"] = Stream(middle, {"rate": rate, **force})
    return OwnFlight(Flight(Path("own.mcap"), 0, streams, {}), time, pose, velocity)


def draw_commands(count: int, seed: int, quiet: int = 0) -> np.ndarray:
    """Blade pitches (count, 2) rad around hover, new every 20 ms, constant for the first `quiet` ms."""
    rng = np.random.default_rng(seed)
    hover = 0.5 * 0.5 * GRAVITY / (0.0505 * 471.239)
    drawn = hover + rng.normal(size=(count // 20 + 1, 2)) * [0.01, 0.01]
    drawn -= 0.5 * (drawn[:, :1] - drawn[:, 1:]) * [[0.7, -0.7]]  # mostly together, so that it does not tumble
    commands = np.repeat(drawn, 20, axis=0)[:count]
    commands[:quiet] = hover
    return commands
