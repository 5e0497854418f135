"""Bad logs: each is refused in one line that says what was found, what was expected and what to do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from tests.logs.bags import (
    EPOCH,
    IMU,
    JOINTS,
    POSE,
    RATE_THRUST,
    ROTOR_COMMAND,
    ROTOR_STATE,
    Bag,
    Message,
    make_imu,
    make_pose,
    make_poses,
    refuse,
    stamp_header,
    write_payloads,
)  # fmt: skip
from vpptwin.logs import FlightWriter, read_flight
from vpptwin.logs.messages import compose_definition
from vpptwin.system.errors import InputError

MS = 10**6  # ns
STRING = "std_msgs/msg/String"


@pytest.mark.parametrize(("name", "content", "part"), [
    ("empty.mcap", b"", "is empty (0 bytes)"),
    ("picture.mcap", b"\x89PNG\r\n\x1a\n" + b"\0" * 99, "is a PNG picture"),
    ("notes.mcap", b"Flew twice.\nLanded once.\n", "is text, starting with b'Flew twice."),
    ("ros1.mcap", b"#ROSBAG V2.0\n", "expected a whole bag; run `rosbag reindex`"),
    ("bag.db3", b"SQLite format 3\0", "expected a whole bag; run `ros2 bag reindex`"),
    ("noise.mcap", bytes(range(200, 256)), "is not MCAP"),
    ("start.mcap", b"\x89MCAP0", "ends after 6 bytes"),
    ("zeros.mcap", b"\x89MCAP0\r\n" + b"\0" * 999, "ends without a footer"),
])  # fmt: skip
def test_files_of_another_kind_are_refused(tmp_path: Path, name: str, content: bytes, part: str) -> None:
    """What is no MCAP file is named as what it is."""
    (tmp_path / name).write_bytes(content)
    refuse(tmp_path / name, name, part)


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    """Paths that lead to no log say what is there instead."""
    refuse(tmp_path / "log.mcap", "no file", "check the path")
    refuse(tmp_path, "holds nothing")
    (tmp_path / "video.mp4").write_bytes(b"x")
    refuse(tmp_path, "holds video.mp4")
    refuse([], "no log given")
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [bag_0.mcap]}")
    refuse(tmp_path, "metadata.yaml names bag_0.mcap, which is missing")


@pytest.fixture(scope="module", params=[CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A valid log of 400 poses in several chunks."""
    bag = Bag(tmp_path_factory.mktemp("whole") / "log.mcap").add("/mocap/pose", POSE, make_poses(400))
    return bag.write(compression=request.param, chunk_size=8000)


