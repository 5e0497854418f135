"""A flight in a window of MuJoCo's own viewer: the log, and the twin as a ghost over it."""

from __future__ import annotations

import time
import warnings
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from vpptwin.system.errors import InputError
from vpptwin.system.signals import until_interrupted
from vpptwin.twin.robot.model import specify_model
from vpptwin.twin.robot.urdf import read_urdf
from vpptwin.twin.spec import TwinSpec
from vpptwin.viz.pages.browse import has_screen
from vpptwin.viz.pages.serve import keep_going
from vpptwin.viz.plots.palette import TWIN, to_rgb
from vpptwin.viz.scene.camera import AZIMUTH, BACKDROP_BOTTOM, BACKDROP_TOP, ELEVATION, FIELD_OF_VIEW
from vpptwin.viz.scene.show import Show, prepare_show, view_show

if TYPE_CHECKING:
    from vpptwin.estimation.replay import Prediction
    from vpptwin.logs.flight import Flight

GHOST = (*to_rgb(TWIN), 0.5)
PERIOD = 1.0 / 60.0
"""Time between pictures, s."""
SPACE, RIGHT, LEFT, DOWN, UP = 32, 262, 263, 264, 265  # GLFW's numbers of keys
STEP = 0.02
"""Time that an arrow key moves on, s."""
KEYS = "space: pause, left and right: a frame, up and down: faster and slower"


@dataclass
class PlaybackClock:
    """Time of the flight [s], in a loop over its duration; keys steer it."""

    duration: float  # of the flight [s]
    time: float = 0.0  # that is shown
    pace: float = 1.0  # seconds of flight a second
    running: bool = True  # not paused

    def advance(self, passed: float) -> None:
        """Let seconds pass."""
        if self.running:
            self.time = (self.time + self.pace * passed) % self.duration

    def press(self, key: int) -> None:
        """Do what a key asks for."""
        if key == SPACE:
            self.running = not self.running
        elif key in (LEFT, RIGHT):
            self.running = False
            self.time = (self.time + (STEP if key == RIGHT else -STEP)) % self.duration
        elif key in (UP, DOWN):
            self.pace = float(np.clip(self.pace * (2.0 if key == UP else 0.5), 1.0 / 16.0, 4.0))


def check_screen() -> None:
    """Refuse what has no screen, or none that a window opens on."""
    other = "leave it out for a page in a browser, or write one with --html"
    if not has_screen():
        raise InputError("--viewer mujoco, and neither DISPLAY nor WAYLAND_DISPLAY is set", "a screen", other)
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # which it reports as warnings
        works = glfw.init()
    if not works:
        raise InputError("--viewer mujoco: no window opens on this screen", "one with OpenGL", other)


def play_window(flight: Flight, prediction: Prediction | None, spec: TwinSpec) -> None:
    """Play a flight in a loop until the window is closed or Ctrl-C.

    Args:
        flight: the log.
        prediction: the twin's answer to the log's commands, drawn translucent; None for the log alone.
        spec: the twin whose rig is drawn.

    Raises:
        InputError: if the log has nothing to draw, or the viewer does not start.
    """
    show = prepare_show(flight, prediction, add_sky(spec))
    data, ghost = mujoco.MjData(show.model), mujoco.MjData(show.model)
    clock = PlaybackClock(float(show.time[-1]))
    handle = open_viewer(show.model, data, clock)
    with until_interrupted(), closing(handle):
        with handle.lock():
            aim(handle.cam, show)
        print(f"{flight.name} in MuJoCo's viewer. {KEYS}; close it or Ctrl-C here to end.", flush=True)
        before = time.perf_counter()
        for _ in keep_going():
            if not handle.is_running():
                break
            now = time.perf_counter()
            clock.advance(now - before)
            before = now
            with handle.lock():
                place(show, clock.time, data, ghost, handle.user_scn)
            handle.sync()
            time.sleep(max(PERIOD - (time.perf_counter() - now), 0.0))


def open_viewer(model: mujoco.MjModel, data: mujoco.MjData, clock: PlaybackClock) -> Any:  # noqa: ANN401
    """MuJoCo's viewer, in a thread of its own."""
    try:
        from mujoco import viewer

        return viewer.launch_passive(
            model, data, key_callback=clock.press, show_left_ui=False, show_right_ui=False
        )  # fmt: skip
    except (ImportError, RuntimeError) as error:  # without GLFW; on a Mac without mjpython
        raise InputError(f"--viewer mujoco: {error}", "a viewer that starts", "leave it out") from error


def add_sky(spec: TwinSpec) -> TwinSpec:
    """The same twin before a pale sky, if its MJCF has none: a dark craft is not seen before MuJoCo's black."""
    scene = specify_model(spec.model_file, read_urdf(spec.model_file), spec.robot.adapt)
    if any(texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for texture in scene.textures):
        return spec
    scene.add_texture(
        name="vpptwin sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=BACKDROP_TOP, rgb2=BACKDROP_BOTTOM, width=64, height=384,
    )  # fmt: skip
    model = scene.compile()
    model.vis.global_.fovy = FIELD_OF_VIEW
    model.vis.headlight.ambient[:] = 0.4
    return spec.with_robot(model=model)


def aim(camera: mujoco.MjvCamera, show: Show) -> None:
    """Look at the flight from where the page does."""
    view = view_show(show)
    camera.lookat[:] = view.centre
    camera.azimuth, camera.elevation = 90.0 + np.degrees(AZIMUTH), -np.degrees(ELEVATION)
    camera.distance = view.distance


def place(show: Show, at: float, data: mujoco.MjData, ghost: mujoco.MjData, scene: mujoco.MjvScene) -> None:
    """Put the rig where the log has it at a time [s], and in the scene the twin over it, if it is known there."""
    row = min(int(np.searchsorted(show.time, at)), len(show.time) - 1)
    data.time, data.qpos[:] = at + show.frames[0], show.log.qpos[row]
    mujoco.mj_forward(show.model, data)
    scene.ngeom = 0
    if show.twin is None or not show.twin.shown[row]:
        return
    ghost.qpos[:] = show.twin.qpos[row]
    mujoco.mj_forward(show.model, ghost)
    option, moving = mujoco.MjvOption(), mujoco.mjtCatBit.mjCAT_DYNAMIC
    option.sitegroup[:] = 0
    mujoco.mjv_addGeoms(show.model, ghost, option, mujoco.MjvPerturb(), moving, scene)
    for geom in scene.geoms[: scene.ngeom]:
        geom.rgba[:] = GHOST
        geom.matid = -1  # whose texture would cover the colour
