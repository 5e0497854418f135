"""What `vpptwin plot` shows of a flight of the drone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vpptwin.actuators.blade import compute_thrust
from vpptwin.estimation.series import interpolate
from vpptwin.logs.flight import Flight, Stream
from vpptwin.robots.planar_drone.craft import PlanarDrone
from vpptwin.robots.planar_drone.vehicle import Propeller
from vpptwin.viz.plots.palette import ORANGE, PURPLE, SKY, TARGET
from vpptwin.viz.plots.panels import Line, Panel, differentiate, measured, twin_line

if TYPE_CHECKING:
    from vpptwin.estimation.replay import Prediction


TURNED = 0.01
"""Change of the setpoint's angle that counts as a trigger, rad."""
SPINNING = 0.1
"""A setpoint's angle that goes on changing within this time is one trigger, s."""


def find_flips(robot: PlanarDrone, flight: Flight) -> np.ndarray:
    """Times at which the setpoint's angle changes, (k,) s; of an angle that turns, the time at which it begins."""
    stream = flight.streams.get("/setpoint/pose")
    if stream is None or len(stream) < 2:
        return np.empty(0)
    times = stream.time[1:][np.abs(np.diff(stream["theta"])) > TURNED]
    begun: np.ndarray = np.diff(times, prepend=-np.inf) > SPINNING
    return times[begun]


def tell_craft(robot: PlanarDrone, flight: Flight, prediction: Prediction | None) -> list[Panel]:
    """Position, velocity, angle, rate, thrust and rotor speed of our craft, as far as they were recorded."""
    pose, target = flight.streams.get("/mocap/pose"), flight.streams.get("/setpoint/pose")
    panels = []
    axes = (("x", "x [m]", "x velocity [m/s]"), ("z", "z [m]", "z velocity [m/s]"), ("theta", "θ [rad]", ""))
    for joint, (column, label, rate) in enumerate(axes):
        if pose is None:
            break
        asked = [] if target is None else [setpoint_line(target, column, pose)]
        panels.append(Panel(label, [measured(pose.time, pose[column]), *asked, *twin_line(prediction, "qpos", joint)]))
        if rate and len(pose) > 4:
            slope = differentiate(pose.time, pose[column])
            panels.append(Panel(rate, [measured(pose.time, slope), *twin_line(prediction, "qvel", joint)]))
    gyro, command = flight.streams.get("/imu/data"), flight.streams.get("/cmd/rate_thrust")
    if gyro is not None:
        lines = [measured(gyro.time, gyro["rate"])]
        if command is not None:
            lines.append(Line("commanded", command.time, command["rate"], PURPLE, ":", steps=True))
        panels.append(Panel("q [rad/s]", [*lines, *twin_line(prediction, "qvel", 2)]))
    return panels + tell_rotors(flight, robot.vehicle.rotor)


def setpoint_line(target: Stream, column: str, pose: Stream) -> Line:
    """The setpoint of x, z or θ; of an angle the turn that the craft is nearest to when the next one is asked for."""
    values = target[column]
    if column == "theta":
        until = np.append(target.time[1:], pose.time[-1])
        values = values + 2.0 * np.pi * np.round((np.interp(until, pose.time, pose["theta"]) - values) / (2.0 * np.pi))
    time, values = np.append(target.time, pose.time[-1]), np.append(values, values[-1])
    return Line("setpoint", time, values, TARGET, ":", steps=True)


def tell_rotors(flight: Flight, rotor: Propeller) -> list[Panel]:
    """Thrust of each rotor by the twin's map, and their speeds."""
    command, state = flight.streams.get("/rotor/command"), flight.streams.get("/rotor/state")
    panels, looks = [], (ORANGE, SKY)
    if command is not None:
        speed = np.full((len(command), 2), rotor.speed)
        if state is not None:
            speed = interpolate(command.time, state.time, state["speed"])
        thrust = compute_thrust(rotor, speed, command["blade_pitch"])
        lines = [Line(f"rotor {i + 1}, by the map", command.time, thrust[:, i], c) for i, c in enumerate(looks)]
        asked = flight.streams.get("/cmd/rate_thrust")
        if asked is not None:
            lines.append(Line("commanded, half of both", asked.time, 0.5 * asked["thrust"], PURPLE, ":", steps=True))
        panels.append(Panel("thrust [N]", lines))
    if state is not None:
        lines = [Line(f"rotor {i + 1}", state.time, state["speed"][:, i], c) for i, c in enumerate(looks)]
        panels.append(Panel("rotor speed [rad/s]", lines))
    return panels
