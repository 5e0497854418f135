"""Windows: means of held commands to the last bit, and simulations that start where the flight was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.estimation.synthetic import OwnFlight, Sensors, draw_commands, fly_own
from vpptwin.estimation.initial import SMOOTH, estimate_states
from vpptwin.estimation.measurements import Series, read_measurements
from vpptwin.estimation.windows import (
    Windows,
    average_held,
    average_sampled,
    cut_windows,
    estimate_spin,
    fly_windows,
    join_windows,
    trace_past,
)
from vpptwin.twin import Twin, load_twin

SPEC = load_twin()
QUIET = 500
"""Milliseconds of constant command at the start of the flight."""


def hold(time: list[float], value: list[float]) -> Series:
    """A command, held from sample to sample."""
    return Series("command", "", np.array(time), np.array(value), 0.0)


@pytest.fixture(scope="module")
def own() -> OwnFlight:
    """Two seconds of the twin's own flight, quiet at first."""
    return fly_own(SPEC, draw_commands(2000, seed=1, quiet=QUIET))


@pytest.fixture(scope="module")
def windows(own: OwnFlight) -> Windows:
    """Eight windows of 0.15 s, from before the first change of the commands to the end."""
    starts = 0.45 + 0.2 * np.arange(8)
    return cut_windows(SPEC, read_measurements(SPEC, own.flight), starts, 0.15, causal=True)


def test_mean_of_a_held_command_by_hand() -> None:
    """1 until 1.5 ms, 2 until 4.2 ms, then 5: means over the milliseconds 1, (1+2)/2, 2, 2, 0.2*2 + 0.8*5 = 4.4."""
    mean = average_held(hold([0.0, 0.0015, 0.0042], [1.0, 2.0, 5.0]), np.arange(6)[None] * 0.001)
    np.testing.assert_allclose(mean[0, :, 0], [1.0, 1.5, 2.0, 2.0, 4.4], rtol=1e-12)


def test_command_is_held_beyond_its_samples() -> None:
    """Before the first sample the first value counts, after the last one the last."""
    mean = average_held(hold([0.01, 0.02], [3.0, 7.0]), np.array([[0.0, 0.005, 0.015, 0.025, 0.5]]))
    np.testing.assert_allclose(mean[0, :, 0], [3.0, 3.0, 5.0, 7.0], rtol=1e-12)


@given(
    st.lists(st.floats(1e-4, 0.01), min_size=1, max_size=12),
    st.lists(st.floats(1e-4, 0.004), min_size=1, max_size=12),
    st.floats(-0.005, 0.02),
    st.integers(0, 1000),
)
def test_mean_of_a_held_command(gaps: list[float], cells: list[float], first: float, seed: int) -> None:
    """However stamps and steps lie, a mean is the sum of values times the share of the cell they were held for."""
    time = np.concatenate([[0.0], np.cumsum(gaps)])
    value = np.random.default_rng(seed).normal(size=len(time))
    edges = first + np.concatenate([[0.0], np.cumsum(cells)])
    begin, end = time.copy(), np.append(time[1:], np.inf)
    begin[0] = -np.inf
    overlap = np.minimum(edges[1:, None], end) - np.maximum(edges[:-1, None], begin)
    expected = (np.maximum(overlap, 0.0) * value).sum(axis=1) / np.diff(edges)
    mean = average_held(hold(list(time), list(value)), edges[None])
    np.testing.assert_allclose(mean[0, :, 0], expected, rtol=0, atol=1e-9)


def test_mean_of_a_sampled_speed() -> None:
    """A quantity sampled at instants is averaged along the line between them: a ramp gives its midpoints."""
    ramp = Series("speed", "rad/s", np.array([0.0, 0.01]), np.array([[0.0, 10.0], [1.0, 20.0]]), 1.0)
    mean = average_sampled(ramp, np.array([[0.0, 0.002, 0.006]]))
    np.testing.assert_allclose(mean[0], [[0.1, 11.0], [0.4, 14.0]], rtol=1e-12)


def test_windows_hold_the_log(own: OwnFlight, windows: Windows) -> None:
    """A window has the log's commands, those of the 0.15 s before it to warm up on, and the measured speeds."""
    assert len(windows) == 8
    assert (windows.steps, windows.dt) == (150, 0.001)
    blades = own.flight.streams["/rotor/command"]["blade_pitch"]
    for i, start in enumerate(np.round(windows.start * 1000).astype(int)):
        np.testing.assert_allclose(windows.command[i], blades[start : start + 150], rtol=0, atol=1e-12)
        np.testing.assert_allclose(windows.warm[i], blades[start - 150 : start], rtol=0, atol=1e-12)
    assert windows.warm.shape[1] * windows.dt == pytest.approx(SPEC.robot.warm_up)
    assert windows.rotor_speed is not None
    np.testing.assert_allclose(windows.rotor_speed, 471.239, rtol=1e-12)


