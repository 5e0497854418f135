"""Recordings as others make them: split files, folders, every storage form, other rigs, ROS 2's own test bags."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as PlainWriter
from mcap_ros2.writer import Writer
from zstandard import ZstdCompressor

from tests.logs.bags import EPOCH, IMU, JOINTS, POSE, Bag, Message, make_imu, make_poses, pose_bag, refuse, stamp_header
from vpptwin.cli.main import main
from vpptwin.logs import Flight, Stream, read_flight, write_flight
from vpptwin.logs.formats.container import read_container
from vpptwin.logs.formats.decode import decode_channel
from vpptwin.logs.formats.raw import Query
from vpptwin.logs.messages import compose_definition
from vpptwin.logs.read import expand_logs
from vpptwin.logs.spelling import list_flights
from vpptwin.logs.transcribe import transcribe
from vpptwin.system.errors import InputError

MS = 10**6  # ns
DEMO = Path(__file__).resolve().parents[2] / "demo" / "flights"


def split_bag(folder: Path) -> list[Path]:
    """Two files of one recording, 30 and 20 poses."""
    bag = Bag(folder / "bag_0.mcap").add("/mocap/pose", POSE, make_poses(50))
    later = Bag(folder / "bag_1.mcap", bag.entries[30:])
    bag.entries = bag.entries[:30]
    return [bag.write(), later.write()]


@pytest.mark.parametrize("order", [1, -1])
def test_split_files_are_read_as_one(tmp_path: Path, order: int) -> None:
    """Files of one recording are put in the order of their log time, however they are given."""
    flight = read_flight(split_bag(tmp_path)[::order])
    assert np.allclose(flight.streams["/mocap/pose"]["x"], 0.01 * np.arange(50))
    assert flight.warnings == ()


@pytest.mark.parametrize("metadata", ["rosbag2_bagfile_information: {relative_file_paths: [bag_1.mcap]}", "junk: ["])
def test_folders_are_read(tmp_path: Path, metadata: str) -> None:
    """A rosbag2 folder holds the files that its metadata lists, or else all of its .mcap files."""
    split_bag(tmp_path)
    (tmp_path / "metadata.yaml").write_text(metadata)
    assert len(read_flight(tmp_path).streams["/mocap/pose"]) == (20 if "bag_1" in metadata else 50)


OLD = "rosbag2_bagfile_information: {{version: 3, relative_file_paths: [{}]}}"


@pytest.mark.parametrize("name", ["swing", "renamed"])
@pytest.mark.parametrize("written", ["swing/bag_0.mcap, swing/bag_1.mcap", "bag_0.mcap, bag_1.mcap"])
@pytest.mark.parametrize("packed", ["", ".zstd", "unpacked"])
def test_folders_of_old_metadata_are_read(tmp_path: Path, name: str, written: str, packed: str) -> None:
    """Version 3 has FOLDER/FILE, and the folder may have another name now; files may be compressed, or be no longer."""
    (tmp_path / name).mkdir()
    for file in split_bag(tmp_path / name):
        if packed == ".zstd":
            file.with_name(f"{file.name}.zstd").write_bytes(ZstdCompressor().compress(file.read_bytes()))
            file.unlink()
    named = written.replace(".mcap", ".mcap.zstd") if packed else written
    (tmp_path / name / "metadata.yaml").write_text(OLD.format(named))
    assert len(read_flight(tmp_path / name).streams["/mocap/pose"]) == 50


@pytest.mark.parametrize(
    "named", ["../else_0.mcap", "else_0.mcap", "link.mcap", "pipe", "x" * 5000, '"a\\0b"', "sub", "[1]"]
)
def test_folders_hold_what_their_metadata_name(tmp_path: Path, named: str) -> None:
    """What lies beside a folder is none of its files, by whatever name; a pipe is no file."""
    folder = tmp_path / "bag"
    (folder / "sub").mkdir(parents=True)
    Bag(tmp_path / "else_0.mcap").add("/mocap/pose", POSE, make_poses(5)).write()
    (folder / "link.mcap").symlink_to(tmp_path / "else_0.mcap")
    os.mkfifo(folder / "pipe")
    (folder / "metadata.yaml").write_text(OLD.format(named))
    with pytest.raises(InputError, match=r"metadata\.yaml names .*(, which is missing|x…); expected all files"):
        read_flight(folder)


def test_metadata_that_wait_or_repeat_are_nothing_to_go_by(tmp_path: Path) -> None:
    """A pipe in the place of metadata is not opened: the folder's files are read; one that is named often, once."""
    split_bag(tmp_path)
    os.mkfifo(tmp_path / "metadata.yaml")
    assert len(read_flight(tmp_path).streams["/mocap/pose"]) == 50
    (tmp_path / "metadata.yaml").unlink()
    (tmp_path / "metadata.yaml").write_text(OLD.format(", ".join(["bag_1.mcap"] * 20_000)))
    assert len(read_flight(tmp_path).streams["/mocap/pose"]) == 20


