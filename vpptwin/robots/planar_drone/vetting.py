"""A drone's flight without channels and samples that cannot be believed.

Dead, stuck, clipped or doubled channels, scales that others contradict, and samples that no motion explains.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vpptwin.actuators.blade import compute_thrust
from vpptwin.estimation.checks.orientation import BEND, MIN_SAMPLES
from vpptwin.estimation.checks.units import is_dead
from vpptwin.estimation.outliers import drop_rows, find_frozen, find_spikes, find_strays, tell_left_out
from vpptwin.estimation.series import integrate
from vpptwin.logs.check import FASTEST, MAX_FORCE, MIN_FORCE, MIN_R_SQUARED, SLOWEST, compare_steps
from vpptwin.logs.flight import Flight, Stream
from vpptwin.robots.planar_drone.vehicle import Sensors, Vehicle
from vpptwin.system.errors import InputError

STUCK = 0.15
"""Longest time [s] for which a noisy sensor may repeat itself to the last digit, and then jump."""
CLIPPED = 5
"""Samples in a row at a noisy channel's very greatest or least value that make a clipped peak."""
MIN_DURATION = 4.0
"""Over so long [s] the accelerometer's mean is gravity's, as no speed on the rig changes by 12 m/s."""
MIN_SCALE, MAX_SCALE = 0.7, 1.4
"""Scale of lengths against the accelerometer, and of that against gravity, beyond which a unit is wrong: `mocap.scale`
reaches from 0.8 to 1.2."""
LENGTHS = {"feet": 0.3048, "inches": 0.0254, "centimetres": 0.01, "millimetres": 0.001}
"""What lengths may be in [m]."""
MAX_SPEED = np.array([8.0, 8.0, 40.0])
"""Nothing on the rig is faster in x, z [m/s] and θ [rad/s]."""
MAX_ACCELERATION = (100.0, 100.0, 600.0)
"""Nor changes its speed faster in x, z [m/s²] and θ [rad/s²], but at once in a bounce."""
RATE_JERK, FORCE_JERK = 2e5, 4e6
"""Second derivatives of rate [rad/s³] and specific force [m/s⁴] that a motion may have."""


def vet_flight(flight: Flight, vehicle: Vehicle) -> tuple[Flight, list[str]]:
    """A drone's flight without channels and samples that cannot be believed, and a warning for each.

    Raises:
        InputError: if what is needed is wrong throughout: poses in another unit or doubled, commands that never change.
    """
    streams, warnings = dict(flight.streams), list[str]()
    pose = streams["/mocap/pose"]
    vets: dict[str, Callable[[Stream], tuple[Stream | None, list[str]]]] = {
        "/imu/data": lambda imu: vet_imu(imu, pose, vehicle),
        "/rotor/state": lambda rotor: vet_rotors(
            rotor, vehicle, streams.get("/imu/data"), streams.get("/rotor/command")
        ),
    }
    for topic, vet in vets.items():
        if topic in streams and len(streams[topic]) >= MIN_SAMPLES:
            vetted, texts = vet(streams.pop(topic))
            warnings += [f"{topic}: {text}" for text in texts]
            streams |= {} if vetted is None else {topic: vetted}
    command = streams.get("/rotor/command")
    if command is not None and is_dead(command["blade_pitch"]) and "/cmd/rate_thrust" in streams:
        del streams["/rotor/command"]
        warnings.append("/rotor/command: blade pitch never changes, left out")
    vet_poses(f"{flight.path}: /mocap/pose", pose, streams.get("/imu/data"), vehicle)
    return replace(flight, streams=streams), warnings


