"""The rig from the side as pixels, without OpenGL: everything that matters moves in one plane.

For animations in a README, for TorchRL's `rlrender`, and where no browser is at hand.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import ConvexHull, QhullError

from vpptwin.actuators.blade import max_thrust
from vpptwin.robots.planar_drone.vehicle import Vehicle
from vpptwin.viz.plots.palette import BLADE, GREY, NEGATIVE_THRUST, POSITIVE_THRUST, TARGET, TOP_MARK, TWIN, to_rgb
from vpptwin.viz.scene import rotors
from vpptwin.viz.scene.camera import View
from vpptwin.viz.scene.motion import Rotors
from vpptwin.viz.scene.scene import FIRST_HIDDEN_GROUP, GRID_STEP, find_craft
from vpptwin.viz.scene.shapes import PLANE_HALF_SIZE, PLANE_THICKNESS, read_paint

FINER = 2
"""Frames are drawn so many times larger and scaled down: Pillow's polygons have no smooth edges."""
ROUND = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
BACKDROP = "#F1F4F7"
TEXT = "#1A1C1F"
THINNEST = 0.005
"""Of a blade seen from its edge, m."""
Colour = tuple[int, int, int, int]


class Painter:
    """Draws one rig.

    Args:
        model: the rig.
        rotorcraft: numbers of the rotors that are drawn; None where there are none.
        view: what part of the x-z plane is seen.
        size: of a frame, width and height in pixels.
    """

    def __init__(
        self, model: mujoco.MjModel, rotorcraft: Vehicle | None, view: View, size: tuple[int, int] = (640, 400)
    ) -> None:
        self.model, self.rotorcraft, self.size = model, rotorcraft, size
        self._data = mujoco.MjData(model)
        self._scale = FINER * 0.5 * size[1] / view.half_height  # pixels per metre
        self._centre = view.centre[[0, 2]]
        self._middle = FINER * 0.5 * np.array(size)
        drawn = [g for g in range(model.ngeom) if model.geom_group[g] < FIRST_HIDDEN_GROUP]
        self._paints = {g: paint for g in drawn if (paint := read_paint(model, g)).opacity > 0.0}
        self._outlines = {g: outline_geom(model, g) for g in self._paints}
        self._moving = {g: model.body_weldid[model.geom_bodyid[g]] != 0 for g in self._paints}
        self._still = self._draw_surroundings()

    def draw(
        self, qpos: np.ndarray, *, spin: Rotors | None = None, twin: np.ndarray | None = None,
        target: np.ndarray | None = None, trail: np.ndarray | None = None, text: Sequence[str] = (),
    ) -> np.ndarray:  # fmt: skip
        """One frame, (height, width, 3) uint8.

        Args:
            qpos: joint positions of the rig, (nq,) m, rad.
            spin: its rotors.
            twin: joint positions of a prediction, (nq,), drawn translucent.
            target: x, z, θ of a setpoint, (3,) m, m, rad.
            trail: where the craft was, (k, 2) m.
            text: lines at the top left.
        """
        picture = self._still.copy()
        pen = ImageDraw.Draw(picture, "RGBA")
        if trail is not None and len(trail) > 1:
            pen.line(self._place(trail), fill=to_colour("#A3A9B1"), width=round(0.012 * self._scale), joint="curve")
        if target is not None:
            self._draw_ghost(pen, target)
        if twin is not None:
            self._draw_bodies(pen, twin, to_colour(TWIN, 0.45))
        self._draw_bodies(pen, qpos)
        if spin is not None and self.rotorcraft is not None:
            self._draw_rotors(pen, self.rotorcraft, spin)
        font = ImageFont.load_default(FINER * 15)
        for row, line in enumerate(text):
            pen.text((FINER * 10, FINER * (8 + 19 * row)), line, fill=TEXT, font=font)
        frame: np.ndarray = np.asarray(picture.resize(self.size, Image.Resampling.BOX))
        return frame

    def _place(self, points: np.ndarray) -> list[tuple[float, float]]:
        """Pixels of places (k, 2) [m]."""
        at = self._middle + (points - self._centre) * self._scale * [1.0, -1.0]
        return [(float(x), float(y)) for x, y in at]

    def _draw_surroundings(self) -> Image.Image:
        width, height = (FINER * s for s in self.size)
        picture = Image.new("RGB", (width, height), BACKDROP)
        pen = ImageDraw.Draw(picture, "RGBA")
        reach = self._middle / self._scale
        for axis in (0, 1):
            low, high = self._centre[axis] - reach[axis], self._centre[axis] + reach[axis]
            for place in np.arange(np.ceil(low / GRID_STEP), np.floor(high / GRID_STEP) + 1) * GRID_STEP:
                ends = np.array([self._centre - 2.0 * reach, self._centre + 2.0 * reach])
                ends[:, axis] = place
                pen.line(self._place(ends), fill=to_colour(GREY, 0.3), width=FINER)
        mujoco.mj_kinematics(self.model, self._data)
        self._draw_geoms(pen, [g for g, moves in self._moving.items() if not moves], None)
        return picture

    def _draw_bodies(self, pen: ImageDraw.ImageDraw, qpos: np.ndarray, colour: Colour | None = None) -> None:
        """All that moves, in its own colours or in one."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        self._draw_geoms(pen, [g for g, moves in self._moving.items() if moves], colour)

    def _draw_ghost(self, pen: ImageDraw.ImageDraw, target: np.ndarray) -> None:
        """The craft at a setpoint."""
        craft = find_craft(self.model)
        self._data.qpos[:] = self.model.qpos0
        for joint, value in zip(("rail_x", "rail_z", "pitch"), target):
            index = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, joint)
            self._data.qpos[self.model.jnt_qposadr[index]] = value
        mujoco.mj_kinematics(self.model, self._data)
        geoms = [g for g in self._paints if self.model.geom_bodyid[g] == craft]
        self._draw_geoms(pen, geoms, to_colour(TARGET, 0.45))

    def _draw_geoms(self, pen: ImageDraw.ImageDraw, geoms: Sequence[int], colour: Colour | None) -> None:
        """Outlines of geoms where the kinematics have them, the farthest first."""
        for geom in sorted(geoms, key=lambda g: -self._data.geom_xpos[g][1]):
            places = self._data.geom_xpos[geom] + self._outlines[geom] @ self._data.geom_xmat[geom].reshape(3, 3).T
            paint = self._paints[geom]
            fill = to_colour(paint.colour, paint.opacity)
            if colour is not None:
                fill = (*colour[:3], round(colour[3] * paint.opacity))
            self._fill(pen, places[:, [0, 2]], fill)

    def _fill(self, pen: ImageDraw.ImageDraw, places: np.ndarray, colour: Colour) -> None:
        """The convex hull of places (k, 2) [m], a line where that has no width."""
        try:
            pen.polygon(self._place(places[ConvexHull(places).vertices]), fill=colour)
        except QhullError:
            ends = places[[np.lexsort(places.T)[0], np.lexsort(places.T)[-1]]]
            pen.line(self._place(ends), fill=colour, width=round(THINNEST * self._scale))

    def _draw_rotors(self, pen: ImageDraw.ImageDraw, vehicle: Vehicle, spin: Rotors) -> None:
        """Blades, mark on top and thrust arrows of the craft that was drawn last."""
        craft = find_craft(self.model)
        origin, turn = self._data.xpos[craft], self._data.xmat[craft].reshape(3, 3)

        def place(points: np.ndarray) -> np.ndarray:
            seen: np.ndarray = (origin + points @ turn.T)[:, [0, 2]]
            return seen

        mark = np.stack([0.03 * np.cos(ROUND), 0.0 * ROUND, 0.018 + 0.014 * np.sin(ROUND)], -1)
        self._fill(pen, place(mark), to_colour(TOP_MARK))
        for i, sign in enumerate(rotors.TURN_SIGNS):
            hub, radius = rotors.find_rotor(self.model, vehicle, i + 1)
            mast = hub + rotors.ROOT_RADIUS * np.array([[-1, 0, 0], [1, 0, 0], [1, 0, 0], [-1, 0, 0]])
            mast[:2, 2] -= hub[2]
            self._fill(pen, place(mast), to_colour(BLADE))
            for side in (1.0, -1.0):
                about = sign * spin.angle[i] / rotors.TURN_SLOWDOWN
                along = side * np.array([np.cos(about), np.sin(about), 0.0])
                across = side * np.array([-np.sin(about), np.cos(about), 0.0])
                pitch = sign * rotors.PITCH_EXAGGERATION * spin.blade_pitch[i]
                chord = 0.5 * rotors.CHORD * (across * np.cos(pitch) + np.array([0.0, 0.0, np.sin(pitch)]))
                thick = np.array([0.0, 0.0, 0.5 * THINNEST])
                edges = [edge + skin for edge in (chord, -chord) for skin in (thick, -thick)]
                corners = np.array([hub + r * along + edge for r in (rotors.ROOT_RADIUS, radius) for edge in edges])
                self._fill(pen, place(corners), to_colour(BLADE))
            length = spin.thrust[i] / max_thrust(vehicle.rotor) * rotors.ARROW_LENGTH
            if abs(length) > 0.01:
                colour = to_colour(POSITIVE_THRUST if length > 0.0 else NEGATIVE_THRUST)
                tip = length + np.sign(length) * rotors.HEAD_HEIGHT
                shaft = hub + np.array([[s * rotors.SHAFT_RADIUS, 0.0, z] for s in (-1, 1) for z in (0.0, length)])
                barbs = [[s * rotors.HEAD_RADIUS, 0.0, length] for s in (-1, 1)]
                head = hub + np.array([*barbs, [0.0, 0.0, tip]])
                self._fill(pen, place(shaft), colour)
                self._fill(pen, place(head), colour)


def to_colour(name: str, opacity: float = 1.0) -> Colour:
    """A "#RRGGBB" colour and an opacity as Pillow takes them."""
    red, green, blue = (round(255 * c) for c in to_rgb(name))
    return red, green, blue, round(255 * opacity)


def outline_geom(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Points (k, 3) [m] in a geom's own frame whose hull is the geom, nearly."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        width, depth = (s if s > 0.0 else PLANE_HALF_SIZE for s in size[:2])
        return signs * [width, depth, 0.5 * PLANE_THICKNESS] - [0.0, 0.0, 0.5 * PLANE_THICKNESS]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = model.mesh_vertadr[mesh]
        return np.asarray(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], dtype=float)
    circle = np.stack([np.cos(ROUND), np.sin(ROUND), 0.0 * ROUND], -1)
    ball = np.concatenate([np.roll(circle, k, axis=1) for k in range(3)])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return size[0] * ball
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return size * ball
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.concatenate([size[0] * ball + [0.0, 0.0, s * size[1]] for s in (-1, 1)])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.concatenate([size[0] * circle + [0.0, 0.0, s * size[1]] for s in (-1, 1)])
    return signs * size
