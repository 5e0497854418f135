"""The measurements of one flight, sorted by the degree of freedom they measure, on any rig."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vpptwin.errors import InputError
from vpptwin.logs.flight import Flight, Stream
from vpptwin.twin.model import HINGE
from vpptwin.twin.spec import TwinSpec

POSITION_SHARE, VELOCITY_SHARE = 0.003, 0.02
"""Shares of its range below which a joint's logged position and velocity are not believed."""


@dataclass(frozen=True)
class Series:
    """Samples of one quantity.

    Attributes:
        name: what it is, e.g. `x` or `pitch rate`.
        unit: SI unit.
        time: (n,) s, increasing.
        value: (n,) or (n, k).
        std: sensor noise of one sample, 1 sigma, in the unit.
        white: the noise is independent from sample to sample, so that averaging reduces it.
    """

    name: str
    unit: str
    time: np.ndarray
    value: np.ndarray
    std: float
    white: bool = True


@dataclass(frozen=True)
class Measurements:
    """What was measured and commanded on one flight.

    Attributes:
        name: file the flight came from.
        positions: degree of freedom → position [m or rad].
        velocities: degree of freedom → velocity [m/s or rad/s].
        specific_force: accelerometer in body axes x, z, (n, 2) m/s²; None without one.
        command: actuator commands (n, nu): blade pitch [rad] on the drone, control inputs elsewhere.
        rotor_speed: measured speed (n, 2) rad/s; None where it was not measured.
        delayed: degrees of freedom whose position comes from the motion capture.
        driven: degree of freedom → position of a joint that is not simulated but follows its log.
        start, end: span in which everything needed is there [s].
    """

    name: str
    positions: dict[int, Series]
    velocities: dict[int, Series]
    specific_force: Series | None
    command: Series
    rotor_speed: Series | None
    delayed: tuple[int, ...]
    start: float
    end: float
    driven: dict[int, Series] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Usable length of the flight [s]."""
        return self.end - self.start


def read_measurements(spec: TwinSpec, flight: Flight) -> Measurements:
    """Sort a flight's streams by degree of freedom.

    Raises:
        InputError: if the log lacks a topic, joint or actuator that the twin needs.
    """
    return read_drone(spec, flight) if spec.vehicle is not None else read_joints(spec, flight)


def read_drone(spec: TwinSpec, flight: Flight) -> Measurements:
    """Measurements of the drone on its rig (SPEC 3)."""
    assert spec.vehicle is not None
    flight.require("/mocap/pose", "/rotor/command")
    sensors = spec.vehicle.sensors
    pose, command = flight.streams["/mocap/pose"], flight.streams["/rotor/command"]
    positions = {
        0: Series("x", "m", pose.time, pose["x"], sensors.mocap.position_std),
        1: Series("z", "m", pose.time, pose["z"], sensors.mocap.position_std),
        2: Series("θ", "rad", pose.time, pose["theta"], sensors.mocap.angle_std),
    }
    velocities: dict[int, Series] = {}
    specific_force = None
    if (imu := flight.streams.get("/imu/data")) is not None:
        velocities[2] = Series("θ rate", "rad/s", imu.time, imu["rate"], sensors.imu.gyro_std)
        force = np.stack([imu["accel_x"], imu["accel_z"]], axis=1)
        specific_force = Series("specific force", "m/s²", imu.time, force, sensors.imu.accel_std)
    rotor_speed = None
    if (rotor := flight.streams.get("/rotor/state")) is not None:
        rotor_speed = Series("rotor speed", "rad/s", rotor.time, rotor["speed"], sensors.rotor.speed_std)
    commands = Series("blade pitch", "rad", command.time, command["blade_pitch"], 0.0)
    series = [*positions.values(), *velocities.values(), commands, *([rotor_speed] if rotor_speed else [])]
    start, end = common_span(series)
    return Measurements(
        flight.path.name, positions, velocities, specific_force, commands, rotor_speed, (0, 1, 2), start, end
    )


def read_joints(spec: TwinSpec, flight: Flight) -> Measurements:
    """Measurements of another rig: the joint states and control inputs that the twin's `signals` name."""
    assert spec.signals is not None
    positions: dict[int, Series] = {}
    velocities: dict[int, Series] = {}
    for joint, topic in spec.signals.joints.items():
        dof, position, velocity = read_joint(spec, flight, topic, joint)
        positions[dof] = position
        if velocity is not None:
            velocities[dof] = velocity
    driven = {}
    for joint, topic in spec.signals.driven.items():
        dof, driven[dof], _ = read_joint(spec, flight, topic, joint)
    command = read_efforts(spec, flight, spec.signals.actuators)
    start, end = common_span([*positions.values(), *driven.values(), command])
    return Measurements(flight.path.name, positions, velocities, None, command, None, (), start, end, driven)


