"""Folders of rosbag2: which files their metadata name, of any version, and whatever the folder is called now."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path, PurePosixPath

import yaml

from vpptwin.system.errors import InputError
from vpptwin.system.plain import read_yaml

PACKED = (".zstd", ".zst")
"""What names of files end with that are compressed as a whole."""
_METADATA = "metadata.yaml"


def is_bag(folder: Path) -> bool:
    """Whether a folder is a rosbag2."""
    return (folder / _METADATA).exists()


def list_bag(folder: Path) -> list[Path]:
    """The files of a rosbag2 folder.

    Raises:
        InputError: if its metadata name none, or one that is not in the folder.
    """
    named = read_metadata(folder)
    if not named:
        raise InputError(f"{folder} with a {_METADATA} that names none of its files", "a rosbag2 folder", "remove it")
    return [find_file(folder, name) for name in dict.fromkeys(named)]


def read_metadata(folder: Path) -> list[str]:
    """The files that the metadata name, as written; those that the folder holds where the metadata cannot be read."""
    try:
        content = read_yaml(folder / _METADATA)
        return [str(name) for name in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return sorted(
            file.name for file in folder.iterdir() if strip_packed(file.name.lower()).endswith((".mcap", ".db3"))
        )


def find_file(folder: Path, name: str) -> Path:
    """A file that metadata name: from the folder on, or its parent as up to version 3, or by name alone.

    Raises:
        InputError: if none of these is a file in the folder.
    """
    bare = PurePosixPath(name).name
    for place in (folder / name, folder.parent / name, folder / bare, folder / strip_packed(bare)):
        with suppress(OSError):  # of names that are too long, folders that nobody may read
            if place.is_file() and place.resolve().is_relative_to(folder.resolve()):
                return place
    raise InputError(f"{folder}/{_METADATA} names {name}, which is missing", "all files of the recording", "copy it")


def strip_packed(name: str) -> str:
    """A file's name once it is unpacked."""
    return next((name.removesuffix(ending) for ending in PACKED if name.endswith(ending)), name)
