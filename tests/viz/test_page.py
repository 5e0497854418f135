"""The page as a file: what it holds, what it would fetch, and how it fails."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.viz.conftest import DURATION, HOVER_PITCH, make_flight, make_prediction
from tests.viz.page_reader import read_commands, read_held, read_paths, read_tracks
from vpptwin.estimation.replay import Prediction
from vpptwin.logs.flight import Flight
from vpptwin.system.errors import InputError
from vpptwin.twin.spec import load_twin
from vpptwin.viz.pages.playback import play_page

FETCHES = r"""(?:src|href|action|data)\s*=\s*["']?\s*(?:https?:)?//|url\(\s*["']?\s*(?:https?:)?//|@import|<link\b"""
CRAFT = "/rig/log/craft"


@pytest.fixture
def page(flight: Flight, prediction: Prediction, tmp_path: Path) -> Path:
    """A page of log and twin."""
    return play_page(flight, prediction, tmp_path / "flight.html")


def test_page_fetches_nothing(page: Path) -> None:
    """The page refers to nothing outside itself, and its policy forbids the browser to connect anywhere."""
    text = page.read_text()
    assert re.findall(FETCHES, text) == []
    # The only address in the file is a name space that three.js passes to createElementNS.
    assert set(re.findall(r"https?://[\w./-]+", text)) == {"http://www.w3.org/1999/xhtml"}
    assert "default-src 'none'" in text
    assert "connect-src" not in text


def test_page_names_log_and_twin(page: Path) -> None:
    """Title and legend say what is solid, what is translucent and how often the twin was set back."""
    text = page.read_text()
    assert "<title>made_up.mcap - vpptwin</title>" in text
    for words in ("the log", "twin nominal, set back to the log every 0.5 s", "target", "negative thrust"):
        assert words in text


def test_title_is_escaped(tmp_path: Path) -> None:
    """A log's name cannot inject markup."""
    flight = make_flight()
    renamed = Flight(Path("<b>x.mcap"), 0, flight.streams, {})
    assert "<b>x" not in play_page(renamed, None, tmp_path / "p.html").read_text()


def test_page_draws_rig_log_twin_and_target(page: Path) -> None:
    """Everything that the eye looks for is there."""
    paths = read_paths(page)
    for part in ("world/world/floor", "world/world/wall", "world/world/rail", "trail", "grid"):
        assert f"/rig/{part}" in paths
    for who in ("log", "twin"):
        for part in ("carriage/carriage", "carriage/guide", "slider/slider", "craft/arm", "craft/rotor_1/mast"):
            assert f"/rig/{who}/{part}" in paths
    assert "/rig/target/arm" in paths
    assert f"{CRAFT}/rotor_2/negative_thrust/shaft/solid" in paths
    assert f"{CRAFT}/hull" not in paths  # the collision geom


def test_log_without_prediction_shows_no_twin(flight: Flight, tmp_path: Path) -> None:
    """The log plays alone."""
    page = play_page(flight, out=tmp_path / "flight.html")
    assert not any(path.startswith("/rig/twin") for path in read_paths(page))


def test_craft_moves_as_logged_at_fifty_frames_a_second(page: Path, flight: Flight) -> None:
    """4 s at 50 Hz are 201 frames, and the craft is where the log has it at each."""
    time, position = read_tracks(page)[CRAFT, ".position"]
    assert len(time) == round(DURATION * 50) + 1
    assert time[-1] == pytest.approx(DURATION)
    pose = flight.streams["/mocap/pose"]
    np.testing.assert_allclose(position[:, 0], np.interp(time, pose.time, pose["x"]), atol=1e-6)
    np.testing.assert_allclose(position[:, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(position[:, 2], np.interp(time, pose.time, pose["z"]), atol=1e-6)


def test_craft_turns_counter_clockwise_about_minus_y(page: Path) -> None:
    """Upside down, θ = π, is the quaternion (x, y, z, w) = (0, -1, 0, 0) up to its sign."""
    _, quaternion = read_tracks(page)[CRAFT, ".quaternion"]
    # Quarter turn (θ = π/2): sin(π/4) about -y; the turn from 2.0 to 2.4 s is there at 2.2 s, frame 110.
    np.testing.assert_allclose(quaternion[110] * np.sign(quaternion[110, 3]), [0, -(0.5**0.5), 0, 0.5**0.5], atol=1e-3)
    np.testing.assert_allclose(np.abs(quaternion[-1]), [0, 1, 0, 0], atol=1e-6)


def test_thrust_arrows_show_size_and_sign(page: Path) -> None:
    """Before the flip only the positive arrow shows, after it only the negative one, as long as the pitch is large."""
    tracks = read_tracks(page)
    length = 0.45 * HOVER_PITCH / 0.21  # m: arrow of the largest pitch times 0.1 rad of 0.21 rad, at governed speed
    for sign, first, last in (("positive", True, False), ("negative", False, True)):
        arrow = f"{CRAFT}/rotor_1/{sign}_thrust"
        time, shown = tracks[arrow, ".visible"]
        assert (bool(shown[0]), bool(shown[-1])) == (first, last)
        assert len(time) == 3  # held: start, change, end
        _, stretch = tracks[f"{arrow}/shaft", ".scale[z]"]
        assert stretch[0 if first else -1, 0] == pytest.approx(length, rel=1e-4)


def test_blade_pitch_of_both_rotors_raises_the_leading_edge(page: Path) -> None:
    """Positive pitch turns blades about their span by opposite angles, because the rotors turn against each other."""
    tracks = read_tracks(page)
    first = tracks[f"{CRAFT}/rotor_1/spin/blade_a/feather", ".rotation[x]"][1][0, 0]
    second = tracks[f"{CRAFT}/rotor_2/spin/blade_b/feather", ".rotation[x]"][1][0, 0]
    assert first == pytest.approx(2.5 * HOVER_PITCH)
    assert second == pytest.approx(-first)
    turn_1, turn_2 = (tracks[f"{CRAFT}/rotor_{i}/spin", ".rotation[z]"][1][:, 0] for i in (1, 2))
    # 471.239 rad/s for 4 s, drawn 20 times slower.
    assert turn_1[-1] - turn_1[0] == pytest.approx(471.239 * DURATION / 20.0, rel=1e-4)
    assert turn_2[-1] - turn_2[0] == pytest.approx(-471.239 * DURATION / 20.0, rel=1e-4)


def test_twin_is_hidden_where_it_is_not_known(page: Path) -> None:
    """The prediction starts at 0.5 s: no ghost before."""
    time, shown = read_tracks(page)["/rig/twin", ".visible"]
    assert list(shown) == [False, True, True]
    assert time[1] == pytest.approx(0.5, abs=0.04)
    _, position = read_tracks(page)["/rig/twin/craft", ".position"]
    assert np.isfinite(position).all()


def test_target_jumps_at_its_stamps(page: Path) -> None:
    """The ghost appears at the first setpoint and holds each until the next."""
    tracks = read_tracks(page)
    time, shown = tracks["/rig/target", ".visible"]
    assert list(shown) == [False, True, True] or list(shown) == [False, True]
    assert time[1] == pytest.approx(1.0)
    time, position = tracks["/rig/target", ".position"]
    np.testing.assert_allclose(time, [1.0, 2.0, DURATION])
    np.testing.assert_allclose(position[:, 0], [0.0, 0.5, 0.5])
    _, quaternion = tracks["/rig/target", ".quaternion"]
    np.testing.assert_allclose(quaternion[[0, 1]], [[0, 0, 0, 1], [0, -1, 0, 0]], atol=1e-6)  # upright, then θ = π
    assert "/rig/target.position" in read_held(page)
    assert "/rig/log/craft.position" not in read_held(page)


def test_long_log_stays_small(tmp_path: Path) -> None:
    """Ten minutes fit into 10 MB at a lower frame rate, still smooth enough to follow."""
    flight = make_flight(600.0)
    page = play_page(flight, make_prediction(flight), tmp_path / "long.html")
    assert page.stat().st_size < 10e6
    time, _ = read_tracks(page)[CRAFT, ".position"]
    assert np.diff(time).max() < 0.1
    assert time[-1] == pytest.approx(600.0)


def test_animation_loops_over_all_nodes_at_once(page: Path) -> None:
    """Every moving node's clip ends with the flight, so that scrubbing keeps them together."""
    assert {float(time[-1]) for time, _ in read_tracks(page).values()} == {DURATION}
    assert read_commands(page)[-1]["options"] == {"play": True, "repetitions": float("inf")}


def test_unwritable_page_is_refused_without_a_trace(flight: Flight, tmp_path: Path) -> None:
    """A folder in the way gives one line and leaves no draft."""
    (tmp_path / "out.html").mkdir()
    with pytest.raises(InputError, match="cannot write"):
        play_page(flight, None, tmp_path / "out.html")
    assert [path.name for path in tmp_path.iterdir()] == ["out.html"]


def test_log_without_pose_is_refused(flight: Flight, tmp_path: Path) -> None:
    """Without a pose there is nothing to draw, and the message names the topic."""
    blind = Flight(flight.path, 0, {"/rotor/state": flight.streams["/rotor/state"]}, {})
    with pytest.raises(InputError, match="/mocap/pose"):
        play_page(blind, None, tmp_path / "out.html", spec=load_twin())
    assert list(tmp_path.iterdir()) == []


def test_pose_alone_is_enough(flight: Flight, tmp_path: Path) -> None:
    """A log without rotors and setpoint plays, without arrows and target."""
    bare = Flight(flight.path, 0, {"/mocap/pose": flight.streams["/mocap/pose"]}, {})
    paths = read_paths(play_page(bare, None, tmp_path / "bare.html"))
    assert f"{CRAFT}/arm" in paths
    assert not any("thrust" in path or "target" in path for path in paths)
