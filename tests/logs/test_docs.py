"""What docs/logs.md shows works as shown."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.logs.bags import EPOCH, IMU, JOINTS, POSE, Bag, make_imu, make_pose, make_poses, stamp_header
from vpptwin.logs import read_flight
from vpptwin.logs.channels import CHANNELS
from vpptwin.logs.formats.readers import FORMATS

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "logs.md").read_text(encoding="utf-8")
MS = 10**6  # ns


def find_block(language: str) -> str:
    """The one code block in a language."""
    (block,) = re.findall(rf"```{language}\n(.*?)```", TEXT, flags=re.DOTALL)
    return block


def test_the_python_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The example reads a flight and writes another."""
    monkeypatch.chdir(tmp_path)
    states = [{"header": stamp_header(EPOCH + k * MS), "name": ["slide"], "position": [0.0]} for k in range(3)]
    bag = Bag(tmp_path / "flight.mcap").add("/mocap/pose", POSE, make_poses(3)).add("/joint_states", JOINTS, states)
    bag.add("/imu/data", IMU, [make_imu(EPOCH + k * MS) for k in range(3)]).write()
    exec(find_block("python"), {})
    written = read_flight(tmp_path / "out.mcap")
    assert written.streams["/mocap/pose"]["z"].tolist() == [1.0]
    assert written.joints["/joint_states"]["slide"]["position"].tolist() == [0.1]


def test_the_example_map_reads_a_foreign_bag(tmp_path: Path) -> None:
    """Every entry of the example finds its topic, with sign, axis, unit and stamp as it says."""
    (tmp_path / "map.yaml").write_text(find_block("yaml"))
    gyro, target = make_imu(EPOCH), make_pose(EPOCH)
    gyro["angular_velocity"] = {"x": 0.0, "y": 0.0, "z": 0.75}
    target["pose"] = {
        "position": {"x": 0.5, "y": 1.5, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
    }
    bag = Bag(tmp_path / "log.mcap").add("/vrpn/drone/pose", POSE, make_poses(3)).add("/mavros/imu", IMU, [gyro])
    bag.add("/target", POSE, [target])
    bag.add(
        "/esc_reports",
        "esc_msgs/msg/R",
        [{"timestamp": EPOCH // 1000, "rpm": [4500, 4400]}],
        "uint64 timestamp\nint32[] rpm",
    )
    bag.add("/robot/joint_states", JOINTS, [{"header": stamp_header(EPOCH), "name": ["a"], "effort": [1.0]}])
    flight = read_flight(bag.write(), tmp_path / "map.yaml")
    assert flight.warnings == ()
    assert len(flight.streams["/mocap/pose"]) == 3
    assert flight.streams["/imu/data"]["rate"][0] == -0.75
    assert flight.streams["/setpoint/pose"]["z"][0] == 1.5
    assert flight.streams["/setpoint/pose"]["theta"][0] == pytest.approx(1.2870022)  # 2 atan(0.6 / 0.8)
    assert flight.streams["/rotor/state"]["speed"][0, 0] == pytest.approx(471.239, abs=0.01)  # 4500 rpm
    assert flight.joints["/joint_states"]["a"]["effort"].tolist() == [1.0]


def test_the_table_of_topics_is_complete() -> None:
    """Every topic of the channel table is documented with its type, its columns and their units."""
    for topic, channel in CHANNELS.items():
        (row,) = (line for line in TEXT.splitlines() if line.startswith(f"| {topic} |"))
        assert channel.message_type in row
        assert all(column.name in row for column in channel.columns)


def test_every_format_is_documented() -> None:
    """The endings of all files that are read stand on the page."""
    endings = {ending.removesuffix(".gz") for form in FORMATS for ending in form.endings}
    assert not [ending for ending in endings if ending not in TEXT]
