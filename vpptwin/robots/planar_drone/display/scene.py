"""Rotors, thrust arrows and the setpoint's ghost in meshcat, and the tracks that move them."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from vpptwin.actuators.blade import max_thrust
from vpptwin.robots.planar_drone.display import rotors
from vpptwin.robots.planar_drone.display.rotors import RotorMotion, SetpointChanges, find_craft, find_rotor
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.viz.plots.palette import BLADE, NEGATIVE_THRUST, POSITIVE_THRUST, TARGET, TOP_MARK
from vpptwin.viz.scene.geoms import ROOT, Paint
from vpptwin.viz.scene.meshes import make_cone, make_cylinder, make_material
from vpptwin.viz.scene.nodes import Node, make_box, make_ellipsoid, shift, turn
from vpptwin.viz.scene.stage import draw_geom
from vpptwin.viz.scene.tracks import KeyframeTrack, make_track

TARGET_PAINT = Paint(TARGET, 0.4, behind=True)
ARROWS = (("positive", 1.0, POSITIVE_THRUST), ("negative", -1.0, NEGATIVE_THRUST))
BLADES = (("blade_a", 0.0), ("blade_b", np.pi))
"""Name and angle about the hub [rad]."""


def draw_rotors(craft: Node, model: mujoco.MjModel, vehicle: Vehicle, paint: Paint | None = None) -> None:
    """Masts, blades and a mark on top of the craft, below its node; paint overrides all colours (the twin)."""
    craft["top"].set_object(make_ellipsoid([0.03, 0.02, 0.014]), make_material(paint or Paint(TOP_MARK)))
    craft["top"].set_transform(shift([0.0, 0.0, 0.018]))
    for number in (1, 2):
        hub, radius = find_rotor(model, vehicle, number)
        rotor, blade = craft[f"rotor_{number}"], paint or Paint(BLADE)
        rotor.set_transform(shift(hub))
        rotor["mast"].set_object(make_cylinder(rotors.ROOT_RADIUS, -hub[2], 0.006), make_material(blade))
        span = radius - rotors.ROOT_RADIUS
        for name, angle in BLADES:
            root = rotor["spin"][name]
            root.set_transform(turn(angle, [0, 0, 1]))
            root["feather"]["skin"].set_object(make_box([span, rotors.CHORD, rotors.THICKNESS]), make_material(blade))
            root["feather"]["skin"].set_transform(shift([rotors.ROOT_RADIUS + 0.5 * span, 0.0, 0.0]))


def draw_arrows(craft: Node) -> None:
    """One arrow per rotor and sign of thrust, of unit length; needs draw_rotors for its place."""
    for number in (1, 2):
        for name, sign, colour in ARROWS:
            arrow = craft[f"rotor_{number}"][f"{name}_thrust"]
            arrow.set_transform(turn(0.0 if sign > 0.0 else np.pi, [1, 0, 0]))
            arrow["shaft"]["solid"].set_object(
                make_cylinder(rotors.SHAFT_RADIUS, 0.0, 1.0), make_material(Paint(colour))
            )
            arrow["head"]["solid"].set_object(
                make_cone(rotors.HEAD_RADIUS, rotors.HEAD_HEIGHT), make_material(Paint(colour))
            )


def draw_ghost(vis: Node, model: mujoco.MjModel, vehicle: Vehicle) -> None:
    """Draw the craft once more, as what shows the setpoint."""
    for geom in np.flatnonzero(model.geom_bodyid == find_craft(model)):
        draw_geom(vis, model, int(geom), TARGET_PAINT)
    draw_rotors(vis, model, vehicle, TARGET_PAINT)


def measure_arrows(thrust: np.ndarray, vehicle: Vehicle) -> Iterator[tuple[str, np.ndarray]]:
    """Node below the craft's and length [m] of every arrow, for thrusts (..., 2) [N]."""
    full = max_thrust(vehicle.rotor)
    for i in range(2):
        for name, sign, _ in ARROWS:
            length = np.maximum(sign * thrust[..., i] / full * rotors.ARROW_LENGTH, rotors.SHORTEST_ARROW)
            yield f"rotor_{i + 1}/{name}_thrust", length


def track_rotors(craft: str, time: np.ndarray, motion: RotorMotion) -> list[KeyframeTrack]:
    """Tracks that turn the rotors and pitch their blades; time (T,) [s] from the animation's start."""
    tracks = []
    for i, sign in enumerate(rotors.TURN_SIGNS):
        spin = f"{craft}/rotor_{i + 1}/spin"
        tracks.append(make_track(spin, "rotation[z]", time, sign * motion.angle[:, i] / rotors.TURN_SLOWDOWN))
        for blade, _ in BLADES:
            # The leading edge is on +y of a blade that turns counter-clockwise, on -y of the other.
            pitch = sign * rotors.PITCH_EXAGGERATION * motion.blade_pitch[:, i]
            tracks.append(make_track(f"{spin}/{blade}/feather", "rotation[x]", time, pitch))
    return tracks


def track_arrows(craft: str, time: np.ndarray, motion: RotorMotion, vehicle: Vehicle) -> list[KeyframeTrack]:
    """Tracks that stretch the thrust arrows, one colour for each sign."""
    tracks = []
    for node, length in measure_arrows(motion.thrust, vehicle):
        arrow = f"{craft}/{node}"
        tracks.append(make_track(arrow, "visible", time, length > rotors.SHORTEST_ARROW))
        tracks.append(make_track(f"{arrow}/shaft", "scale[z]", time, length))
        tracks.append(make_track(f"{arrow}/head", "position[z]", time, length))
    return tracks


def track_setpoint(setpoint: SetpointChanges, end: float) -> list[KeyframeTrack]:
    """Tracks of the ghost, which is hidden before the first setpoint and holds the last one until the `end` [s]."""
    node, half = f"{ROOT}/target", -0.5 * setpoint.theta  # θ turns about -y
    zero = np.zeros_like(half)
    rows = np.append(np.arange(len(half)), len(half) - 1)
    time = np.append(setpoint.time, end)
    position = np.stack([setpoint.x, zero, setpoint.z], -1)[rows]
    quaternion = np.stack([zero, np.sin(half), zero, np.cos(half)], -1)[rows]
    moves = {"position": position, "quaternion": quaternion}
    tracks = [make_track(node, name, time, values, hold=True) for name, values in moves.items()]
    if setpoint.time[0] > 0.0:
        shown = np.array([False, True, True])
        tracks.append(make_track(node, "visible", np.array([0.0, setpoint.time[0], end]), shown))
    return tracks
