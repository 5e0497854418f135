"""Where the viewer looks from: x to the right, z up, a little above and beside the plane of flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FIELD_OF_VIEW = 30.0  # degrees, vertical; narrow, so that perspective distorts little
AZIMUTH, ELEVATION = np.radians(-8.0), np.radians(10.0)  # of the camera, seen from what it looks at
MARGIN = 0.55  # m around what moves: the arm, a rotor and an arrow
SMALLEST_HALF_HEIGHT = 0.85  # m
SCREEN_ASPECT = 1.5  # width over height that the view is made for
BACKDROP_TOP, BACKDROP_BOTTOM = [0.96, 0.97, 0.98], [0.80, 0.84, 0.88]


@dataclass(frozen=True)
class CameraView:
    """What the camera looks at: centre (3,) [m] in the world and the half height [m] that it sees there."""

    centre: np.ndarray
    half_height: float

    @property
    def distance(self) -> float:
        """From the camera to the centre [m]."""
        # h = d tan(fov/2)
        return self.half_height / float(np.tan(np.radians(FIELD_OF_VIEW) / 2.0))


def frame_view(
    places: np.ndarray, margin: float = MARGIN, smallest: float = SMALLEST_HALF_HEIGHT, aspect: float = SCREEN_ASPECT
) -> CameraView:
    """The view that holds all places (n, 3) [m] with a margin [m] and at least `smallest` [m] above its centre."""
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    half, centre = 0.5 * (high - low), 0.5 * (low + high)
    return CameraView(np.array([centre[0], 0.0, centre[2]]), max(half[2], half[0] / aspect, smallest))
