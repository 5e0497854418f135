"""First-order lag of a servo and transport delay of a command."""

from __future__ import annotations

import numpy as np

TINY = 1e-300
"""Stands for a time constant of zero, which would divide by zero [s]."""


def step_lag(
    output: np.ndarray, command: np.ndarray, time_constant: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """First-order lag 1/(T s + 1) over one step with the command held (paper, System Identification, item 1).

    Exact for any step; a time constant of zero passes the command through.

    Args:
        output: output at the start of the step, (N, nu).
        command: command during the step, (N, nu).
        time_constant: T, (N, nu) s.
        dt: step, s.

    Returns:
        Output at the end of the step and its mean over the step, both (N, nu).
    """
    ratio = np.maximum(time_constant, TINY) / dt
    left = np.exp(-1.0 / ratio)
    gap = command - output
    return command - left * gap, command - ratio * (1.0 - left) * gap


def push_command(history: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Shift a command (N, nu) into its history (N, depth, nu), newest first."""
    return np.concatenate([command[:, None], history[:, :-1]], axis=1)


def read_delayed(history: np.ndarray, delay: np.ndarray, dt: float) -> np.ndarray:
    """Mean over the coming step of a held command that arrives `delay` [s] late.

    The command was piecewise constant, so its mean over one step is the interpolation between two neighbours: delays
    are not rounded to whole steps.

    Args:
        history: commands, newest first, (N, depth, nu).
        delay: (N, nu) s, at most (depth - 2) dt.
        dt: step, s.
    """
    steps = delay / dt
    whole = steps.astype(np.intp)
    part = steps - whole
    newer = np.take_along_axis(history, whole[:, None, :], axis=1)[:, 0]
    older = np.take_along_axis(history, whole[:, None, :] + 1, axis=1)[:, 0]
    return newer * (1.0 - part) + older * part
