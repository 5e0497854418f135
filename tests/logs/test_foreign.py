"""Logs of other kinds: each is read to the same Flight as MCAP, and refused in one line that names the place."""

from __future__ import annotations

import gzip
import json
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from zstandard import ZstdCompressor

from tests.logs.bags import EPOCH, POSE, Bag, make_poses, refuse
from vpptwin.cli.main import main
from vpptwin.logs import Flight, Stream, read_flight
from vpptwin.logs.formats import vehicles
from vpptwin.logs.formats.raw import Query
from vpptwin.logs.formats.tables import Table
from vpptwin.logs.read import expand_logs
from vpptwin.logs.recording import open_recording
from vpptwin.logs.transcribe import transcribe
from vpptwin.mapping.survey import survey
from vpptwin.system.errors import InputError
from vpptwin.system.fields import SignalEntry

ALL = Query(lambda channel: True)


def read_joint(path: Path | list[Path], topic: str, **fields: object) -> Flight:
    """A flight with one joint, j, out of fields of a topic."""
    entry = SignalEntry.model_validate({"topic": topic, **fields})
    return read_flight(path, None, {"/joint_states": {"j": entry}})


def read_stream(path: Path, topic: str, **fields: object) -> Stream:
    """The one joint of `read_joint`."""
    return read_joint(path, topic, **fields).joints["/joint_states"]["j"]


def read_all(path: Path, topic: str, column: str) -> np.ndarray:
    """A column of a log."""
    return np.concatenate([batch.values[column] for batch in open_recording(path, ALL).decode(topic, [column])])


ROWS = [(0.01 * k, 0.5 * k) for k in range(40)]
"""Time [s] and position."""


def write_csv(path: Path, content: str | bytes) -> Path:
    """Write a file, as it is."""
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def compose(head: str, row: str, scale: float = 1.0, end: str = "\n") -> str:
    """CSV with these rows; `row` formats t and q."""
    return end.join([head, *(row.format(t=t * scale, q=q, n=round(t * scale)) for t, q in ROWS)]) + end


FIELD = {
    "plain": (compose("time,q", "{t:.6f},{q}"), "q"),
    "semicolons and decimal commas": (compose("time;q", "{t:.3f};{q:.2f}").replace(".", ","), "q"),
    "tabs": (compose("t\tq", "{t}\t{q}"), "q"),
    "spaces after a comment": (compose("# t q", "{t} {q}"), "q"),
    "milliseconds by name": (compose("time_ms,q", "{t:.3f},{q}", 1e3), "q"),
    "microseconds by step": (compose("timestamp,q", "{t:.3f},{q}", 1e6), "q"),
    "nanoseconds since 1970": (
        "stamp,q\n" + "".join(f"{1_700_000_000 * 10**9 + round(t * 1e9)},{q}\n" for t, q in ROWS),
        "q",
    ),
    "seconds since 1970": ("stamp,q\n" + "".join(f"{1_700_000_000 + t:.6f},{q}\n" for t, q in ROWS), "q"),
    "a row of units": (compose("time,angle\nms,deg", "{t:.3f},{q}", 1e3), "angle"),
    "units in names": (compose("Time [ms],angle (deg)", "{t:.3f},{q}", 1e3), "angle"),
    "names that are no identifiers": (compose("time,Joint 1: q [rad]", "{t},{q}"), "Joint 1: q"),
    "the same name twice": (compose("time,q,q", "{t},0,{q}"), "q_2"),
    "lists in quoted cells": (compose("time,q", '{t},"[7.0, {q}]"'), "q[1]"),
    "lists with spaces": (compose("time,q", '{t},"( 7.0  {q} )"'), "q[1]"),
    "text beside": (compose("kind,time,q", "STATE,{t},{q}"), "q"),
    "mixed line endings": (compose("time,q", "{t},{q}").replace("\n", "\r\n", 20), "q"),
    "carriage returns": (compose("time,q", "{t},{q}", end="\r"), "q"),
    "dates": ("date_time,q\n" + "".join(f"2026-01-31 23:59:59.{round(t * 1e3):03d},{q}\n" for t, q in ROWS), "q"),
    "dates of a zone": ("t,q\n" + "".join(f"2026-01-31T23:59:59.{round(t * 1e6):06d}Z,{q}\n" for t, q in ROWS), "q"),
    "a mark of UTF-8": ("\ufeff" + compose("time,q", "{t},{q}"), "q"),
    "empty lines at the end": (compose("time,q", "{t},{q}") + "\n,\n,\n", "q"),
}


