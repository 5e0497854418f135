"""Frames without OpenGL: where things are drawn, in which colours; animations; TorchRL's rlrender."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from PIL import Image

from tests.train.conftest import tiny_env
from vpptwin.cli.main import main
from vpptwin.estimation.replay import Prediction
from vpptwin.logs.flight import Flight, Stream
from vpptwin.robots.planar_drone.display.overlay import CraftOverlay
from vpptwin.robots.planar_drone.display.rotors import RotorMotion, SetpointChanges
from vpptwin.robots.planar_drone.vehicle import load_vehicle
from vpptwin.system.errors import InputError
from vpptwin.system.files import is_own
from vpptwin.train.stored import find_checkpoint
from vpptwin.twin.spec import load_twin
from vpptwin.viz.plots.palette import NEGATIVE_THRUST, POSITIVE_THRUST, TARGET, TOP_MARK, TWIN, to_rgb
from vpptwin.viz.scene.camera import CameraView
from vpptwin.viz.scene.frames import BACKDROP, Painter
from vpptwin.viz.scene.video import encode_film, write_video

FLIP = Path(__file__).parents[2] / "demo/flights/flip.mcap"
SIZE, VIEW = (480, 300), CameraView(np.array([0.0, 0.0, 1.2]), 0.75)  # 200 pixels a metre
STILL = RotorMotion(*np.zeros((3, 1, 2)))
SHAPES = """
<mujoco><worldbody>
  <body name="slider"><joint name="slide" type="slide" axis="1 0 0"/>
    <geom name="box" type="box" size="0.1 0.05 0.05" pos="0 0 1.2" rgba="1 0 0 1"/></body>
  <geom name="ball" type="sphere" size="0.1" pos="-0.5 0 1.2" rgba="0 1 0 1"/>
  <geom name="stick" type="capsule" size="0.05" fromto="0.4 0 1 0.4 0 1.4" rgba="0 0 1 1"/>
  <geom name="plate" type="cylinder" size="0.2 0.01" pos="0 0 0.8" rgba="1 0 1 1"/>
  <geom name="egg" type="ellipsoid" size="0.1 0.1 0.2" pos="0.8 0 1.2" rgba="0 1 1 1"/>
  <geom name="ground" type="plane" size="0 0 0.1" pos="0 0 0.55" rgba="1 1 0 1"/>
  <geom name="unseen" type="box" size="0.2 0.2 0.2" pos="0 0 1.7" group="3" rgba="0 0 0 1"/>
