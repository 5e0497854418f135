"""Memory and time that logs of gigabytes take: `python benchmarks/large_logs.py ulog --gigabytes 2`.

Writes two topics of 13 float32 at 1 kHz, inspects them and reads a joint of one, each in a process of its own.
"""

from __future__ import annotations

import argparse
import resource
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

COLUMNS = [f"v{i}" for i in range(13)]
ROWS = 1 << 17
READ = """import sys
from vpptwin.fields import SignalEntry
from vpptwin.logs import read_flight
entry = SignalEntry.model_validate({"topic": "one", "position": "v0", "velocity": "v1"})
read_flight(sys.argv[1], None, {"/joint_states": {"j": entry}})
"""
JOBS = {"inspect": ["-m", "vpptwin", "inspect"], "read a joint": ["-c", READ]}


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


def write_rows(path: Path, head: bytes, kind: np.dtype, constants: dict, size: float) -> None:
    """Messages of both topics in turn until the file is so large."""
    rows, random = np.zeros((ROWS, 2), kind), np.random.default_rng(0)
    for name, value in constants.items():
        rows[name] = value
    with path.open("wb") as file:
        file.write(head)
        step = 0
        while file.tell() < size:
            rows["time"] = 1000 * (step + np.arange(ROWS))[:, None]
            rows["values"] = random.normal(size=(ROWS, 1, 13))
            rows.tofile(file)
            step += ROWS


KINDS = {"ulog": (write_ulog, "log.ulg"), "dataflash": (write_dataflash, "log.bin")}


def main(arguments: Sequence[str] | None = None) -> None:
    """Write, inspect, read; print what it took."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--gigabytes", type=float, default=2.0)
    args = parser.parse_args(arguments)
    write, name = KINDS[args.kind]
    with TemporaryDirectory() as folder:
        log = Path(folder) / name
        write(log, args.gigabytes * 1e9)
        for job, command in JOBS.items():
            before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            subprocess.run([sys.executable, *command, log], check=True, stdout=subprocess.DEVNULL)
            after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - begun
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"{job}: up to {after.ru_maxrss / 1e6:.2f} GB so far, {wall:.0f} s, {cpu:.0f} s of processor")


if __name__ == "__main__":
    main()
