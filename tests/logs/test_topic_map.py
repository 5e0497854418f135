"""Topic maps: other people's topics, types, fields, signs and units read as ours; mistakes in a map name the key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.logs.bags import EPOCH, IMU, JOINTS, POSE, Bag, make_imu, make_pose, make_poses, refuse, stamp_header
from vpptwin.logs import read_flight
from vpptwin.logs.messages import compose_definition
from vpptwin.system.errors import InputError

MS = 10**6  # ns
POINT = "geometry_msgs/msg/PointStamped"
POINT_TEXT = "std_msgs/Header header\ngeometry_msgs/Point point\n" + compose_definition(POSE).split("\n", 2)[2]
ESC = "esc_msgs/msg/Report"
ESC_TEXT = "uint64 timestamp\nfloat32[4] rpm\nint16 left\nint16 right"


def write_map(folder: Path, text: str) -> Path:
    """Write a topic map."""
    path = folder / "map.yaml"
    path.write_text(text)
    return path


def test_a_topic_is_renamed(tmp_path: Path) -> None:
    """The short form names another topic of the same type."""
    log = Bag(tmp_path / "log.mcap").add("/vrpn/drone/pose", POSE, make_poses(3)).write()
    flight = read_flight(log, write_map(tmp_path, "/mocap/pose: /vrpn/drone/pose"))
    assert flight.streams["/mocap/pose"]["x"].tolist() == [0.0, 0.01, 0.02]


def test_fields_are_scaled_and_turned(tmp_path: Path) -> None:
    """Path, scale and offset of a column; the columns that the map leaves out are read as usual."""
    messages = [make_imu(EPOCH + k * MS, rate=k) for k in range(3)]
    log = Bag(tmp_path / "log.mcap").add("/mavros/imu", IMU, messages).write()
    text = "/imu/data: {topic: /mavros/imu, fields: {rate: {path: angular_velocity.y, scale: 2, offset: 0.5}}}"
    imu = read_flight(log, write_map(tmp_path, text)).streams["/imu/data"]
    assert imu["rate"].tolist() == [0.5, -1.5, -3.5]  # angular_velocity.y = -k
    assert imu["accel_z"].tolist() == [9.81] * 3


def test_millimetres_are_read_through_a_map(tmp_path: Path) -> None:
    """The refusal of millimetres can be answered as it advises."""
    poses = [make_pose(EPOCH + k * MS, 100.0, 900.0) for k in range(3)]
    log = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, poses).write()
    scale = "{path: pose.position.%s, scale: 0.001}"
    text = f"/mocap/pose: {{topic: /mocap/pose, fields: {{x: {scale % 'x'}, z: {scale % 'z'}}}}}"
    refuse(log, "millimetres")
    pose = read_flight(log, write_map(tmp_path, text)).streams["/mocap/pose"]
    assert np.allclose(pose["x"], 0.1)
    assert np.allclose(pose["z"], 0.9)


def test_another_type_is_read_field_by_field(tmp_path: Path) -> None:
    """A type of which we know nothing: integers, arrays, one field per rotor, a count of microseconds as stamp."""
    reports = [{"timestamp": 10**15 + k * 1000, "rpm": [1500.0 + k, 0, 3000.0, 0], "left": 10, "right": 20}
               for k in range(4)]  # fmt: skip
    log = Bag(tmp_path / "log.mcap").add("/esc", ESC, reports, ESC_TEXT).write()
    text = """
/rotor/state:
  topic: /esc
  stamp: {path: timestamp, unit: us}
  fields:
    speed: {path: ["rpm[0]", "rpm[2]"], scale: [0.1, 0.2]}
    current: {path: [left, right], scale: 0.01}
