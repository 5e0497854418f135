"""From tracks to a log: the topics of docs/logs.md as the sensors would have given them."""

from __future__ import annotations

import numpy as np

from vpptwin.actuators.layer import supply
from vpptwin.actuators.motor import compute_current
from vpptwin.actuators.numbers import record_vehicle
from vpptwin.logs.flight import Stream
from vpptwin.robots.planar_drone.pilot.flight import SimulatedFlights
from vpptwin.twin.sensors import age_of_pose, body_force, measure_pose, measure_rate, sensor_noise

BATTERY_PERIOD = 1.0
"""Between messages about the battery [s]."""


def record_streams(tracks: SimulatedFlights, row: int = 0) -> dict[str, Stream]:
    """What the log of one of the flights holds, topic → samples; time zero is the log's start.

    Accelerometer samples are means over the two steps about their stamp; currents are those under the voltage that
    acted until then.
    """
    vehicle, constants = tracks.twin.vehicle, tracks.twin.constants[row : row + 1]
    sensors, (lead, lead_ticks) = vehicle.sensors, tracks.lead
    pose, velocity, speed = tracks.pose[row], tracks.velocity[row], tracks.speed[row]
    noise = tracks.noise.fast[row, lead:-1]
    time = tracks.step * (np.arange(lead, len(pose) - 1) - lead)
    ticks = tracks.period * np.arange(tracks.command.shape[1] - lead_ticks)

    force = body_force(pose[None], velocity[None], tracks.step, vehicle.gravity)[0]
    force = 0.5 * (force[lead - 1 : -1] + force[lead:]) + sensors.imu.accel_std * noise[:, 1:3]
    rate = measure_rate(constants, velocity[lead:-1, 2]) + sensors.imu.gyro_std * noise[:, 0]
    full = vehicle.motor.battery * supply(constants, time)
    voltage = tracks.throttle[row, lead - 1 : -2] * full[:, None]
    current = compute_current(record_vehicle(vehicle)[0].motor, voltage, speed[lead:-1])
    current = current + sensors.rotor.current_std * noise[:, 5:7]
    turning = speed[lead:-1] + sensors.rotor.speed_std * noise[:, 3:5]
    blade_pitch, command = tracks.blade_pitch[row, lead:-1], tracks.command[row, lead_ticks:]
    target = tracks.target[row, lead_ticks:]
    changed = np.append(True, (np.diff(target, axis=0) != 0.0).any(axis=1))
    seconds = np.arange(0, len(time), max(round(BATTERY_PERIOD / tracks.step), 1))
    return {
        "/mocap/pose": record_mocap(tracks, row),
        "/imu/data": Stream(time, {"rate": rate, "accel_x": force[:, 0], "accel_z": force[:, 1]}),
        "/cmd/rate_thrust": Stream(ticks, {"thrust": command[:, 0], "rate": command[:, 1]}),
        "/rotor/command": Stream(time, {"blade_pitch": blade_pitch, "throttle": tracks.throttle[row, lead:-1]}),
        "/rotor/state": Stream(time, {"speed": turning, "current": current}),
        "/setpoint/pose": Stream(ticks[changed], name_pose(target[changed])),
        "/battery": Stream(time[seconds], {"voltage": full[seconds]}),
    }


def record_mocap(tracks: SimulatedFlights, row: int) -> Stream:
    """Poses of the motion capture: what the craft's were when each was taken, by its clock, with its errors."""
    vehicle, constants = tracks.twin.vehicle, tracks.twin.constants[row : row + 1]
    frames = max(round(1.0 / (vehicle.sensors.mocap.rate * tracks.period)), 1)
    lead, lead_ticks = tracks.lead
    tick = np.arange(lead_ticks, tracks.command.shape[1])
    tick = tick[tick % frames == 0]
    stamp = tracks.period * (tick - lead_ticks)
    taken = stamp - age_of_pose(constants, stamp)
    known = tracks.step * (np.arange(tracks.pose.shape[1]) - lead)
    within = taken <= known[-1]
    tick, stamp, taken = tick[within], stamp[within], taken[within]
    pose = np.column_stack([np.interp(taken, known, tracks.pose[row, :, axis]) for axis in range(3)])
    seen = measure_pose(constants, pose) + sensor_noise(vehicle)[0] * tracks.noise.pose[row, tick]
    return Stream(stamp, name_pose(seen))


def name_pose(pose: np.ndarray) -> dict[str, np.ndarray]:
    """Poses (n, 3) as columns of a topic."""
    return {name: pose[:, i] for i, name in enumerate(("x", "z", "theta"))}
