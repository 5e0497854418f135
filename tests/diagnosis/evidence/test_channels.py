"""Bins of measurements, and the same bins of a simulated motion that is known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests import builders
from vpptwin.diagnosis.evidence.channels import (
    Channel,
    bin_channel,
    join_channels,
    observe_windows,
    predict_channel,
)
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.estimation.windows import Windows
from vpptwin.twin import load_twin
from vpptwin.twin.sensors import body_force, perfect_sensors

DT = 0.001
GRAVITY = 9.81
PERFECT = perfect_sensors(1)
START = np.zeros(2)


def lay_windows(starts: list[float], length: float) -> Windows:
    """Windows of the drone without commands."""
    return builders.lay_windows(load_twin(), starts, steps=round(length / DT))


def bin_one(
    windows: Windows, series: Series, kind: str = "position", delayed: bool = False, floor: float = 0.02
) -> Channel:
    """A channel of degree of freedom 0, poses compared from 20 ms on if delayed."""
    return bin_channel(
        windows, series, series.value, kind, 0, delayed, 0.02, series.name, floor if kind == "velocity" else 0.0
    )


def move(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """A motion known in closed form at all steps: x = sin 3t, z = t², θ = 2t; (K, steps + 1, 3) pose and velocity."""
    t = windows.start[:, None] + DT * np.arange(windows.steps + 1)
    pose = np.stack([np.sin(3.0 * t), t**2, 2.0 * t], axis=-1)
    return pose, np.stack([3.0 * np.cos(3.0 * t), 2.0 * t, np.full_like(t, 2.0)], axis=-1)


def test_bins_hold_the_mean_of_their_samples() -> None:
    """400 Hz, value = time: samples at 0, 2.5, 5, 7.5 ms average to 3.75 ms, the next four to 13.75 ms."""
    time = np.arange(400) / 400.0
    channel = bin_one(lay_windows([0.0, 0.5], 0.03), Series("x", "m", time, time, 0.002))
    np.testing.assert_allclose(channel.value, [[0.00375, 0.01375, 0.02375], [0.50375, 0.51375, 0.52375]])
    np.testing.assert_allclose(channel.std, 0.001)  # four samples: half the noise of one
    np.testing.assert_allclose(channel.weight, 0.25)
    # Samples that share their error are worth no more than one of them, and no rigid-body floor is added.
    time = np.arange(400) / 400.0
    for kind in ("position", "velocity"):
        channel = bin_one(lay_windows([0.0], 0.03), Series("x", "m", time, time, 0.002, white=False), kind)
        np.testing.assert_allclose(channel.std, 0.002)


def test_what_no_rigid_body_explains_adds_to_white_noise() -> None:
    """Variances add: that of the mean of four samples and that of the model's roughness."""
    time = np.arange(400) / 400.0
    channel = bin_one(lay_windows([0.0], 0.03), Series("q", "rad/s", time, time, 0.02), "velocity")
    np.testing.assert_allclose(channel.std**2, 0.01**2 + 0.02**2)


def test_empty_bins_count_for_nothing() -> None:
    """A tracker that pauses from 8 to 22 ms leaves the second bin empty and the others as they are."""
    time = np.array([0.002, 0.006, 0.022, 0.026])
    channel = bin_one(lay_windows([0.0], 0.03), Series("x", "m", time, np.array([1.0, 3.0, 5.0, 9.0]), 0.001))
    np.testing.assert_allclose(channel.value, [[2.0, 0.0, 7.0]])
    np.testing.assert_array_equal(channel.weight.sum(axis=2), [[1.0, 0.0, 1.0]])
    assert channel.std[0, 1] > 1e4 * channel.std[0, 0]
    pose, velocity = np.ones((1, 31, 3)), np.zeros((1, 31, 3))
    np.testing.assert_array_equal(
        predict_channel(channel, pose, velocity, DT, GRAVITY, np.zeros(1), PERFECT), [[1, 0, 1]]
    )


def test_delayed_poses_are_compared_after_the_lead() -> None:
    """The first 20 ms would reach back before the window; a pose stamped too early reaches past its last 20 ms."""
    time = np.arange(400) / 400.0
    channel = bin_one(lay_windows([0.1], 0.05), Series("x", "m", time, time, 0.002), delayed=True)
    np.testing.assert_array_equal(channel.weight.sum(axis=2), [[0, 0, 1, 0, 0]])


def test_poses_and_velocities_of_a_known_motion() -> None:
    """Measured without noise at odd instants, x = sin 3t is predicted to within the line between two milliseconds."""
    windows = lay_windows([0.2, 0.9], 0.3)
    time = 0.0004 + np.arange(300) / 241.0
    for kind, value in (("position", np.sin(3.0 * time)), ("velocity", 3.0 * np.cos(3.0 * time))):
        channel = bin_one(windows, Series("x", "m", time, value, 1e-3), kind)
        predicted = predict_channel(channel, *move(windows), DT, GRAVITY, START, PERFECT)
        # The chord misses an arc of curvature up to 27 by 27 dt²/8 = 3.4e-6.
        np.testing.assert_allclose(predicted, channel.value, atol=4e-6)


