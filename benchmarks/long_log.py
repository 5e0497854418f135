"""How long a log of ten minutes takes to read and to sort, and how much memory: `python benchmarks/long_log.py`.

The log repeats 20 s of the tests' independent simulation (which jumps where it starts anew: only its size matters).
"""

from __future__ import annotations

import argparse
import resource
import shutil
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from proving.drone import fly, write_mcap
from proving.drone.recording import Topic
from vpptwin.diagnosis.evidence.preflight import inspect_flight
from vpptwin.estimation.measurements import read_measurements
from vpptwin.logs import read_flight
from vpptwin.twin import load_twin

PIECE = 20.0
"""Length of the flight that is repeated [s]."""


def repeat_topic(topic: Topic, times: int) -> Topic:
    """A topic of the piece, so many times in a row."""
    rows = topic.time < PIECE
    stamps = np.concatenate([topic.time[rows] + PIECE * k for k in range(times)])
    columns = {name: np.tile(values[rows], times) for name, values in topic.columns.items()}
    return replace(topic, time=stamps, latency=np.tile(topic.latency[rows], times), columns=columns)


def measure_peak() -> float:
    """Most memory that this process has had so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def add_camera(path: Path, gigabytes: float) -> Path:
    """The log with a camera's frames of noise among its messages, which no compressor makes smaller."""
    filmed, size, rng = path.with_name("filmed.mcap"), 1 << 20, np.random.default_rng(1)
    frames = round(gigabytes * 1e9 / size)
    with path.open("rb") as source, filmed.open("wb") as target:
        reader, writer = make_reader(source), Writer(target, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/CompressedImage", "ros2msg", b"string format\nuint8[] data")
        camera = writer.register_channel("/camera", "cdr", schema)
        channels: dict[int, int] = {}
        messages = reader.get_summary().statistics.message_count
        for number, (kind, channel, message) in enumerate(reader.iter_messages()):
            if channel.id not in channels:
                known = writer.register_schema(kind.name, kind.encoding, kind.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", known)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
            if number * frames // messages != (number + 1) * frames // messages:
                writer.add_message(camera, message.log_time, rng.bytes(size), message.publish_time)
        writer.finish()
    return filmed


def main() -> None:
    """Write the log, then read it with a clock beside."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--camera", type=float, default=0.0, help="gigabytes of pictures among the messages")
    parser.add_argument("--keep", type=Path, help="write the log here, and no more")
    parser.add_argument("--log", type=Path, help="time this log instead")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = given.log
        if path is None:
            recording = fly({}, "mixed", PIECE, seed=7)
            times = max(round(60.0 * given.minutes / PIECE), 1)
            recording.topics = {name: repeat_topic(topic, times) for name, topic in recording.topics.items()}
            path = write_mcap(recording, Path(folder) / "long.mcap")
            del recording
            if given.camera:
                path = add_camera(path, given.camera)
        if given.keep:
            shutil.move(path, given.keep)
            return
        spec, before = load_twin(), measure_peak()
        begin = time.perf_counter()
        flight = read_flight(path)
        read = time.perf_counter()
        measurements = read_measurements(spec, flight)
        done = time.perf_counter()
        messages = sum(len(stream) for stream in flight.streams.values())
        print(f"{flight.duration:.0f} s, {messages} messages, {path.stat().st_size / 1e6:.0f} MB")
        print(
            f"read in {read - begin:.1f} s, sorted in {done - read:.1f} s, {measure_peak() - before:.0f} MB more memory"
        )
        print(inspect_flight(spec, measurements).describe())


if __name__ == "__main__":
    main()