def vet_imu(imu: Stream, pose: Stream, vehicle: Vehicle) -> tuple[Stream | None, list[str]]:
    """An IMU without what is dead or doubled, and without samples that are stuck or clipped; None for a dead gyro."""
    sensors = vehicle.sensors
    if is_dead(imu["rate"]) and np.ptp(pose["theta"]) > 20.0 * sensors.mocap.angle_std:
        return None, [f"the rate is {imu['rate'][0]:g} throughout while the craft turns, the IMU is left out"]
    warnings = []
    forces = [name for name in ("accel_x", "accel_z") if name in imu.values and imu[name].any()]
    dead = [name for name in forces if is_dead(imu[name])]
    doubled = len(forces) == 2 and np.array_equal(imu["accel_x"], imu["accel_z"])
    if dead or doubled:
        reason = f"{' and '.join(dead)} never changes" if dead else "accel_x and accel_z are one and the same"
        warnings.append(f"{reason}, the accelerometer is left out")
        imu, forces = Stream(imu.time, {"rate": imu["rate"]}), []
    elif len(forces) == 2 and len(pose) >= MIN_SAMPLES and imu.time[-1] - imu.time[0] > MIN_DURATION:
        up = turn_force(imu, pose)[:, 1]
        share = float(up.mean()) / vehicle.gravity
        if (
            MIN_FORCE < np.median(np.hypot(imu["accel_x"], imu["accel_z"])) < MAX_FORCE
            and not MIN_SCALE < share < MAX_SCALE
        ):
            found = f"the accelerometer shows {share:.2g} times gravity upwards on average"
            warnings.append(f"{found}: in another unit, or its axes swapped or turned; it is left out")
            imu, forces = Stream(imu.time, {"rate": imu["rate"]}), []
    noise = {"rate": sensors.imu.gyro_std, "accel_x": sensors.imu.accel_std, "accel_z": sensors.imu.accel_std}
    stuck, clipped = np.zeros(len(imu), dtype=bool), np.zeros(len(imu), dtype=bool)
    for name in ("rate", *forces):
        if is_noisy(imu[name], noise[name]):
            stuck |= find_stuck(imu.time, imu[name], noise[name])
            clipped |= find_clipped(imu[name])
    for rows, what in ((stuck, "repeat a value to the last digit"), (clipped & ~stuck, "are clipped")):
        warnings += [text.split(": ", 1)[1] for text in tell_left_out("", rows, what)]
    return drop_rows(imu, stuck | clipped), warnings


def vet_rotors(
    rotor: Stream, vehicle: Vehicle, imu: Stream | None, command: Stream | None
) -> tuple[Stream | None, list[str]]:
    """Rotor telemetry without what is dead or stuck; None where speeds are dead, doubled or in another unit.

    Whether the unit is another is asked of the thrust that the accelerometer felt, where there is one.
    """
    noise, governed, warnings = vehicle.sensors.rotor.speed_std, vehicle.rotor.speed, list[str]()
    backwards = np.median(rotor["speed"], axis=0) < 0.0
    if backwards.any():
        numbers = " and ".join(str(i + 1) for i in np.flatnonzero(backwards))
        warnings.append(f"the speed of rotor {numbers} is negative, its sign is turned")
        rotor = Stream(rotor.time, rotor.values | {"speed": np.where(backwards, -1.0, 1.0) * rotor["speed"]})
    speed = rotor["speed"]
    if np.array_equal(speed[:, 0], speed[:, 1]) and is_noisy(speed[:, 0], noise):
        return None, ["both rotor speeds are one and the same, left out"]
    ratio = np.median(np.abs(speed), axis=0) / governed
    worst = ratio[np.argmax(np.abs(np.log(np.maximum(ratio, 1e-9))))]
    found = f"a rotor speed is {worst:.2g} times the governed {governed:g} rad/s"
    doubted = bool(ratio.min() < SLOWEST or ratio.max() > FASTEST)
    if not doubted and any(is_dead(column) and column[0] != governed for column in speed.T):  # as of a simulation
        return None, ["a rotor speed never changes, left out"]
    logged, nominal = (
        weigh_thrust(s, vehicle, imu, command)
        for s in (rotor, replace(rotor, values={"speed": 0.0 * speed + governed}))
    )
    if logged is not None and nominal is not None:
        fits, fits_nominal = (MIN_SCALE < factor < MAX_SCALE for factor in (logged, nominal))
        if doubted and fits and not fits_nominal and ratio.max() < 1.2 * ratio.min():
            warnings.append(f"{found}, and so is the thrust felt: correct rotor.speed of the vehicle")
            doubted = False
        elif not fits and fits_nominal and not doubted:
            found = f"at rotor speeds as logged there would be {1.0 / logged:.2g} times the thrust that is felt"
            doubted = True
    if doubted:
        return None, [f"{found}, left out"]
    stuck = np.zeros(len(rotor), dtype=bool)
    for column in speed.T:
        if is_noisy(column, noise):
            stuck |= find_stuck(rotor.time, column, noise)
    warnings += [text.split(": ", 1)[1] for text in tell_left_out("", stuck, "repeat a value to the last digit")]
    rotor = drop_rows(rotor, stuck)
    if "current" in rotor.values and any(is_dead(column) for column in rotor["current"].T):
        warnings.append("a motor current never changes, currents are left out")
        rotor = Stream(rotor.time, {name: data for name, data in rotor.values.items() if name != "current"})
    return rotor, warnings