@pytest.mark.parametrize("name", FIELD)
def test_csv_of_the_field(tmp_path: Path, name: str) -> None:
    """Whatever it looks like, time and positions are those that were written."""
    content, column = FIELD[name]
    stream = read_stream(write_csv(tmp_path / "state.csv", content), "state", position=column)
    assert np.allclose(stream.time, [t for t, _ in ROWS], atol=1e-6)
    assert stream["position"].tolist() == [q for _, q in ROWS]


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1", "gzip"])
def test_csv_in_other_encodings(tmp_path: Path, encoding: str) -> None:
    """UTF-16, Latin-1 with a note, and gzip."""
    text = compose("time,Größe", "{t},{q}")
    content = gzip.compress(text.encode()) if encoding == "gzip" else text.encode(encoding)
    flight = read_joint(write_csv(tmp_path / "state.csv", content), "/state", position="Größe")
    assert flight.joints["/joint_states"]["j"]["position"].tolist() == [q for _, q in ROWS]
    assert any("Latin-1" in line for line in flight.warnings) == (encoding == "latin-1")


def spoil(change: Callable[[list[str]], None]) -> str:
    """Rows with one of them changed; line 1 holds the names."""
    lines = compose("time,q", "{t},{q}").splitlines()
    change(lines)
    return "\n".join(lines) + "\n"


