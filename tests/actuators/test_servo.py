"""Lag and delay: exact for any step, fractions of a step included."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vpptwin.actuators.servo import push_command, read_delayed, step_lag

DT = 0.001


def delay_series(commands: np.ndarray, delay: float, depth: int = 8) -> np.ndarray:
    """Send commands (n,), one a step, through a delay line that rested at zero: what arrives, (n,)."""
    history, arrived = np.zeros((1, depth, 1)), []
    for command in commands:
        history = push_command(history, np.full((1, 1), command))
        arrived.append(read_delayed(history, np.full((1, 1), delay), DT)[0, 0])
    return np.array(arrived)


def test_lag_by_hand() -> None:
    """Half a time constant after a step: 1 - e^-0.5 = 0.393469; mean 1 - 2 (1 - e^-0.5) = 0.213061."""
    end, mean = step_lag(np.zeros((1, 1)), np.ones((1, 1)), np.full((1, 1), 0.02), dt=0.01)
    assert end[0, 0] == pytest.approx(0.3934693402873666, rel=1e-14)
    assert mean[0, 0] == pytest.approx(0.21306131942526685, rel=1e-14)


@given(st.floats(0.001, 0.2), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.integers(1, 40))
def test_lag_follows_the_exponential(time_constant: float, start: float, command: float, steps: int) -> None:
    """After any number of steps the output lies on the analytic exponential, and the means add up to its integral."""
    output, constant = np.full((1, 1), start), np.full((1, 1), time_constant)
    area = 0.0
    for _ in range(steps):
        output, mean = step_lag(output, np.full((1, 1), command), constant, DT)
        area += DT * mean[0, 0]
    elapsed = steps * DT
    decay = np.exp(-elapsed / time_constant)
    np.testing.assert_allclose(output, command + (start - command) * decay, rtol=0, atol=1e-15)
    np.testing.assert_allclose(area, command * elapsed + (start - command) * time_constant * (1 - decay), atol=1e-15)


@given(st.floats(0.001, 0.1), st.integers(2, 10))
def test_lag_does_not_depend_on_the_step(time_constant: float, parts: int) -> None:
    """One long step ends where several short ones do, with the same mean."""
    constant, command = np.full((1, 1), time_constant), np.full((1, 1), 0.3)
    end, mean = step_lag(np.full((1, 1), -0.1), command, constant, 0.01)
    output, means = np.full((1, 1), -0.1), []
    for _ in range(parts):
        output, part = step_lag(output, command, constant, 0.01 / parts)
        means.append(part)
    np.testing.assert_allclose(output, end, atol=1e-15)
    np.testing.assert_allclose(np.mean(means), mean[0, 0], atol=1e-15)


def test_no_lag_passes_the_command() -> None:
    """With a time constant of zero the output and its mean are the command, to the last bit."""
    command = np.array([[0.1, -0.3]])
    end, mean = step_lag(np.array([[0.7, 0.2]]), command, np.zeros((1, 2)), DT)
    np.testing.assert_array_equal(end, command)
    np.testing.assert_array_equal(mean, command)


def test_rotors_lag_on_their_own() -> None:
    """Every actuator of every simulation has its own time constant."""
    constants = np.array([[0.01, 0.02], [0.04, 0.0]])
    end, _ = step_lag(np.zeros((2, 2)), np.ones((2, 2)), constants, dt=0.01)
    np.testing.assert_allclose(end, 1 - np.exp([[-1.0, -0.5], [-0.25, -np.inf]]), rtol=1e-14)


@pytest.mark.parametrize(
    ("delay", "expected"),
    [
        (0.0, [1, 1, 1, 1, 1]),
        (0.001, [0, 1, 1, 1, 1]),
        (0.0005, [0.5, 1, 1, 1, 1]),  # arrives in the middle of the first step: half of it is still the old command
        (0.00225, [0, 0, 0.75, 1, 1]),
    ],
)
def test_step_command_arrives_late(delay: float, expected: list[float]) -> None:
    """A step command is seen `delay` later, as its mean over the step in which it arrives."""
    np.testing.assert_allclose(delay_series(np.ones(5), delay), expected, atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.0004, 0.002, 0.0035, 0.006])
def test_ramp_command_arrives_late(delay: float) -> None:
    """A ramp of 1 per step arrives lowered by the delay in steps, fractions included."""
    arrived = delay_series(np.arange(20.0), delay)
    settled = slice(7, None)  # the line started at rest
    np.testing.assert_allclose(arrived[settled], (np.arange(20.0) - delay / DT)[settled], atol=1e-9)


@given(st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=20), st.floats(0.0, 0.006))
def test_delay_neither_loses_nor_adds(commands: list[float], delay: float) -> None:
    """Once it has run out, the line has passed on exactly what went in, for any commands and delay."""
    padded = np.array([*commands, *[0.0] * 8])
    np.testing.assert_allclose(delay_series(padded, delay).sum(), padded.sum(), atol=1e-12)


@given(st.lists(st.floats(-1.0, 1.0), min_size=12, max_size=12), st.floats(0.0, 0.006))
def test_delay_is_the_mean_of_the_late_command(commands: list[float], delay: float) -> None:
    """What arrives is the integral of the held command, shifted by the delay, over the step."""
    edges = np.arange(13) * DT
    total = np.concatenate([[0.0], np.cumsum(commands)]) * DT  # integral of the held command up to each edge
    shifted = np.interp(edges - delay, edges, total)
    np.testing.assert_allclose(delay_series(np.array(commands), delay), np.diff(shifted) / DT, atol=1e-10)


def test_history_is_not_modified() -> None:
    """Pushing a command leaves the old history as it was and forgets the oldest command."""
    history = np.arange(6.0).reshape(1, 3, 2)
    before = history.copy()
    pushed = push_command(history, np.array([[9.0, 8.0]]))
    np.testing.assert_array_equal(history, before)
    np.testing.assert_array_equal(pushed, [[[9, 8], [0, 1], [2, 3]]])
