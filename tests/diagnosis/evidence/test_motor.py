"""Channels of rotor telemetry: by hand, and on flights of the independent simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from proving.drone import fly_many, write_mcap
from proving.drone.flight import FlightPlan
from tests import builders
from vpptwin.diagnosis.criteria import CRITERIA
from vpptwin.diagnosis.evidence.channels import Channel
from vpptwin.diagnosis.evidence.motor import CURRENT, SPEED, observe_motor, predict_motor
from vpptwin.estimation.measurements import Measurements, Series, read_measurements
from vpptwin.estimation.windows import Windows, cut_windows, fly_windows
from vpptwin.logs import read_flight
from vpptwin.twin import Twin, load_twin

SPEC = load_twin()
assert SPEC.vehicle is not None
MOTOR = SPEC.vehicle.motor
DT = 0.001
HIDDEN: dict[str, dict[str, dict[str, float]]] = {
    "none": {},
    "drag": {"rotor.drag": {"gain": 0.85}},
    "sag": {"battery.sag": {"rate": 0.005}},
    "rail": {"rail_x.coulomb": {"force": 0.3}, "airframe.mass": {"mass": 0.06}},
}
Values = Mapping[tuple[str, str], float]


def lay_windows(count: int = 2) -> Windows:
    """Windows of 0.1 s from 10 s on, throttle 0.4 and 0.5, 460 and 480 rad/s."""
    windows = builders.lay_windows(SPEC, 10.0 + 0.1 * np.arange(count), steps=100)
    speed, throttle = (np.tile(pair, (count, 100, 1)) for pair in ([460.0, 480.0], [0.4, 0.5]))
    return replace(windows, rotor_speed=speed, throttle=throttle, spin=np.zeros((count, 2)))


def measure(rate: float = 1000.0, current: bool = True) -> Measurements:
    """Speeds t and 2 t, currents 3 t and 4 t, at a rate [Hz] from 9 s on; noise 1 rad/s and 0.05 A."""
    time = 9.0 + np.arange(round(2.0 * rate)) / rate
    speed = Series("rotor speed", "rad/s", time, np.stack([time, 2.0 * time], axis=1), 1.0)
    amperes = Series("current", "A", time, np.stack([3.0 * time, 4.0 * time], axis=1), 0.05)
    command = Series("blade pitch", "rad", time, np.zeros((len(time), 2)), 0.0)
    return Measurements(
        "by hand", {}, {}, None, command, speed, (), 9.0, 11.0, throttle=command, current=amperes if current else None
    )


def test_bins_are_means_with_their_noise() -> None:
    """1 kHz in bins of 50 ms, each sample telling of the millisecond before: the first bin's mean is that at 25.5 ms.

    A current is compared with what a measured speed makes of it: 1/(115 * 0.12) A per rad/s of its noise.
    """
    channels = observe_motor(lay_windows(), measure(), MOTOR)
    assert [(c.kind, c.axis, c.unit) for c in channels] == [
        (SPEED, 0, "rad/s"), (SPEED, 1, "rad/s"), (CURRENT, 0, "A"), (CURRENT, 1, "A")
    ]  # fmt: skip
    for channel, slope in zip(channels, (1.0, 2.0, 3.0, 4.0)):
        np.testing.assert_allclose(channel.value, slope * np.array([[10.0255, 10.0755], [10.1255, 10.1755]]))
        np.testing.assert_allclose(channel.weight.sum(axis=2), 1.0)
    np.testing.assert_allclose(channels[0].std, np.hypot(1.0 / np.sqrt(50.0), CRITERIA.rotor_speed_floor))
    noise = np.hypot(0.05, 1.0 / (115.0 * 0.12))
    np.testing.assert_allclose(channels[2].std, np.hypot(noise / np.sqrt(50.0), CRITERIA.current_floor))


def test_bins_without_samples_count_for_nothing() -> None:
    """Telemetry that stops at 10.12 s leaves the second window's last bin empty, without a warning."""
    measured = measure()
    assert measured.rotor_speed is not None
    kept = measured.rotor_speed.time < 10.1205
    speed = replace(measured.rotor_speed, time=measured.rotor_speed.time[kept], value=measured.rotor_speed.value[kept])
    channel = observe_motor(lay_windows(), replace(measured, rotor_speed=speed), MOTOR)[0]
    np.testing.assert_allclose(channel.weight.sum(axis=2), [[1.0, 1.0], [1.0, 0.0]])
    assert channel.std[1, 1] > 1e4 * channel.std[0, 0]
    np.testing.assert_allclose(channel.value[1, 0], 10.1105)  # mean of 10.101 to 10.120 s


def test_channels_need_throttle_and_speed() -> None:
    """Without throttle there is nothing to compare; without currents, speeds alone."""
    assert observe_motor(replace(lay_windows(), throttle=None, spin=None), measure(), MOTOR) == []
    assert observe_motor(lay_windows(), replace(measure(), rotor_speed=None), MOTOR) == []
    assert [c.kind for c in observe_motor(lay_windows(), measure(current=False), MOTOR)] == [SPEED, SPEED]