def test_files_compressed_as_a_whole_are_read(tmp_path: Path) -> None:
    """By zstd, in several frames too; what is cut or unpacks to far too much is refused by its own name."""
    log = pose_bag(tmp_path / "log.mcap", EPOCH + MS * np.arange(50)).read_bytes()
    packed = tmp_path / "log.mcap.zst"
    packed.write_bytes(ZstdCompressor().compress(log[:500]) + ZstdCompressor().compress(log[500:]))
    assert len(read_flight(packed).streams["/mocap/pose"]) == 50
    assert list_flights(tmp_path) == [tmp_path / "log.mcap", packed]
    for content, said in (
        (packed.read_bytes()[:-300], "log.mcap.zst is damaged .it ends early"),
        (ZstdCompressor().compress(log)[:20] + b"nonsense" * 9, "log.mcap.zst is damaged"),
        (ZstdCompressor().compress(bytes(1 << 26)), "log.mcap.zst unpacks to more than"),
    ):
        packed.write_bytes(content)
        with pytest.raises(InputError, match=said):
            read_flight(packed)


def test_a_folder_of_flights_is_a_folder_of_flights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without metadata.yaml every file is a flight, which a line says; where one is wanted, the line asks for one."""
    split_bag(tmp_path)
    assert [len(flight.streams["/mocap/pose"]) for flight in map(read_flight, expand_logs([tmp_path]))] == [30, 20]
    assert f"{tmp_path} is a folder of 2 recordings" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"holds 2 recordings; expected one recording here; give one, such as .*bag_0"):
        read_flight(tmp_path)


def test_files_that_overlap_are_joined(tmp_path: Path) -> None:
    """Messages that two files share are taken once."""
    first, _ = split_bag(tmp_path)
    again = Bag(tmp_path / "again.mcap").add("/mocap/pose", POSE, make_poses(50)).write()
    flight = read_flight([again, first])
    assert len(flight.streams["/mocap/pose"]) == 50
    assert "30 of 80 messages on /mocap/pose repeat a stamp, dropped" in flight.warnings


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_compression_is_read(tmp_path: Path, compression: CompressionType) -> None:
    """zstd, lz4 and no compression, in many small chunks."""
    bag = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(50))
    assert len(read_flight(bag.write(compression, chunk_size=500)).streams["/mocap/pose"]) == 50


def test_files_without_chunks_are_read(tmp_path: Path) -> None:
    """Messages may lie in the file itself, between schemas, channels and records that mean nothing to us."""
    bag = Bag(tmp_path / "a.mcap").add("/mocap/pose", POSE, make_poses(9))
    source = read_container(bag.write(), Query(lambda _: True))
    with (tmp_path / "b.mcap").open("wb") as file:
        writer = PlainWriter(file, use_chunking=False, use_statistics=False)
        writer.start("ros2")
        schema = writer.register_schema(POSE, "ros2msg", compose_definition(POSE).encode())
        channel = writer.register_channel("/mocap/pose", "cdr", schema)
        writer.add_attachment(0, 0, "notes", "text/plain", b"windy")
        for k, payload in enumerate(source.channels[0].blocks[0].payload):
            writer.add_message(channel, EPOCH + k, payload.tobytes(), EPOCH + k)
            writer.add_metadata("mood", {"k": str(k)})
        writer.finish()
    assert np.allclose(read_flight(tmp_path / "b.mcap").streams["/mocap/pose"]["x"], 0.01 * np.arange(9))


def test_other_channels_are_let_be(tmp_path: Path) -> None:
    """Channels that are not ours may have any encoding and any definition, even one that does not parse."""
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        for kind, text in (("a/srv/B_Event", "int32 a\n---\nint32 b"), (POSE, compose_definition(POSE))):
            schema = writer.register_msgdef(kind, text)
        for pose in make_poses(3):
            writer.write_message("/mocap/pose", schema, pose, log_time=EPOCH)
        plain = writer._writer
        plain.add_message(plain.register_channel("/service", "cdr", 1), EPOCH, b"\xff", EPOCH)
        plain.add_message(plain.register_channel("/web", "json", 0), EPOCH, b"{}", EPOCH)
        writer.finish()
    assert set(read_flight(tmp_path / "log.mcap").streams) == {"/mocap/pose"}


def make_state(k: int, **values: object) -> Message:
    """JointState number k, 1 ms after the last."""
    return {"header": stamp_header(EPOCH + k * MS), **values}


def test_joints_may_come_in_any_messages(tmp_path: Path) -> None:
    """Joints that come together, apart, or in another order give one stream each."""
    states = [make_state(0, name=["a", "b"], position=[0.0, 10.0]),
              make_state(1, name=["b", "a"], position=[11.0, 1.0]),
              make_state(2, name=["a"], position=[2.0]), make_state(2, name=["b"], position=[12.0]),
              make_state(3, name=[])]  # fmt: skip
    joints = read_flight(Bag(tmp_path / "log.mcap").add("/robot", JOINTS, states).write()).joints["/robot"]
    assert joints["a"]["position"].tolist() == [0.0, 1.0, 2.0]
    assert joints["b"]["position"].tolist() == [10.0, 11.0, 12.0]
    assert joints["b"].time.tolist() == [0.0, 0.001, 0.002]


def test_joints_of_one_message_share_their_warning(tmp_path: Path) -> None:
    """A gap is told once for all joints that come in the same messages."""
    states = [make_state(k, name=["a", "b"], position=[0.0, 1.0]) for k in range(20) if not 5 < k < 15]
    flight = read_flight(Bag(tmp_path / "log.mcap").add("/joint_states", JOINTS, states).write())
    assert flight.warnings == ("1 gap over 0.005 s on /joint_states a, b, the longest 0.01 s at 0.005 s",)


def test_joint_columns_that_are_mostly_absent_are_left_out(tmp_path: Path) -> None:
    """Columns that are NaN throughout are left out; messages that lack what most have are dropped with a warning."""
    nan = float("nan")
    states = [make_state(k, name=["a"], position=[float(k)], velocity=[1.0], effort=[nan]) for k in range(8)]
    states[3] = make_state(3, name=["a"], position=[3.0], effort=[nan])
    flight = read_flight(Bag(tmp_path / "log.mcap").add("/joint_states", JOINTS, states).write())
    assert set(flight.joints["/joint_states"]["a"].values) == {"position", "velocity"}
    assert flight.joints["/joint_states"]["a"]["position"].tolist() == [0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0]
    assert flight.warnings == ("1 of 8 messages on /joint_states a lack position or velocity or effort, left out",)
    states[5] = make_state(5, name=["a"], position=[nan], velocity=[1.0], effort=[nan])
    with pytest.raises(InputError, match=r"/joint_states a: position is NaN in 1 of 7 messages, first at 0.005 s"):
        read_flight(Bag(tmp_path / "log.mcap").add("/joint_states", JOINTS, states).write())


def test_unknown_optional_values_are_left_out(tmp_path: Path) -> None:
    """A current that nobody measured is written as NaN and read as absent."""
    time = np.arange(5) / 1000
    write_flight(tmp_path / "log.mcap", {"/rotor/state": Stream(time, {"speed": np.full((5, 2), 470.0)})})
    flight = read_flight(tmp_path / "log.mcap")
    assert set(flight.streams["/rotor/state"].values) == {"speed"}
    assert flight.warnings == ("current on /rotor/state is NaN throughout, left out",)


def test_a_written_flight_is_in_order_of_time(tmp_path: Path) -> None:
    """Streams written whole are merged by time, joints beside topics."""
    slow, fast = np.arange(3) / 10, np.arange(30) / 100
    streams = {"/battery": Stream(slow, {"voltage": 11.0 + 0 * slow})}
    joints = {"/joint_states": {"a": Stream(fast, {"position": fast, "effort": -fast})}}
    write_flight(tmp_path / "log.mcap", streams, joints)
    raw = read_container(tmp_path / "log.mcap", Query(lambda _: True))
    stamps = np.concatenate([block.log_time for channel in raw.channels for block in channel.blocks])
    number = np.concatenate([block.number for channel in raw.channels for block in channel.blocks])
    assert (np.diff(stamps[np.argsort(number)].astype(np.int64)) >= 0).all()
    assert read_flight(tmp_path / "log.mcap").joints["/joint_states"]["a"]["effort"].tolist() == (-fast).tolist()


@pytest.mark.parametrize("path", sorted(DEMO.glob("*.mcap")), ids=lambda path: path.stem)
def test_demo_flights_are_read(path: Path) -> None:
    """The flights that ship with the project, written by the independent simulation, read whole and plausibly."""
    flight = read_flight(path)
    flight.require("/mocap/pose", "/imu/data", "/cmd/rate_thrust", "/rotor/command", "/rotor/state")
    assert flight.duration > 5.0
    pose, imu = flight.streams["/mocap/pose"], flight.streams["/imu/data"]
    turned = np.interp(pose.time, imu.time[1:], np.cumsum(imu["rate"][1:] * np.diff(imu.time)))
    assert np.corrcoef(turned, pose["theta"])[0, 1] > 0.9  # the gyro turns as the angle does
    assert 8.0 < np.median(np.hypot(imu["accel_x"], imu["accel_z"])) < 12.0


@pytest.mark.parametrize(("name", "counts"), [
    ("pitch_attitude_steps", {"pitch": 1971, "slide": 790}),
    ("pitch_free_decay", {"pitch": 5994, "slide": 2400}),
    ("rail_velocity_doublets_1", {"pitch": 9471, "slide": 3790}),
    ("rail_velocity_doublets_2", {"pitch": 7650, "slide": 3061}),
])  # fmt: skip
def test_the_antx_rig_is_read(shared_data: Path, name: str, counts: dict[str, int]) -> None:
    """Joints that come in messages of their own at their own rates; two actuators in one message."""
    flight = read_flight(shared_data / "antx" / f"{name}.mcap")
    assert {joint: len(stream) for joint, stream in flight.joints["/joint_states"].items()} == counts
    assert set(flight.joints["/joint_states"]["slide"].values) == {"position", "velocity"}
    assert set(flight.joints["/actuator_command"]) == {"moment", "thrust"}
    assert set(flight.joints["/actuator_command"]["thrust"].values) == {"effort"}
    assert flight.streams == {}


@pytest.mark.parametrize(("name", "part"), [
    ("wrong_encoding.mcap", "message encoding 'wrong_format' on /test_topic, /array_topic; expected 'cdr'"),
    ("service_events.mcap", "only /test_service1/_service_event (test_msgs/srv/BasicTypes_Event)"),
    ("old_schema_name.mcap", "only topic1 (test_msgs/BasicTypes)"),
    ("talker.mcap", "only /rosout (rcl_interfaces/msg/Log), /parameter_events"),
    ("split_0.mcap", "only AAA (std_msgs/msg/String), BBB"),
])  # fmt: skip
def test_bags_of_ros_itself_are_told_apart(shared_data: Path, name: str, part: str) -> None:
    """None is a flight, and each refusal says what it is instead."""
    refuse(shared_data / "rosbag2" / name, part)


def test_bags_of_ros_itself_decode(shared_data: Path) -> None:
    """The definition parser and the bulk decoder handle what ROS 2's own tests record."""
    seen = {}
    for path in list_flights(shared_data / "rosbag2"):
        for channel in read_container(path, Query(lambda channel: channel.encoding == "cdr")).channels:
            if channel.topic == "topic1":
                (batch,) = decode_channel(channel, ["float64_value", "uint8_value"])
                seen[channel.topic] = len(batch.number)
            elif channel.topic == "/rosout":
                seen[channel.topic] = sum(len(batch.number) for batch in decode_channel(channel, ["stamp.sec", "line"]))
    assert seen == {"topic1": 5, "/rosout": 10}


