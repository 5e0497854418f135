"""What is written is read again, by this reader and by mcap-ros2-support's; nothing is left of what fails."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from vpptwin.logs import FlightWriter, Stream, read_flight, write_flight
from vpptwin.logs.channels import CHANNELS
from vpptwin.logs.check import HUGE
from vpptwin.system.errors import InputError

NANOSECONDS = st.lists(st.integers(0, 20 * 10**9), min_size=1, max_size=12, unique=True).map(sorted)
# float32 in BatteryState; angles step by less than half a turn, as unwrapping assumes
SPECIAL = {
    "voltage": lambda n: hnp.arrays(np.float32, n, elements=st.floats(0, 100, width=32)).map(lambda a: a.astype(float)),
    "theta": lambda n: hnp.arrays(float, n, elements=st.floats(-3.1, 3.1)).map(lambda a: np.cumsum(a)),
}


@st.composite
def draw_stream(draw: st.DrawFn, topic: str, start_ns: int) -> Stream:
    """Any samples of a topic, the first at start_ns."""
    stamps = np.array(draw(NANOSECONDS))
    stamps += start_ns - stamps[0]
    values = {}
    for column in CHANNELS[topic].columns:
        shape = len(stamps) if column.width == 1 else (len(stamps), column.width)
        limit = min(column.limit, HUGE)
        plain = hnp.arrays(float, shape, elements=st.floats(-limit, limit))
        values[column.name] = draw(SPECIAL[column.name](len(stamps)) if column.name in SPECIAL else plain)
    return Stream(stamps / 1e9, values)


@pytest.mark.parametrize("topic", CHANNELS)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_values_come_back_bit_equal(topic: str, data: st.DataObject) -> None:
    """Every column of every topic is read as it was written, to the bit, angles to a few roundings."""
    stream = data.draw(draw_stream(topic, 0))
    with tempfile.TemporaryDirectory() as folder:
        write_flight(f"{folder}/log.mcap", {topic: stream})
        flight = read_flight(f"{folder}/log.mcap")
    assert np.array_equal(flight.streams[topic].time, stream.time)
    for name, values in stream.values.items():
        got = flight.streams[topic][name]
        if name == "theta":
            assert np.allclose(got, values, rtol=0, atol=1e-12)  # first angle within a half turn: no turns are lost
        else:
            assert got.dtype == np.float64
            assert got.tobytes() == values.tobytes()


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_joints_come_back_bit_equal(data: st.DataObject) -> None:
    """Joints of any name, with any of position, velocity and effort, are read as they were written."""
    text = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
    names = data.draw(st.lists(text, min_size=1, max_size=4, unique=True))
    columns = data.draw(st.lists(st.sampled_from(["position", "velocity", "effort"]), min_size=1, unique=True))
    stamps = data.draw(NANOSECONDS)
    value = st.floats(-HUGE, HUGE)
    rows = [{name: {column: data.draw(value) for column in columns} for name in names} for _ in stamps]
    with tempfile.TemporaryDirectory() as folder:
        with FlightWriter(f"{folder}/log.mcap") as writer:
            for stamp, row in zip(stamps, rows, strict=True):
                writer.write_joints("/joint_states", stamp / 1e9, row)
        flight = read_flight(f"{folder}/log.mcap")
    assert set(flight.joints["/joint_states"]) == set(names)
    for name, stream in flight.joints["/joint_states"].items():
        assert set(stream.values) == set(columns)
        for column in columns:
            assert stream[column].tolist() == [row[name][column] for row in rows]


def make_flight(path: Path) -> None:
    """Write one message of every topic and of two joints."""
    with FlightWriter(path, start_ns=5 * 10**9, metadata={"seed": "7"}) as writer:
        for topic, channel in CHANNELS.items():
            values = {c.name: 0.5 if c.width == 1 else (0.5, -0.25) for c in channel.columns}
            writer.write(topic, 0.25, values, log_time=0.5)
        writer.write_joints("/joint_states", 0.25, {"a": {"position": 1.0}, "b": {"position": 2.0}})


def test_files_open_with_the_reference_reader(tmp_path: Path) -> None:
    """mcap-ros2-support reads every message by the definitions embedded, with our signs and ROS's conventions."""
    make_flight(tmp_path / "log.mcap")
    with (tmp_path / "log.mcap").open("rb") as file:
        decoded = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    messages = {m.channel.topic: m.decoded_message for m in decoded}
    assert set(messages) == {*CHANNELS, "/joint_states"}
    times = {(m.message.log_time, m.message.publish_time) for m in decoded}
    assert times == {(5_500_000_000, 5_250_000_000), (5_250_000_000, 5_250_000_000)}
    imu, pose = messages["/imu/data"], messages["/mocap/pose"].pose
    assert (imu.header.stamp.sec, imu.header.stamp.nanosec) == (5, 250_000_000)
    assert imu.angular_velocity.y == -0.5  # q = -omega_y
    assert imu.orientation_covariance[0] == -1  # sensor_msgs/Imu: no estimate of the orientation
    assert imu.linear_acceleration_covariance == [0.0] * 9
    assert (pose.position.x, pose.position.y, pose.position.z) == (0.5, 0.0, 0.5)
    assert (pose.orientation.y, pose.orientation.w) == (-np.sin(0.25), np.cos(0.25))
    assert messages["/rotor/state"].speed == [0.5, -0.25]
    assert messages["/battery"].voltage == 0.5
    assert np.isnan(messages["/battery"].charge)
    assert messages["/joint_states"].name == ["a", "b"]
    assert messages["/joint_states"].velocity == []