def weigh_thrust(rotor: Stream, vehicle: Vehicle, imu: Stream | None, command: Stream | None) -> float | None:
    """The thrust that the accelerometer felt over that of the blades at these speeds; None where nothing tells."""
    if imu is None or command is None or "accel_z" not in imu.values or not imu["accel_z"].any():
        return None
    speed = np.stack([np.interp(command.time, rotor.time, column) for column in rotor["speed"].T], axis=1)
    thrust = compute_thrust(vehicle.rotor, speed, command["blade_pitch"]).sum(axis=1)
    felt = (vehicle.airframe.mass + vehicle.rig.slider_mass) * imu["accel_z"]
    starts = max(stream.time[0] for stream in (rotor, imu, command))
    steps = np.arange(starts, min(stream.time[-1] for stream in (rotor, imu, command)), BEND)
    if len(steps) < MIN_SAMPLES:
        return None
    made, had = (
        np.diff(np.interp(steps, time, integrate(force, time)))
        for time, force in ((command.time, thrust), (imu.time, felt))
    )
    factor, r_squared = compare_steps(made, had)
    return factor if r_squared > MIN_R_SQUARED else None


def vet_poses(label: str, pose: Stream, imu: Stream | None, vehicle: Vehicle) -> None:
    """Refuse lengths in another unit than the accelerometer's, an axis that stands still, and axes that are one.

    Raises:
        InputError: naming the unit that they look like.
    """
    if len(pose) < MIN_SAMPLES:
        return
    if np.array_equal(pose["x"], pose["z"]) and not is_dead(pose["x"]):
        raise InputError(f"{label}: x and z are one and the same", "two axes", "correct the topic map or the tracker")
    if imu is None or "accel_x" not in imu.values or not imu["accel_x"].any() or len(imu) < MIN_SAMPLES:
        return
    seen, felt = bend_tracks(pose, imu, vehicle.gravity)
    least = 20.0 * vehicle.sensors.mocap.position_std
    for name, moved in zip("xz", felt.T):
        if is_dead(pose[name]) and np.sqrt(np.mean(moved**2)) > least:
            found = f"{label}: {name} never changes, while the accelerometer shows motion"
            raise InputError(found, "positions that were measured", "look at the tracker, or correct the topic map")
    factor, r_squared = compare_steps(felt.ravel(), seen.ravel())
    if r_squared < MIN_R_SQUARED or MIN_SCALE < factor < MAX_SCALE:
        return
    unit = min(LENGTHS, key=lambda name: abs(np.log(abs(factor) * LENGTHS[name])))
    near = 0.75 < factor * LENGTHS[unit] < 1.33
    looks = f" and look like {unit}" if near else ""
    scale = LENGTHS[unit] if near else 1.0 / factor
    raise InputError(
        f"{label}: positions move {factor:.3g} times as far as the accelerometer shows{looks}",
        "metres",
        f"convert x and z, for instance with `scale: {scale:.4g}` in a topic map, or check the accelerometer's axes",
    )


