"""What rotor telemetry shows of a motor: the speed that it reaches under its throttle, and the current that it draws.

The two part what looks alike. Speed is compared with that of a motor simulated from the throttle alone, which drag and
voltage change. Current is compared with what throttle and the *measured* speed make of it, which voltage alone changes.
"""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.layer import SUPPLY, supply
from vpptwin.actuators.motor import compute_current
from vpptwin.diagnosis.criteria import CRITERIA, Criteria
from vpptwin.diagnosis.evidence.channels import MISSING, Channel
from vpptwin.estimation.measurements import Measurements, Series
from vpptwin.estimation.windows import Windows
from vpptwin.robots.planar_drone.vehicle import Motor
from vpptwin.twin.sensors import Constants

SPEED, CURRENT = "rotor speed", "current"
"""Kinds of these channels; their axis is the rotor's index."""
MOTOR_BIN = 0.05
"""Samples are averaged over bins of about this length [s]: a motor answers in 52 ms, while a governor that feeds
the noise of a single speed back makes current noisy from sample to sample."""


def observe_motor(
    windows: Windows, measurements: Measurements, motor: Motor, criteria: Criteria = CRITERIA
) -> list[Channel]:
    """Channels of rotor speeds and currents of one flight's windows; none without throttle and rotor speed.

    Args:
        windows: of the flight.
        measurements: of the flight.
        motor: constants by which current follows speed.
        criteria: the roughness below which no model of a motor is believed.
    """
    speed, current = measurements.rotor_speed, measurements.current
    if windows.throttle is None or speed is None:
        return []
    channels = [bin_rotor(windows, speed, SPEED, i, speed.std, criteria.rotor_speed_floor) for i in range(2)]
    if current is not None:
        noise = float(np.hypot(current.std, speed.std / (motor.k_v * motor.resistance)))
        channels += [bin_rotor(windows, current, CURRENT, i, noise, criteria.current_floor) for i in range(2)]
    return channels


def bin_rotor(windows: Windows, series: Series, kind: str, rotor: int, noise: float, floor: float) -> Channel:
    """Average samples of a rotor, (n, 2) of the series, over the bins of each window.

    Args:
        windows: K windows of one flight.
        series: of both rotors.
        kind: of the channel.
        rotor: index.
        noise: of one sample against its prediction, in the series' unit.
        floor: roughness of the model, likewise.
    """
    length = windows.steps * windows.dt
    bins = max(round(length / MOTOR_BIN), 1)
    edges = windows.start[:, None] + length / bins * np.arange(bins + 1)
    first = np.searchsorted(series.time, edges + 1e-9)  # a sample tells of the time up to it
    count = np.diff(first, axis=1)[..., None]
    index = first[:, :-1, None] + np.arange(max(int(count.max()), 1))
    inside = index < first[:, 1:, None]
    index = np.clip(index, 0, len(series.time) - 1)
    number = np.maximum(count, 1)
    weight = inside / number
    value = (series.value[index, rotor] * weight).sum(axis=2)
    std = np.hypot(noise / np.sqrt(number[..., 0]), floor)
    offset = np.where(inside, series.time[index] - windows.start[:, None, None], 0.5 * length)
    return Channel(
        f"{series.name}, rotor {rotor + 1}", series.unit, kind, rotor, False,
        value, np.where(count[..., 0] > 0, std, MISSING * noise), offset, weight, noise,
    )  # fmt: skip


def predict_motor(
    channel: Channel, windows: Windows, rotor_speed: np.ndarray, constants: Constants, motor: Motor
) -> np.ndarray:
    """The channel as a simulation shows it.

    Args:
        channel: of the same K windows, of kind SPEED or CURRENT.
        windows: with throttle and measured speed.
        rotor_speed: simulated, at the start and after every step, (K, steps + 1, 2) rad/s.
        constants: of the twin, of which `battery.sag` counts, (1,) or (K,).
        motor: the twin's.

    Returns:
        Mean over each bin, (K, B) rad/s or A.
    """
    assert windows.throttle is not None
    assert windows.rotor_speed is not None
    if channel.kind == SPEED:
        track = rotor_speed[..., channel.axis]
    else:
        middle = windows.start[:, None] + windows.dt * (np.arange(windows.steps) + 0.5)
        left = supply({name: constants[name][:, None] for name in SUPPLY}, middle)
        voltage = motor.battery * left * windows.throttle[..., channel.axis]
        measured = windows.rotor_speed[..., channel.axis]
        speed = 0.5 * (measured + np.concatenate([measured[:, 1:], measured[:, -1:]], axis=1))  # after each step
        after = compute_current(motor, voltage, speed)
        track = np.concatenate([after[:, :1], after], axis=1)
    return channel.average(track, windows.dt)