</worldbody></mujoco>
"""


@pytest.fixture(scope="module")
def painter() -> Painter:
    """Our rig on a small canvas."""
    return Painter(load_twin().model, VIEW, SIZE)


def add(rotors: RotorMotion | None = None, target: np.ndarray | None = None) -> CraftOverlay:
    """What the drone adds to a single picture: its rotors, and a setpoint x, z, θ."""
    setpoint = None if target is None else SetpointChanges(np.zeros(1), *target[:, None])
    return CraftOverlay(load_vehicle(), np.zeros(1), rotors, setpoint=setpoint)


def find(frame: np.ndarray, colour: str, near: int = 12) -> np.ndarray:
    """Places (k, 2) [m] of the pixels of a colour."""
    wanted = np.array([255 * c for c in to_rgb(colour)])
    rows, columns = np.nonzero(np.abs(frame.astype(int) - wanted).max(axis=-1) <= near)
    return np.stack([(columns + 0.5 - 240) / 200.0, 1.2 - (rows + 0.5 - 150) / 200.0], -1)


def pose(x: float, z: float, theta: float) -> np.ndarray:
    """Joint positions of the rig."""
    return np.array([x, z, theta])


def test_every_shape_is_drawn_where_it_is() -> None:
    """Box, ball, capsule, disc, ellipsoid and plane in their colours, with their extent; what is hidden is not."""
    model = mujoco.MjModel.from_xml_string(SHAPES)
    frame = Painter(model, VIEW, SIZE).draw(np.array([0.1]))
    for colour, low, high in (
        ("#FF0000", (0.0, 1.15), (0.2, 1.25)),
        ("#00FF00", (-0.6, 1.1), (-0.4, 1.3)),
        ("#0000FF", (0.35, 0.95), (0.45, 1.45)),
        ("#FF00FF", (-0.2, 0.79), (0.2, 0.81)),
        ("#00FFFF", (0.7, 1.0), (0.9, 1.4)),
        ("#FFFF00", (-1.2, 0.54), (1.2, 0.55)),
    ):
        seen = find(frame, colour)
        np.testing.assert_allclose(seen.min(axis=0), low, atol=0.012, err_msg=colour)
        np.testing.assert_allclose(seen.max(axis=0), high, atol=0.012, err_msg=colour)
    assert not len(find(frame, "#000000"))


def test_the_craft_moves_and_turns(painter: Painter) -> None:
    """The mark on its top is above it upright, below it upside-down, to the left after a quarter turn to the left."""
    for theta, aside, above in ((0.0, 0.0, 0.018), (np.pi, 0.0, -0.018), (0.5 * np.pi, -0.018, 0.0)):
        mark = find(painter.draw(pose(0.3, 1.4, theta), overlay=add(STILL)), TOP_MARK)
        assert len(mark) > 15
        np.testing.assert_allclose(mark.mean(axis=0), [0.3 + aside, 1.4 + above], atol=0.012)


def test_thrust_has_a_colour_for_each_sign(painter: Painter) -> None:
    """Arrows point where the rotors push, from their hubs; none without thrust."""
    frame = painter.draw(pose(0.0, 1.2, 0.0), overlay=add(replace(STILL, thrust=np.array([[4.0, -4.0]]))))
    up, down = find(frame, POSITIVE_THRUST), find(frame, NEGATIVE_THRUST)
    assert up[:, 0].mean() == pytest.approx(-0.2, abs=0.01)
    assert up[:, 1].max() > 1.5
    assert down[:, 0].mean() == pytest.approx(0.2, abs=0.01)
    assert down[:, 1].min() < 0.9
    idle = painter.draw(pose(0.0, 1.2, 0.0), overlay=add(STILL))
    assert not len(find(idle, POSITIVE_THRUST))
    assert not len(find(idle, NEGATIVE_THRUST))


def test_blade_pitch_is_visible(painter: Painter) -> None:
    """A blade that points at the viewer is seen from its end: steep with pitch, flat without."""
    spin = replace(STILL, angle=np.full((1, 2), 0.5 * np.pi * 20.0))
    flat, steep = (
        painter.draw(pose(0.0, 1.2, 0.0), overlay=add(replace(spin, blade_pitch=np.full((1, 2), pitch)))).astype(int)
        for pitch in (0.0, 0.2)
    )
    assert np.count_nonzero(np.abs(flat - steep).max(axis=-1) > 60) > 10


def test_twin_target_trail_and_text(painter: Painter) -> None:
    """Each changes the picture where it lies: the twin's blue, the target's purple, the path, the clock."""
    here = pose(-0.3, 1.2, 0.0)
    plain = painter.draw(here)
    assert np.abs(plain[:8, 220:].astype(int) - [255 * c for c in to_rgb(BACKDROP)]).max() < 60
    for options, box in (
        ({"twin": pose(0.5, 1.2, 0.0)}, (0.3, 1.15, 0.7, 1.25)),
        ({"overlay": add(target=pose(0.5, 0.8, 0.0))}, (0.3, 0.75, 0.7, 0.85)),
        ({"trail": np.array([[0.2, 0.9], [0.6, 1.5]])}, (0.2, 0.9, 0.6, 1.5)),
        ({"text": ["1.50 s"]}, (-1.2, 1.75, -0.8, 1.95)),
    ):
        changed = np.abs(painter.draw(here, **options).astype(int) - plain).max(axis=-1) > 20  # type: ignore[arg-type]
        rows, columns = np.nonzero(changed)
        x, z = (columns + 0.5 - 240) / 200.0, 1.2 - (rows + 0.5 - 150) / 200.0
        assert np.count_nonzero((x > box[0]) & (x < box[2]) & (z > box[1]) & (z < box[3])) > 40
    blue = painter.draw(here, twin=pose(0.5, 1.2, 0.0))[150, 340].astype(int)
    wanted = np.array([255 * c for c in to_rgb(TWIN)])
    purple = painter.draw(here, overlay=add(target=pose(0.5, 1.2, 0.0)))[150, 340].astype(int)
    assert np.argmax(blue) == np.argmax(wanted) == 2
    assert np.argmin(purple) == np.argmin(to_rgb(TARGET)) == 1


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_an_animation_plays_in_real_time(flight: Flight, prediction: Prediction, tmp_path: Path, kind: str) -> None:
    """4 s are 100 frames of 40 ms that repeat; the craft moves; both thrusts keep their colours."""
    out = write_video(flight, prediction, tmp_path / f"flight.{kind}", spec=load_twin(), size=(320, 200))
    with Image.open(out) as video:
        assert video.n_frames == 100  # type: ignore[attr-defined]
        assert video.info["loop"] == 0
        frames = []
        for at in (30, 80):
            video.seek(at)
            video.load()
            assert video.info["duration"] == 40
            frames.append(np.asarray(video.convert("RGB")).astype(int))
    assert np.count_nonzero(np.abs(frames[0] - frames[1]).max(axis=-1) > 60) > 300
    for frame, colour in zip(frames, (POSITIVE_THRUST, NEGATIVE_THRUST)):
        wanted = np.array([255 * c for c in to_rgb(colour)])
        assert np.count_nonzero(np.abs(frame - wanted).max(axis=-1) < 40) > 20
    assert out.stat().st_size < 1e6


def test_a_film_plays_in_real_time(flight: Flight, prediction: Prediction, tmp_path: Path) -> None:
    """100 frames at 25 a second as MP4, in the colours of the animations; it is known as ours."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
    out = write_video(flight, prediction, tmp_path / "flight.mp4", spec=load_twin(), size=(320, 200))
    reader = ffmpeg.read_frames(str(out))
    told = next(reader)
    frames = [np.frombuffer(frame, np.uint8).reshape(200, 320, 3).astype(int) for frame in reader]
    assert (told["size"], told["fps"], told["codec"], len(frames)) == ((320, 200), 25.0, "h264", 100)
    assert told["pix_fmt"].startswith("yuv420p")
    assert np.count_nonzero(np.abs(frames[30] - frames[80]).max(axis=-1) > 60) > 300
    green = np.array([255 * c for c in to_rgb(POSITIVE_THRUST)])
    assert np.count_nonzero(np.abs(frames[30] - green).max(axis=-1) < 60) > 10
    assert is_own(out)
    assert [path.name for path in tmp_path.iterdir()] == ["flight.mp4"]


