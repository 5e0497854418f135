"""Everything random about a flight, drawn ahead from its seed: sensor noise, gusts, dropouts, stamp jitter.

Readings are quantised to a power of two well under the noise, as real converters do, which also lets logs compress.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .gusts import draw_gust
from .rotor import STEP

GYRO_LSB, ACCEL_LSB = 2.0**-8, 2.0**-6  # rad/s, m/s^2: a fifth of the noise
SPEED_LSB, CURRENT_LSB = 2.0**-2, 2.0**-6  # rad/s, A
POSITION_LSB, ANGLE_LSB = 2.0**-14, 2.0**-11  # m, rad
MOCAP_PERIOD = 10  # ms
STAMP_JITTER = 0.0002  # s
DROPOUT_RATE, DROPOUT_TIME = 0.15, 0.05  # 1/s, s
RIPPLE, RIPPLE_RATE = 0.004, 2 * np.pi * 150.0  # of thrust, rad/s: two blades at 75 Hz
GYRO_WANDER, WANDER_TIME = 0.001, 20.0  # rad/s, s
OUTLIER_SHARE = 0.005  # of mocap frames
OUTLIER_REACH, OUTLIER_TURN = 0.3, 0.8  # m, rad


def quantise(value: np.ndarray, lsb: float) -> np.ndarray:
    """Round to a whole number of least significant bits."""
    return np.rint(value * (1.0 / lsb)) * lsb


@dataclass
class Chances:
    """Random series of a batch. Time runs in steps of 1 ms (mocap: 10 ms), flights are the last axis."""

    gyro: np.ndarray  # rad/s, (steps, flights)
    accel: np.ndarray  # m/s^2, (steps, 2, flights)
    speed: np.ndarray  # rad/s, (steps, 2, flights)
    current: np.ndarray  # A, (steps, 2, flights)
    gust: np.ndarray  # N, N, N m at the whole milliseconds, (steps + 1, 3, flights); of a field once it has been felt
    mocap: np.ndarray  # m, m, rad, (frames, 3, flights)
    jitter: np.ndarray  # s, error of mocap stamps, (frames, flights)
    seen: np.ndarray  # Whether a frame arrives, (frames, flights)
    phase: np.ndarray  # ms from a policy tick to the mocap frame that follows, (flights,)
    ripple: np.ndarray  # Factor on thrust, (steps, flights)
    wild: np.ndarray  # m, m, rad, by which recorded mocap frames are wrong, mostly 0, (frames, 3, flights)


def _draw_gaps(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Mocap frames that arrive: all but a few gaps of some 50 ms. (frames,)."""
    seen = np.ones(frames, dtype=bool)
    for _ in range(rng.poisson(DROPOUT_RATE * frames * MOCAP_PERIOD * STEP)):
        start = rng.integers(frames)
        seen[start : start + max(1, round(rng.normal(DROPOUT_TIME, 0.015) / (MOCAP_PERIOD * STEP)))] = False
    return seen


def _draw_distractors(rng: np.random.Generator, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """What no catalogue lists and no diagnosis should notice: thrust ripple (a factor), gyro wander rad/s; (steps,)."""
    time, phase = np.arange(steps) * STEP, rng.uniform(0, 2 * np.pi, 2)
    ripple = 1 + RIPPLE * np.sin(RIPPLE_RATE * time + phase[0])
    return ripple, GYRO_WANDER * np.sin(2 * np.pi * time / WANDER_TIME + phase[1])


def _draw_outliers(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Frames in which the tracker took something else for a marker, (frames, 3)."""
    wrong = rng.uniform(-1, 1, (frames, 3)) * np.array([OUTLIER_REACH, OUTLIER_REACH, OUTLIER_TURN])
    return wrong * (rng.random(frames) < OUTLIER_SHARE)[:, None]


def draw_chances(flights: Sequence[Mapping[str, Any]], steps: int, nominal: dict) -> Chances:
    """Draw the random series of a batch.

    Args:
        flights: Per flight `seed`, `gusts`, `wind`, `jitter`, `dropouts`, `distractors`, `outliers`.
        steps: ms.
        nominal: Content of vehicle.yaml.
    """
    sensors = nominal["sensors"]
    frames = steps // MOCAP_PERIOD + 1
    rows: dict[str, list[np.ndarray]] = {name: [] for name in Chances.__dataclass_fields__}
    for flight in flights:
        noise, gust, gaps, timing = (np.random.default_rng([flight["seed"], k]) for k in range(4))
        small, wild = (np.random.default_rng([flight["seed"], k]) for k in (6, 7))
        ripple, wander = _draw_distractors(small, steps) if flight["distractors"] else (np.ones(steps), 0.0)
        rows["ripple"].append(ripple)
        rows["wild"].append(_draw_outliers(wild, frames) if flight["outliers"] else np.zeros((frames, 3)))
        rows["gyro"].append(sensors["imu"]["gyro_std"] * noise.standard_normal(steps) + wander)
        rows["accel"].append(sensors["imu"]["accel_std"] * noise.standard_normal((steps, 2)))
        rows["speed"].append(sensors["rotor"]["speed_std"] * noise.standard_normal((steps, 2)))
        rows["current"].append(sensors["rotor"]["current_std"] * noise.standard_normal((steps, 2)))
        spread = np.array([sensors["mocap"]["position_std"]] * 2 + [sensors["mocap"]["angle_std"]])
        rows["mocap"].append(spread * noise.standard_normal((frames, 3)))
        blown = draw_gust(flight["wind"], gust, steps + 1, nominal) if flight["gusts"] else np.zeros((steps + 1, 3))
        rows["gust"].append(blown)
        rows["seen"].append(_draw_gaps(gaps, frames) if flight["dropouts"] else np.ones(frames, dtype=bool))
        jitter = STAMP_JITTER * timing.standard_normal(frames)
        rows["jitter"].append(jitter if flight["jitter"] else np.zeros(frames))
        rows["phase"].append(np.asarray(timing.integers(MOCAP_PERIOD) if flight["jitter"] else 0))
    return Chances(**{name: np.ascontiguousarray(np.stack(series, axis=-1)) for name, series in rows.items()})


def look_back(
    position: np.ndarray, velocity: np.ndarray, step: np.ndarray, delay: np.ndarray, flights: np.ndarray
) -> np.ndarray:
    """True pose `delay` s before step `step`, by cubic Hermite interpolation between the milliseconds.

    Args:
        position: (steps, 3, flights), filled up to the millisecond that follows `step`.
        velocity: Likewise.
        step: ms since the arrays' start. (len(flights),).
        delay: s, (len(flights),).
        flights: Indices of the flights looked at.

    Returns:
        (3, len(flights)).
    """
    when = np.maximum(step - delay / STEP, 0.0)
    left = np.minimum(np.floor(when + 1e-9), np.maximum(np.ceil(step) - 1, 0)).astype(int)
    u = when - left
    p0, p1 = position[left, :, flights].T, position[left + 1, :, flights].T
    v0, v1 = velocity[left, :, flights].T * STEP, velocity[left + 1, :, flights].T * STEP
    return (1 + 2 * u) * (1 - u) ** 2 * p0 + u * (1 - u) ** 2 * v0 + u * u * (3 - 2 * u) * p1 + u * u * (u - 1) * v1
