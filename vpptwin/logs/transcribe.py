"""Any log that is read, written anew as MCAP: every message and every column, as it was."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from mcap.well_known import MessageEncoding

from vpptwin.logs.formats.raw import Query, RawChannel
from vpptwin.logs.formats.tables import pack_rows
from vpptwin.logs.recording import Recording, open_recording
from vpptwin.logs.spelling import PathLike, list_sources
from vpptwin.logs.write import FlightWriter, merge_times
from vpptwin.system.errors import InputError
from vpptwin.system.files import is_same
from vpptwin.system.progress import open_bar


def transcribe(log: PathLike, out: Path) -> Recording:
    """Write a log as MCAP with ROS 2 messages, which our reader, Foxglove and PlotJuggler open.

    Args:
        log: of any kind that is read.
        out: file to write; one that exists is replaced at the end.

    Returns:
        What was read.

    Raises:
        InputError: if the log cannot be read, is `out` itself, or `out` cannot be written.
    """
    if out.suffix.lower() != ".mcap":
        raise InputError(f"{out} as the file to write", "a name that ends with .mcap", "rename it")
    if is_same(out, list_sources(log)):
        raise InputError(f"{out} is the log itself", "another file to write", "choose another name")
    with FlightWriter(out) as writer, open_bar(desc="convert", unit=" messages") as bar:

        def take(channels: Sequence[RawChannel]) -> None:
            numbers = [writer.add_channel(channel) for channel in channels]
            for place, time, content in list_messages(channels):
                writer.write_raw(numbers[place], time, content)
                bar.update()
            for channel in channels:
                channel.forget()

        recording = open_recording(log, Query(lambda c: c.encoding == MessageEncoding.CDR, take=take, texts=True))
        for raw in recording.files:
            take(raw.channels)
        writer.add_metadata({"source": ", ".join(os.fspath(file.path.name) for file in recording.files)})
    return recording


def list_messages(held: Sequence[RawChannel]) -> Iterator[tuple[int, int, bytes]]:
    """Place of the channel, log time [ns] and content of every message that channels hold, in record order."""
    groups = [[(place, block) for place, channel in enumerate(held) for block in channel.blocks]]
    pieces = [(rows.number, place, rows) for place, channel in enumerate(held) for rows in channel.rows]
    for _, place, rows in sorted(pieces, key=lambda piece: piece[0]):
        groups.append([(place, block) for block in pack_rows(held[place], rows)])
    for blocks in groups:
        for i, row in merge_times([block.number for _, block in blocks]):
            place, block = blocks[i]
            yield place, int(block.log_time[row]), block.payload[row].tobytes()


def list_kept(recording: Recording) -> list[RawChannel]:
    """The channels whose messages are written."""
    channels = [channel for file in recording.files for channel in file.channels]
    return [channel for channel in channels if channel.count and channel.encoding == MessageEncoding.CDR]