def test_films_take_an_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which is said before any work; so is an ffmpeg that does not do."""
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert main(["play", str(tmp_path / "none.mcap"), "--video", str(tmp_path / "flip.mp4")]) == 2
    assert "pip install 'vpptwin[video]'" in capsys.readouterr().err

    def fail(*given: object, **options: object) -> Iterator[None]:
        raise OSError("Unknown encoder 'libx264'")
        yield

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", SimpleNamespace(write_frames=fail))
    with pytest.raises(InputError, match="ffmpeg does not write MP4: Unknown encoder 'libx264'"):
        encode_film([np.zeros((4, 4, 3), np.uint8)], (4, 4))


def test_bad_videos(flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Another format, a log of minutes, a place that cannot be written: told so, nothing left."""
    time = np.linspace(0.0, 300.0, 3001)
    endless = {"/mocap/pose": Stream(time, {"x": 0 * time, "z": 0 * time + 1.2, "theta": 0 * time})}
    with pytest.raises(InputError, match="300 s"):
        write_video(replace(flight, streams=endless), None, tmp_path / "long.gif", spec=load_twin())
    for name, hint in (("flip.avi", ".gif, .webp or .mp4"), ("/proc/flip.gif", "cannot write")):
        assert main(["play", str(FLIP), "--video", str(tmp_path / name)]) == 2
        assert hint in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_environment_shows_itself() -> None:
    """`render` follows the first simulation; other modes are refused; rlrender finds the length of an episode."""
    env = tiny_env("task=flip", "task.episode=2", "task.success.window=0.5")
    env.reset()
    assert env.max_steps == 200
    before = env.render()
    assert before.shape == (400, 640, 3)
    assert before.dtype == np.uint8
    env.state.qpos[0, 0] += 0.3
    assert np.count_nonzero((env.render().astype(int) - before).any(axis=-1)) > 500
    with pytest.raises(InputError, match="render mode 'human'"):
        env.render("human")


@pytest.mark.slow
def test_rlrender_works_on_it(tmp_path: Path) -> None:
    """TorchRL's own viewer flies the shipped policy and writes an animation."""
    out, command = tmp_path / "flip.gif", Path(sys.executable).with_name("rlrender")
    factories = [
        "--env",
        "vpptwin.train.evaluate.render:make_env",
        "--policy",
        "vpptwin.train.evaluate.render:make_policy",
    ]
    given = ["--ckpt", str(find_checkpoint("flip")), "--seed", "3", "--max-steps", "40", "--out", str(out)]
    done = subprocess.run([str(command), *factories, *given], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with Image.open(out) as video:
        assert video.size == (640, 400)
        assert video.n_frames >= 40  # type: ignore[attr-defined]
        first = np.asarray(video.convert("RGB")).astype(int)
        video.seek(39)
        assert np.abs(np.asarray(video.convert("RGB")).astype(int) - first).max() > 100