@pytest.mark.parametrize("rate", [1000.0, 437.0])
def test_speeds_are_read_at_the_samples(rate: float) -> None:
    """A simulated speed that grows as the measured one does is predicted as measured, at any rate of telemetry."""
    windows = lay_windows()
    time = windows.start[:, None] + DT * np.arange(windows.steps + 1)
    for channel in observe_motor(windows, measure(rate), MOTOR)[:2]:
        simulated = np.stack([time, 2.0 * time], axis=2)
        np.testing.assert_allclose(
            predict_motor(channel, windows, simulated, {"battery.sag": np.zeros(1)}, MOTOR), channel.value, rtol=1e-6
        )


def test_current_by_hand() -> None:
    """Throttle 0.4 of 11.1 V at 460 rad/s: (4.44 - 4)/0.12 = 3.667 A; less 1 % of 4.44 V a second from the start on."""
    windows = lay_windows()
    first, second = observe_motor(windows, measure(), MOTOR)[2:]
    simulated = np.full((2, 101, 2), np.nan)  # does not count
    full, sagging = ({"battery.sag": np.array([rate])} for rate in (0.0, 0.01))
    np.testing.assert_allclose(predict_motor(first, windows, simulated, full, MOTOR), (4.44 - 4.0) / 0.12)
    np.testing.assert_allclose(predict_motor(second, windows, simulated, full, MOTOR), (5.55 - 480.0 / 115.0) / 0.12)
    lost = 4.44 * 0.01 * np.array([[10.025, 10.075], [10.125, 10.175]]) / 0.12
    # the first sample of a window has the voltage of the step after it, 1 ms late in one of 50
    np.testing.assert_allclose(
        predict_motor(first, windows, simulated, sagging, MOTOR), (4.44 - 4.0) / 0.12 - lost, atol=2e-5
    )


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Windows, list[Channel]]]:
    """Windows of 0.3 s and their motor channels, of 6 s flights of the independent simulation with hidden effects."""
    folder = tmp_path_factory.mktemp("motor")
    plans: list[FlightPlan] = [
        {"effects": hidden, "manoeuvre": "aggressive", "duration": 6.0, "seed": 5} for hidden in HIDDEN.values()
    ]
    cut = {}
    for name, recording in zip(HIDDEN, fly_many(plans)):
        measured = read_measurements(SPEC, read_flight(write_mcap(recording, folder / f"{name}.mcap")))
        windows = cut_windows(SPEC, measured, np.arange(0.2, 5.4, 0.3), 0.3, causal=False)
        cut[name] = (windows, observe_motor(windows, measured, MOTOR))
    return cut


def find_misfit(windows: Windows, channels: list[Channel], values: Values) -> dict[str, np.ndarray]:
    """What a twin with these values misses, by kind of channel, in units of the channel's noise; (2, K, B)."""
    twin = Twin(SPEC, len(windows), {effect for effect, _ in values}, num_threads=1)
    for (effect, parameter), value in values.items():
        twin.set_parameter(effect, parameter, value)
    speed = fly_windows(twin, windows).rotor_speed
    assert speed is not None
    missed = [(c.value - predict_motor(c, windows, speed, twin.constants, MOTOR)) / c.std for c in channels]
    return {kind: np.stack([m for m, c in zip(missed, channels) if c.kind == kind]) for kind in (SPEED, CURRENT)}


def root_mean_square(misfit: np.ndarray) -> float:
    """Of all values."""
    return float(np.sqrt((misfit**2).mean()))


@pytest.mark.parametrize("name", HIDDEN)
def test_truth_leaves_noise(flights: dict[str, tuple[Windows, list[Channel]]], name: str) -> None:
    """The twin with the hidden effect's true values misses nothing but noise, which is below the assumed floor."""
    values = {(effect, p): value for effect, ps in HIDDEN[name].items() for p, value in ps.items()}
    missed = find_misfit(*flights[name], values)
    assert root_mean_square(missed[SPEED]) < 0.6
    assert root_mean_square(missed[CURRENT]) < 0.4


def test_effects_show_where_they_should(flights: dict[str, tuple[Windows, list[Channel]]]) -> None:
    """Drag shows in speeds alone, a battery that sags in both, what is outside the motors in neither."""
    seen = {
        name: {kind: root_mean_square(m) for kind, m in find_misfit(*cut, {}).items()} for name, cut in flights.items()
    }
    assert seen["drag"][SPEED] > 10.0
    assert seen["drag"][CURRENT] < 0.4
    assert seen["sag"][SPEED] > 10.0
    assert seen["sag"][CURRENT] > 5.0
    for kind in (SPEED, CURRENT):
        assert seen["rail"][kind] == pytest.approx(seen["none"][kind], abs=0.1)


def test_drag_is_no_explanation_of_a_sagging_battery(flights: dict[str, tuple[Windows, list[Channel]]]) -> None:
    """Speeds that fall could be drag; the currents say that it is the voltage."""
    missed = find_misfit(*flights["sag"], {("rotor.drag", "gain"): 1.3})
    assert root_mean_square(missed[CURRENT]) > 5.0