def test_a_truncated_log_says_what_is_readable(tmp_path: Path, whole: Path) -> None:
    """A log, read in any compression, that is cut at 60 % is refused, with what is readable and what saves it."""
    assert len(read_flight(whole).streams["/mocap/pose"]) == 400
    path, content = tmp_path / "cut.mcap", whole.read_bytes()
    size = len(content) * 6 // 10
    path.write_bytes(content[:size])
    refuse(path, "ends", f"of {size}, ", " before it are readable", "mcap recover cut.mcap -o recovered.mcap")
    with pytest.raises(InputError, match=r"(\d+) messages over [12]\.\d s before") as caught:
        read_flight(path)
    assert 100 < int(caught.value.found.split(" messages")[0].split()[-1]) < 300


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_cut_is_refused(whole: Path, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Wherever a log is cut, it is refused, never read in part."""
    path = tmp_path_factory.getbasetemp() / "any_cut.mcap"
    content = whole.read_bytes()
    path.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    refuse(path, "any_cut.mcap")


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_damaged_bytes_never_crash(whole: Path, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """A log with bytes changed anywhere is read (if they don't matter) or refused, but nothing else happens."""
    path = tmp_path_factory.getbasetemp() / "damaged.mcap"
    content = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(8, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    try:
        flight = read_flight(path)
    except InputError:
        return
    assert len(flight.streams["/mocap/pose"]) == 400


@pytest.mark.parametrize(("profile", "encoding", "schema", "part"), [
    ("ros1", "ros1", "ros1msg", "MCAP profile 'ros1'"),
    ("", "json", "jsonschema", "message encoding 'json' on /mocap/pose"),
    ("", "protobuf", "protobuf", "message encoding 'protobuf' on /mocap/pose"),
    ("ros2", "cdr", "ros2idl", "definition 'ros2idl' on /mocap/pose"),
    ("ros2", "cdr", "", "definition '' on /mocap/pose"),
])  # fmt: skip
def test_other_encodings_are_refused(tmp_path: Path, profile: str, encoding: str, schema: str, part: str) -> None:
    """MCAP holds many things; what is not ROS 2's CDR with embedded definitions is named."""
    path = tmp_path / "log.mcap"
    refuse(write_payloads(path, [b"{}"], profile=profile, encoding=encoding, schema=schema), part)


def spoil_pose(index: int, value: float, *path: str) -> Callable[[int, Message], None]:
    """Set one number of the pose at one index."""

    def change(at: int, message: Message) -> None:
        if at >= index:
            part = message["pose"]
            for name in path[:-1]:
                part = part[name]  # type: ignore[index]
            part[path[-1]] = value  # type: ignore[index]

    return change


@pytest.mark.parametrize(("change", "parts"), [
    (spoil_pose(97, np.nan, "position", "x"),
     ["/mocap/pose: pose.position.x is NaN in 3 of 100 messages, first at 0.970 s"]),
    (spoil_pose(99, np.inf, "position", "z"), ["pose.position.z is an infinity in 1 of 100", "0.990 s"]),
    (spoil_pose(0, np.nan, "orientation", "w"), ["pose.orientation.w is NaN in 100 of 100"]),
    (spoil_pose(0, 980.0, "position", "z"), ["z reaches 980", "looks like millimetres", "expected m"]),
    (spoil_pose(0, 0.0, "orientation", "w"), ["100 of 100 messages is no unit quaternion, norm 0"]),
    (spoil_pose(50, 0.5, "orientation", "x"), ["50 of 100 messages is no unit quaternion, norm 1.12"]),
])  # fmt: skip
def test_poses_that_cannot_be_right_are_refused(
    tmp_path: Path, change: Callable[[int, Message], None], parts: list[str]
) -> None:
    """NaN, other units and broken quaternions are told with topic, count and time."""
    refuse(Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(100, change=change)).write(), *parts)


def test_a_rotation_out_of_the_plane_is_refused(tmp_path: Path) -> None:
    """A tracker whose vertical is y reports rotations about another axis."""

    def turn(index: int, message: Message) -> None:
        angle = 0.02 * index
        message["pose"]["orientation"] = {"x": 0.0, "y": 0.0, "z": np.sin(angle / 2), "w": np.cos(angle / 2)}  # type: ignore[index]

    path = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(100, change=turn)).write()
    refuse(path, "the orientation is no rotation about y, but 0.99 rad off (median)")


def stamped(count: int, **values: object) -> list[Message]:
    """Messages of one kind, 1 ms apart, all with these values."""
    return [{"header": stamp_header(EPOCH + k * MS), **values} for k in range(count)]


@pytest.mark.parametrize(("topic", "kind", "values", "part"), [
    ("/rotor/state", ROTOR_STATE, {"speed": [4500.0] * 2, "current": [3.0] * 2},
     "speed reaches 4500 and looks like rpm"),
    ("/rotor/state", ROTOR_STATE, {"speed": [np.nan, 1.0], "current": [3.0] * 2}, "speed is NaN in 9 of 9"),
    ("/rotor/command", ROTOR_COMMAND, {"blade_pitch": [9.0, 8.0], "throttle": [0.4] * 2}, "9 and looks like degrees"),
    ("/rotor/command", ROTOR_COMMAND, {"blade_pitch": [0.1] * 2, "throttle": [40.0] * 2}, "40 and looks like percent"),
    ("/cmd/rate_thrust", RATE_THRUST, {"thrust": 5.0, "rate": -600.0},
     "rate reaches 600 and looks like degrees per second"),
    ("/joint_states", JOINTS, {"name": ["a", "b"], "position": [1.0]}, "has 1 values of position for 2 names"),
])  # fmt: skip
def test_other_values_that_cannot_be_right_are_refused(
    tmp_path: Path, topic: str, kind: str, values: Message, part: str
) -> None:
    """Units are told by values that no rig reaches."""
    refuse(Bag(tmp_path / "log.mcap").add(topic, kind, stamped(9, **values)).write(), f"log.mcap: {topic}", part)


@pytest.mark.parametrize("value", [1e308, -1e200, 1e18])
@pytest.mark.parametrize("column", ["position", "velocity", "effort"])
@pytest.mark.filterwarnings("error")
def test_numbers_beyond_all_measure_are_left_out_or_refused(tmp_path: Path, value: float, column: str) -> None:
    """Of a joint: one of 200 goes with a warning, every other one is refused, and no square of it overflows."""
    for every, name in ((150, "few.mcap"), (2, "many.mcap")):
        with FlightWriter(tmp_path / name) as writer:
            for i in range(200):
                told = dict.fromkeys(("position", "velocity", "effort"), float(np.sin(0.1 * i)))
                told[column] = value if i % every == 1 else told[column]
                writer.write_joints("/joint_states", 0.01 * i, {"arm": told})
    flight = read_flight(tmp_path / "few.mcap")
    assert np.abs(flight.joints["/joint_states"]["arm"][column]).max() <= 1.0
    told = "2 of 200 messages on /joint_states arm hold impossible values, left out, first at 0.010 s"
    assert told in flight.warnings
    refuse(tmp_path / "many.mcap", f"{column} reaches ", ", beyond 1e+12 in 100 of 200 messages, first at 0.010")


@pytest.mark.parametrize(
    ("factor", "part"), [(57.29578, "looks like degrees per second"), (-1.0, "runs against the turning"), (1.0, "")]
)
def test_the_gyro_is_compared_with_the_angle(tmp_path: Path, factor: float, part: str) -> None:
    """Degrees per second and a wrong sign show against the angle seen, for rates that are plausible by themselves."""
    rng = np.random.default_rng(0)
    angle = 0.8 * np.sin(2.0 * np.arange(300) / 100)
    poses = [make_pose(EPOCH + k * 10 * MS, theta=a + 0.003 * rng.normal()) for k, a in enumerate(angle)]
    rate = 1.6 * np.cos(2.0 * np.arange(3000) / 1000)
    gyro = [make_imu(EPOCH + k * MS, rate=factor * r + 0.02 * rng.normal()) for k, r in enumerate(rate)]
    path = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, poses).add("/imu/data", IMU, gyro).write()
    if part:
        refuse(path, "/imu/data: rate", part)
    else:
        assert read_flight(path).warnings == ()


