"""How long a log of ten minutes takes to read and to sort, and how much memory: `python benchmarks/long_log.py`.

The log repeats 20 s of the tests' independent simulation (which jumps where it starts anew: only its size matters).
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.reality import fly, write_mcap
from tests.reality.recording import Topic
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


def main() -> None:
    """Write the log, then read it with a clock beside."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
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