BAD = {
    "text where numbers are": (spoil(lambda lines: lines.__setitem__(9, "0.08,broken")), "line 10: 'broken' as q"),
    "a cell too few": (spoil(lambda lines: lines.__setitem__(9, "0.08")), "line 10: 1 cells"),
    "cut in a line": (compose("time,q", "{t},{q}").rstrip("\n")[:-5], "line 41: 1 cells"),
    "no time in a row": (spoil(lambda lines: lines.__setitem__(9, ",4.0")), "line 10: no number as time"),
    "a time that is no number": (compose("time,q", "12h{t},{q}"), "line 2: '12h0.0' as time"),
    "a date that is none": ("t,q\n2026-01-31 12:00:00.0,1\n2026-01-31 12:00:00.1,2\nnoon,3\n", "line 4: 'noon' as t"),
    "a missing column": (compose("time,angle", "{t},{q}"), "no numeric column q, only time, angle"),
    "numbers nowhere": (compose("time,q", "{t},nan"), "no row with a number as q"),
    "names alone": ("time,q\n", "has no rows"),
    "nothing but blanks": ("\n\n \n", "has no rows"),
    "no time at all": (compose("a,b", "{q},{q}"), "columns a, b; expected a column time, t or timestamp"),
    "a shorter list": (compose("time,q", '{t},"[1, {q}]"') + '0.4,"[1]"\n', "line 42: 1 values in the list of q"),
    "time that goes back": (
        spoil(lambda lines: lines.__setitem__(slice(1, None), lines[:0:-1])), "stamps",
    ),
    "time that stands still": (compose("time,q", "1.0,{q}"), "stamp"),
    "a time without end": (spoil(lambda lines: lines.__setitem__(9, "-inf,4.0")), "line 10: no number as time"),
    "a number beyond all measure": (
        spoil(lambda lines: lines.__setitem__(9, "0.08,1e200")), "position reaches 1e+200, beyond 1e+12 in 1 of 40",
    ),
    "infinity": (spoil(lambda lines: lines.__setitem__(9, "0.08,inf")), "position is an infinity"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_csv_is_refused_in_a_line(tmp_path: Path, name: str) -> None:
    """Each says what is wrong, and in which line of the file."""
    content, part = BAD[name]
    log, field = write_csv(tmp_path / "state.csv", content), "q" if "list" not in name else "q[1]"
    refuse(log, part, read=lambda path: read_joint(path, "state", position=field))


def test_empty_cells_are_no_samples(tmp_path: Path) -> None:
    """What was not measured in a row is left out of that signal, and counted."""
    content = spoil(lambda lines: lines.__setitem__(slice(5, 8), ["0.04,", "0.05,nan", "0.06,NA"]))
    flight = read_joint(write_csv(tmp_path / "state.csv", content), "state", position="q")
    assert len(flight.joints["/joint_states"]["j"]) == 37
    assert "3 of 40 rows of /state lack /joint_states j, left out" in flight.warnings


def test_rows_a_little_out_of_order_are_sorted(tmp_path: Path) -> None:
    """As late messages are, and the second of two rows with one time is dropped."""
    content = spoil(lambda lines: lines.__setitem__(slice(5, 8), [lines[6], lines[5], lines[5]]))
    stream = read_stream(write_csv(tmp_path / "state.csv", content), "state", position="q")
    assert (np.diff(stream.time) > 0).all()
    assert len(stream) == 39


@pytest.mark.parametrize(("head", "names"), [("tick,q\n", ("tick", "q")), ("", ("c0", "c1"))])
def test_the_clock_can_be_named(tmp_path: Path, head: str, names: tuple[str, str]) -> None:
    """A column and its unit, for whom the header does not tell; without a header columns are called by place."""
    log = write_csv(tmp_path / "state.csv", head + compose("", "{t},{q}", 1e3).lstrip())
    stream = read_stream(log, "state", position=names[1], stamp={"path": names[0], "unit": "ms"})
    assert np.allclose(stream.time, [t for t, _ in ROWS])


@pytest.mark.parametrize(("field", "expected"), [
    ({"path": "q", "unit": "deg"}, lambda q: np.deg2rad(q)),
    ({"path": "q", "unit": "mm", "scale": -1.0, "offset": 0.1}, lambda q: -0.001 * q + 0.1),
    ({"path": "q", "polynomial": [1.0, 0.0, 2.0], "scale": 0.5}, lambda q: 0.5 * (1.0 + 2.0 * q**2)),
])  # fmt: skip
def test_fields_have_units_scales_and_polynomials(
    tmp_path: Path, field: dict[str, object], expected: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Scale · polynomial(field) · unit + offset."""
    stream = read_stream(write_csv(tmp_path / "state.csv", FIELD["plain"][0]), "state", position=field)
    assert np.allclose(stream["position"], expected(np.array([q for _, q in ROWS])))


def test_a_topic_map_names_joints_too(tmp_path: Path) -> None:
    """The same entries as in a twin; the drone's topics are made of columns likewise."""
    log = write_csv(tmp_path / "state.csv", FIELD["plain"][0])
    (tmp_path / "map.yaml").write_text(
        "/joint_states: {names: {j: {topic: state, position: q}}}\n"
        "/imu/data: {topic: state, fields: {rate: {path: q, unit: deg/s}}}\n"
    )
    flight = read_flight(log, tmp_path / "map.yaml")
    assert flight.joints["/joint_states"]["j"]["position"][3] == 1.5
    assert flight.streams["/imu/data"]["rate"][3] == pytest.approx(np.deg2rad(1.5))


def test_parquet_is_read(tmp_path: Path) -> None:
    """Numbers, dates, lists; pictures and ragged lists are left out."""
    start = 1_700_000_000 * 10**9
    table = pa.table({
        "time": pa.array([start + round(t * 1e9) for t, _ in ROWS], pa.timestamp("ns")),
        "q": pa.array([[7.0, q] for _, q in ROWS], pa.list_(pa.float32())),
        "ragged": [[1.0] * (k % 3) for k in range(len(ROWS))],
    })  # fmt: skip
    parquet.write_table(table, tmp_path / "state.parquet")
    flight = read_joint(tmp_path / "state.parquet", "state", position="q[1]")
    assert flight.start_ns == start
    assert flight.joints["/joint_states"]["j"]["position"].tolist() == [q for _, q in ROWS]
    content = (tmp_path / "state.parquet").read_bytes()
    (tmp_path / "state.parquet").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="is damaged"):
        read_joint(tmp_path / "state.parquet", "state", position="q[1]")


def test_lists_of_parquet_may_be_torn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of another length, or empty ones, are no samples; lists whose mean length alone is one are none at all."""
    monkeypatch.setattr("vpptwin.logs.formats.columnar._MAX_ROWS", 15)
    lists = [None if k == 3 else [7.0, q] if k != 30 else [7.0] for k, (_, q) in enumerate(ROWS)]
    odd = [[1.0] * (1 + 2 * (k % 2)) for k in range(len(ROWS))]
    late = [[k, k] if k < 30 else [k] for k in range(len(ROWS))]
    half = [[1.0, q] if k % 3 else None for k, (_, q) in enumerate(ROWS)]
    times, places = zip(*ROWS)
    table = {"t": times, "half": half, "q": lists, "odd": odd, "late": late, "p": places}
    parquet.write_table(pa.table(table), log := tmp_path / "state.parquet")
    assert len(read_stream(log, "state", position="q[1]")) == len(ROWS) - 2
    assert len(read_stream(log, "state", position="half[1]")) == 26
    assert len(read_stream(log, "state", position="p")) == len(ROWS)
    with pytest.raises(InputError, match="late holds lists of several lengths"):
        read_joint(log, "state", position="late[0]")
    recording, signals = survey(log)
    assert recording.files[0].notes == ["/state: no numbers in odd, left out"]
    assert {"t", "p", "q[0]", "q[1]"} <= {signal.field for signal in signals}


def test_episodes_of_a_file_without_its_folder_are_flights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Parquet out of a LeRobot data set: FILE#EPISODE, never one laid over another."""
    file = tmp_path / "some.parquet"
    file.write_bytes((write_lerobot(tmp_path / "set") / "data/chunk-000/file-000.parquet").read_bytes())
    entry = SignalEntry.model_validate({"topic": "some", "position": "observation.state[0]"})
    flights = [read_flight(part, None, {"/joint_states": {"j": entry}}) for part in expand_logs([file])]
    assert [len(flight.joints["/joint_states"]["j"]) for flight in flights] == [30, 20]
    assert "some.parquet stands for 2 recordings" in capsys.readouterr().err
    refuse(file, "holds 2 tests: #0 episode_index 0, #1 episode_index 1", "give one, such as ", "#0", read=survey)
    refuse(Path(f"{file}#5"), "no episode 5; expected #0, #1", read=survey)
    assert main(["inspect", str(file)]) == 0
    assert "some.parquet#1: " in capsys.readouterr().out.replace("\n", "")  # long paths are folded


def write_lerobot(folder: Path) -> Path:
    """A data set of version 3: two episodes in one file, as LeRobot lays it out."""
    names = {"names": ["shoulder.pos", "elbow.pos"], "dtype": "float32", "shape": [2]}
    about = {
        "codebase_version": "v3.0", "fps": 50, "total_episodes": 2,
        "features": {"observation.state": names, "action": names},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    }  # fmt: skip
    for part in ("meta/episodes/chunk-000", "data/chunk-000"):
        (folder / part).mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(about))
    episodes = {"episode_index": [0, 1], "data/chunk_index": [0, 0], "data/file_index": [0, 0], "length": [30, 20]}
    parquet.write_table(pa.table(episodes), folder / "meta/episodes/chunk-000/file-000.parquet")
    frames = [k for length in (30, 20) for k in range(length)]
    state = pa.array([[0.01 * k, -0.5] for k in frames], pa.list_(pa.float32(), 2))
    data = {
        "observation.state": state, "action": state, "timestamp": pa.array([k / 50 for k in frames], pa.float32()),
        "frame_index": frames, "episode_index": [0] * 30 + [1] * 20, "index": list(range(50)), "task_index": [0] * 50,
    }  # fmt: skip
    parquet.write_table(pa.table(data), folder / "data/chunk-000/file-000.parquet")
    return folder


def test_an_episode_of_lerobot_is_a_flight(tmp_path: Path) -> None:
    """A data set is a folder of flights; elements of a list go by the names in info.json."""
    folder = write_lerobot(tmp_path / "set")
    entry = SignalEntry.model_validate({"topic": "episode", "position": "observation.state.shoulder.pos"})
    flights = [read_flight(log, None, {"/joint_states": {"j": entry}}) for log in expand_logs([folder])]
    assert [len(flight.joints["/joint_states"]["j"]) for flight in flights] == [30, 20]
    assert flights[1].joints["/joint_states"]["j"]["position"][3] == np.float32(0.03)
    assert flights[1].joints["/joint_states"]["j"].time[-1] == pytest.approx(19 / 50)
    with pytest.raises(InputError, match="no rows of episode 7; expected 0 to 1"):
        read_flight(f"{folder}#7", None, {"/joint_states": {"j": entry}})


def write_ulog(path: Path) -> Path:
    """A ULog of two topics, by the format's specification."""

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), kind[0]) + content

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000), message(b"B", bytes(40))]
    parts.append(message(b"F", b"servo:uint64_t timestamp;float[2] angle;uint8_t[4] _padding0;"))
    parts.append(message(b"A", struct.pack("<BH", 0, 3) + b"servo"))
    parts.append(message(b"A", struct.pack("<BH", 1, 4) + b"servo"))
    for t, q in ROWS:
        for number, sign in ((3, 1.0), (4, -1.0)):
            parts.append(message(b"D", struct.pack("<HQff", number, round(t * 1e6) + 5_000_000, 7.0, sign * q)))
    path.write_bytes(b"".join(parts))
    return path


