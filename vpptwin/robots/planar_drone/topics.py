"""The drone's topics: measurements from them, where need be through its firmware's rate loop, and what they lack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import accumulate

import mujoco
import numpy as np

from vpptwin.actuators.blade import pitch_for_thrust
from vpptwin.actuators.controller import allocate, compute_torque, filter_gyro
from vpptwin.estimation.gaps import tell_cut, tell_gaps
from vpptwin.estimation.initial import DRIFT_STD
from vpptwin.estimation.series import Displacement, Lag, Measurements, Sampled, Series, integrate
from vpptwin.logs.check import MAX_FORCE, MIN_FORCE
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.streams.clocks import refuse_step
from vpptwin.robots.planar_drone.craft import PITCH, PlanarDrone
from vpptwin.robots.planar_drone.lag import estimate_lag, find_step
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.robots.planar_drone.vetting import clean_imu, clean_poses, clean_rotors, vet_flight
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec

MEASURED = ("/mocap/pose", "/imu/data", "/rotor/state")
"""Topics of the drone's sensors."""
MIN_DURATION = 2.0
"""Over so long [s] no craft falls for half of the time, so that the median of its specific force is telling."""
MAX_OFFSET = 0.25
"""No motion capture is later than this [s]; one that seems to be is stamped by another clock."""
SLOPE_STD = 0.3
"""Prior on a leftover acceleration [m/s²] once the accelerometer has been integrated."""
MEAN = 20
"""Poses over whose mean the gyro's integral is set right."""
STALE = 0.05
"""A policy command older than this was followed by others that the log lacks, unless they come slower [s]."""
MAX_GYRO_GAP = 0.02
"""Longest gap in the gyro that is bridged by a line [s]: in a longer one the rate loop saw what the log lacks."""


def read_drone(robot: PlanarDrone, spec: TwinSpec, flight: Flight) -> Measurements:
    """Measurements of the drone on its rig (docs/logs.md), from whatever part of it was recorded.

    Raises:
        InputError: if the log lacks poses, or all from which the rotors' commands could be known.
    """
    flight.require("/mocap/pose")
    flight, unsound = vet_flight(flight, spec.vehicle)
    sensors, streams = spec.vehicle.sensors, flight.streams
    warnings = [*unsound, *tell_lost(spec, streams)]
    imu, rotor = streams.get("/imu/data"), streams.get("/rotor/state")
    if imu is not None:
        imu, wild = clean_imu(imu, sensors)
        warnings += wild
    pose, wild = clean_poses(streams["/mocap/pose"], imu, sensors)
    warnings += wild
    if rotor is not None:
        rotor, wild = clean_rotors(rotor, sensors)
        warnings += wild
    command = streams.get("/rotor/command")
    commands = read_commands(spec.vehicle, flight, command, imu)
    driving = "/cmd/rate_thrust" if command is None else "/rotor/command"
    used = {topic: streams[topic].time for topic in (*MEASURED, driving) if topic in streams}
    spans = {topic: (float(time[0]), float(time[-1])) for topic, time in used.items()}
    start, end = max(span[0] for span in spans.values()), min(span[1] for span in spans.values())
    place, turn = sensors.mocap.position_std, sensors.mocap.angle_std
    columns = (("x", "x", "m", place), ("z", "z", "m", place), ("θ", "theta", "rad", turn))
    force = speed = current = throttle = None
    if imu is not None and measures_force(imu):
        accel = np.stack([imu["accel_x"], imu["accel_z"]], axis=1)
        if imu.time[-1] - imu.time[0] > MIN_DURATION:
            check_accelerometer(f"{flight.path}: /imu/data", np.hypot(accel[:, 0], accel[:, 1]))
        force = Series("specific force", "m/s²", imu.time, accel, sensors.imu.accel_std)
    if rotor is not None:
        speed = Series("rotor speed", "rad/s", rotor.time, rotor["speed"], sensors.rotor.speed_std)
        if "current" in rotor.values:
            current = Series("current", "A", rotor.time, rotor["current"], sensors.rotor.current_std)
    if command is not None and command["throttle"].any():  # zeros throughout are none
        throttle = Series("throttle", "1", command.time, command["throttle"], 0.0)
    measurements = Measurements(
        flight.name,
        {dof: Series(name, unit, pose.time, pose[c], std) for dof, (name, c, unit, std) in enumerate(columns)},
        {} if imu is None else {PITCH: Series("θ rate", "rad/s", imu.time, imu["rate"], sensors.imu.gyro_std)},
        force, commands, speed, (0, 1, PITCH),
        max(start, float(commands.time[0])), min(end, float(commands.time[-1])),
        throttle=throttle, current=current, clocks=flight.clocks, dead_reckon=dead_reckon,
    )  # fmt: skip
    lag = measure_offset(flight, measurements)
    warnings += [*tell_cut(spans), *tell_gaps(measurements)]
    return replace(measurements, lag=lag, warnings=tuple(warnings))