"""
    flight = read_flight(log, write_map(tmp_path, text))
    state = flight.streams["/rotor/state"]
    assert flight.start_ns == 10**18
    assert state.time.tolist() == [0.0, 0.001, 0.002, 0.003]
    assert np.allclose(state["speed"], [[150.0 + 0.1 * k, 600.0] for k in range(4)])
    assert np.allclose(state["current"], [[0.1, 0.2]] * 4)


def test_optional_columns_may_be_absent(tmp_path: Path) -> None:
    """A gyro without accelerometer is an IMU; a stamp may be a Time anywhere, or the log time if there is none."""
    gyro = [{"header": stamp_header(EPOCH + k * MS), "point": {"x": 0.0, "y": 0.1 * k, "z": 0.0}} for k in range(3)]
    log = Bag(tmp_path / "log.mcap").add("/gyro", POINT, gyro, POINT_TEXT).write()
    text = "/imu/data: {topic: /gyro, stamp: %s, fields: {rate: {path: point.y, scale: -1}}}"
    for stamp in ("header.stamp", "log_time"):
        imu = read_flight(log, write_map(tmp_path, text % stamp)).streams["/imu/data"]
        assert imu["rate"].tolist() == [0.0, -0.1, -0.2]
        assert imu.time.tolist() == [0.0, 0.001, 0.002]
        assert set(imu.values) == {"rate"}


def test_a_scalar_angle_is_unwrapped(tmp_path: Path) -> None:
    """An angle given as a number counts turns too."""
    angle = np.linspace(0.0, 8.0, 50)
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    points = [{"header": stamp_header(EPOCH + k * MS), "point": {"x": 0.0, "y": w, "z": 0.0}}
              for k, w in enumerate(wrapped)]  # fmt: skip
    log = Bag(tmp_path / "log.mcap").add("/tracker", POINT, points, POINT_TEXT).write()
    text = "/mocap/pose: {topic: /tracker, fields: {x: point.x, z: point.z, theta: point.y}}"
    assert np.allclose(read_flight(log, write_map(tmp_path, text)).streams["/mocap/pose"]["theta"], angle)


def test_a_mapped_topic_that_the_log_lacks_is_told(tmp_path: Path) -> None:
    """A map made for many logs may name topics that one lacks: a warning, and an error when they are required."""
    log = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(3)).write()
    flight = read_flight(log, write_map(tmp_path, "/battery: {topic: /power}"))
    assert flight.warnings == (f"{tmp_path}/map.yaml: /battery is mapped to /power, which the log lacks",)
    with pytest.raises(InputError, match=r"no messages on /battery \(mapped to /power\), only on /mocap/pose"):
        flight.require("/battery")


def test_a_mapped_topic_is_not_read_twice(tmp_path: Path) -> None:
    """A topic that has one of our names but another meaning is taken as the map says, and only so."""
    log = Bag(tmp_path / "log.mcap").add("/setpoint/pose", POSE, make_poses(3)).write()
    flight = read_flight(log, write_map(tmp_path, "/mocap/pose: /setpoint/pose"))
    assert set(flight.streams) == {"/mocap/pose"}


@pytest.mark.parametrize(("text", "part"), [
    ("/mocap: {topic: /a}", "/mocap; expected one of /mocap/pose"),
    ("/imu/data: {topik: /a}", "/imu/data.topik: Extra inputs"),
    ("/imu/data: {topic: /a, feilds: {}}", "/imu/data.feilds: Extra inputs are not permitted"),
    ("/imu/data: {topic: 3}", "/imu/data.topic: Input should be a valid string"),
    ("/imu/data: {topic: /a, fields: {gyro: x}}", "/imu/data.fields.gyro; expected one of the columns rate"),
    ("/imu/data: {topic: /a, fields: {rate: {scale: 2}}}", "/imu/data.fields.rate.path: Field required"),
    ("/imu/data: {topic: /a, fields: {rate: {path: x, scale: fast}}}", "/imu/data.fields.rate.scale"),
    ("/imu/data: {topic: /a, fields: {rate: {path: x, axis: y}}}", "/imu/data.fields.rate.axis"),
    ("/imu/data: {topic: /a, fields: {rate: {path: [x, y]}}}", "/imu/data.fields.rate.path: 2 fields"),
    ("/rotor/state: {topic: /a, fields: {speed: {path: x, scale: [1, 2, 3]}}}", "speed.scale: 3 factors"),
    ("/mocap/pose: {topic: /a, fields: {theta: {path: q, axis: yaw}}}", "/mocap/pose.fields.theta.axis"),
    ("/imu/data: {topic: /a, stamp: {path: t, unit: min}}", "/imu/data.stamp.unit"),
    ("/joint_states: {topic: /a, fields: {slide: x}}", "/joint_states.fields; expected only a topic"),
    ("- /imu/data", "list at top level"),
    ("", "NoneType at top level"),
    ("/imu/data: {topic: /a", "no readable YAML"),
])  # fmt: skip
def test_mistakes_in_a_map_name_the_key(tmp_path: Path, text: str, part: str) -> None:
    """Every mistake is told on one line with the file and the key."""
    refuse(tmp_path / "unread.mcap", part, "map.yaml", topics=write_map(tmp_path, text))


@pytest.mark.parametrize(("text", "part"), [
    ("/mocap/pose: /imu",
     "/imu is of type sensor_msgs/msg/Imu; expected geometry_msgs/msg/PoseStamped for /mocap/pose"),
    ("/mocap/pose: {topic: /imu, fields: {x: linear_acceleration.x}}",
     "say in a topic map where z, theta of /mocap/pose"),
    ("/imu/data: {topic: /imu, fields: {rate: gyro.y}}", "/imu (sensor_msgs/msg/Imu) has no numeric field gyro.y"),
    ("/imu/data: {topic: /imu, fields: {rate: orientation_covariance}}",
     "orientation_covariance has 9 values per message"),
    ("/imu/data: {topic: /imu, stamp: angular_velocity}", "no numeric field angular_velocity.sec"),
])  # fmt: skip
def test_maps_that_do_not_fit_the_log_are_refused(tmp_path: Path, text: str, part: str) -> None:
    """A map that asks for what the messages do not hold is told so by field."""
    log = Bag(tmp_path / "log.mcap").add("/imu", IMU, [make_imu(EPOCH + k * MS) for k in range(3)]).write()
    refuse(log, part, topics=write_map(tmp_path, text))


def test_a_missing_map_is_refused(tmp_path: Path) -> None:
    """A topic map that does not exist is refused before the log is read."""
    refuse(tmp_path / "log.mcap", "no topic map", topics=tmp_path / "map.yaml")


def test_a_rotation_about_another_axis_is_read(tmp_path: Path) -> None:
    """A tracker with y up and the plane's normal along its z names that axis."""
    angle = 0.1 * np.arange(20)
    poses = make_poses(20)
    for value, pose in zip(angle, poses, strict=True):
        pose["pose"] = {
            "position": {"x": 0.0, "y": 1.5, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": np.sin(value / 2), "w": np.cos(value / 2)},
        }
    log = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, poses).write()
    text = "/mocap/pose: {topic: /mocap/pose, fields: {z: pose.position.y, theta: {path: pose.orientation, axis: z}}}"
    pose = read_flight(log, write_map(tmp_path, text)).streams["/mocap/pose"]
    assert np.allclose(pose["theta"], angle, atol=1e-12)
    assert np.allclose(pose["z"], 1.5)


def test_joint_topics_are_renamed(tmp_path: Path) -> None:
    """JointState topics can be given the name that a twin asks for."""
    states = [{"header": stamp_header(EPOCH + k * MS), "name": ["a"], "position": [0.1 * k]} for k in range(3)]
    log = Bag(tmp_path / "log.mcap").add("/robot/joints", JOINTS, states).write()
    flight = read_flight(log, write_map(tmp_path, "/joint_states: {topic: /robot/joints}"))
    assert flight.joints["/joint_states"]["a"]["position"].tolist() == [0.0, 0.1, 0.2]
    assert set(read_flight(log).joints) == {"/robot/joints"}