def test_split_bags_of_ros_itself_are_complete(shared_data: Path) -> None:
    """Both halves of the recording hold as many messages as their summaries say."""
    paths = [shared_data / "rosbag2" / f"split_{k}.mcap" for k in (1, 0)]
    counts = [sum(channel.count for channel in read_container(path, Query(lambda _: False)).channels) for path in paths]
    assert counts == [1240, 1246]
    refuse(paths, "none of our topics")


def list_streams(flight: Flight) -> dict[tuple[str, ...], Stream]:
    """All that was read, by topic and name."""
    joints = {(topic, name): stream for topic, names in flight.joints.items() for name, stream in names.items()}
    return {(topic,): stream for topic, stream in {**flight.streams, **flight.spatial}.items()} | joints


@pytest.mark.parametrize("large", [20_000, 300_000])
def test_large_logs_are_read_and_converted_as_they_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, large: int
) -> None:
    """The flight is the same, to the last bit, whether all messages were held or only numbers that are wanted."""
    flip, table = DEMO / "flip.mcap", tmp_path / "table.csv"
    states = [make_state(k, name=["a", "b"][:: 1 - 2 * (k > 20)], position=[0.01 * k, -0.5]) for k in range(40)]
    bag = Bag(tmp_path / "joints.mcap").add("/joint_states", JOINTS, states).add("/odd", IMU, [make_imu(EPOCH)])
    table.write_text("time,Arm q,kind\n" + "".join(f"{0.01 * k:.2f},{k},A{k}\n" for k in range(99)))
    transcribe(table, tmp_path / "table.mcap")
    (tmp_path / "map.yaml").write_text("/joint_states: {names: {q: {topic: table, position: Arm q}}}")
    for log in (flip, bag.write(), table, tmp_path / "table.mcap"):
        given = tmp_path / "map.yaml" if log.stem == "table" else None
        whole = read_flight(log, given)
        monkeypatch.setattr("vpptwin.logs.formats.raw.LARGE", large if log == flip else 100)
        monkeypatch.setattr("vpptwin.logs.formats.container._MAX_NOTED", 50)
        monkeypatch.setattr("vpptwin.logs.formats.delimited._BLOCK", 100)
        parts = read_flight(log, given)
        assert not any(channel.is_kept for channel in transcribe(log, tmp_path / "again.mcap").files[0].channels)
        again = read_flight(tmp_path / "again.mcap", given)
        for found in (parts, again):
            streams = list_streams(found)
            assert found.start_ns == whole.start_ns
            assert found.warnings == whole.warnings
            assert streams.keys() == list_streams(whole).keys()
            for name, stream in list_streams(whole).items():
                assert np.array_equal(streams[name].time, stream.time)
                assert streams[name].values.keys() == stream.values.keys()
                assert all(np.array_equal(streams[name][c], values) for c, values in stream.values.items())
        monkeypatch.undo()


