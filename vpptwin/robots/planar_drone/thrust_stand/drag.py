"""Air drag of the drone by least squares, as the paper has it (System Identification, item 2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vpptwin.drift.free_flight import LeastSquares
from vpptwin.estimation.regression import solve_linear
from vpptwin.logs.flight import Flight
from vpptwin.robots.planar_drone.craft import PlanarDrone

STILL = 0.3
"""Drag is looked for at speeds beyond this [m/s]."""


def regress_drag(robot: PlanarDrone, flights: Sequence[Flight]) -> LeastSquares | None:
    """The drone's `regress_drag`: k_d from thrust commands and recorded accelerations, None where a log lacks them.

    Along z, where neither carriage nor horizontal rail come in: m (a + g) = f cos θ - k_d |v| v_z, with a + g from the
    accelerometer, θ and v from the motion capture, f as commanded. Lags and whatever else acts go into it, as they do
    in the paper; a constant is fitted beside it.
    """
    along, wanted = [], []
    for flight in flights:
        if any(topic not in flight.streams for topic in ("/cmd/rate_thrust", "/imu/data", "/mocap/pose")):
            return None
        command, imu, pose = (flight.streams[t] for t in ("/cmd/rate_thrust", "/imu/data", "/mocap/pose"))
        if "accel_x" not in imu.values:
            return None
        craft = robot.vehicle.airframe.mass + robot.vehicle.rig.slider_mass
        time = np.arange(max(pose.time[2], command.time[0]), min(pose.time[-3], imu.time[-1]), 0.01)
        speed = [np.interp(time, pose.time, np.gradient(pose[axis], pose.time)) for axis in ("x", "z")]
        speed = [np.convolve(v, np.ones(5) / 5.0, "same") for v in speed]
        theta = np.interp(time, pose.time, pose["theta"])
        calm = np.ones(10) / 10.0
        smooth = (np.convolve(imu[name], calm, "same") for name in ("accel_x", "accel_z"))
        force_x, force_z = (np.interp(time, imu.time, force) for force in smooth)
        upward = np.cos(theta) * force_z + np.sin(theta) * force_x
        thrust = command["thrust"][np.clip(np.searchsorted(command.time, time, side="right") - 1, 0, None)]
        size = np.hypot(*speed)
        moving = size > STILL
        # along z only: the carriage's mass and the rail's friction are not in it
        along.append((-size * speed[1])[moving])
        wanted.append((craft * upward - thrust * np.cos(theta))[moving])
    pushed, missed = np.concatenate(along), np.concatenate(wanted)
    if len(pushed) < 50 or not np.any(pushed):
        return None
    inputs = np.column_stack([pushed, np.ones(len(pushed))])
    found, std = solve_linear(inputs, missed, 10.0)
    return LeastSquares(float(found[0]), float(std[0]), len(pushed))
