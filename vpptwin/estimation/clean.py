"""A drone's streams without the samples that no motion explains, and with its angle followed through gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vpptwin.estimation.outliers import find_frozen, find_spikes, find_strays
from vpptwin.estimation.series import Series, integrate
from vpptwin.logs.flight import Stream
from vpptwin.robots.planar_drone.vehicle import Sensors

SPEED = np.array([8.0, 8.0, 40.0])
"""Nothing on the rig is faster in x, z [m/s] and θ [rad/s]."""
ACCELERATION = (100.0, 100.0, 600.0)
"""Nor changes its speed faster in x, z [m/s²] and θ [rad/s²], but at once in a bounce."""
RATE_JERK, FORCE_JERK = 2e5, 4e6
"""Second derivatives of rate [rad/s³] and specific force [m/s⁴] that a motion may have."""


def clean_poses(pose: Stream, imu: Stream | None, sensors: Sensors) -> tuple[Stream, list[str]]:
    """Poses without frozen and wild ones, the angle unwrapped anew: a wild one may have thrown it off by a turn.

    The rate of an IMU, where there is one, tells how far the craft turned between two poses.

    Returns:
        The poses left, and a warning for each kind left out.
    """
    std = np.array([sensors.mocap.position_std, sensors.mocap.position_std, sensors.mocap.angle_std])
    turned = np.zeros(len(pose))
    if imu is not None and len(imu) > 1:
        turned = np.interp(pose.time, imu.time, integrate(imu["rate"], imu.time))
    value = np.stack([pose["x"], pose["z"], np.unwrap(pose["theta"] - turned)], axis=1)
    frozen = find_frozen(np.stack([pose[name] for name in ("x", "z", "theta")], axis=1), std)
    wild = np.zeros(len(pose), dtype=bool)
    left = np.flatnonzero(~frozen)
    for axis, bend in enumerate(ACCELERATION):
        wild[left] |= find_spikes(pose.time[left], value[left, axis], std[axis], bend)
    left = np.flatnonzero(~frozen & ~wild)
    wild[left] |= find_strays(pose.time[left], value[left], std, SPEED, turn=2)
    kept = np.flatnonzero(~frozen & ~wild)
    theta = np.unwrap(value[kept, 2]) + turned[kept]
    theta = pose["theta"][kept] + 2.0 * np.pi * np.rint((theta - pose["theta"][kept]) / (2.0 * np.pi))
    warnings = tell_left_out("/mocap/pose", wild, "are outliers")
    warnings += tell_left_out("/mocap/pose", frozen, "repeat a frozen pose")
    return Stream(pose.time[kept], {"x": pose["x"][kept], "z": pose["z"][kept], "theta": theta}), warnings


def clean_imu(imu: Stream, sensors: Sensors) -> tuple[Stream, list[str]]:
    """IMU messages without spikes in rate or specific force, and a warning that counts them."""
    wild = find_spikes(imu.time, imu["rate"], sensors.imu.gyro_std, RATE_JERK)
    for name in ("accel_x", "accel_z"):
        if name in imu.values:
            wild |= find_spikes(imu.time, imu[name], sensors.imu.accel_std, FORCE_JERK)
    return drop_rows(imu, wild), tell_left_out("/imu/data", wild, "are outliers")


def clean_rotors(rotor: Stream, sensors: Sensors) -> tuple[Stream, list[str]]:
    """Rotor telemetry without spikes of the speeds, and a warning that counts them."""
    wild = find_spikes(rotor.time, rotor["speed"], sensors.rotor.speed_std, 0.0)
    return drop_rows(rotor, wild), tell_left_out("/rotor/state", wild, "are outliers")


def clean_series(series: Series, label: str) -> tuple[Series, list[str]]:
    """A joint's track without spikes, and a warning that counts them; of its motion nothing is known."""
    wild = find_spikes(series.time, series.value, series.std, None)
    if not wild.any():
        return series, []
    left = replace(series, time=series.time[~wild], value=series.value[~wild])
    return left, tell_left_out(label, wild, "are outliers")


def drop_rows(stream: Stream, rows: np.ndarray) -> Stream:
    """A stream without some of its samples, (n,) bool."""
    if not rows.any():
        return stream
    return Stream(stream.time[~rows], {name: values[~rows] for name, values in stream.values.items()})


def tell_left_out(label: str, rows: np.ndarray, what: str) -> list[str]:
    """One line if there are any rows, (n,) bool."""
    count = int(np.count_nonzero(rows))
    return [f"{label}: {count} of {len(rows)} samples {what}, left out"] if count else []