def measures_force(imu: Stream) -> bool:
    """Whether an IMU has an accelerometer: drivers of those without one leave zeros."""
    return all(name in imu.values and bool(imu[name].any()) for name in ("accel_x", "accel_z"))


def dead_reckon(measurements: Measurements, model: mujoco.MjModel) -> dict[int, Displacement]:
    """Displacement of x, z and θ as gyro and accelerometer have it: a = R(θ) f - g, integrated twice (Särkkä)."""
    force = measurements.specific_force
    if force is None or PITCH not in measurements.velocities:
        return {}
    gyro, angle, time = measurements.velocities[PITCH], measurements.positions[PITCH], force.time
    gravity = -float(model.opt.gravity[2])
    rate = np.interp(time, gyro.time, gyro.value)
    turned = Displacement(time, integrate(rate, time), rate, np.zeros_like(time), DRIFT_STD)
    offset = angle.value - turned.read(angle.time)[0]
    summed = np.cumsum(np.concatenate([np.full(MEAN, offset[0]), offset]))
    smooth = (summed[MEAN:] - summed[:-MEAN]) / float(MEAN)
    theta = turned.value + smooth[np.maximum(np.searchsorted(angle.time, time, side="right") - 1, 0)]
    body_x, body_z = force.value[:, 0], force.value[:, 1]
    displacement = {PITCH: turned}
    for dof, acceleration in enumerate(
        (
            body_x * np.cos(theta) - body_z * np.sin(theta),
            body_x * np.sin(theta) + body_z * np.cos(theta) - gravity,
        )
    ):
        speed = integrate(acceleration, time)
        displacement[dof] = Displacement(time, integrate(speed, time), speed, acceleration, SLOPE_STD)
    return displacement


def read_commands(vehicle: Vehicle, flight: Flight, command: Stream | None, imu: Stream | None) -> Series:
    """Blade-pitch commands as logged, or else from the policy's commands and the gyro.

    Raises:
        InputError: if neither was recorded.
    """
    if command is not None:
        return Series("blade pitch", "rad", command.time, command["blade_pitch"], 0.0)
    policy = flight.streams.get("/cmd/rate_thrust")
    if policy is None or imu is None or min(len(policy), len(imu)) < 2:
        raise InputError(
            f"{flight.path} has no messages on /rotor/command, only on {', '.join(sorted(flight.streams))}",
            "/rotor/command, or both /cmd/rate_thrust and /imu/data to reconstruct it from",
            "record them, or name them in a topic map if they are recorded under other names",
        )
    given = policy.time, policy["thrust"], policy["rate"]
    time, pitch = reconstruct_commands(vehicle, given, (imu.time, imu["rate"]))
    if len(time) < 2:
        found = f"{flight.path}: /cmd/rate_thrust and /imu/data are never there together"
        raise InputError(found, "both over the whole flight, or /rotor/command", "record them together")
    return Series("blade pitch", "rad", time, pitch, 0.0)


def reconstruct_commands(
    vehicle: Vehicle, policy: tuple[np.ndarray, np.ndarray, np.ndarray], gyro: Sampled
) -> Sampled:  # fmt: skip
    """Run the inner loop of the flight controller over logged policy commands and gyro samples.

    Args:
        vehicle: the believed numbers, which are those the craft flies on.
        policy: time [s], thrust [N] and rate [rad/s] of the policy's commands, (n,) each.
        gyro: time [s] and rate [rad/s] as measured, (m,) each.

    Returns:
        Time (k,) s and blade pitch (k, 2) rad, one inner step apart. Steps at which policy or gyro are unknown are
        left out, so that they show as gaps.
    """
    dt = 1.0 / vehicle.control.inner_rate
    time = lay_grid(gyro[0], dt)
    rate = np.interp(time, *gyro)
    filtered = np.fromiter(accumulate(rate.tolist(), lambda last, now: filter_gyro(vehicle, last, now)), float)
    before = np.concatenate([filtered[:1], filtered[:-1]])
    held = np.searchsorted(policy[0], time, side="right") - 1
    torque = compute_torque(vehicle, policy[2][held], filtered, before, dt)
    thrusts = allocate(vehicle, policy[1][held], torque)
    pitch = np.stack([pitch_for_thrust(vehicle.rotor, thrust) for thrust in thrusts], axis=1)
    known = (held >= 0) & (time - policy[0][held] <= max(STALE, 3.0 * float(np.median(np.diff(policy[0])))))
    following = np.clip(np.searchsorted(gyro[0], time), 1, len(gyro[0]) - 1)
    known &= gyro[0][following] - gyro[0][following - 1] <= MAX_GYRO_GAP
    return time[known], pitch[known]