def test_replay_of_its_own_flight_is_exact(own: OwnFlight, windows: Windows) -> None:
    """Started from the true state on blades that were at rest, the twin flies its own flight again, to rounding."""
    first = windows.take(np.array([0]))  # from 0.45 s; the first new command comes at 0.5 s
    first = replace(first, pose=own.state_at(first.start)[0], velocity=own.state_at(first.start)[1])
    pose, velocity, _ = fly_windows(Twin(SPEC, 1), first)
    for k in range(0, 151, 10):
        expected = own.state_at(first.start + k * 0.001)
        np.testing.assert_allclose(pose[:, k], expected[0], rtol=0, atol=1e-11)
        np.testing.assert_allclose(velocity[:, k], expected[1], rtol=0, atol=1e-10)
    assert np.abs(velocity[0, -1] - velocity[0, 0]).max() > 0.01


def test_warm_up_forgets_the_past(own: OwnFlight, windows: Windows) -> None:
    """In the midst of a flight only what blades remember from before the warm-up is missing, e^(-0.15/0.02)."""
    truth = replace(windows, pose=own.state_at(windows.start)[0], velocity=own.state_at(windows.start)[1])
    pose, velocity, _ = fly_windows(Twin(SPEC, len(windows)), truth)
    blades = own.flight.streams["/rotor/command"]["blade_pitch"]
    forgotten = np.ptp(blades, axis=0).max() * np.exp(-SPEC.robot.warm_up / 0.02)  # rad, at most, decaying with 20 ms
    impulse = 2 * 23.8 * forgotten * 0.02  # N s: 23.8 N/rad and rotor
    bound = impulse / np.array([0.58, 0.50, 0.006 / 0.2])
    for k in (50, 100, 150):
        expected = own.state_at(windows.start + k * 0.001)
        moved = np.abs(velocity[:, k] - expected[1])
        tilted = 10.0 * bound[2] * 0.15**2 / 2  # m/s in x and z, by the angle that the lost torque makes
        assert (moved <= bound + tilted).all()
        assert (np.abs(pose[:, k] - expected[0]) <= (bound + tilted) * 0.15).all()
    assert bound.max() < 0.003  # m/s, rad/s


def test_estimated_starts_are_close(own: OwnFlight, windows: Windows) -> None:
    """From the noise-free log itself, without looking ahead, starts are found far better than sensors' noise."""
    pose, velocity = own.state_at(windows.start)
    np.testing.assert_allclose(windows.pose, pose, rtol=0, atol=1e-5)
    np.testing.assert_allclose(windows.velocity[:, :2], velocity[:, :2], rtol=0, atol=1e-4)
    # A command changes torque by up to 0.06 N m, 10 rad/s², in 20 ms: a line misses that by 500 rad/s³ (10 ms)²/12.
    np.testing.assert_allclose(windows.velocity[:, 2], velocity[:, 2], rtol=0, atol=0.0042)


def test_simulations_of_windows_are_independent(windows: Windows) -> None:
    """A window is simulated alike alone, among others, and twice."""
    together = fly_windows(Twin(SPEC, 8), windows)
    alone = fly_windows(Twin(SPEC, 1), windows.take(np.array([3])))
    twice = fly_windows(Twin(SPEC, 2), windows.take(np.array([3, 3])))
    for all_of_them, one, two in zip(together[:2], alone[:2], twice[:2]):
        np.testing.assert_array_equal(one[0], all_of_them[3])
        np.testing.assert_array_equal(two[0], two[1])
        np.testing.assert_array_equal(two[0], all_of_them[3])


def test_shifted_starts(windows: Windows) -> None:
    """A shift is added to the starting states of a copy, and nothing else changes."""
    pose, velocity = np.full((8, 3), 0.01), np.full((8, 3), -0.02)
    before = windows.pose.copy()
    shifted = windows.shift(SPEC.model, pose, velocity)
    np.testing.assert_array_equal(windows.pose, before)
    np.testing.assert_array_equal(shifted.pose, before + 0.01)
    np.testing.assert_array_equal(shifted.velocity, windows.velocity - 0.02)
    track = fly_windows(Twin(SPEC, 8), shifted)
    np.testing.assert_array_equal(track.pose[:, 0], shifted.pose)


def test_joined_windows_remember_their_flights(own: OwnFlight, windows: Windows) -> None:
    """Windows of two flights are joined in order; measured speeds are dropped unless both flights have them."""
    measured = read_measurements(SPEC, own.flight)
    second = cut_windows(SPEC, measured, np.array([0.7, 1.1]), 0.15, causal=False, flight=1)
    joined = join_windows([windows, second])
    np.testing.assert_array_equal(joined.flight, [0] * 8 + [1] * 2)
    np.testing.assert_array_equal(joined.command[8:], second.command)
    np.testing.assert_array_equal(joined.pose[:8], windows.pose)
    assert joined.rotor_speed is not None
    assert len(joined.rotor_speed) == 10
    unmeasured = replace(second, rotor_speed=None)
    assert join_windows([windows, unmeasured]).rotor_speed is None