def read_joint(spec: TwinSpec, flight: Flight, topic: str, joint: str) -> tuple[int, Series, Series | None]:
    """Degree of freedom, position and, where logged, velocity of a joint."""
    stream = find_joint(flight, topic, joint)
    dof = int(spec.model.joint(joint).dofadr[0])
    rotary = int(spec.model.joint(joint).type[0]) == HINGE
    length, unit = ("rad", "rad/s") if rotary else ("m", "m/s")
    if "position" not in stream.values:
        raise InputError(
            f"{flight.path}: {topic} has no position of joint {joint!r}", "positions in JointState", "record them"
        )
    position = Series(
        joint, length, stream.time, stream["position"], estimate_noise(stream["position"], POSITION_SHARE), white=False
    )
    if "velocity" not in stream.values:
        return dof, position, None
    noise = estimate_noise(stream["velocity"], VELOCITY_SHARE)
    return dof, position, Series(f"{joint} rate", unit, stream.time, stream["velocity"], noise, white=False)


def read_efforts(spec: TwinSpec, flight: Flight, actuators: dict[str, str]) -> Series:
    """Control inputs of all actuators on one time axis, held between samples; unlogged actuators stay at zero."""
    streams = {name: find_joint(flight, topic, name) for name, topic in actuators.items()}
    if not streams:
        return Series("control", "", np.array([0.0, flight.duration]), np.zeros((2, spec.model.nu)), 0.0)
    time = np.unique(np.concatenate([s.time for s in streams.values()]))
    time = time[time >= max(s.time[0] for s in streams.values())]
    value = np.zeros((len(time), spec.model.nu))
    for name, stream in streams.items():
        if "effort" not in stream.values:
            raise InputError(
                f"{flight.path}: no effort of actuator {name!r} on {actuators[name]}",
                "`effort` = control input in the JointState", "record it or correct `signals`",
            )  # fmt: skip
        held = np.searchsorted(stream.time, time, side="right") - 1
        value[:, spec.model.actuator(name).id] = stream["effort"][held]
    return Series("control", "", time, value, 0.0)


def find_joint(flight: Flight, topic: str, name: str) -> Stream:
    """The stream of a joint or actuator on a JointState topic."""
    joints = flight.joints.get(topic)
    if joints is None:
        known = ", ".join(flight.joints) or "no JointState topic at all"
        raise InputError(f"{flight.path}: no topic {topic}", f"it in the log, which has {known}", "correct `signals`")
    if name not in joints:
        raise InputError(f"{flight.path}: {topic} has no {name!r}", f"one of {', '.join(joints)}", "correct `signals`")
    return joints[name]


def common_span(series: list[Series]) -> tuple[float, float]:
    """Span in which all series have samples [s]."""
    return max(float(s.time[0]) for s in series), min(float(s.time[-1]) for s in series)


def estimate_noise(value: np.ndarray, share: float) -> float:
    """Noise of one sample of somebody's estimator output, 1 sigma in its unit.

    Third differences remove what is smooth and leave the noise; but estimators smooth that away too, so nothing is
    believed better than a `share` of the range in which the signal moves.

    Args:
        value: samples, (n,).
        share: of the range between the 1st and the 99th percentile.
    """
    low, high = np.percentile(value, [1.0, 99.0])
    floor = max(share * float(high - low), 1e-9)
    if len(value) < 8:
        return floor
    spread = np.median(np.abs(np.diff(value, 3))) / 0.6745 / np.sqrt(20.0)
    return float(max(spread, floor))
