"""The measurements of one flight, sorted by the degree of freedom they measure, on any rig."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from vpptwin.errors import InputError
from vpptwin.estimation.joints import read_joints
from vpptwin.estimation.policy import reconstruct_commands
from vpptwin.estimation.series import Measurements, Series, common_span
from vpptwin.logs.flight import Flight, Stream
from vpptwin.twin.spec import TwinSpec
from vpptwin.vehicle import Vehicle

__all__ = ["Measurements", "Series", "read_measurements"]


def read_measurements(spec: TwinSpec, flight: Flight) -> Measurements:
    """Sort a flight's streams by degree of freedom.

    Raises:
        InputError: if the log lacks a topic, joint or actuator that the twin needs.
    """
    return read_drone(spec, flight) if spec.vehicle is not None else read_joints(spec, flight)


def read_drone(spec: TwinSpec, flight: Flight) -> Measurements:
    """Measurements of the drone on its rig (SPEC 3), from whatever part of it was recorded.

    Raises:
        InputError: if the log lacks poses, or all from which the rotors' commands could be known.
    """
    assert spec.vehicle is not None
    flight.require("/mocap/pose")
    sensors, streams = spec.vehicle.sensors, flight.streams
    pose, imu, rotor = streams["/mocap/pose"], streams.get("/imu/data"), streams.get("/rotor/state")
    positions = {
        0: Series("x", "m", pose.time, pose["x"], sensors.mocap.position_std),
        1: Series("z", "m", pose.time, pose["z"], sensors.mocap.position_std),
        2: Series("θ", "rad", pose.time, pose["theta"], sensors.mocap.angle_std),
    }
    velocities: dict[int, Series] = {}
    specific_force = rotor_speed = current = throttle = None
    if imu is not None:
        velocities[2] = Series("θ rate", "rad/s", imu.time, imu["rate"], sensors.imu.gyro_std)
        if {"accel_x", "accel_z"} <= imu.values.keys():
            force = np.stack([imu["accel_x"], imu["accel_z"]], axis=1)
            specific_force = Series("specific force", "m/s²", imu.time, force, sensors.imu.accel_std)
    if rotor is not None:
        rotor_speed = Series("rotor speed", "rad/s", rotor.time, rotor["speed"], sensors.rotor.speed_std)
        if "current" in rotor.values:
            current = Series("current", "A", rotor.time, rotor["current"], sensors.rotor.current_std)
    if (command := streams.get("/rotor/command")) is not None:
        throttle = Series("throttle", "1", command.time, command["throttle"], 0.0)
    commands = read_commands(spec.vehicle, flight, command, imu)
    used = [*positions.values(), *velocities.values(), commands, *([rotor_speed] if rotor_speed else [])]
    start, end = common_span(used)
    return Measurements(
        flight.path.name, positions, velocities, specific_force, commands, rotor_speed, (0, 1, 2), start, end,
        throttle=throttle, current=current, warnings=tuple(tell_lost(spec, streams)),
    )  # fmt: skip


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
    time, pitch = reconstruct_commands(
        vehicle, (policy.time, policy["thrust"], policy["rate"]), (imu.time, imu["rate"])
    )
    if len(time) < 2:
        raise InputError(
            f"{flight.path}: /cmd/rate_thrust and /imu/data are never there together",
            "both over the whole flight, or /rotor/command",
            "record them together",
        )
    return Series("blade pitch", "rad", time, pitch, 0.0)


def tell_lost(spec: TwinSpec, topics: Collection[str]) -> list[str]:
    """What a drone's log cannot tell because topics are missing, one line each."""
    assert spec.vehicle is not None
    lines = []
    if "/imu/data" not in topics:
        lines.append(
            f"no /imu/data: rates and forces come from /mocap/pose alone{list_unseen(spec, '/imu/data')}; short and "
            "small effects hide in its noise"
        )
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