def test_ulog_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays are indexed, instances counted, in stretches as in one piece; one that ends early is used so far."""
    log = write_ulog(tmp_path / "log.ulg")
    for topic, sign in (("servo", 1.0), ("servo_1", -1.0)):
        stream = read_stream(log, topic, position="angle[1]")
        assert np.allclose(stream.time, [t for t, _ in ROWS])
        assert stream["position"].tolist() == [sign * q for _, q in ROWS]
    whole = read_all(log, "/servo", "angle")
    monkeypatch.setattr(vehicles, "_MAX_PIECE", 300)
    assert np.array_equal(read_all(log, "/servo", "angle"), whole)
    monkeypatch.undo()
    log.write_bytes(log.read_bytes()[:900])
    flight = read_joint(log, "servo", position="angle[1]")
    assert 0 < len(flight.joints["/joint_states"]["j"]) < 40
    assert flight.warnings == ("log.ulg ends within a message: what is before it is used",)
    log.write_bytes(log.read_bytes()[:20])
    with pytest.raises(InputError, match=r"ULog"):
        read_joint(log, "servo", position="angle[1]")


def describe(kind: int, name: str, form: str, columns: str, size: int) -> bytes:
    """A message of DataFlash that describes others."""
    fields = (name.encode(), form.encode(), columns.encode())
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, *fields)


def write_dataflash(path: Path) -> Path:
    """A DataFlash log by ArduPilot's format: descriptions first, as a board writes them."""
    parts = [describe(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)]
    parts.append(describe(150, "ATT", "Qcf", "TimeUS,Roll,Pitch", 3 + 8 + 2 + 4))
    for t, q in ROWS:
        parts.append(b"\xa3\x95\x96" + struct.pack("<Qhf", round(t * 1e6) + 5_000_000, round(100 * q), -q))
    path.write_bytes(b"".join(parts))
    return path