def test_a_gyro_that_is_turned_shows_other_axes() -> None:
    """Its x axis points where the body's y does, about which the body turns by 2t; its own y against the body's x."""
    windows, turned = lay_windows([0.2, 0.9], 0.3), perfect_sensors(1)
    turned["rate.turn"][:, 2] = np.pi / 2.0
    time = 0.0004 + np.arange(300) / 241.0
    channel = replace(bin_one(windows, Series("x", "rad/s", time, 2.0 * time, 1e-3), "velocity"), turn=0)
    predicted = predict_channel(channel, *move(windows), DT, GRAVITY, START, turned)
    np.testing.assert_allclose(predicted, channel.value, atol=1e-9)
    predicted = predict_channel(replace(channel, axis=1), *move(windows), DT, GRAVITY, START, turned)
    np.testing.assert_allclose(predicted, -3.0 * np.cos(1.5 * channel.value), atol=3e-4)


def test_delayed_poses_show_the_past() -> None:
    """A tracker 7 ms late in one window and 12.3 ms in the other shows sin 3(t - 7 ms) and sin 3(t - 12.3 ms)."""
    windows, delay = lay_windows([0.2, 0.9], 0.3), np.array([0.007, 0.0123])
    time = 0.0004 + np.arange(300) / 241.0
    for k in range(2):
        channel = bin_one(windows, Series("x", "m", time, np.sin(3.0 * (time - delay[k])), 1e-3), delayed=True)
        predicted = predict_channel(
            channel, *move(windows), DT, GRAVITY, START, PERFECT | {"pose.delay": delay[:, None, None, None]}
        )
        np.testing.assert_allclose(predicted[k], channel.value[k], atol=4e-6)
        assert np.abs(predicted[1 - k] - channel.value[1 - k]).max() > 1e-3


def test_accelerometer_sees_gravity_and_acceleration_in_body_axes() -> None:
    """Turn the inertial acceleration plus gravity back by θ, here as a complex number: (a_x + i (a_z + g)) e^(-iθ)."""
    windows = lay_windows([0.2, 0.9], 0.3)
    time = 0.0001 + np.arange(1200) / 1000.0
    force = (-9.0 * np.sin(3.0 * time) + 1j * (2.0 + GRAVITY)) * np.exp(-2j * time)
    for axis, value in ((0, force.real), (1, force.imag)):
        series = Series("force", "m/s²", time, value, 0.08)
        channel = bin_channel(windows, series, value, "specific force", axis, False, 0.0, "force")
        predicted = predict_channel(channel, *move(windows), DT, GRAVITY, START, PERFECT)
        # Differences of velocity over a step are exact to dt²/24 of the third derivative; the first bin reaches half a
        # step before the first difference, worth 0.5 ms of 40 m/s³ in one of ten samples.
        np.testing.assert_allclose(predicted, channel.value, atol=3e-3)
        np.testing.assert_allclose(predicted[:, 1:], channel.value[:, 1:], atol=1e-4)


@pytest.mark.parametrize(
    ("tilt", "fall", "expected"), [(0.0, 0.0, (0, 9.81)), (np.pi / 2, 0.0, (9.81, 0)), (0.3, 1.0, (0, 0))]
)
def test_specific_force_by_hand(tilt: float, fall: float, expected: tuple[float, float]) -> None:
    """At rest g upwards; on its tail, nose up, g along body x; in free fall nothing."""
    velocity = np.zeros((1, 11, 3))
    velocity[0, :, 1] = -fall * GRAVITY * DT * np.arange(11)
    pose = np.zeros((1, 11, 3))
    pose[..., 2] = tilt
    np.testing.assert_allclose(
        body_force(pose, velocity, DT, GRAVITY), np.broadcast_to(expected, (1, 10, 2)), atol=1e-9
    )


def test_windows_of_flights_with_other_rates_join() -> None:
    """Joined channels hold both flights' bins; padding samples weigh nothing."""
    windows = lay_windows([0.0], 0.03)
    slow, fast = (
        bin_one(windows, Series("x", "m", t, 7.0 * t, 1e-3)) for t in (np.arange(9) / 200, np.arange(41) / 1e3)
    )
    (joined,) = join_channels([[slow], [fast]])
    np.testing.assert_array_equal(joined.value, np.concatenate([slow.value, fast.value]))
    np.testing.assert_allclose(joined.weight.sum(axis=2), 1.0)
    pose = np.repeat(7.0 * DT * np.arange(31)[None, :, None], 2, axis=0)
    predicted = predict_channel(joined, pose, pose, DT, GRAVITY, START, PERFECT)
    np.testing.assert_allclose(predicted, joined.value, atol=1e-12)
    np.testing.assert_array_equal(joined.take(np.array([1])).value, fast.value)


def test_every_measured_quantity_becomes_a_channel() -> None:
    """Positions, rates, and both axes of the accelerometer, with names and units of their own."""
    time = np.arange(100) / 100.0
    positions = {2: Series("θ", "rad", time, time, 0.003), 0: Series("x", "m", time, time, 0.001)}
    rates = {2: Series("θ rate", "rad/s", time, time, 0.02)}
    force = Series("specific force", "m/s²", time, np.stack([time, -time], axis=1), 0.08)
    command = Series("command", "", time, np.zeros((100, 2)), 0.0)
    flight = Measurements("by hand", positions, rates, force, command, None, (0,), 0.0, 0.99)
    channels = observe_windows(lay_windows([0.2], 0.1), flight)
    assert [(c.name, c.unit, c.kind, c.axis, c.delayed) for c in channels] == [
        ("x", "m", "position", 0, True),
        ("θ", "rad", "position", 2, False),
        ("θ rate", "rad/s", "velocity", 2, False),
        ("specific force, body x", "m/s²", "specific force", 0, False),
        ("specific force, body z", "m/s²", "specific force", 1, False),
    ]
    np.testing.assert_allclose(channels[4].value, -channels[3].value)
