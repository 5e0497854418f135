"""Logs that claim more than they hold, clocks that leap: one line, in no time, in little memory."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from shutil import copy

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Footer, Header
from mcap.writer import MCAP0_MAGIC

from tests.bad_files import swing
from tests.diagnosis.made_up import FLIP
from tests.logs.bags import EPOCH, JOINTS, POSE, Bag, make_pose, refuse, stamp_header
from tests.measured import run_measured
from vpptwin.logs import read_flight
from vpptwin.logs.formats.container import read_container
from vpptwin.logs.formats.raw import Query
from vpptwin.logs.formats.unpack import FREE, MAX_RATIO
from vpptwin.system.errors import InputError

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
from long_log import add_camera

GIB = 1 << 30
MESSAGE = struct.pack("<BQHIQQ", 5, 22, 1, 0, EPOCH, EPOCH)  # an empty one


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> float:
    """What refusing a file that is missing takes, all of it Python's imports [s of processor time]."""
    folder = tmp_path_factory.mktemp("usual")
    return run_measured("play", "missing.mcap", "--html", "page.html", folder=folder).seconds


def write_chunks(path: Path, chunks: list[Chunk]) -> Path:
    """A file of these chunks and nothing else."""
    builder = RecordBuilder()
    for record in (Header("ros2", "a bomb"), *chunks, Footer(0, 0, 0)):
        record.write(builder)
    path.write_bytes(MCAP0_MAGIC + builder.end() + MCAP0_MAGIC)
    return path