def test_motors_start_at_the_measured_speed_and_follow_the_throttle(windows: Windows) -> None:
    """Beside a craft that flies by measured speeds, motors run from 471 rad/s under the log's throttle of 0.4.

    4.44 V are 0.21 V less than blades at 0.1 rad need (4.61 A): they lose speed, and the craft does not notice.
    """
    twin = Twin(SPEC, len(windows))
    motion = fly_windows(twin, windows)
    assert motion.rotor_speed is not None
    assert motion.rotor_speed.shape == (8, 151, 2)
    np.testing.assert_allclose(motion.rotor_speed[:, 0], 471.239, rtol=1e-9)
    assert (motion.rotor_speed[:, -1] < 465.0).all()
    without = fly_windows(twin, replace(windows, throttle=None, spin=None))
    assert without.rotor_speed is None
    np.testing.assert_array_equal(motion.pose, without.pose)
    np.testing.assert_array_equal(motion.velocity, without.velocity)


@pytest.mark.parametrize(("causal", "spread"), [(False, 1 / np.sqrt(21)), (True, 2 / np.sqrt(10))])
def test_rotor_speed_at_the_start(causal: bool, spread: float) -> None:
    """Speeds in the middle of 20 ms of noisy samples, or at the end of 10 ms, are those of a line fitted to them."""
    rng, time = np.random.default_rng(3), np.arange(4000) / 1000.0
    truth = np.stack([450.0 + 30.0 * time, 480.0 - 20.0 * time], axis=1)
    starts = 0.02 + 0.04 * np.arange(90)
    noisy = Series("rotor speed", "rad/s", time, truth + rng.normal(size=truth.shape), 1.0)
    error = estimate_spin(noisy, starts, causal) - np.stack([450.0 + 30.0 * starts, 480.0 - 20.0 * starts], axis=1)
    assert np.sqrt((error**2).mean()) == pytest.approx(spread, rel=0.2)  # 180 of them: 5 %


def test_throttle_is_taken_and_joined_with_its_windows(windows: Windows) -> None:
    """Throttles and speeds at the start go where their windows go, and are dropped unless all windows have them."""
    assert windows.throttle is not None
    assert windows.spin is not None
    marked = replace(windows, throttle=windows.throttle + np.arange(8)[:, None, None], spin=np.arange(16).reshape(8, 2))
    twice = join_windows([marked.take(np.array([5, 2])), marked])
    assert twice.throttle is not None
    np.testing.assert_allclose(twice.throttle[:3, 0, 0], [5.4, 2.4, 0.4])
    assert twice.spin is not None
    np.testing.assert_array_equal(twice.spin[:2, 1], [11, 5])
    mixed = join_windows([marked, replace(windows, throttle=None, spin=None)])
    assert mixed.throttle is None
    assert mixed.spin is None


def test_throttle_needs_measured_speeds() -> None:
    """Without rotor telemetry nobody knows where the motors start, nor is there anything to compare them with."""
    own = fly_own(SPEC, draw_commands(1000, seed=1), rotors=False)
    cut = cut_windows(SPEC, read_measurements(SPEC, own.flight), np.array([0.4]), 0.1, causal=True)
    assert (cut.throttle, cut.spin, cut.rotor_speed) == (None, None, None)


def test_a_past_does_not_look_ahead(own: OwnFlight, windows: Windows) -> None:
    """What leads up to a window of a twin that judges is the same whatever the sensors say after its start."""
    measured, last = read_measurements(SPEC, own.flight), windows.take(np.array([7]))
    poses = {
        dof: replace(s, value=np.where(s.time > last.start[0], s.value + 0.1, s.value))
        for dof, s in measured.positions.items()
    }
    past, other = (trace_past(SPEC, [m], last, True) for m in (measured, replace(measured, positions=poses)))
    np.testing.assert_array_equal(past.lead_qpos, other.lead_qpos)
    np.testing.assert_array_equal(past.qpos[: past.stops[0] + 1], other.qpos[: other.stops[0] + 1])
    assert past.lead_qpos.shape[1] == round(SMOOTH / SPEC.model.opt.timestep) + 1
    truth = own.state_at(last.start)
    np.testing.assert_allclose(past.lead_qvel[:, -1], truth[1], atol=5e-3)
    seeing = trace_past(SPEC, [replace(measured, positions=poses)], last, False)
    assert np.abs(seeing.lead_qpos[:, -1] - past.lead_qpos[:, -1]).max() > 1e-3


def test_a_track_has_no_jolts() -> None:
    """From millisecond to millisecond noise moves a track a tenth of what it moves estimates that stand alone."""
    measured, times = Sensors().measure(3.0), np.arange(1.0, 2.0, 0.001)
    alone, track = (
        estimate_states(measured, times, SPEC.model, False, until)[0] for until in (None, np.full(1000, np.inf))
    )
    jolts = [np.diff(pose[:, :2], n=2, axis=0).std(axis=0) for pose in (alone, track)]
    assert (jolts[1] < 0.1 * jolts[0]).all(), jolts
