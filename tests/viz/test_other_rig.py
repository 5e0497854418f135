"""A user's own rig: its MJCF's geoms move as the log's joints do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.viz.page_reader import read_paths, read_tracks
from vpptwin.estimation.replay import Prediction
from vpptwin.logs.flight import Flight, Stream
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import TwinSpec, load_twin
from vpptwin.viz.pages.playback import play_page
from vpptwin.viz.plots.panels import tell_robot
from vpptwin.viz.scene.show import find_positions

CART_POLE = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="2 1 0.1"/>
  <body name="cart"><joint name="slide" type="slide" axis="1 0 0"/><geom name="box" type="box" size="0.1 0.05 0.05"/>
    <body name="pole"><joint name="hinge" type="hinge" axis="0 -1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02"/>
      <geom name="bob" type="sphere" size="0.05" pos="0 0 0.5"/></body></body>
</worldbody></mujoco>
"""


@pytest.fixture
def spec(tmp_path: Path) -> TwinSpec:
    """A cart with a pole."""
    (tmp_path / "cart.xml").write_text(CART_POLE)
    (tmp_path / "cart.yaml").write_text(
        "model: cart.xml\nsignals:\n  joints: {slide: /joint_states, hinge: /joint_states}\n"
    )
    return load_twin(tmp_path / "cart.yaml")


@pytest.fixture
def flight() -> Flight:
    """2 s of the cart rolling while the pole swings."""
    time = np.arange(201) / 100.0
    joints = {"slide": Stream(time, {"position": 0.3 * time}), "hinge": Stream(time, {"position": np.sin(time)})}
    return Flight(Path("cart.mcap"), 0, {}, {"/joint_states": joints})


def test_geoms_follow_the_logged_joints(spec: TwinSpec, flight: Flight, tmp_path: Path) -> None:
    """Cart and pole move, log beside twin, and unnamed geoms are drawn too."""
    time = flight.joints["/joint_states"]["slide"].time
    qpos = np.stack([0.4 * time, 0.0 * time], -1)
    prediction = Prediction(time, qpos, 0 * qpos, np.zeros((201, 0)), np.zeros((201, 0)), np.array([0.0]))
    page = play_page(flight, prediction, tmp_path / "cart.html", spec=spec)
    assert {"/rig/world/world/floor", "/rig/log/cart/box", "/rig/log/pole/bob", "/rig/twin/pole/geom_2"} <= read_paths(
        page
    )
    tracks = read_tracks(page)
    _, cart = tracks["/rig/log/cart", ".position"]
    assert cart[-1, 0] == pytest.approx(0.6)
    _, pole = tracks["/rig/log/pole", ".quaternion"]
    # Half of sin(2 s) about -y.
    np.testing.assert_allclose(pole[-1], [0, -np.sin(0.5 * np.sin(2)), 0, np.cos(0.5 * np.sin(2))], atol=1e-6)
    _, twin = tracks["/rig/twin/cart", ".position"]
    assert twin[-1, 0] == pytest.approx(0.8)
    assert "free-running" in page.read_text()


def test_a_hinge_logged_within_one_turn_is_drawn_as_it_goes_on(spec: TwinSpec) -> None:
    """In what moves and in its panel, beside a twin that turns on; a slide's jumps stay."""
    time = np.arange(801) / 100.0
    turns, jumps = 5.0 * time, 7.0 * (time > 4.0)
    joints = {
        "slide": Stream(time, {"position": jumps}),
        "hinge": Stream(time, {"position": np.angle(np.exp(1j * turns))}),
    }
    flight = Flight(Path("cart.mcap"), 0, {}, {"/joint_states": joints})
    found = find_positions(spec.robot, flight)
    np.testing.assert_allclose(found[1][1], turns, atol=1e-9)
    np.testing.assert_array_equal(found[0][1], jumps)
    (panel,) = [panel for panel in tell_robot(spec.robot, flight, None) if panel.label.startswith("hinge")]
    np.testing.assert_allclose(panel.lines[0].values, turns, atol=1e-9)


def test_log_without_the_joints_is_refused(spec: TwinSpec, tmp_path: Path) -> None:
    """The message names the joints and topics that the twin expects and what the log has."""
    other = Flight(Path("x.mcap"), 0, {}, {"/arm": {"elbow": Stream(np.array([0.0, 1.0]), {"velocity": np.zeros(2)})}})
    with pytest.raises(InputError, match=r"topics /arm; expected the position of slide on /joint_states or hinge"):
        play_page(other, None, tmp_path / "x.html", spec=spec)