def test_a_topic_of_another_type_is_refused(tmp_path: Path) -> None:
    """A string on /mocap/pose is refused with both types; so is anything but JointState on /joint_states."""
    text = "string data\n"
    path = Bag(tmp_path / "a.mcap").add("/mocap/pose", STRING, [{"data": "here"}], text).write()
    refuse(path, f"/mocap/pose is of type {STRING}", f"expected {POSE}", "topic map")
    path = Bag(tmp_path / "b.mcap").add("/joint_states", STRING, [{"data": "here"}], text).write()
    refuse(path, f"/joint_states is of type {STRING}", f"expected {JOINTS}")
    poses = Bag(tmp_path / "c.mcap").add("/mocap/pose", POSE, make_poses(3)).write()
    refuse([tmp_path / "a.mcap", poses], f"/mocap/pose is recorded as {STRING} and as {POSE}")


def test_a_definition_without_our_fields_is_refused(tmp_path: Path) -> None:
    """A type of the right name but with other fields says which field is missing."""
    text = compose_definition(RATE_THRUST).replace("float64 thrust", "float64 force")
    messages = stamped(3, force=1.0, rate=0.0)
    path = Bag(tmp_path / "log.mcap").add("/cmd/rate_thrust", RATE_THRUST, messages, text).write()
    refuse(path, "/cmd/rate_thrust (vpptwin_msgs/msg/RateThrust) has no numeric field thrust", "force")


def test_a_foreign_bag_says_what_it_holds(tmp_path: Path) -> None:
    """A bag without any of our topics lists its own."""
    path = Bag(tmp_path / "log.mcap").add("/chatter", STRING, [{"data": "hello"}], "string data\n").write()
    refuse(path, f"has none of our topics with messages, only /chatter ({STRING})", "topic map")
    refuse(Bag(tmp_path / "none.mcap").write(), "holds no messages")


def test_require_names_what_is_missing(tmp_path: Path) -> None:
    """A log without /mocap/pose reads, and says so when the pose is asked for."""
    path = Bag(tmp_path / "log.mcap").add("/imu/data", IMU, [make_imu(EPOCH + k * MS) for k in range(5)]).write()
    flight = read_flight(path)
    flight.require("/imu/data")
    lacking = "has no messages on /mocap/pose, only on /imu/data; expected a log with /mocap/pose"
    with pytest.raises(InputError, match=lacking):
        flight.require("/mocap/pose", "/imu/data")
    with pytest.raises(KeyError, match="no column gyro, only rate, accel_x, accel_z"):
        flight.streams["/imu/data"]["gyro"]
