"""The drone's topics: measurements from them, and predictions on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vpptwin.estimation.checks.sound import vet_flight
from vpptwin.estimation.clean import clean_imu, clean_poses, clean_rotors
from vpptwin.estimation.gaps import tell_cut, tell_gaps
from vpptwin.estimation.series import Lag, Measurements, Series
from vpptwin.logs.check import MAX_FORCE, MIN_FORCE
from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.streams.clocks import refuse_step
from vpptwin.robots.planar_drone.craft import PlanarDrone
from vpptwin.robots.planar_drone.lag import estimate_lag, find_step
from vpptwin.robots.planar_drone.policy import reconstruct_commands
from vpptwin.robots.planar_drone.vehicle import Sensors, Vehicle
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec

MEASURED = ("/mocap/pose", "/imu/data", "/rotor/state")
"""Topics of the drone's sensors."""
TELLING = 2.0
"""Over so long [s] no craft falls for half of the time, so that the median of its specific force is telling."""
MAX_OFFSET = 0.25
"""No motion capture is later than this [s]; one that seems to be is stamped by another clock."""


def read_drone(robot: PlanarDrone, spec: TwinSpec, flight: Flight) -> Measurements:
    """Measurements of the drone on its rig (SPEC 3), from whatever part of it was recorded.

    Raises:
        InputError: if the log lacks poses, or all from which the rotors' commands could be known.
    """
    flight.require("/mocap/pose")
    flight, unsound = vet_flight(flight, spec.vehicle)
    sensors, streams = spec.vehicle.sensors, flight.streams
    warnings = [*unsound, *tell_lost(spec, streams)]
    imu, rotor = streams.get("/imu/data"), streams.get("/rotor/state")
    if imu is not None:
        imu, found = clean_imu(imu, sensors)
        warnings += found
    pose, found = clean_poses(streams["/mocap/pose"], imu, sensors)
    warnings += found
    if rotor is not None:
        rotor, found = clean_rotors(rotor, sensors)
        warnings += found
    command = streams.get("/rotor/command")
    commands = read_commands(spec.vehicle, flight, command, imu)
    driving = "/cmd/rate_thrust" if command is None else "/rotor/command"
    used = {topic: streams[topic].time for topic in (*MEASURED, driving) if topic in streams}
    spans = {topic: (float(time[0]), float(time[-1])) for topic, time in used.items()}
    start, end = max(span[0] for span in spans.values()), min(span[1] for span in spans.values())
    measurements = Measurements(
        flight.name,
        sort_poses(pose, sensors),
        {} if imu is None else {2: Series("θ rate", "rad/s", imu.time, imu["rate"], sensors.imu.gyro_std)},
        sort_force(flight, imu, sensors),
        commands,
        None if rotor is None else Series("rotor speed", "rad/s", rotor.time, rotor["speed"], sensors.rotor.speed_std),
        (0, 1, 2),
        max(start, float(commands.time[0])), min(end, float(commands.time[-1])),
        throttle=sort_throttle(command),
        current=sort_current(rotor, sensors),
    )  # fmt: skip
    lag = measure_offset(flight, measurements)
    warnings += [*tell_cut(spans), *tell_gaps(measurements)]
    return replace(measurements, lag=lag, clocks=flight.clocks, warnings=tuple(warnings))


def sort_poses(pose: Stream, sensors: Sensors) -> dict[int, Series]:
    """Degree of freedom → position."""
    place, turn = sensors.mocap.position_std, sensors.mocap.angle_std
    columns = (("x", "x", "m", place), ("z", "z", "m", place), ("θ", "theta", "rad", turn))
    return {dof: Series(name, unit, pose.time, pose[c], std) for dof, (name, c, unit, std) in enumerate(columns)}


def sort_force(flight: Flight, imu: Stream | None, sensors: Sensors) -> Series | None:
    """Specific force in body axes x and z, where there is an accelerometer.

    Raises:
        InputError: if it is in another unit.
    """
    if imu is None or not measures_force(imu):
        return None
    force = np.stack([imu["accel_x"], imu["accel_z"]], axis=1)
    if imu.time[-1] - imu.time[0] > TELLING:
        check_accelerometer(f"{flight.path}: /imu/data", np.hypot(force[:, 0], force[:, 1]))
    return Series("specific force", "m/s²", imu.time, force, sensors.imu.accel_std)


def measures_force(imu: Stream) -> bool:
    """Whether an IMU has an accelerometer: drivers of those without one leave zeros."""
    return all(name in imu.values and bool(imu[name].any()) for name in ("accel_x", "accel_z"))


def sort_current(rotor: Stream | None, sensors: Sensors) -> Series | None:
    """Motor currents, where they were measured."""
    if rotor is None or "current" not in rotor.values:
        return None
    return Series("current", "A", rotor.time, rotor["current"], sensors.rotor.current_std)


def sort_throttle(command: Stream | None) -> Series | None:
    """Commanded throttle, where it was logged: zeros throughout are none."""
    if command is None or not command["throttle"].any():
        return None
    return Series("throttle", "1", command.time, command["throttle"], 0.0)


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


def measure_offset(flight: Flight, measurements: Measurements) -> Lag | None:
    """Lag of the poses behind the gyro; None where nothing tells.

    Raises:
        InputError: if what turned in both lies further apart than any delay of a motion capture, or one clock steps.
    """
    if 2 not in measurements.velocities:
        return None
    angle, rate = measurements.positions[2], measurements.velocities[2]
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
    return f", {' and '.join(hidden)} can't be seen" if hidden else ""


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
