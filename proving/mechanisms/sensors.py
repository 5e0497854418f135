"""What is logged of a rig, and what disturbs it: encoders, velocities, torques; forces that nobody modelled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .families import spread

MARGIN = 20.0
"""Memories of a disturbance before the log starts."""


@dataclass(frozen=True)
class Sensors:
    """How a rig is measured, in shares of what moves there."""

    noise: float  # of positions, share of their standard deviation
    quantum: float  # of an encoder, likewise; 0 for none
    velocity: str  # `none`, `noisy`, or `filtered`: differences of what the encoder says, low-passed
    velocity_noise: float  # share of the rms velocity
    cut: float  # of that filter [Hz]
    torque: float  # noise of logged inputs, share of their rms


def draw_sensors(rng: np.random.Generator) -> Sensors:
    """Sensors of a rig."""
    velocity = str(rng.choice(["none", "noisy", "filtered"]))
    quantum = spread(rng, 1e-4, 3e-3) if rng.random() < 0.7 else 0.0
    return Sensors(
        spread(rng, 2e-4, 4e-3), quantum, velocity, spread(rng, 3e-3, 5e-2), spread(rng, 15.0, 50.0),
        spread(rng, 5e-4, 1e-2),
    )  # fmt: skip


@dataclass(frozen=True)
class Disturbance:
    """Random force on every joint: its spectrum, its rms as a share of the joint's own typical force, its time [s]."""

    kind: str
    strength: float
    time: float


def draw_disturbance(rng: np.random.Generator) -> Disturbance:
    """Slow or fast, smooth or not, or swinging."""
    return Disturbance(str(rng.choice(["ou", "smooth", "swinging"])), spread(rng, 1e-3, 1e-2), spread(rng, 0.05, 1.0))


def push(
    rng: np.random.Generator, disturbance: Disturbance, scale: np.ndarray, samples: int, period: float
) -> np.ndarray:
    """Disturbing force at every sample, (T, n) [N, N m]."""
    before = min(round(MARGIN * disturbance.time / period), 20000)
    shaken = rng.standard_normal((before + samples, len(scale)))
    keep = np.exp(-period / disturbance.time)
    if disturbance.kind == "swinging":
        rate = 2.0 / disturbance.time
        pole = np.exp((-0.15 + 1j) * rate * period)
        out = chase(shaken, pole).imag
    else:
        out = chase(shaken, keep).real
        out = chase(out, keep).real if disturbance.kind == "smooth" else out
    settled = out[before:]
    return disturbance.strength * scale * settled / np.sqrt(np.mean(out**2, axis=0))


def chase(driving: np.ndarray, keep: complex) -> np.ndarray:
    """y(k) = keep y(k-1) + x(k), row by row."""
    out, held = np.empty(driving.shape, complex), np.zeros(driving.shape[1], complex)
    for k, x in enumerate(driving):
        held = keep * held + x
        out[k] = held
    return out


def measure_motion(
    rng: np.random.Generator, sensors: Sensors, moved: np.ndarray, noise: np.ndarray, spread: np.ndarray,
    speed: np.ndarray, period: float,
) -> tuple[np.ndarray, np.ndarray | None]:  # fmt: skip
    """Logged positions (T, n) and velocities, if any.

    Args:
        rng: of the velocities' noise.
        sensors: of the rig.
        moved: what happened, (T, 3, n).
        noise: of positions, (T, n) [m, rad]: what the feedback saw too.
        spread: standard deviation of positions, (n,).
        speed: rms velocity, (n,).
        period: s.
    """
    position = moved[:, 0] + noise
    if sensors.quantum:
        position = np.round(position / (sensors.quantum * spread)) * sensors.quantum * spread
    if sensors.velocity == "none":
        return position, None
    if sensors.velocity == "noisy":
        return position, moved[:, 1] + sensors.velocity_noise * speed * rng.standard_normal(position.shape)
    keep = np.exp(-2.0 * np.pi * sensors.cut * period)
    raw = np.diff(position, axis=0, prepend=position[:1]) / period
    return position, chase((1.0 - keep) * raw, keep).real


def measure_inputs(given: np.ndarray, faults: Mapping[int, Mapping[str, float]]) -> np.ndarray:
    """Inputs (T, m) as logged, but for noise: drive → gain, offset, dead band, quantum of its sensor."""
    logged = given.copy()
    for i, fault in faults.items():
        u = logged[:, i] * fault.get("gain", 1.0) + fault.get("offset", 0.0)
        dead, quantum = fault.get("sensor_dead", 0.0), fault.get("quantum", 0.0)
        u = u - np.clip(u, -dead, dead)
        logged[:, i] = np.round(u / quantum) * quantum if quantum else u
    return logged