def test_numbers_that_find_no_room_are_refused_and_a_stretch_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a line that says what to write; LOG@START-END is that part of a file, of a table, of a folder."""
    monkeypatch.setattr("vpptwin.logs.formats.raw.LARGE", 10_000)
    monkeypatch.setattr("vpptwin.logs.formats.container._MAX_NOTED", 50)
    monkeypatch.setattr("vpptwin.logs.streams.condense.MAX_BYTES", 50_000.0)
    log = pose_bag(tmp_path / "log.mcap", [EPOCH + k * 10**7 for k in range(1000)])
    table = tmp_path / "log.csv"
    table.write_text("time,q\n" + "".join(f"{0.01 * k:.2f},{k}\n" for k in range(3000)))
    (tmp_path / "map.yaml").write_text("/joint_states: {names: {q: {topic: log, position: q}}}")
    for given in (log, table):
        with pytest.raises(InputError, match=rf"{given}: the needed .* of \d+ s .* such as {given}@0-\d+ \(seconds\)"):
            read_flight(given, tmp_path / "map.yaml" if given == table else None)
    part = read_flight(f"{log}@2-4")
    assert part.path == Path(f"{log}@2-4")
    assert part.streams["/mocap/pose"]["x"].tolist() == [0.01 * k for k in range(200, 400)]
    part = read_flight(f"{table}@2.5-2.61", tmp_path / "map.yaml")
    assert part.joints["/joint_states"]["q"]["position"].tolist() == list(range(250, 261))
    assert main(["convert", f"{log}@2-4", str(tmp_path / "part.mcap")]) == 0
    assert "200 messages on 1 topics" in capsys.readouterr().out
    refuse(f"{log}@20-30", "@20-30 holds no messages; expected a stretch in which there are some")
    refuse(f"{log}@3-2", "from 3 to 2 s; expected a start before the end")


def test_a_stretch_of_split_files_counts_from_their_first(tmp_path: Path) -> None:
    """Of a rosbag2 folder, of FILE+FILE, and of nothing that is not there."""
    first, second = split_bag(tmp_path)
    (tmp_path / "metadata.yaml").write_text("")
    for given in (tmp_path, f"{first}+{second}"):
        assert len(read_flight(f"{given}@0.1-0.4").streams["/mocap/pose"]) == 30
    with pytest.raises(InputError, match=r"no file .*none.mcap; expected"):
        read_flight(tmp_path / "none.mcap@0-1")
