"""How a rig is moved about: moves with holds, chirps, steps, dithers, sums of sines. Positions over time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Reference = np.ndarray
"""Position of a joint at every sample, for a travel of about one, (T,)."""


def smooth(position: np.ndarray, period: float, time: float) -> np.ndarray:
    """Two first-order lags in a row, which leave velocity continuous."""
    keep = np.exp(-period / time)
    for _ in range(2):
        held = position[0]
        out = np.empty_like(position)
        for i, value in enumerate(position):
            held = value + keep * (held - value)
            out[i] = held
        position = out
    return position


def move(rng: np.random.Generator, time: np.ndarray, pace: float) -> Reference:
    """From goal to goal without a jerk, with holds between, some long."""
    position, now, at = np.zeros(len(time)), 0.3, 0.0
    while now < time[-1]:
        goal = rng.uniform(-1.4, 1.4)
        span = max(abs(goal - at), 0.3) * 4.0 / pace
        s = np.clip((time - now) / span, 0.0, 1.0)
        position += (goal - at) * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        now, at = now + span + (rng.uniform(0.1, 0.6) if rng.random() < 0.7 else rng.uniform(1.0, 3.0)), goal
    return position


def sweep(rng: np.random.Generator, time: np.ndarray, pace: float) -> Reference:
    """A chirp from a quarter of the pace to twice it; faster means less far."""
    low, high = 0.25 * pace, 2.0 * pace
    ratio = np.log(high / low) / time[-1]
    rate = low * np.exp(ratio * time)
    return np.sin((rate - low) / ratio + rng.uniform(0.0, 1.0)) * np.minimum(1.4, 1.4 * pace / rate)


def step(rng: np.random.Generator, time: np.ndarray, pace: float) -> Reference:
    """Steps, rounded off."""
    each = max(int(rng.uniform(2.5, 5.0) / pace / (time[1] - time[0])), 1)
    goals = rng.uniform(0.2, 1.4, len(time) // each + 1) * rng.choice([-1.0, 1.0], len(time) // each + 1)
    return smooth(np.repeat(goals, each)[: len(time)], time[1] - time[0], 0.5 / pace)


def dither(rng: np.random.Generator, time: np.ndarray, pace: float) -> Reference:
    """Slow steps with a small fast triangle on them."""
    fast = pace * rng.uniform(1.5, 3.0)
    triangle = 2.0 / np.pi * np.arcsin(np.sin(fast * time))
    return 0.7 * step(rng, time, 0.5 * pace) + 0.3 * smooth(triangle, time[1] - time[0], 0.1 / fast)


def sines(rng: np.random.Generator, time: np.ndarray, pace: float) -> Reference:
    """A sum of five sines."""
    rates, phases = pace * np.array([0.23, 0.41, 0.74, 1.13, 1.71]) * rng.uniform(0.9, 1.1, 5), rng.uniform(0, 6.28, 5)
    sizes = rng.uniform(0.3, 1.0, 5) / np.array([0.6, 0.6, 0.8, 1.2, 2.0])
    wave = np.sin(np.outer(time, rates) + phases) @ sizes
    return wave / np.sqrt(np.mean(wave**2))


KINDS: dict[str, Callable[[np.random.Generator, np.ndarray, float], Reference]] = {
    "moves": move, "chirp": sweep, "steps": step, "dither": dither, "sines": sines,
}  # fmt: skip


def differentiate(position: np.ndarray, period: float) -> np.ndarray:
    """Positions (T, n) with their first and second derivatives, (T, 3, n), after a gentle start from rest at zero."""
    ramp = np.clip(np.arange(len(position)) * period / 0.5, 0.0, 1.0)[:, None]
    eased = position * ramp**2 * (3.0 - 2.0 * ramp)
    speed = np.gradient(eased, period, axis=0)
    return np.stack([eased, speed, np.gradient(speed, period, axis=0)], axis=1)
