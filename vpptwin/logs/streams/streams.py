"""Samples turned into streams: times from stamps, columns from message fields, everything checked."""

from __future__ import annotations

import numpy as np

from vpptwin.logs.check import check_finite, find_broken, find_huge, find_wild
from vpptwin.logs.flight import Stream
from vpptwin.logs.streams.convert import convert_column, list_fields
from vpptwin.logs.streams.samples import Samples
from vpptwin.system.errors import InputError

_PIECE = 1 << 20


def build_stream(samples: Samples, time: np.ndarray, path: str, warnings: list[str]) -> Stream:
    """Stream of a topic of the channel table, from samples in order of time, (n,) s; adds to `warnings`."""
    label = f"{path}: {samples.label}"
    values: dict[str, np.ndarray] = {}
    wild = np.zeros(len(time), dtype=bool)
    for column in samples.columns:
        fields = {field: samples.fields[field] for field in list_fields(column.source)}
        if column.optional and all(np.isnan(data).all() for data in fields.values()):
            warnings.append(f"{column.name} on {samples.label} is NaN throughout, left out")
            continue
        for field, data in fields.items():
            check_finite(label, time, field, data)
        if column.source.axis is not None:
            wild |= find_broken(label, time, column.source, fields)
        values[column.name] = made = convert_column(column.source, fields)
        if made.shape != ((len(time),) if column.width == 1 else (len(time), column.width)):
            raise InputError(
                f"{label}: {', '.join(column.source.paths)} has {made.size // len(time)} values per message",
                f"{column.width} for {column.name}",
                "name single fields or array elements in the topic map",
            )
        wild |= find_wild(label, column, made) | find_huge(label, time, column.name, made)
    stream = drop_samples(Stream(time, values), wild, samples.label, warnings)
    if "theta" in stream.values:
        stream.values["theta"] = np.unwrap(stream.values["theta"])
    return stream


def build_joint_stream(samples: Samples, time: np.ndarray, path: str, warnings: list[str]) -> Stream:
    """Stream of one joint, from samples in order of time, (n,) s; adds to `warnings`."""
    label, wild = f"{path}: {samples.label}", np.zeros(len(time), dtype=bool)
    for column, data in samples.fields.items():
        check_finite(label, time, column, data)
        wild |= find_huge(label, time, column, data)
    return drop_samples(Stream(time, samples.fields), wild, samples.label, warnings)


def drop_samples(stream: Stream, wild: np.ndarray, label: str, warnings: list[str]) -> Stream:
    """A stream without impossible samples, (n,) bool, of which a warning tells."""
    if not wild.any():
        return stream
    first = stream.time[np.argmax(wild)]
    warnings.append(
        f"{np.count_nonzero(wild)} of {len(wild)} messages on {label} hold impossible values, left out, "
        f"first at {first:.3f} s"
    )
    return Stream(stream.time[~wild], {name: data[~wild] for name, data in stream.values.items()})


def measure_time(stamp: np.ndarray, start_ns: int) -> np.ndarray:
    """Time of stamps (n,) ns since `start_ns`, (n,) s."""
    time = np.empty(len(stamp))
    for i in range(0, len(stamp), _PIECE):  # logs of gigabytes leave no room for the differences
        time[i : i + _PIECE] = (stamp[i : i + _PIECE] - start_ns) / 1e9  # which rounds right: 1000000 ns is 0.001
    return time