def lay_grid(time: np.ndarray, dt: float) -> np.ndarray:
    """Instants about `dt` [s] apart that include the samples' own, (n,) s, or even ones if those are much closer."""
    steps = np.diff(time)
    if np.median(steps) < 0.75 * dt:
        return np.arange(time[0], time[-1], dt)
    index = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / dt), 1.0))])
    return np.interp(np.arange(index[-1] + 1.0), index, time)


def measure_offset(flight: Flight, measurements: Measurements) -> Lag | None:
    """Lag of the poses behind the gyro; None where nothing tells.

    Raises:
        InputError: if what turned in both lies further apart than any delay of a motion capture, or one clock steps.
    """
    if PITCH not in measurements.velocities:
        return None
    angle, rate = measurements.positions[PITCH], measurements.velocities[PITCH]
    if (step := find_step(angle, rate)) is not None:
        raise refuse_step(str(flight.path), "/mocap/pose", *step)
    lag = estimate_lag(angle, rate)
    if lag is not None and abs(lag.start) > MAX_OFFSET:
        order = "after" if lag.start > 0.0 else "before"
        raise InputError(
            f"{flight.path}: /mocap/pose shows every turn {abs(lag.start):.2f} s {order} /imu/data does",
            "both stamped by one clock",
            "set the clocks by NTP or PTP, or give /mocap/pose `stamp: log_time` in a topic map",
        )
    return lag


def tell_lost(spec: TwinSpec, topics: Mapping[str, Stream]) -> list[str]:
    """What a drone's log cannot tell because topics are missing, one line each."""
    lines = []
    if "/imu/data" not in topics:
        lines.append(
            f"no /imu/data: rates and forces come from /mocap/pose alone{list_unseen(spec, '/imu/data')}; short and "
            "small effects hide in its noise"
        )
    elif not measures_force(topics["/imu/data"]):
        lines.append("no accelerometer on /imu/data: forces come from /mocap/pose alone, small ones hide in its noise")
    if "/rotor/command" not in topics:
        lines.append(
            "no /rotor/command: blade pitch is reconstructed from /cmd/rate_thrust and the gyro through the believed "
            "rate loop, so what that loop does otherwise would be taken for the rig's; throttle is unknown"
            f"{list_unseen(spec, '/rotor/state')}"
        )
    if "/rotor/state" not in topics:
        lines.append(
            f"no /rotor/state: rotors are taken to turn at {spec.vehicle.rotor.speed:.0f} rad/s throughout"
            f"{list_unseen(spec, '/rotor/state')}; a speed that sags would be taken for lost thrust"
        )
    return lines


def list_unseen(spec: TwinSpec, topic: str) -> str:
    """The effects that show in one topic alone, as part of a sentence."""
    hidden = [effect.id for effect in spec.catalogue if set(effect.shows) == {topic}]
    return f", {' and '.join(hidden)} cannot be identified" if hidden else ""


def check_accelerometer(label: str, force: np.ndarray) -> None:
    """Refuse specific forces (n,) in another unit or without gravity: in flight and at rest the median is gravity's."""
    median = float(np.median(force))
    if MIN_FORCE < median < MAX_FORCE:
        return
    if 0.5 < median < 1.5:
        found, action = "looks like multiples of g", "convert it with `scale: 9.80665` in a topic map"
    elif median <= MIN_FORCE:
        found, action = "looks like acceleration without gravity", "record the raw specific force"
    else:
        found, action = "looks like milli-g or cm/s^2", "convert it with `scale` in a topic map"
    raise InputError(f"{label}: the acceleration's median is {median:.3g} and {found}", "m/s^2, 9.8 at rest", action)