def test_files_are_what_rosbag2_writes(tmp_path: Path) -> None:
    """Profile ros2, CDR, ros2msg definitions with all dependencies, zstd chunks with an index, metadata."""
    make_flight(tmp_path / "log.mcap")
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary, header = reader.get_summary(), reader.get_header()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert summary is not None
    assert header.profile == "ros2"
    assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
    assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
    assert metadata == {"vpptwin": {"seed": "7"}}
    for schema in summary.schemas.values():
        assert "\nMSG: std_msgs/Header\n" in schema.data.decode()
        assert "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n" in schema.data.decode()


def test_an_exception_leaves_nothing(tmp_path: Path) -> None:
    """A flight that breaks off leaves neither a file nor a part of one, and an older file as it was."""
    target = tmp_path / "log.mcap"
    target.write_bytes(b"older")

    def break_off() -> None:
        with FlightWriter(target) as writer:
            writer.write("/battery", 0.0, {"voltage": 11.0})
            raise RuntimeError("the simulation diverged")

    with pytest.raises(RuntimeError):
        break_off()
    assert [item.name for item in tmp_path.iterdir()] == ["log.mcap"]
    assert target.read_bytes() == b"older"


@pytest.mark.parametrize("target", ["missing/log.mcap", "folder"])
def test_an_unwritable_path_is_refused(tmp_path: Path, target: str) -> None:
    """A log that cannot be written is refused before anything is flown."""
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        FlightWriter(tmp_path / target)
    assert not [name for name in os.listdir(tmp_path) if name.endswith(".part")]


def test_wrong_columns_are_refused(tmp_path: Path) -> None:
    """A message with a column missing or misspelt is an error of the program."""
    with FlightWriter(tmp_path / "log.mcap") as writer:
        for values in ({"thrust": 1.0}, {"thrust": 1.0, "rate": 0.0, "yaw": 0.0}):
            with pytest.raises(ValueError, match="takes thrust, rate"):
                writer.write("/cmd/rate_thrust", 0.0, values)


def test_turns_are_counted(tmp_path: Path) -> None:
    """Three turns come back as three turns, though a quaternion knows none."""
    time = np.arange(600) / 100
    theta = np.linspace(0.0, 6 * np.pi, len(time))
    stream = Stream(time, {"x": 0 * time, "z": 1 + 0 * time, "theta": theta})
    write_flight(tmp_path / "log.mcap", {"/mocap/pose": stream})
    assert np.allclose(read_flight(tmp_path / "log.mcap").streams["/mocap/pose"]["theta"], theta, atol=1e-12)
