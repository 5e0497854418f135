"""Memory and time that logs of gigabytes take: `python benchmarks/large_logs.py ulog --gigabytes 2`.

Writes two topics of 13 float32 at 1 kHz (of csv one, of three columns or forty), reads a joint of one, inspects and
converts them, each in a process of its own.
"""

from __future__ import annotations

import argparse
import os
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mcap.writer import MCAP0_MAGIC

COLUMNS = [f"v{i}" for i in range(13)]
ROWS = 1 << 17
READ = """import sys
from vpptwin.system.errors import InputError
from vpptwin.system.fields import SignalEntry
from vpptwin.logs import read_flight
entry = SignalEntry.model_validate({"topic": "one", "position": "v0", "velocity": "v1"})
try:
    read_flight(sys.argv[1], None, {"/joint_states": {"j": entry}})
except InputError as error:
    sys.exit(str(error))
"""
JOBS = {"read": ["-c", READ], "inspect": ["-m", "vpptwin", "inspect"], "convert": ["-m", "vpptwin", "convert"]}


def write_ulog(path: Path, size: float) -> None:
    """A ULog of PX4 of at least so many bytes."""

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    fields = "uint64_t timestamp;" + "".join(f"float {name};" for name in COLUMNS)
    head = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    head += [message("F", f"{topic}:{fields}".encode()) for topic in ("one", "two")]
    head += [message("A", struct.pack("<BH", 0, i) + topic) for i, topic in enumerate((b"one", b"two"))]
    kind = np.dtype([("size", "<u2"), ("kind", "u1"), ("topic", "<u2"), ("time", "<u8"), ("values", "<f4", 13)])
    write_rows(path, b"".join(head), kind, {"size": kind.itemsize - 3, "kind": ord("D"), "topic": [0, 1]}, size)


