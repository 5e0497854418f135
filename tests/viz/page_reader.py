"""Reads a written page back: its drawing commands and animation tracks, as the viewer would."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import numpy as np
import umsgpack


def read_commands(page: Path) -> list[dict]:
    """The meshcat commands of a page in order."""
    text = re.search(r'<script id="commands" type="application/json">(.*?)</script>', page.read_text(), re.DOTALL)
    assert text is not None
    return [umsgpack.unpackb(base64.b64decode(command)) for command in json.loads(text[1])]


def read_paths(page: Path) -> set[str]:
    """Scene paths at which something is drawn."""
    return {command["path"] for command in read_commands(page) if command["type"] == "set_object"}


def read_tracks(page: Path) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]:
    """(scene path, property) -> key times (k,) [s] and values (k, ...)."""
    (animation,) = [command for command in read_commands(page) if command["type"] == "set_animation"]
    found = {}
    for clip in animation["animations"]:
        assert clip["clip"]["fps"] == 1
        for track in clip["clip"]["tracks"]:
            time = np.frombuffer(track["times"].data, dtype=np.float32)
            if track["type"] == "bool":
                values = np.array(track["values"])
            else:
                values = np.frombuffer(track["values"].data, dtype=np.float32).reshape(len(time), -1)
            found[clip["path"], track["name"]] = (time, values)
    return found


def read_held(page: Path) -> set[str]:
    """Path and property of the tracks that hold each value until the next key."""
    (animation,) = [command for command in read_commands(page) if command["type"] == "set_animation"]
    return {
        clip["path"] + track["name"]
        for clip in animation["animations"]
        for track in clip["clip"]["tracks"]
        if track.get("interpolation") == 2300  # three.js InterpolateDiscrete
    }
