"""Lag, rate limit, play and delay: exact for any step, fractions of a step included."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vpptwin.actuators.servo import limit_rate, read_delayed, step_lag, take_up_play

DT = 0.001


def mean_arriving(history: np.ndarray, newest: int, delay: float) -> float:
    """Mean over the coming step of a command that arrives `delay` [s] late."""
    older, newer, late = read_delayed(history, newest, delay, DT)
    return late * older + (1.0 - late) * newer


def delay_series(commands: np.ndarray, delay: float, depth: int = 8) -> np.ndarray:
    """Send commands (n,), one a step, through a delay line that rested at zero: what arrives, (n,)."""
    history, arrived = np.zeros(depth), []
    for k, command in enumerate(commands):
        history[k % depth] = command
        arrived.append(mean_arriving(history, k % depth, delay))
    return np.array(arrived)


def test_lag_by_hand() -> None:
    """Half a time constant after a step: 1 - e^-0.5 = 0.393469; mean 1 - 2 (1 - e^-0.5) = 0.213061."""
    end, mean = step_lag(0.0, 1.0, 0.02, dt=0.01)
    assert end == pytest.approx(0.3934693402873666, rel=1e-14)
    assert mean == pytest.approx(0.21306131942526685, rel=1e-14)


@given(st.floats(0.001, 0.2), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.integers(1, 40))
def test_lag_follows_the_exponential(time_constant: float, start: float, command: float, steps: int) -> None:
    """After any number of steps the output lies on the analytic exponential, and the means add up to its integral."""
    output, area = start, 0.0
    for _ in range(steps):
        output, mean = step_lag(output, command, time_constant, DT)
        area += DT * mean
    elapsed = steps * DT
    decay = np.exp(-elapsed / time_constant)
    np.testing.assert_allclose(output, command + (start - command) * decay, rtol=0, atol=1e-15)
    np.testing.assert_allclose(area, command * elapsed + (start - command) * time_constant * (1 - decay), atol=1e-15)


@given(st.floats(0.001, 0.1), st.integers(2, 10))
def test_lag_does_not_depend_on_the_step(time_constant: float, parts: int) -> None:
    """One long step ends where several short ones do, with the same mean."""
    end, mean = step_lag(-0.1, 0.3, time_constant, 0.01)
    output, means = -0.1, []
    for _ in range(parts):
        output, part = step_lag(output, 0.3, time_constant, 0.01 / parts)
        means.append(part)
    np.testing.assert_allclose(output, end, atol=1e-15)
    np.testing.assert_allclose(np.mean(means), mean, atol=1e-15)


def test_no_lag_passes_the_command() -> None:
    """With a time constant of zero the output and its mean are the command, to the last bit."""
    command = np.array([[0.1, -0.3]])
    end, mean = step_lag(np.array([[0.7, 0.2]]), command, np.zeros((1, 2)), DT)
    np.testing.assert_array_equal(end, command)
    np.testing.assert_array_equal(mean, command)


def test_lag_takes_arrays() -> None:
    """Given arrays, every element has its own time constant."""
    constants = np.array([[0.01, 0.02], [0.04, 0.0]])
    end, _ = step_lag(np.zeros((2, 2)), np.ones((2, 2)), constants, dt=0.01)
    np.testing.assert_allclose(end, 1 - np.exp([[-1.0, -0.5], [-0.25, -np.inf]]), rtol=1e-14)


@pytest.mark.parametrize(
    ("move", "expected"),
    [
        pytest.param((0.1, 0.5, 0.4), (0.3, 0.2), id="too fast up"),  # 0.1 + 200 * 0.001; the mean of 0.1 and 0.3
        pytest.param((0.1, -0.5, -0.4), (-0.1, 0.0), id="too fast down"),
        pytest.param((0.1, 0.25, 0.2), (0.25, 0.2), id="slow enough"),
        pytest.param((0.1, 0.1, 0.1), (0.1, 0.1), id="at rest"),
    ],
)
def test_rate_limit_by_hand(move: tuple[float, float, float], expected: tuple[float, float]) -> None:
    """At 200 rad/s a move reaches 0.2 rad in 1 ms; one that stays within that keeps its end and its mean."""
    assert limit_rate(*move, 200.0, DT) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize(
    ("blade", "horn", "expected"),
    [(0.10, 0.10, 0.10), (0.10, 0.12, 0.10), (0.10, 0.13, 0.11), (0.10, 0.07, 0.09), (0.10, -0.5, -0.48)],
)
def test_play_by_hand(blade: float, horn: float, expected: float) -> None:
    """In play of 0.04 rad the blade rests while the horn moves by less than 0.02 rad, and is dragged along beyond."""
    assert take_up_play(blade, horn, 0.04) == pytest.approx(expected, abs=1e-15)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_without_play_the_blade_is_at_the_horn(blade: float, horn: float) -> None:
    """A gap of zero leaves the horn's position, to the last bit."""
    assert take_up_play(blade, horn, 0.0) == horn


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=30), st.floats(0.0, 0.5))
def test_blade_stays_within_the_play(horns: list[float], gap: float) -> None:
    """Whatever the horn does, the blade is never farther from it than half the gap, and only moves if it must."""
    blade = 0.0
    for horn in horns:
        before, blade = blade, take_up_play(blade, horn, gap)
        assert abs(blade - horn) <= 0.5 * gap + 1e-15
        assert blade == before or abs(before - horn) > 0.5 * gap


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


def test_ring_starts_anywhere() -> None:
    """Where in the ring the newest command lies makes no difference, to the last bit."""
    commands = np.random.default_rng(0).normal(size=7)  # newest first
    arrived = set()
    for newest in range(7):
        history = np.empty(7)
        history[(newest - np.arange(7)) % 7] = commands
        arrived.add(mean_arriving(history, newest, 0.0034))
    assert arrived == {commands[3] * (1.0 - (3.4 - 3)) + commands[4] * (3.4 - 3)}
