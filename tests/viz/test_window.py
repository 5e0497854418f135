"""`vpptwin play --viewer mujoco`: what its window is given; the window itself needs a screen."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from tests.bad_files import DEMO
from vpptwin.cli.main import main
from vpptwin.estimation.replay import Prediction
from vpptwin.logs.flight import Flight
from vpptwin.twin.spec import load_twin
from vpptwin.viz.pages import window
from vpptwin.viz.pages.window import DOWN, GHOST, LEFT, RIGHT, SPACE, UP, PlaybackClock, add_sky, place, play_window
from vpptwin.viz.scene.show import prepare_show


def test_time_goes_round() -> None:
    """At its pace, in a loop, not while paused; keys steer it."""
    clock = PlaybackClock(4.0)
    clock.advance(3.0)
    clock.advance(1.5)
    assert clock.time == pytest.approx(0.5)
    clock.press(SPACE)
    clock.advance(1.0)
    assert clock.time == pytest.approx(0.5)
    clock.press(SPACE)
    clock.press(UP)
    clock.advance(0.5)
    assert clock.time == pytest.approx(1.5)
    clock.press(LEFT)
    clock.press(LEFT)
    clock.press(RIGHT)
    clock.advance(1.0)
    assert clock.time == pytest.approx(1.48)
    for _ in range(9):
        clock.press(DOWN)
    assert clock.pace == 1.0 / 16.0
    clock.press(ord("Q"))
    assert not clock.running


def test_the_twin_is_a_ghost_over_the_log(flight: Flight, prediction: Prediction) -> None:
    """The log where it was, the twin's moving parts 10 cm to its right, in its colour; none where it is unknown."""
    show = prepare_show(flight, prediction, load_twin())
    data, ghost = mujoco.MjData(show.model), mujoco.MjData(show.model)
    scene = mujoco.MjvScene(show.model, 1000)
    place(show, 1.0, data, ghost, scene)
    named = {show.model.geom(geom.objid).name for geom in scene.geoms[: scene.ngeom]}
    assert data.time == pytest.approx(1.0)
    np.testing.assert_allclose(data.qpos, show.log.qpos[50])
    assert named == {"carriage", "guide", "slider", "axle", "arm", "hub", "disc_1", "disc_2"}
    for geom in scene.geoms[: scene.ngeom]:
        np.testing.assert_allclose(geom.pos - data.geom_xpos[geom.objid], [0.1, 0.0, 0.0], atol=1e-5)
        np.testing.assert_allclose(geom.rgba, GHOST, atol=1e-6)
    place(show, 0.2, data, ghost, scene)
    assert scene.ngeom == 0
    np.testing.assert_allclose(data.qpos, show.log.qpos[10])


def test_a_sky_behind_a_dark_craft() -> None:
    """Added where the MJCF has none; the rig is the same."""
    spec = load_twin()
    model = add_sky(spec).model
    assert list(model.tex_type).count(mujoco.mjtTexture.mjTEXTURE_SKYBOX) == 1
    np.testing.assert_array_equal(model.geom_pos, spec.model.geom_pos)
    np.testing.assert_array_equal(model.body_inertia, spec.model.body_inertia)


class Handle:
    """Stands for MuJoCo's: a window that is closed after three pictures.

    Attributes:
        closed: whether it is.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.data, self.user_scn, self.cam = data, mujoco.MjvScene(model, 1000), mujoco.MjvCamera()
        self.lock, self.seen, self.closed = nullcontext, [data.qpos.copy()], False

    def is_running(self) -> bool:
        """Until three pictures were taken."""
        return len(self.seen) < 4

    def sync(self) -> None:
        """Take a picture."""
        self.seen.append(self.data.qpos.copy())

    def close(self) -> None:
        """Close it."""
        self.closed = True


def test_it_plays_until_the_window_is_closed(
    flight: Flight, prediction: Prediction, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The flight goes on from picture to picture, seen from the side; then the viewer ends."""
    opened: list[Handle] = []

    def open_viewer(model: mujoco.MjModel, data: mujoco.MjData, clock: PlaybackClock) -> Handle:
        opened.append(Handle(model, data))
        return opened[0]

    monkeypatch.setattr(window, "open_viewer", open_viewer)
    play_window(flight, prediction, load_twin())
    (handle,) = opened
    assert handle.closed
    assert handle.seen[3][0] > handle.seen[1][0]  # it moves along x at 0.2 m/s
    assert handle.cam.distance > 1.0
    assert "close it or Ctrl-C" in capsys.readouterr().out


def test_without_a_screen(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """One line before any work: no screen, one that no window opens on, a viewer that does not start."""
    command = ["play", str(tmp_path / "none.mcap"), "--viewer", "mujoco"]
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    assert main(command) == 2
    assert "neither DISPLAY nor WAYLAND_DISPLAY is set; expected a screen" in capsys.readouterr().err
    monkeypatch.setenv("DISPLAY", ":4711")
    monkeypatch.setitem(__import__("sys").modules, "glfw", SimpleNamespace(init=lambda: False))
    assert main(command) == 2
    said = capsys.readouterr().err
    assert "no window opens on this screen" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("other", [["--html", "a.html"], ["--video", "a.gif"], ["--live", "flip"]])
def test_one_way_of_looking(other: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """The viewer and a file, or a live flight, are one too many."""
    assert main(["play", str(DEMO), "--viewer", "mujoco", *other]) == 2
    assert f"--viewer mujoco and {other[0]} {other[1]}; expected one of them" in capsys.readouterr().err
