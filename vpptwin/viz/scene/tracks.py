"""Keyframe tracks of three.js: what changes over time, in the form that meshcat's viewer plays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import umsgpack

from vpptwin.viz.scene.nodes import join_path, write_path

FLOAT32_ARRAY = 0x17  # msgpack extension that the viewer unpacks into a Float32Array
HOLD = 2300  # three.js InterpolateDiscrete


@dataclass(frozen=True)
class KeyframeTrack:
    """One animated property of one scene node."""

    path: str  # the node, absolute, such as "/rig/log/craft"
    name: str  # the property as three.js binds it: "position", "quaternion", "visible", "rotation[z]", "scale[z]"
    kind: str  # vector3, quaternion (x, y, z, w), number or bool
    time: np.ndarray  # (k,) key times [s] from the animation's start; the last is the animation's end
    values: np.ndarray  # (k,) or (k, n) the property at the keys
    hold: bool = False  # keep each value until the next key instead of interpolating

    def lower(self) -> dict[str, object]:
        """The track as three.js's AnimationClip.parse takes it, times in clip frames of 1 s."""
        keys: dict[str, object] = {"name": "." + self.name, "type": self.kind, "times": pack_floats(self.time)}
        if self.kind == "bool":
            return keys | {"values": [bool(v) for v in self.values]}
        return keys | {"values": pack_floats(self.values)} | ({"interpolation": HOLD} if self.hold else {})


def pack_floats(array: np.ndarray) -> umsgpack.Ext:
    """An array of any shape as one flat Float32Array, four bytes a number."""
    return umsgpack.Ext(FLOAT32_ARRAY, np.ascontiguousarray(array, dtype=np.float32).tobytes())


def make_track(path: str, name: str, time: np.ndarray, values: np.ndarray, hold: bool = False) -> KeyframeTrack:
    """A track whose kind follows from the values, without the keys that change nothing.

    Args:
        path: the node.
        name: the animated property.
        time: (T,) frame times [s].
        values: (T,), (T, 3) or (T, 4); bool arrays are held by nature.
        hold: keep each value until the next key.
    """
    boolean = values.dtype == bool
    kind = "bool" if boolean else {1: "number", 3: "vector3", 4: "quaternion"}[values[0].size]
    flat = values.reshape(len(values), -1)
    moves = np.any(flat[1:] != flat[:-1], axis=1)
    if hold or boolean or not moves.any():
        keep = np.concatenate([[True], moves])
        keep[-1] = True
        time, values = time[keep], values[keep]
    return KeyframeTrack(path, name, kind, time, values, hold or boolean)


@dataclass(frozen=True)
class Animation:
    """All tracks of a page; takes the place of meshcat's own Animation, which spends a dictionary on every key."""

    tracks: list[KeyframeTrack] = field(default_factory=list)

    def lower(self) -> list[dict[str, object]]:
        """One clip per animated node, in the order in which the nodes appear."""
        clips: dict[str, list[dict[str, object]]] = {}
        for track in self.tracks:
            clips.setdefault(track.path, []).append(track.lower())
        return [
            {"path": write_path(join_path((), path)), "clip": {"fps": 1, "name": "default", "tracks": tracks}}
            for path, tracks in clips.items()
        ]