def pack_zeros(size: int, compression: str) -> bytes:
    """So many bytes of zeros, compressed piece by piece."""
    sink, piece = BytesIO(), bytes(1 << 24)
    packer = zstandard.ZstdCompressor().stream_writer(sink, closefd=False)
    if compression == "lz4":
        packer = lz4.frame.LZ4FrameFile(sink, "wb")
    for _ in range(size // len(piece)):
        packer.write(piece)
    packer.close()
    return sink.getvalue()


BOMBS: dict[str, Callable[[], list[Chunk]]] = {
    "zstd": lambda: [Chunk("zstd", pack_zeros(2 * GIB, "zstd"), 0, 0, 0, 2 * GIB)],
    "zstd that claims little": lambda: [Chunk("zstd", pack_zeros(2 * GIB, "zstd"), 0, 0, 0, 1 << 20)],
    "lz4 that claims little": lambda: [Chunk("lz4", pack_zeros(2 * GIB, "lz4"), 0, 0, 0, 1 << 20)],
    "many": lambda: 100 * [Chunk("zstd", pack_zeros(1 << 26, "zstd"), 0, 0, 0, 1 << 26)],
    "messages": lambda: [Chunk("zstd", zstandard.compress(MESSAGE * 10**7), 0, 0, 0, len(MESSAGE) * 10**7)],
}


@pytest.mark.parametrize(
    "name", [name if name == "messages" else pytest.param(name, marks=pytest.mark.slow) for name in BOMBS]
)
def test_chunks_that_unpack_to_gigabytes_are_refused(tmp_path: Path, name: str, usual: float) -> None:
    """Before they are unpacked: a line, under 2 s of processor time, under 1 GB."""
    path = write_chunks(tmp_path / "bomb.mcap", BOMBS[name]())
    cost = run_measured("play", path, "--html", tmp_path / "page.html", folder=tmp_path)
    cost.check_refused("bomb.mcap", "holds a broken chunk" if "little" in name else "unpacks to", "expected")
    assert cost.seconds < 2.0 + usual
    assert cost.megabytes < 1000


def test_what_logs_do_unpack_to_is_read(tmp_path: Path) -> None:
    """Up to the bound everything is: a million empty messages in a chunk, and a still craft without noise."""
    count = FREE // len(MESSAGE)
    data = zstandard.compress(MESSAGE * count)
    raw = read_container(
        write_chunks(tmp_path / "full.mcap", [Chunk("zstd", data, 0, 0, 0, len(MESSAGE) * count)]),
        Query(lambda _: True),
    )
    assert raw.channels == []
    assert raw.log_time == (EPOCH, EPOCH)
    still = [make_pose(EPOCH + k * 10**7) for k in range(20000)]
    path = Bag(tmp_path / "still.mcap").add("/mocap/pose", POSE, still).write()
    assert len(read_flight(path).streams["/mocap/pose"]) == 20000
    assert 2 * 20000 * 160 / path.stat().st_size < MAX_RATIO  # of a log as regular as can be


@pytest.mark.parametrize("ahead", [4_000, 10**7, 10**8])
@pytest.mark.parametrize("place", [-1, 600])
def test_a_clock_set_forward_is_refused(tmp_path: Path, ahead: int, place: int) -> None:
    """Whether from one message on or in the last alone, whatever command reads it."""
    stamps = [k + ahead * 100 * (k >= place % 1200) for k in range(1200)]
    poses = [swing(k, stamp) for k, stamp in enumerate(stamps)]
    path = Bag(tmp_path / "ahead.mcap").add("/mocap/pose", POSE, poses).write()
    message = 1200 if place < 0 else 601
    refuse(path, f"leaps forward by {ahead + 0.01:.4g} s before message {message} of 1200", "clock that was set")


def test_milliseconds_called_seconds_are_asked_for_their_unit(tmp_path: Path) -> None:
    """A message every ten seconds, one like the other: no clock was set there."""
    poses = [swing(k, 1000 * k + 7 * (k % 3)) for k in range(1200)]
    path = Bag(tmp_path / "slow.mcap").add("/mocap/pose", POSE, poses).write()
    with pytest.raises(InputError, match=r"one of /mocap/pose every 10\.\d* s; .* milliseconds, name the column"):
        read_flight(path)


def test_a_clock_set_forward_costs_nothing(tmp_path: Path, usual: float) -> None:
    """A line under 2 s of processor time and 1 GB, where a grid of 10 ms over the leap took all memory."""
    joints = [
        {"header": stamp_header(EPOCH + (k + 10**9 * (k == 999)) * 10**7), "name": ["slide"], "position": [0.1 * k]}
        for k in range(1000)
    ]
    path = Bag(tmp_path / "ahead.mcap").add("/joint_states", JOINTS, joints).write()
    cost = run_measured("play", path, "--html", tmp_path / "page.html", folder=tmp_path)
    cost.check_refused("/joint_states slide leaps forward by 1e+07 s")
    assert cost.seconds < 2.0 + usual
    assert cost.megabytes < 1000


def test_rare_messages_over_months_are_refused(tmp_path: Path) -> None:
    """A leap of half an hour between any two is one too."""
    poses = [make_pose(EPOCH + k * 1800 * 10**9) for k in range(1000)]
    refuse(Bag(tmp_path / "rare.mcap").add("/mocap/pose", POSE, poses).write(), "1000 messages over 1.798e")


@pytest.mark.parametrize("stamp", [np.nan, np.inf, 1e300, -1e12])
def test_stamps_that_are_no_time_are_refused(tmp_path: Path, stamp: float) -> None:
    """Stamps that a topic map takes from a field of doubles may hold anything."""
    text = "float64 t\nfloat64 x\nfloat64 z\nfloat64 theta\n"
    rows = [{"t": 0.01 * k if k != 30 else stamp, "x": 0.1, "z": 0.2, "theta": 0.3} for k in range(100)]
    path = Bag(tmp_path / "log.mcap").add("/track", "lab_msgs/msg/Track", rows, text).write()
    mapped = tmp_path / "map.yaml"
    mapped.write_text("/mocap/pose: {topic: /track, stamp: {path: t, unit: s}, fields: {x: x, z: z, theta: theta}}\n")
    with pytest.raises(InputError, match=r"/track: 1 of 100 stamps are no time, such as .*within 146 years"):
        read_flight(path, mapped)


@pytest.mark.slow
def test_memory_is_that_of_the_flight_not_of_the_file(tmp_path: Path) -> None:
    """Pictures among the messages, 20 times the flight: they cost no memory, however many there are."""
    filmed = add_camera(copy(FLIP, tmp_path / "flip.mcap"), 0.2)
    assert filmed.stat().st_size > 2e8
    plain, large = (run_measured("plot", log, "--out", "plot.svg", folder=tmp_path) for log in (FLIP, filmed))
    assert plain.code == large.code == 0
    assert large.megabytes < plain.megabytes + 80.0