def test_dataflash_is_read(tmp_path: Path) -> None:
    """Messages by name, with the multipliers of their formats."""
    log = write_dataflash(tmp_path / "00000001.BIN")
    stream = read_stream(log, "ATT", position="Roll", velocity="Pitch")
    assert np.allclose(stream.time, [t for t, _ in ROWS])
    assert np.allclose(stream["position"], [q for _, q in ROWS])
    assert np.allclose(stream["velocity"], [-q for _, q in ROWS])
    log.write_bytes(log.read_bytes()[:-5])
    assert read_joint(log, "ATT", position="Roll").warnings == (
        "00000001.BIN ends within a message: what is before it is used",
    )
    log.write_bytes(log.read_bytes()[:150])
    with pytest.raises(InputError, match="DataFlash"):
        read_joint(log, "ATT", position="Roll")


def write_instances(path: Path) -> Path:
    """A DataFlash log of two sensors, with text, halves and an array, and a torn message amid them."""
    parts = [describe(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)]
    parts.append(describe(151, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds", 44))
    parts.append(describe(152, "IMU", "QBgLna", "TimeUS,I,G,Lat,S,A", 3 + 8 + 1 + 2 + 4 + 4 + 64))
    parts.append(b"\xa3\x95\x97" + struct.pack("<QB16s16s", 0, 152, b"s#----", b"F-----"))
    for k in range(80):
        row = struct.pack("<QBeI4s32h", 10_000 * k, k % 2, k / 4, 10**7 * k, b"ab\0x", *range(k, k + 32))
        parts.append(b"\xa3\x95\x98" + row)
    parts.insert(50, b"junk" * 200)
    path.write_bytes(b"".join(parts))
    return path


@pytest.mark.parametrize("stretch", [1 << 26, 1000])
def test_dataflash_has_instances_and_is_read_in_stretches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stretch: int
) -> None:
    """Messages by instance with their types and factors, what is torn left out, whatever a stretch cuts through."""
    monkeypatch.setattr(vehicles, "_MAX_PIECE", stretch)
    log, notes = write_instances(tmp_path / "log.bin"), []  # type: ignore[var-annotated]
    tables: dict[str, list[Table]] = {}
    for table in vehicles.read_dataflash(log, "", ALL, notes):
        tables.setdefault(table.topic, []).append(table)
    assert len(tables.pop("/FMTU")) == 1
    assert tables.keys() == {"/IMU", "/IMU_1"}
    for instance, topic in enumerate(tables):
        own = np.arange(instance, 80, 2)
        column = {name: np.concatenate([t.columns[name] for t in tables[topic]]) for name in tables[topic][0].columns}
        assert np.array_equal(np.concatenate([table.time for table in tables[topic]]), own * 10**7)
        assert np.array_equal(column["G"], (own / 4).astype("f4"))
        assert np.array_equal(column["Lat"], own.astype(float))
        assert set(column["S"]) == {"ab"}
        assert np.array_equal(column["A"], own[:, None] + np.arange(32))
    assert notes == ["log.bin is damaged in places, which are left out"]


def test_rosbag2_in_sqlite_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What rosbags writes as a rosbag2 folder with SQLite is the flight that it is as MCAP, in stretches if large."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    source = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(50)).write()
    recording = open_recording(source, ALL)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/mocap/pose", POSE, typestore=get_typestore(Stores.ROS2_HUMBLE))
        for block in recording.files[0].channels[0].blocks:
            for time, payload in zip(block.log_time, block.payload):
                writer.write(connection, int(time), payload.tobytes())
    expected = read_flight(source).streams["/mocap/pose"]
    found = read_flight(tmp_path / "bag").streams["/mocap/pose"]
    assert all(np.array_equal(found[column], expected[column]) for column in expected.values)
    with sqlite3.connect(next((tmp_path / "bag").glob("*.db3"))) as base:  # as --compression-mode message has it
        for key, data in base.execute("SELECT id, data FROM messages WHERE id % 3 = 0").fetchall():
            base.execute("UPDATE messages SET data = ? WHERE id = ?", (ZstdCompressor().compress(data), key))
    assert np.array_equal(read_flight(tmp_path / "bag").streams["/mocap/pose"]["x"], expected["x"])
    whole = survey(tmp_path / "bag")[1]
    monkeypatch.setattr("vpptwin.logs.formats.bags._MAX_GATHERED", 10)
    monkeypatch.setattr("vpptwin.system.progress.QUIET_S", 0.0)
    monkeypatch.setattr("vpptwin.logs.formats.raw.LARGE", 500)
    parts = survey(tmp_path / "bag")[1]
    assert [part.whole.high for part in parts] == [signal.whole.high for signal in whole]
    assert sum(len(part.stretches) for part in parts) > 2 * len(parts)
    assert "\rread " in capsys.readouterr().err
    (file,) = (tmp_path / "bag").glob("*.db3")
    file.write_bytes(file.read_bytes()[:5000])
    refuse(tmp_path / "bag", "is damaged")


def test_a_bag_of_ros_1_is_read(tmp_path: Path) -> None:
    """What rosbags writes as a ROS 1 bag; its messages become those of ROS 2."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    source = Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(50)).write()
    store, two = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    with Writer(tmp_path / "log.bag") as writer:
        connection = writer.add_connection("/mocap/pose", POSE, typestore=store)
        for block in open_recording(source, ALL).files[0].channels[0].blocks:
            for k, (time, payload) in enumerate(zip(block.log_time, block.payload)):
                message = two.deserialize_cdr(payload.tobytes(), POSE)
                header = store.types["std_msgs/msg/Header"](k, message.header.stamp, message.header.frame_id)
                raw = store.serialize_ros1(store.types[POSE](header, message.pose), POSE)
                writer.write(connection, int(time), raw)
    expected = read_flight(source)
    found = read_flight(tmp_path / "log.bag")
    assert found.start_ns == expected.start_ns >= EPOCH
    assert np.array_equal(found.streams["/mocap/pose"]["x"], expected.streams["/mocap/pose"]["x"])
    content = (tmp_path / "log.bag").read_bytes()
    (tmp_path / "log.bag").write_bytes(content[:5000])
    refuse(tmp_path / "log.bag", "is damaged")


@pytest.mark.parametrize("change", ["cut", "flip", "version"])
def test_a_crazyflies_card_is_read_and_checked(shared_data: Path, tmp_path: Path, change: str) -> None:
    """Real logs of CrazyPAD: a hover at half a metre to two, at 4 V; what is damaged fails its checksum."""
    log = shared_data / "crazypad/normal_flight/E9_log00"
    voltage, height = (read_all(log, "/fixedFrequency", name) for name in ("pm.vbatMV", "stateEstimate.z"))
    assert len(voltage) == 2593
    assert (np.median(voltage) > 3000) & (np.median(voltage) < 4300)
    assert 0.2 < np.median(height) < 2.0
    content = bytearray(log.read_bytes())
    content = content[:-100] if change == "cut" else content
    content[1 if change == "version" else 5000] ^= 4
    copy = write_csv(tmp_path / "E9_log00", bytes(content))
    with pytest.raises(InputError, match="version" if change == "version" else "checksum|starting with"):
        read_all(copy, "/fixedFrequency", "pm.vbatMV")


REAL = {
    "so101/multisine/state_motor.csv": ("positions[5]", 6000, 120.34),
    "so101/multisine/control.csv": ("positions[0]", 6000, 120.34),
    "double_pendulum/design_A_02.csv": ("tau_meas2", None, None),
    "simple_pendulum/ilqr.csv": ("torque", 1000, 19.98),
    "nanobench/B2_circle_fast_rep1.csv.gz": ("imu_acc_z", 2674, 26.76),
}
"""Log → a column, how many rows it has, over how long [s]."""


@pytest.mark.parametrize("name", REAL)
def test_real_csv_is_read_and_transcribed(shared_data: Path, tmp_path: Path, name: str) -> None:
    """Every column of the MCAP is bit-equal to that of the log."""
    column, rows, duration = REAL[name]
    log, copy = shared_data / name, tmp_path / "copy.mcap"
    assert main(["convert", str(log), str(copy)]) == 0
    (channel,) = open_recording(log, ALL).files[0].channels
    assert rows is None or channel.count == rows
    flight = read_joint(copy, channel.topic, position=column)
    assert duration is None or flight.duration == pytest.approx(duration, abs=0.01)
    assert np.array_equal(read_all(copy, channel.topic, column), read_all(log, channel.topic, column))


def test_transcription_keeps_everything(tmp_path: Path) -> None:
    """Text, whole numbers, lists and times come back, and mcap-ros2-support decodes them."""
    from mcap_ros2.reader import read_ros2_messages

    log = write_csv(tmp_path / "state.csv", 'kind,time,n,q\nA,0.1,5,"[1, 2.5]"\nLonger,0.2,6,"[3, 4.5]"\n')
    transcribe(log, tmp_path / "out.mcap")
    found = [m.ros_msg for m in read_ros2_messages(str(tmp_path / "out.mcap"))]
    assert [m.kind for m in found] == ["A", "Longer"]
    assert [list(m.q) for m in found] == [[1.0, 2.5], [3.0, 4.5]]
    assert [m.header.stamp.nanosec for m in found] == [100_000_000, 200_000_000]


@pytest.mark.parametrize(("source", "out", "part"), [
    ("log.mcap", "log.mcap", "is the log itself"), ("log.mcap", "log.bag", "ends with .mcap"),
    ("log.mcap", "missing/out.mcap", "cannot be written"), ("nothing.csv", "out.mcap", "no file"),
])  # fmt: skip
def test_bad_conversions_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], source: str, out: str, part: str
) -> None:
    """In one line, with exit code 2, even with --force."""
    Bag(tmp_path / "log.mcap").add("/mocap/pose", POSE, make_poses(5)).write()
    assert main(["convert", "--force", str(tmp_path / source), str(tmp_path / out)]) == 2
    assert part in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["csv", "parquet", "mcap"])
def test_columns_of_no_interest_cost_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """Only what a twin names is converted and held, once, whatever pieces it comes in; other columns may be broken."""
    monkeypatch.setattr("vpptwin.logs.formats.delimited._BLOCK", 1000)
    monkeypatch.setattr("vpptwin.logs.formats.columnar._MAX_ROWS", 7)
    log = write_csv(tmp_path / "state.csv", compose("time,other,q,text", "{t},{q},{q},A"))
    if kind == "csv":
        log.write_text(log.read_text().replace("0.35,17.5,", "0.35,broken,"))
    elif kind == "parquet":
        times, places = zip(*ROWS)
        table = pa.table({"time": times, "other": places, "q": places, "text": ["A"] * len(ROWS)})
        parquet.write_table(table, log := tmp_path / "state.parquet")
    else:
        transcribe(log, log := tmp_path / "state.mcap")
    if kind != "mcap":
        recording = open_recording(log, Query(lambda channel: True, {"/state": {"q", "header.stamp"}}))
        (rows,) = recording.files[0].channels[0].rows
        assert list(rows.columns) == ["q"]
        assert len(rows.time) == len(ROWS)
    found = read_stream(log, "state", position="q")["position"]
    assert found.tolist() == [q for _, q in ROWS]


@pytest.mark.parametrize("kind", ["csv", "mcap"])
def test_large_logs_are_surveyed_in_stretches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """What is said of a log is the same whether it was looked at whole or in stretches, the first of which is kept."""
    time = np.arange(3000) * 0.001
    time[1500:] += 0.2
    place = np.sin(time)
    place[[1000, 2500]] += 9.0
    text = "".join(f"{t:.3f},{q:.6f},A\n" for t, q in zip(time, place)).replace("0.700,0.644218", "0.700,")
    log = write_csv(tmp_path / "state.csv", "time,q,text\n" + text)
    monkeypatch.setattr("vpptwin.logs.formats.delimited._BLOCK", 1000)
    if kind == "mcap":
        transcribe(log, log := tmp_path / "state.mcap")
    whole = survey(log)[1]
    monkeypatch.setattr("vpptwin.logs.formats.raw.LARGE", 20_000)
    monkeypatch.setattr("vpptwin.logs.formats.container._MAX_NOTED", 300)
    parts = survey(log)[1]
    assert len(whole[1].stretches) == 1
    assert len(parts[1].stretches) > 2
    assert len(parts[1].time) == len(parts[1].values) < 1500 < len(whole[1].time) == 3000
    for one, several in zip(whole, parts, strict=True):
        assert list(one.list_oddities()) == list(several.list_oddities()), one.title
        assert several.rate == pytest.approx(one.rate)
        assert (several.whole.start, several.whole.end) == (one.whole.start, one.whole.end)
        assert (several.whole.low, several.whole.high) == (one.whole.low, one.whole.high)
    assert list(parts[1].list_oddities()) == ["1 missing", "1 gaps, longest 0.201 s", "4 jumps, up to 9"]


def test_a_clock_that_falls_or_stands_is_told(tmp_path: Path) -> None:
    """`inspect` shows such a log, and says so."""
    log = write_csv(tmp_path / "log.csv", "time,q\n0.01,1\n0.02,2\n0.02,3\n0.01,4\n0.03,5\n")
    recording, _ = survey(log)
    assert "/log: the time falls 1 times and repeats 1 times" in recording.files[0].notes


def test_files_of_one_flight_are_joined(shared_data: Path) -> None:
    """FILE+FILE is one flight: commands of one, positions of the other."""
    folder = shared_data / "so101/multisine"
    entries = {
        "/joint_states": {"j": SignalEntry.model_validate({"topic": "state_motor", "position": "positions[0]"})},
        "/actuator_command": {"j": SignalEntry.model_validate({"topic": "control", "effort": "positions[0]"})},
    }
    flight = read_flight(f"{folder}/control.csv+{folder}/state_motor.csv", None, entries)
    assert len(flight.joints["/joint_states"]["j"]) == len(flight.joints["/actuator_command"]["j"]) == 6000


def test_a_missing_library_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one line."""

    def refuse(name: str) -> object:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr("vpptwin.system.errors.import_module", refuse)
    parquet.write_table(pa.table({"t": [0.0, 1.0], "q": [0.0, 1.0]}), tmp_path / "state.parquet")
    with pytest.raises(InputError, match=r"needs pyarrow, which is not installed; .*pip install 'vpptwin\[logs\]'"):
        read_joint(tmp_path / "state.parquet", "state", position="q")


def test_a_twin_names_columns(shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A CSV with a twin that says what its columns are scores as the MCAP that was made of it by hand, and is kept."""
    from examples.double_pendulum.convert import convert
    from vpptwin.twin import load_twin

    folder = Path(__file__).resolve().parents[2] / "examples/double_pendulum"
    text = (folder / "both.yaml").read_text().replace("model: ", f"model: {folder}/")
    for k, joint in ((1, "shoulder"), (2, "elbow")):
        text = text.replace(
            f"{joint}_motor: /actuator_command", f"{joint}_motor: {{topic: design_A_02, effort: tau_con{k}}}"
        )
        fields = f"{{topic: design_A_02, position: pos_meas{k}, velocity: vel_meas{k}}}"
        text = text.replace(f"{joint}: /joint_states", f"{joint}: {fields}")
    (tmp_path / "twin.yaml").write_text(text)
    log = shared_data / "double_pendulum/design_A_02.csv"
    convert(log, tmp_path / "log.mcap")
    scores = []
    for given, twin in ((log, tmp_path / "twin.yaml"), (tmp_path / "log.mcap", folder / "both.yaml")):
        assert main(["compare", str(given), "--twin", str(twin), "--json", "-"]) == 0
        scores.append(json.loads(capsys.readouterr().out)["error"])
    assert scores[0] == scores[1]
    signals = load_twin(tmp_path / "twin.yaml").robot.signals
    assert type(signals).model_validate(signals.as_dict()) == signals


def test_a_twin_of_one_run_takes_the_next(tmp_path: Path) -> None:
    """Files of one table each, whatever they are called; a file more, and each keeps its name."""
    for run in ("run_1", "run_2"):
        write_csv(tmp_path / f"{run}.csv", FIELD["plain"][0])
    entries = {"/joint_states": {"j": SignalEntry.model_validate({"topic": "run_1", "position": "q"})}}
    first, second = (read_flight(tmp_path / f"run_{i}.csv", None, entries) for i in (1, 2))
    positions = [flight.joints["/joint_states"]["j"]["position"] for flight in (first, second)]
    np.testing.assert_array_equal(*positions)
    write_csv(tmp_path / "run_3.csv", FIELD["plain"][0])
    assert not second.warnings
    with pytest.raises(InputError, match=r"lacks topic /run_1.*one of /run_2, /run_3"):
        read_flight(f"{tmp_path}/run_2.csv+{tmp_path}/run_3.csv", None, entries)
