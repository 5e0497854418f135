"""YAML and JSON of anyone's, read within bounds: no code, no gigabytes, no endless references, no pipe that waits."""

from __future__ import annotations

import json
import os
import stat
from errno import EINVAL, EISDIR
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import yaml

MAX_BYTES = 1 << 18
"""Longest file [bytes], which takes a second or two; a twin has 1 kB, metadata of a bag 100."""
MAX_NODES = 50_000
"""Values in it, those behind an alias counted as often as they are named."""


def open_regular(path: Path) -> BinaryIO:
    """Open a file to read; a pipe, on which opening would wait, a device and a folder are refused.

    Raises:
        OSError: if there is no file, or it is none.
    """
    number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    kind = os.fstat(number).st_mode
    if not stat.S_ISREG(kind):
        os.close(number)
        raise OSError(EISDIR, "Is a directory") if stat.S_ISDIR(kind) else OSError(EINVAL, "No regular file")
    return os.fdopen(number, "rb")


def is_within(name: str) -> bool:
    """Whether a name that a file gives leads to somewhere in the folder that it starts from."""
    parts = PurePosixPath(name).parts
    return bool(parts) and parts[0] != "/" and ".." not in parts and name.isprintable()


def read_json(path: Path) -> Any:  # noqa: ANN401
    """What a JSON file holds.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is no JSON, or longer or deeper than one that describes anything.
    """
    with open_regular(path) as file:
        text = file.read(MAX_BYTES + 1)
    if len(text) > MAX_BYTES:
        raise ValueError(f"longer than {MAX_BYTES} bytes")
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def read_yaml(path: Path) -> Any:  # noqa: ANN401
    """What a YAML file holds: mappings, lists, text, numbers.

    Raises:
        OSError: if it cannot be read.
        UnicodeDecodeError: if it is no text.
        yaml.YAMLError: if it is no YAML, longer, deeper or more often referred to than one that describes anything.
    """
    with open_regular(path) as file:
        text = file.read(MAX_BYTES + 1).decode()
    if len(text) > MAX_BYTES:
        raise yaml.YAMLError(f"longer than {MAX_BYTES} bytes")
    loader = yaml.SafeLoader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        if count_nodes(node, {}) > MAX_NODES:
            raise yaml.YAMLError(f"aliases make more than {MAX_NODES} values of it")
        return loader.construct_document(node)
    except RecursionError:
        raise yaml.YAMLError("nested too deeply, or in itself") from None
    except yaml.MarkedYAMLError as error:  # whose own words show the line, which may be of any file
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise yaml.YAMLError(f"{line}{error.problem}") from None
    except (ValueError, OverflowError, TypeError) as error:  # of dates and numbers that are none
        raise yaml.YAMLError(str(error)) from None
    finally:
        loader.dispose()


def count_nodes(node: yaml.Node, known: dict[int, int]) -> int:
    """Values below a node, itself included; `known` holds counts by identity."""
    if id(node) not in known:
        below = node.value if isinstance(node.value, list) else ()
        parts = [part for item in below for part in (item if isinstance(item, tuple) else (item,))]
        known[id(node)] = 1 + sum(count_nodes(part, known) for part in parts)
    return known[id(node)]
