"""The rig from the side as pixels, without OpenGL: everything that matters moves in one plane.

For animations in a README, for TorchRL's `rlrender`, and where no browser is at hand.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from vpptwin.viz.plots.palette import GREY, TWIN, to_rgb
from vpptwin.viz.scene.camera import CameraView
from vpptwin.viz.scene.geoms import GRID_STEP, find_hull, list_drawn, outline_geom
from vpptwin.viz.scene.show import BARE, Overlay

FINER = 2
"""Frames are drawn so many times larger and scaled down: Pillow's polygons have no smooth edges."""
BACKDROP = "#F1F4F7"
TEXT = "#1A1C1F"
THINNEST = 0.005
"""Of a blade seen from its edge, m."""
Colour = tuple[int, int, int, int]


class Painter:
    """Draws one rig.

    Args:
        model: the rig; its kinematics are in `data`.
        view: what part of the x-z plane is seen.
        size: of a frame, width and height in pixels.
    """

    def __init__(self, model: mujoco.MjModel, view: CameraView, size: tuple[int, int] = (640, 400)) -> None:
        self.model, self.size = model, size
        self.data = mujoco.MjData(model)
        self._scale = FINER * 0.5 * size[1] / view.half_height  # pixels per metre
        self._centre = view.centre[[0, 2]]
        self._middle = FINER * 0.5 * np.array(size)
        self.paints = list_drawn(model)
        self._outlines = {g: outline_geom(model, g) for g in self.paints}
        self._moving = {g: model.body_weldid[model.geom_bodyid[g]] != 0 for g in self.paints}
        self._still = self._draw_surroundings()

    def draw(
        self, qpos: np.ndarray, *, twin: np.ndarray | None = None, trail: np.ndarray | None = None,
        text: Sequence[str] = (), overlay: Overlay = BARE, time: float = 0.0,
    ) -> np.ndarray:  # fmt: skip
        """One frame, (height, width, 3) uint8.

        Args:
            qpos: joint positions of the rig, (nq,) m, rad.
            twin: joint positions of a prediction, (nq,), drawn translucent.
            trail: where the craft was, (k, 2) m.
            text: lines at the top left.
            overlay: what the robot adds.
            time: of that [s].
        """
        picture = self._still.copy()
        pen = ImageDraw.Draw(picture, "RGBA")
        if trail is not None and len(trail) > 1:
            pen.line(self._place(trail), fill=to_colour("#A3A9B1"), width=round(0.012 * self._scale), joint="curve")
        overlay.paint_target(self, pen, time)
        if twin is not None:
            self._draw_bodies(pen, twin, to_colour(TWIN, 0.45))
        self._draw_bodies(pen, qpos)
        overlay.paint_parts(self, pen, time)
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
        mujoco.mj_kinematics(self.model, self.data)
        self.draw_geoms(pen, (g for g, moves in self._moving.items() if not moves))
        return picture

    def _draw_bodies(self, pen: ImageDraw.ImageDraw, qpos: np.ndarray, colour: Colour | None = None) -> None:
        """All that moves, in its own colours or in one."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        self.draw_geoms(pen, (g for g, moves in self._moving.items() if moves), colour)

    def draw_geoms(self, pen: ImageDraw.ImageDraw, geoms: Iterable[int], colour: Colour | None = None) -> None:
        """Draw geoms where the kinematics have them, the farthest first, in their own colours or in one."""
        for geom in sorted(geoms, key=lambda g: -self.data.geom_xpos[g][1]):
            places = self.data.geom_xpos[geom] + self._outlines[geom] @ self.data.geom_xmat[geom].reshape(3, 3).T
            paint = self.paints[geom]
            fill = to_colour(paint.colour, paint.opacity)
            if colour is not None:
                fill = (*colour[:3], round(colour[3] * paint.opacity))
            self.fill(pen, places[:, [0, 2]], fill)

    def fill(self, pen: ImageDraw.ImageDraw, places: np.ndarray, colour: Colour) -> None:
        """Fill the convex hull of places (k, 2) [m], a line where that has no width."""
        hull, is_wide = find_hull(places)
        if is_wide:
            pen.polygon(self._place(hull), fill=colour)
        else:
            pen.line(self._place(hull), fill=colour, width=round(THINNEST * self._scale))


def to_colour(name: str, opacity: float = 1.0) -> Colour:
    """A "#RRGGBB" colour and an opacity as Pillow takes them."""
    red, green, blue = (round(255 * c) for c in to_rgb(name))
    return red, green, blue, round(255 * opacity)
