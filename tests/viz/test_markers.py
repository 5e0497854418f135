"""What a flown log gives to the 3D panels of Foxglove and RViz, and layouts whose paths the log has."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from vpptwin.cli.main import main
from vpptwin.logs import read_flight

Log = dict[str, list[object]]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight of the shipped policy, as a user gets it."""
    out = tmp_path_factory.mktemp("flown") / "flip.mcap"
    assert main(["fly", "flip", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def log(path: Path) -> Log:
    """Messages by topic, decoded by mcap-ros2-support from the definitions in the file."""
    messages: Log = {}
    with path.open("rb") as file:
        for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            messages.setdefault(channel.topic, []).append(message)
    return messages


def test_frames_follow_the_craft(path: Path, log: Log) -> None:
    """/tf has carriage, slider and body where motion capture saw the craft, and the target where it was asked for."""
    pose = read_flight(path).streams["/mocap/pose"]
    stamps, seen = [], []
    for message in log["/tf"]:
        frames = {t.child_frame_id: t for t in message.transforms}  # type: ignore[attr-defined]
        assert set(frames) == {"carriage", "slider", "body", "target"}
        body = frames["body"]
        assert body.header.frame_id == "world"
        stamps.append(body.header.stamp.sec + 1e-9 * body.header.stamp.nanosec)
        place, turn = body.transform.translation, body.transform.rotation
        assert (turn.x, turn.z, place.y) == (0.0, 0.0, 0.0)
        assert frames["carriage"].transform.translation.x == frames["slider"].transform.translation.x == place.x
        assert frames["slider"].transform.translation.z == place.z
        seen.append([place.x, place.z, np.exp(-2.0j * np.arctan2(turn.y, turn.w))])
    time = np.array(stamps) - stamps[0] + pose.time[0]
    assert np.diff(time).max() < 0.021
    x, z, turned = np.array(seen).T
    np.testing.assert_allclose(x.real, np.interp(time, pose.time, pose["x"]), atol=1e-5)
    np.testing.assert_allclose(z.real, np.interp(time, pose.time, pose["z"]), atol=1e-5)
    np.testing.assert_allclose(turned, np.exp(1.0j * np.interp(time, pose.time, pose["theta"])), atol=1e-4)


def test_markers_are_fixed_to_frames_that_exist(log: Log) -> None:
    """Every second floor, wall, rail, carriage, craft and its ghost; numbers differ, nothing is invisible or flat."""
    frames = {"world"} | {t.child_frame_id for t in log["/tf"][-1].transforms}  # type: ignore[attr-defined]
    assert len(log["/rig/markers"]) == 6
    markers = log["/rig/markers"][0].markers  # type: ignore[attr-defined]
    assert {marker.header.frame_id for marker in markers} == frames
    assert len({marker.id for marker in markers}) == len(markers) > 10
    for marker in markers:
        assert min(marker.scale.x, marker.scale.y, marker.scale.z) > 0.0
        assert 0.0 < marker.color.a <= 1.0
        assert marker.frame_locked
        assert marker.type in (1, 2, 3)
    arm = next(m for m in markers if m.header.frame_id == "body" and m.type == 1)
    assert arm.scale.x == pytest.approx(0.4)
    wall = next(m for m in markers if m.header.frame_id == "world" and m.pose.position.x > 1.6)
    assert wall.pose.position.x - 0.5 * wall.scale.x == pytest.approx(1.7)


def resolve(message: object, path: str) -> float:
    """The number at a path such as `a.b[1]`."""
    for name, index in re.findall(r"([A-Za-z_]+)(?:\[(\d+)\])?", path):
        message = getattr(message, name)
        if index:
            message = message[int(index)]  # type: ignore[index]
    assert isinstance(message, float)
    return message


def test_layouts_name_what_the_log_has(log: Log, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`vpptwin layouts` writes both; every topic and field in them exists, and every panel is placed."""
    assert main(["layouts", str(tmp_path / "new")]) == 0
    written = [Path(line) for line in capsys.readouterr().out.split()]
    assert [file.name for file in written] == ["foxglove.json", "plotjuggler.xml"]
    layout = json.loads(written[0].read_text())
    panels = layout["configById"]
    paths = [p["value"] for panel in panels.values() for p in panel.get("paths", [])]
    assert len(paths) >= 10
    for each in paths:
        topic, field = each.removesuffix(".@negative").split(".", 1)
        assert np.isfinite(resolve(log[topic][0], field))
    assert set(panels["3D!rig"]["topics"]) <= set(log)
    placed = re.findall(r"'(\w+![a-z]+)'", str(layout["layout"]))
    assert sorted(placed) == sorted(panels)
    curves = [curve.attrib["name"] for curve in ElementTree.parse(written[1]).iter("curve")]
    assert len(curves) >= 8
    for each in curves:
        topic = next(t for t in log if each.startswith(t + "/"))
        assert np.isfinite(resolve(log[topic][0], each.removeprefix(topic + "/").replace("/", ".")))


def test_layouts_to_nowhere(capsys: pytest.CaptureFixture[str]) -> None:
    """A folder that cannot be made is told so."""
    assert main(["layouts", "/proc/vpptwin"]) == 2
    assert "cannot write" in capsys.readouterr().err
