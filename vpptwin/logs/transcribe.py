"""Any log that is read, written anew as MCAP: every message and every column, as it was."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from mcap.well_known import MessageEncoding
from mcap.writer import LIBRARY_IDENTIFIER, Writer

from vpptwin.logs.formats.raw import RawChannel, Wish
from vpptwin.logs.formats.tables import pack_rows
from vpptwin.logs.recording import Recording, open_recording
from vpptwin.logs.spelling import PathLike, list_sources
from vpptwin.logs.write import merge_times
from vpptwin.system.errors import InputError
from vpptwin.system.files import is_same, replace_files
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
    try:
        out.parent.stat()  # a log goes where somebody keeps logs
        with replace_files(out.parent, [out.name]) as drafts, (drafts / out.name).open("wb") as file:
            return _write_messages(log, Writer(file))
    except OSError as error:
        found = f"{out} cannot be written ({error.strerror or error})"
        raise InputError(found, "a path to write a log to", "choose another") from None


def _write_messages(log: PathLike, writer: Writer) -> Recording:
    """All messages of a log, file by file, in record order; those of a large one as they come."""
    writer.start(profile="ros2", library=f"vpptwin {LIBRARY_IDENTIFIER}")
    schemas: dict[tuple[str, str], int] = {}
    known: dict[int, int] = {}

    def take(channels: Sequence[RawChannel]) -> None:
        for channel in channels:
            key = channel.message_type, channel.definition
            if key not in schemas:
                text = channel.definition.encode()
                schemas[key] = writer.register_schema(channel.message_type, channel.schema_encoding, text)
            if id(channel) not in known:
                metadata = {"offered_qos_profiles": ""}
                known[id(channel)] = writer.register_channel(channel.topic, channel.encoding, schemas[key], metadata)
        for place, time, content in list_messages(channels):
            writer.add_message(known[id(channels[place])], time, content, time)
            bar.update()
        for channel in channels:
            channel.forget()

    with open_bar(desc="convert", unit=" messages") as bar:
        recording = open_recording(log, Wish(lambda c: c.encoding == MessageEncoding.CDR, take=take, texts=True))
        for raw in recording.files:
            take(raw.channels)
    writer.add_metadata("vpptwin", {"source": ", ".join(os.fspath(file.path.name) for file in recording.files)})
    writer.finish()
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
