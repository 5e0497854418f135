"""A servo: transport delay of its command, first-order lag limited in rate, play in its linkage."""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.numbers import Number, choose
from vpptwin.engine.compile import compilable

TINY = 1e-300
"""Stands for a time constant of zero, which would divide by zero [s]."""


@compilable()
def step_lag(output: Number, command: Number, time_constant: Number, dt: float) -> tuple[Number, Number]:
    """First-order lag 1/(T s + 1) over one step with the command held (paper, System Identification, item 1).

    Exact for any step; a time constant of zero passes the command through.

    Args:
        output: output at the start of the step.
        command: command during the step.
        time_constant: T [s].
        dt: step [s].

    Returns:
        Output at the end of the step and its mean over the step.
    """
    ratio = np.maximum(time_constant, TINY) / dt
    # y(dt) = u - e^(-dt/T) (u - y), mean u - T/dt (1 - e^(-dt/T)) (u - y): zero-order hold of 1/(T s + 1).
    remaining = np.exp(-1.0 / ratio)
    gap = command - output
    return command - remaining * gap, command - ratio * (1.0 - remaining) * gap


@compilable()
def limit_rate(start: Number, end: Number, mean: Number, rate: Number, dt: float) -> tuple[Number, Number]:
    """Keep a move from `start` to `end` within `rate` [1/s]: its end and its mean over the step."""
    reach = rate * dt
    limited = np.minimum(np.maximum(end, start - reach), start + reach)
    return limited, choose(limited == end, mean, 0.5 * (start + limited))


@compilable()
def take_up_play(blade: Number, horn: Number, gap: Number) -> Number:
    """Where a blade rests that a horn drags along through play of width `gap`."""
    return np.minimum(np.maximum(blade, horn - 0.5 * gap), horn + 0.5 * gap)


@compilable()
def read_delayed(history: np.ndarray, newest: int, delay: float, dt: float) -> tuple[float, float, float]:
    """What a command that arrives `delay` [s] late is in the coming step: first the older one, then the newer one.

    Delays are not rounded to whole steps: the newer one arrives within the step.

    Args:
        history: ring of commands, (depth,).
        newest: index of the one issued now.
        delay: s, at most (depth - 2) dt.
        dt: step [s].

    Returns:
        The older command, the newer one, and the share of the step until it arrives, 0 to 1.
    """
    depth = len(history)
    steps = delay / dt
    whole = int(steps)
    part = steps - whole
    newer = history[(newest - whole) % depth]
    older = history[(newest - whole - 1) % depth]
    return older, newer, part
