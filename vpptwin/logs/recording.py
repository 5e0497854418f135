"""The files of one recording, and what their channels hold before any topic is interpreted."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC

from vpptwin.errors import InputError, check_name
from vpptwin.logs.container import RawChannel, RawFile, read_container
from vpptwin.logs.decode import Batch, DecodeError, decode_channel
from vpptwin.logs.messages import shorten_type
from vpptwin.plain import read_yaml

PathLike = str | os.PathLike[str]
_EXPECTED = "a flight log in MCAP (ros2 profile, CDR messages)"
_SIGNATURES = {
    b"\x89PNG": ("a PNG picture", "give the .mcap file itself"),
    b"#ROSBAG": ("a ROS 1 bag", "convert it with `rosbags-convert`, or record with ROS 2"),
    b"SQLite format 3": ("a rosbag2 SQLite file", "convert it with `ros2 bag convert` to storage mcap"),
    b"\x28\xb5\x2f\xfd": ("zstd-compressed as a whole", "decompress it with `zstd -d`"),
    b"\x1f\x8b": ("gzip-compressed", "decompress it with `gunzip`"),
    b"PK\x03\x04": ("a ZIP archive", "unpack it and give the .mcap file inside"),
    b"\x7fELF": ("a program", "give a log"),
    b"\x89HDF": ("an HDF5 file", "convert it to MCAP"),
    b"ULog": ("a PX4 ULog", "convert it to MCAP"),
}


@dataclass(frozen=True)
class Recording:
    """The files of one recording in the order of their log time, all with ROS 2 messages."""

    path: Path
    files: tuple[RawFile, ...]

    def list_topics(self) -> dict[str, str]:
        """Topic -> message type, of all channels."""
        return {channel.topic: channel.message_type for file in self.files for channel in file.channels}

    def check_type(self, topic: str) -> str:
        """Message type of a topic.

        Raises:
            InputError: if it was recorded with several types.
        """
        types = {shorten_type(c.message_type): c.message_type for _, c in self._find_channels(topic)}
        if len(types) > 1:
            raise InputError(
                f"{self.path}: {topic} is recorded as {' and as '.join(types.values())}",
                "one type per topic",
                "record again without the program that publishes the other type",
            )
        return next(iter(types.values()))

    def _find_channels(self, topic: str) -> list[tuple[int, RawChannel]]:
        """Channels of a topic, each with the position of its file."""
        return [(i, c) for i, file in enumerate(self.files) for c in file.channels if c.topic == topic]

    def decode(self, topic: str, paths: Sequence[str], texts: Sequence[str] = ()) -> list[Batch]:
        """Decode fields of all messages of a topic.

        Args:
            topic: name in the log.
            paths: fields wanted.
            texts: string sequences wanted.

        Returns:
            Batches whose record numbers count across all files.

        Raises:
            InputError: if messages are no ROS 2 messages, or do not decode.
        """
        batches = []
        for index, channel in self._find_channels(topic):
            refuse_encoding(self.path, [channel])
            try:
                for batch in decode_channel(channel, paths, texts):
                    batches.append(Batch(batch.number + (index << 40), batch.log_time, batch.values, batch.texts))
            except DecodeError as error:
                raise InputError(
                    f"{self.path}: {topic} ({channel.message_type}) has {error}",
                    f"messages with {', '.join(paths)} as the definition in the file says",
                    "check the field names and the program that wrote it",
                ) from None
        return batches


def open_recording(path: PathLike | Sequence[PathLike], wanted: Callable[[RawChannel], bool]) -> Recording:
    """Read the raw messages of a recording (file, rosbag2 folder or list of files) on the channels `wanted`.

    Raises:
        InputError: if there is no such file, or it is no MCAP file with ROS 2 messages.
    """
    paths = find_files(path)
    files = [_read_file(file, wanted) for file in paths]
    files.sort(key=lambda file: file.log_time[0])
    for file in files:
        if file.channels and not any(channel.encoding == MessageEncoding.CDR for channel in file.channels):
            refuse_encoding(file.path, file.channels)
    return Recording(paths[0], tuple(files))


def refuse_encoding(path: Path, channels: Sequence[RawChannel]) -> None:
    """Refuse messages that are not CDR with a ros2msg definition.

    Raises:
        InputError: naming the encoding and the topics.
    """
    for name, given, expected in (
        ("message encoding", [c.encoding for c in channels], MessageEncoding.CDR),
        ("definition", [c.schema_encoding for c in channels], SchemaEncoding.ROS2),
    ):
        if expected not in given:
            topics = ", ".join(channel.topic for channel in channels[:5])
            raise InputError(
                f"{path}: {name} '{given[0]}' on {topics}",
                f"'{expected}', as ROS 2 records it",
                "record with `ros2 bag record -s mcap`, or convert the log",
            )


def find_files(path: PathLike | Sequence[PathLike]) -> list[Path]:
    """Files of a recording that is a file, a rosbag2 folder, or a list of files.

    Raises:
        InputError: if there are none.
    """
    if not isinstance(path, str | os.PathLike):
        if not path:
            raise InputError("no log given", _EXPECTED, "name at least one .mcap file")
        return [file for item in path for file in find_files(item)]
    given = Path(path)
    if not given.exists():
        raise InputError(f"no file {given}", _EXPECTED, "check the path")
    if not given.is_dir():
        return [given]
    listed = _read_metadata(given)
    found = [given / name for name in listed] if listed else sorted(given.glob("*.mcap"))
    if not found:
        held = ", ".join(sorted(item.name for item in given.iterdir())[:5]) or "nothing"
        raise InputError(f"folder {given} holds {held}", "a rosbag2 folder with .mcap files", "give an .mcap file")
    for file in found:
        if not file.exists():
            absent = f"{given}/metadata.yaml names {file.name}, which is missing"
            raise InputError(absent, "all files of the recording", "copy it")
    return found


def _read_metadata(folder: Path) -> list[str]:
    try:
        content = read_yaml(folder / "metadata.yaml")
        return [str(name) for name in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return []  # the folder speaks for itself


def _read_file(path: Path, wanted: Callable[[RawChannel], bool]) -> RawFile:
    check_name(str(path))
    try:
        with path.open("rb") as file:
            start = file.read(64)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})", _EXPECTED, "check its permissions") from None
    if not start:
        advice = "check that the recorder was stopped properly, and record again"
        raise InputError(f"{path} is empty (0 bytes)", _EXPECTED, advice)
    if not start.startswith(MCAP0_MAGIC):
        raise _refuse_foreign(path, start)
    raw = read_container(path, wanted)
    if raw.profile not in ("ros2", ""):
        found = f"{path} has the MCAP profile '{raw.profile}'"
        raise InputError(found, "'ros2'", "record with ROS 2, or convert the log")
    return raw


def _refuse_foreign(path: Path, start: bytes) -> InputError:
    for signature, (found, action) in _SIGNATURES.items():
        if start.startswith(signature):
            return InputError(f"{path} is {found}", _EXPECTED, action)
    if MCAP0_MAGIC.startswith(start):
        return InputError(f"{path} ends after {len(start)} bytes", _EXPECTED, "copy or record it again")
    kind = "text" if all(32 <= byte < 127 or byte in b"\t\r\n" for byte in start) else "not MCAP"
    return InputError(f"{path} is {kind}, starting with {start[:12]!r}", _EXPECTED, "give the .mcap file itself")
