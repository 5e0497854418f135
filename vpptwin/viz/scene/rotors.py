"""Rotors and thrust arrows on the craft, and the tracks that turn, pitch and stretch them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from vpptwin.actuators.blade import max_thrust
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.viz.plots.palette import BLADE, NEGATIVE_THRUST, POSITIVE_THRUST, TOP_MARK
from vpptwin.viz.scene.motion import Rotors
from vpptwin.viz.scene.shapes import Paint, make_cone, make_cylinder
from vpptwin.viz.scene.tracks import Track, make_track

if TYPE_CHECKING:
    from meshcat import Visualizer

TURN_SLOWDOWN = 20.0  # rotors are drawn this much slower, so that 75 turns a second do not alias at 50 frames a second
PITCH_EXAGGERATION = 2.5  # blade pitch is drawn this much larger: its 12 degrees are a few pixels
ARROW_LENGTH = 0.45  # m, arrow of the rotor's largest thrust
ROOT_RADIUS, CHORD, THICKNESS = 0.012, 0.030, 0.003  # m, of a blade
HEAD_RADIUS, HEAD_HEIGHT, SHAFT_RADIUS = 0.022, 0.05, 0.008  # m, of an arrow
SHORTEST_ARROW = 1e-3  # m; three.js cannot invert a scale of zero
TURN_SIGNS = (1.0, -1.0)  # the rotors turn against each other, so that their drag torques cancel


def draw_rotors(craft: Visualizer, model: mujoco.MjModel, vehicle: Vehicle, paint: Paint | None = None) -> None:
    """Masts, blades and a mark on top of the craft, below its node; paint overrides all colours (the twin)."""
    import meshcat.geometry as mg  # as in `vpptwin.viz.scene.shapes`
    import meshcat.transformations as tf

    mark = paint or Paint(TOP_MARK)
    craft["top"].set_object(mg.Ellipsoid([0.03, 0.02, 0.014]), mark.material())
    craft["top"].set_transform(tf.translation_matrix([0.0, 0.0, 0.018]))
    for number in (1, 2):
        hub, radius = find_rotor(model, vehicle, number)
        rotor = craft[f"rotor_{number}"]
        rotor.set_transform(tf.translation_matrix(hub))
        rotor["mast"].set_object(make_cylinder(ROOT_RADIUS, -hub[2], 0.006), (paint or Paint(BLADE)).material())
        span = radius - ROOT_RADIUS
        for blade in ("blade_a", "blade_b"):
            root = rotor["spin"][blade]
            root.set_transform(tf.rotation_matrix(0.0 if blade == "blade_a" else np.pi, [0, 0, 1]))
            root["feather"]["skin"].set_object(mg.Box([span, CHORD, THICKNESS]), (paint or Paint(BLADE)).material())
            root["feather"]["skin"].set_transform(tf.translation_matrix([ROOT_RADIUS + 0.5 * span, 0.0, 0.0]))


def find_rotor(model: mujoco.MjModel, vehicle: Vehicle, number: int) -> tuple[np.ndarray, float]:
    """Hub position (3,) in the craft's frame [m] and radius [m] of rotor 1 or 2, the latter from the MJCF's disc."""
    side = -1.0 if number == 1 else 1.0
    disc = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"disc_{number}")
    height, radius = (model.geom_pos[disc, 2], model.geom_size[disc, 0]) if disc >= 0 else (0.02, 0.13)
    return np.array([side * vehicle.airframe.half_length, 0.0, height]), float(radius)


def draw_arrows(craft: Visualizer) -> None:
    """One arrow per rotor and sign of thrust, of unit length; needs draw_rotors for its place."""
    import meshcat.transformations as tf

    for number in (1, 2):
        for sign, colour in (("positive", POSITIVE_THRUST), ("negative", NEGATIVE_THRUST)):
            arrow = craft[f"rotor_{number}"][f"{sign}_thrust"]
            arrow.set_transform(tf.rotation_matrix(0.0 if sign == "positive" else np.pi, [1, 0, 0]))
            arrow["shaft"]["solid"].set_object(make_cylinder(SHAFT_RADIUS, 0.0, 1.0), Paint(colour).material())
            arrow["head"]["solid"].set_object(make_cone(HEAD_RADIUS, HEAD_HEIGHT), Paint(colour).material())


def track_rotors(craft: str, time: np.ndarray, rotors: Rotors) -> list[Track]:
    """Tracks that turn the rotors and pitch their blades; time (T,) [s] from the animation's start."""
    tracks = []
    for i, sign in enumerate(TURN_SIGNS):
        spin = f"{craft}/rotor_{i + 1}/spin"
        tracks.append(make_track(spin, "rotation[z]", time, sign * rotors.angle[:, i] / TURN_SLOWDOWN))
        for blade in ("blade_a", "blade_b"):
            # The leading edge is on +y of a blade that turns counter-clockwise, on -y of the other.
            pitch = sign * PITCH_EXAGGERATION * rotors.blade_pitch[:, i]
            tracks.append(make_track(f"{spin}/{blade}/feather", "rotation[x]", time, pitch))
    return tracks


def track_arrows(craft: str, time: np.ndarray, rotors: Rotors, vehicle: Vehicle) -> list[Track]:
    """Tracks that stretch the thrust arrows, one colour for each sign."""
    full = max_thrust(vehicle.rotor)
    tracks = []
    for i in range(2):
        for sign, factor in (("positive", 1.0), ("negative", -1.0)):
            arrow = f"{craft}/rotor_{i + 1}/{sign}_thrust"
            length = np.maximum(factor * rotors.thrust[:, i] / full * ARROW_LENGTH, SHORTEST_ARROW)
            tracks.append(make_track(arrow, "visible", time, length > SHORTEST_ARROW))
            tracks.append(make_track(f"{arrow}/shaft", "scale[z]", time, length))
            tracks.append(make_track(f"{arrow}/head", "position[z]", time, length))
    return tracks