def bend_tracks(pose: Stream, imu: Stream, gravity: float) -> tuple[np.ndarray, np.ndarray]:
    """By how much x and z leave a straight line, by the poses and by the accelerometer, (n, 2) m each."""
    moved = turn_force(imu, pose) - [0.0, gravity]
    for _ in range(2):
        moved = integrate(moved, imu.time)
    low, high = max(pose.time[0], imu.time[0]) + BEND, min(pose.time[-1], imu.time[-1]) - BEND
    middle = np.arange(low, high, 0.5 * BEND)
    ahead = np.searchsorted(pose.time, middle)
    near = np.diff(pose.time)[np.clip(ahead - 1, 0, len(pose) - 2)] < BEND  # no motion is read off a gap

    def bend(time: np.ndarray, track: np.ndarray) -> np.ndarray:
        before, now, after = (np.interp(middle[near] + side * BEND, time, track) for side in (-1.0, 0.0, 1.0))
        return np.asarray(before - 2.0 * now + after)

    seen = np.stack([bend(pose.time, pose["x"]), bend(pose.time, pose["z"])], axis=1)
    return seen, np.stack([bend(imu.time, moved[:, 0]), bend(imu.time, moved[:, 1])], axis=1)


def turn_force(imu: Stream, pose: Stream) -> np.ndarray:
    """Specific force in world axes x and z, by the angle of the poses, (n, 2) m/s²."""
    angle = np.interp(imu.time, pose.time, pose["theta"])
    cosine, sine = np.cos(angle), np.sin(angle)
    force_x, force_z = imu["accel_x"], imu["accel_z"]
    return np.stack([cosine * force_x - sine * force_z, sine * force_x + cosine * force_z], axis=1)


def is_noisy(value: np.ndarray, std: float) -> bool:
    """Whether a channel (n,) has the noise of a sensor: without, as in simulations, it may stand still or be one.

    The longest run of one value is not asked, in which the sensor may have been stuck for most of the log.
    """
    begins, lengths = list_runs(value)
    longest = int(np.argmax(lengths))
    steps = np.abs(np.diff(np.delete(value, slice(begins[longest] + 1, begins[longest] + lengths[longest])), 2))
    return len(steps) > 0 and float(np.median(steps)) > 0.3 * std


def list_runs(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First index and length of every run of equal values in (n,)."""
    begins = np.flatnonzero(np.append(True, np.diff(value) != 0.0))
    return begins, np.diff(np.append(begins, len(value)))


def find_stuck(time: np.ndarray, value: np.ndarray, std: float) -> np.ndarray:
    """Samples (n,) of a run that is longer than STUCK and that a jump ends, or that lasts to the end, (n,) bool."""
    begins, lengths = list_runs(value)
    ends = begins + lengths
    lasting = time[ends - 1] - time[begins] > STUCK
    after = value[np.minimum(ends, len(value) - 1)]
    jumps = (np.abs(after - value[begins]) > 8.0 * std) | (ends == len(value))
    return np.repeat(lasting & jumps, lengths)


def find_clipped(value: np.ndarray) -> np.ndarray:
    """Samples (n,) in peaks that end flat at the channel's very greatest or least value, (n,) bool."""
    begins, lengths = list_runs(value)
    clipped = np.zeros(len(begins), dtype=bool)
    for limit in (value.max(), value.min()):
        at = value[begins] == limit
        if np.any(lengths[at] >= CLIPPED):
            clipped |= at
    return np.repeat(clipped, lengths)


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
    remaining = np.flatnonzero(~frozen)
    for axis, bend in enumerate(MAX_ACCELERATION):
        wild[remaining] |= find_spikes(pose.time[remaining], value[remaining, axis], std[axis], bend)
    remaining = np.flatnonzero(~frozen & ~wild)
    wild[remaining] |= find_strays(pose.time[remaining], value[remaining], std, MAX_SPEED, turn=2)
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