def write_dataflash(path: Path, size: float) -> None:
    """A DataFlash log of ArduPilot of at least so many bytes."""
    kind = np.dtype([("head", "u1", 2), ("topic", "u1"), ("time", "<u8"), ("values", "<f4", 13)])
    said = [(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")]
    said += [(i + 1, kind.itemsize, topic, b"Q" + b"f" * 13, ",".join(["TimeUS", *COLUMNS]).encode())
             for i, topic in enumerate((b"one", b"two"))]  # fmt: skip
    head = b"".join(b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *line) for line in said)
    write_rows(path, head, kind, {"head": [0xA3, 0x95], "topic": [1, 2]}, size)


def write_mcap(path: Path, size: float) -> None:
    """An MCAP file of at least so many bytes, in chunks that are not compressed."""
    text = compose_text(2)
    kind = np.dtype([("op", "u1"), ("size", "<u8"), ("topic", "<u2"), ("number", "<u4"), ("times", "<u8", 2),
                     ("cdr", "u1", 4), ("stamp", "<u4", 2), ("frame", "<u4"), ("rest", "u1", 4),
                     ("values", "<f4", 13)])  # fmt: skip
    constants = {"op": 5, "size": kind.itemsize - 9, "topic": [1, 2], "cdr": [0, 1, 0, 0], "frame": 1}

    def record(op: int, content: bytes) -> bytes:
        return struct.pack("<BQ", op, len(content)) + content

    def spell(said: str) -> bytes:
        return struct.pack("<I", len(said)) + said.encode()

    def chunk(rows: np.ndarray) -> bytes:
        head = struct.pack("<QQQI", 0, 0, rows.nbytes, 0) + spell("") + struct.pack("<Q", rows.nbytes)
        return record(6, head + rows.tobytes())

    head = [MCAP0_MAGIC, record(1, spell("ros2") + spell("")),
            record(3, struct.pack("<H", 1) + spell("bench_msgs/msg/Row") + spell("ros2msg") + spell(text))]  # fmt: skip
    head += [record(4, struct.pack("<HH", i, 1) + spell(f"/{topic}") + spell("cdr") + spell(""))
             for i, topic in ((1, "one"), (2, "two"))]  # fmt: skip
    write_rows(path, b"".join(head), kind, constants, size, chunk)
    with path.open("ab") as file:
        file.write(record(15, bytes(8)) + record(2, bytes(20)) + MCAP0_MAGIC)


def write_bag(path: Path, size: float) -> None:
    """A ROS 1 bag of at least so many bytes, by rosbags but for the messages themselves."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(compose_text(1), "bench_msgs/msg/Row"))
    kind = np.dtype([("seq", "<u4"), ("stamp", "<u4", 2), ("frame", "<u4"), ("values", "<f4", 13)])
    random, step = np.random.default_rng(0), 0
    with Writer(path) as writer:
        topics = [writer.add_connection(f"/{t}", "bench_msgs/msg/Row", typestore=store) for t in ("one", "two")]
        while step * 2 * 111 < size:  # bytes of a record
            rows = np.zeros(1000, kind)
            times = 10**6 * (step + np.arange(len(rows)))
            rows["stamp"] = np.stack([times // 10**9, times % 10**9], axis=1)
            rows["values"] = random.normal(size=(len(rows), 13))
            for time, raw in zip(times.tolist(), rows):
                for topic in topics:
                    writer.write(topic, time, raw.tobytes())
            step += len(rows)


def compose_text(version: int) -> str:
    """Definition of a message of ROS."""
    fields = "".join(f"float32 {name}\n" for name in COLUMNS)
    stamp = "builtin_interfaces/Time stamp" if version == 2 else "uint32 seq\ntime stamp"
    return f"std_msgs/Header header\n{fields}{'=' * 80}\nMSG: std_msgs/Header\n{stamp}\nstring frame_id\n"


def write_csv(path: Path, size: float, columns: int = 3) -> None:
    """A CSV of at least so many bytes, of a time and so many columns."""
    rows = np.random.default_rng(0).normal(size=(1000, columns))
    text = "".join(f"S.{k:03d}" + "".join(f",{v:.4f}" for v in row) + "\n" for k, row in enumerate(rows))
    second = 0
    with path.open("w") as file:
        file.write(",".join(["time", *(f"v{i}" for i in range(columns))]) + "\n")
        while file.tell() < size:
            file.write(text.replace("S", str(second)))
            second += 1


def write_rows(
    path: Path, head: bytes, kind: np.dtype, constants: dict, size: float,
    pack: Callable[[np.ndarray], bytes] = np.ndarray.tobytes,
) -> None:  # fmt: skip
    """Messages of both topics in turn until the file is so large."""
    rows, random = np.zeros((ROWS, 2), kind), np.random.default_rng(0)
    for name, value in constants.items():
        rows[name] = value
    with path.open("wb") as file:
        file.write(head)
        step = 0
        while file.tell() < size:
            times = 1000 * (step + np.arange(ROWS, dtype=np.int64))
            if "stamp" in kind.names:
                rows["times"] = 1000 * times[:, None, None]
                rows["stamp"] = np.stack([times // 10**6, times % 10**6 * 1000], axis=1)[:, None]
            else:
                rows["time"] = times[:, None]
            rows["values"] = random.normal(size=(ROWS, 1, 13))
            file.write(pack(rows))
            step += ROWS


KINDS = {"ulog": (write_ulog, "log.ulg"), "dataflash": (write_dataflash, "log.bin"), "mcap": (write_mcap, "log.mcap"),
         "bag": (write_bag, "log.bag"), "csv": (write_csv, "log.csv"),
         "wide-csv": (partial(write_csv, columns=40), "log.csv")}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Write, inspect, read; print what it took."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--jobs", nargs="+", choices=JOBS, default=list(JOBS))
    parser.add_argument("--stretch", default="", help="@START-END [s], of which log to read")
    args = parser.parse_args(arguments)
    write, name = KINDS[args.kind]
    with TemporaryDirectory() as folder:
        log = Path(folder) / name
        write(log, args.gigabytes * 1e9)
        for job in args.jobs:
            command = [sys.executable, *JOBS[job], f"{log}{args.stretch}"]
            command += [str(Path(folder) / "out.mcap")] if job == "convert" else []
            begun = time.perf_counter()
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
            _, code, used = os.wait4(process.pid, 0)
            wall, cpu = time.perf_counter() - begun, used.ru_utime + used.ru_stime
            end = "" if code == 0 else f", ended with {os.waitstatus_to_exitcode(code)}"
            print(f"{job}: {used.ru_maxrss / 1e6:.2f} GB, {wall:.0f} s, {cpu:.0f} s of processor{end}", flush=True)


if __name__ == "__main__":
    main()
