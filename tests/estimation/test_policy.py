"""Blade pitch reconstructed from the policy's commands and the gyro."""

from __future__ import annotations

import numpy as np
import pytest

from vpptwin.actuators.layer import command_from_policy, constants_dtype, layer_dtype
from vpptwin.actuators.numbers import record_vehicle
from vpptwin.robots.planar_drone.topics import lay_grid, reconstruct_commands
from vpptwin.robots.planar_drone.vehicle import load_vehicle

VEHICLE = load_vehicle()
DT = 1.0 / VEHICLE.control.inner_rate


def draw_inputs(seconds: float, seed: int = 0) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, np.ndarray]]:
    """Policy commands at 100 Hz and gyro samples at 1 kHz, as wild as a flip."""
    rng = np.random.default_rng(seed)
    slow, fast = np.arange(0.0, seconds, 0.01), np.arange(0.0, seconds, DT)
    policy = slow, rng.uniform(-10.0, 10.0, len(slow)), rng.uniform(-12.0, 12.0, len(slow))
    return policy, (fast, np.cumsum(rng.normal(0.0, 0.3, len(fast))) * np.exp(-fast))


def test_it_is_the_inner_loop_itself() -> None:
    """Step by step the actuator layer issues the same pitches, to rounding."""
    policy, gyro = draw_inputs(1.0)
    time, pitch = reconstruct_commands(VEHICLE, policy, gyro)
    vehicle = record_vehicle(VEHICLE)[0]
    state = np.zeros(1, layer_dtype(2, 0)).view(np.recarray)[0]
    constants = np.zeros(1, constants_dtype(2, 3))[0]
    constants["rate.scale"] = 1.0
    state.gyro = gyro[1][0]
    expected = [
        command_from_policy(vehicle, state, constants, policy[1][k // 10], policy[2][k // 10], rate, 0.0, DT)
        for k, rate in enumerate(gyro[1])
    ]
    np.testing.assert_allclose(pitch, expected, atol=1e-15)
    np.testing.assert_array_equal(time, gyro[0])


def test_slow_gyros_are_read_between_samples() -> None:
    """A 200 Hz gyro gives commands at every inner step; a smooth turn comes out as with the fast one."""
    time = np.arange(0.0, 2.0, DT)
    rate = 3.0 * np.sin(4.0 * time)
    policy = np.array([0.0, 1.0, 2.0]), np.full(3, 5.0), np.zeros(3)
    _, fine = reconstruct_commands(VEHICLE, policy, (time, rate))
    grid, coarse = reconstruct_commands(VEHICLE, policy, (time[::5], rate[::5]))
    np.testing.assert_allclose(np.diff(grid), DT, rtol=1e-9)
    # Lines through 5 ms of the sine miss by 3 * 16 * 0.005^2 / 8 = 1.5e-4 rad/s; slope errors of 0.12 rad/s^2 through
    # rate_kd make 1e-4 N, over k_t * speed and half the arm 1e-5 rad.
    np.testing.assert_allclose(coarse[10:], fine[10 : len(coarse)], atol=3e-5)


def test_unknown_steps_are_left_out() -> None:
    """Where the policy falls silent for longer than 50 ms, or the gyro for 20 ms, nothing is made up."""
    policy, gyro = draw_inputs(2.0)
    silent = (policy[0] > 0.5) & (policy[0] < 0.8)
    blind = (gyro[0] > 1.2) & (gyro[0] < 1.3)
    time, _ = reconstruct_commands(VEHICLE, tuple(c[~silent] for c in policy), (gyro[0][~blind], gyro[1][~blind]))
    known = np.diff(time) < 1.5 * DT
    np.testing.assert_allclose(time[:-1][~known], [0.55, 1.2], atol=2e-3)
    np.testing.assert_allclose(time[1:][~known], [0.8, 1.3], atol=2e-3)


@pytest.mark.parametrize(("period", "count"), [(0.001, 101), (0.005, 101), (0.00025, 100)])
def test_grids_hold_the_samples(period: float, count: int) -> None:
    """0.1 s in steps of 1 ms, at the samples' own stamps unless those come faster."""
    samples = np.arange(0.0, 0.1 + 1e-9, period)
    grid = lay_grid(samples, DT)
    np.testing.assert_allclose(grid, DT * np.arange(len(grid)), atol=1e-12)
    assert abs(len(grid) - count) <= 1
