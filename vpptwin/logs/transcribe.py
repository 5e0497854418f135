"""Any log that is read, written anew as MCAP: every message and every column, as it was."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from mcap.well_known import MessageEncoding
from mcap.writer import LIBRARY_IDENTIFIER, Writer

from vpptwin.errors import InputError
from vpptwin.files import replace_files
from vpptwin.logs.container import Block, RawChannel, RawFile
from vpptwin.logs.recording import PathLike, Recording, open_recording
from vpptwin.logs.tables import Wish, pack_rows
from vpptwin.progress import open_bar


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
    if out.suffix != ".mcap":
        raise InputError(f"{out} as the file to write", "a name that ends with .mcap", "rename it")
    recording = open_recording(log, Wish(lambda channel: channel.encoding == MessageEncoding.CDR))
    if out.resolve() in [file.path.resolve() for file in recording.files]:
        raise InputError(f"{out} is the log itself", "another file to write", "choose another name")
    try:
        out.parent.stat()  # a log goes where somebody keeps logs
        with replace_files(out.parent, [out.name]) as drafts, (drafts / out.name).open("wb") as file:
            write_messages(recording, Writer(file))
    except OSError as error:
        found = f"{out} cannot be written ({error.strerror or error})"
        raise InputError(found, "a path to write a log to", "choose another") from None
    return recording


def write_messages(recording: Recording, writer: Writer) -> None:
    """All messages of a recording, file by file, in record order."""
    writer.start(profile="ros2", library=f"vpptwin {LIBRARY_IDENTIFIER}")
    schemas: dict[tuple[str, str], int] = {}
    total = sum(channel.count for file in recording.files for channel in file.channels)
    with open_bar(desc="convert", total=total, unit=" messages") as bar:
        for raw in recording.files:
            identifiers = []
            for channel in raw.channels:
                key = channel.message_type, channel.definition
                if key not in schemas:
                    text = channel.definition.encode()
                    schemas[key] = writer.register_schema(channel.message_type, channel.schema_encoding, text)
                metadata = {"offered_qos_profiles": ""}
                identifiers.append(writer.register_channel(channel.topic, channel.encoding, schemas[key], metadata))
            for place, time, content in list_messages(raw):
                writer.add_message(identifiers[place], time, content, time)
                bar.update()
    writer.add_metadata("vpptwin", {"source": ", ".join(os.fspath(file.path.name) for file in recording.files)})
    writer.finish()


def list_messages(raw: RawFile) -> Iterator[tuple[int, int, bytes]]:
    """Place of the channel, log time [ns] and content of every message that was kept, in record order."""
    channels = list(enumerate(raw.channels))
    yield from _merge([(place, block) for place, channel in channels for block in channel.blocks])
    pieces = [(rows.number, place, rows) for place, channel in channels for rows in channel.rows]
    for _, place, rows in sorted(pieces, key=lambda piece: piece[0]):
        yield from _merge([(place, block) for block in pack_rows(raw.channels[place], rows)])


def _merge(blocks: Sequence[tuple[int, Block]]) -> Iterator[tuple[int, int, bytes]]:
    if not blocks:
        return
    which = np.concatenate([np.full(len(block.number), i) for i, (_, block) in enumerate(blocks)])
    row = np.concatenate([np.arange(len(block.number)) for _, block in blocks])
    for index in np.argsort(np.concatenate([block.number for _, block in blocks]), kind="stable"):
        place, block = blocks[which[index]]
        yield place, int(block.log_time[row[index]]), block.payload[row[index]].tobytes()


def list_kept(recording: Recording) -> list[RawChannel]:
    """The channels whose messages are written."""
    return [channel for file in recording.files for channel in file.channels if channel.is_kept]
