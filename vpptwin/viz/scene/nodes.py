"""What meshcat's viewer is told: objects, transforms and properties of the nodes of a scene.

The viewer (https://github.com/meshcat-dev/meshcat, MIT) ships with us. Its messages are dictionaries in msgpack; shapes
and materials in them are three.js's JSON.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import mujoco
import numpy as np
import umsgpack

import vpptwin.viz

VIEWER = Path(vpptwin.viz.__file__).parent / "viewer" / "meshcat.min.js"
ARRAYS = {np.dtype(np.uint32): ("Uint32Array", 0x16), np.dtype(np.float32): ("Float32Array", 0x17)}
"""Type → its name in three.js, and the extension of msgpack that the viewer unpacks into it."""
ROUND = 20
"""Segments of a sphere each way."""
MATERIAL = {
    "color": 0xFFFFFF, "reflectivity": 0.5, "side": 2, "transparent": False, "opacity": 1.0, "linewidth": 1.0,
    "wireframe": False, "wireframeLinewidth": 1.0, "vertexColors": 0,
}  # fmt: skip
"""What is not said of a material."""
Message = Mapping[str, object]


class Window(Protocol):
    """What takes messages: a server, or a page that is written."""

    def send(self, message: Message) -> None:
        """Take one."""


@dataclass(frozen=True)
class Geometry:
    """A shape as three.js's JSON, and the transform (4, 4) that stretches it."""

    content: Message
    matrix: np.ndarray


@dataclass(frozen=True)
class Node:
    """A place in the scene, from which on paths are told."""

    window: Window
    path: tuple[str, ...] = ("meshcat",)

    def __getitem__(self, path: str) -> Node:
        """A node below, or with a leading `/` one from the scene's root."""
        return Node(self.window, join_path(self.path, path))

    def set_object(self, shape: Geometry, material: Message, kind: str = "Mesh") -> None:
        """Put a mesh here, or another `kind` of three.js's objects."""
        geometry, painted = (part | {"uuid": name_content(part)} for part in (dict(shape.content), dict(material)))
        own = {"type": kind, "geometry": geometry["uuid"], "material": painted["uuid"]}
        matrix = shape.matrix.T.flatten().tolist()
        content = {
            "metadata": {"version": 4.5, "type": "Object"}, "geometries": [geometry], "materials": [painted],
            "object": own | {"uuid": name_content(own | {"path": self.path}), "matrix": matrix},
        }  # fmt: skip
        self._send("set_object", object=content)

    def set_transform(self, matrix: np.ndarray) -> None:
        """Place what is here, (4, 4)."""
        self._send("set_transform", matrix=matrix.T.flatten().tolist())

    def set_property(self, name: str, value: object) -> None:
        """Set a property of three.js's."""
        self._send("set_property", property=name, value=value)

    def delete(self) -> None:
        """Remove what is here and below."""
        self._send("delete")

    def _send(self, kind: str, **content: object) -> None:
        self.window.send({"type": kind, "path": write_path(self.path), **content})


def join_path(path: tuple[str, ...], other: str) -> tuple[str, ...]:
    """A path with another behind it, which starts anew where it begins with `/`."""
    parts = tuple(part for part in other.split("/") if part)
    return parts if other.startswith("/") else path + parts


def write_path(path: tuple[str, ...]) -> str:
    """A path as messages have it."""
    return "/" + "/".join(path)


def name_content(content: Message) -> str:
    """What three.js calls a shape or material: the same for the same."""
    return hashlib.sha256(umsgpack.packb(content)).hexdigest()[:32]


def pack_array(values: np.ndarray) -> dict[str, object]:
    """Values (n, k) as three.js's attribute."""
    name, code = ARRAYS[values.dtype]
    content = umsgpack.Ext(code, np.ascontiguousarray(values).tobytes())
    return {"itemSize": values.shape[1], "type": name, "array": content, "normalized": False}


def make_box(sizes: Sequence[float]) -> Geometry:
    """A box of these sizes along x, y, z [m]."""
    return Geometry({"type": "BoxGeometry", **dict(zip(("width", "height", "depth"), sizes))}, np.eye(4))


def make_ellipsoid(radii: Sequence[float]) -> Geometry:
    """An ellipsoid with these radii along x, y, z [m]; a sphere has one for all."""
    sphere = {"type": "SphereGeometry", "radius": 1.0, "widthSegments": ROUND, "heightSegments": ROUND}
    return Geometry(sphere, np.diag([*radii, 1.0]))


def make_mesh(vertices: np.ndarray, faces: np.ndarray) -> Geometry:
    """Triangles (m, 3) between vertices (n, 3) [m]."""
    data = {"attributes": {"position": pack_array(np.asarray(vertices, dtype=np.float32))},
            "index": pack_array(np.asarray(faces, dtype=np.uint32))}  # fmt: skip
    return Geometry({"type": "BufferGeometry", "data": data}, np.eye(4))


def make_lines(ends: np.ndarray) -> Geometry:
    """Segments between every two points of (n, 3) [m]."""
    data = {"attributes": {"position": pack_array(np.asarray(ends, dtype=np.float32))}}
    return Geometry({"type": "BufferGeometry", "data": data}, np.eye(4))


def paint_material(kind: str, colour: int, opacity: float = 1.0, **options: object) -> Message:
    """A material of three.js's, such as `MeshPhongMaterial`, of a colour 0xRRGGBB."""
    return MATERIAL | {"type": kind, "color": colour, "opacity": opacity, "transparent": opacity != 1.0} | options


def shift(place: Sequence[float] | np.ndarray) -> np.ndarray:
    """The transform (4, 4) that moves by x, y, z [m]."""
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return matrix


def turn(angle: float, axis: Sequence[float]) -> np.ndarray:
    """The transform (4, 4) that turns by an angle [rad] about an axis."""
    attitude, rotation, matrix = np.zeros(4), np.zeros(9), np.eye(4)
    mujoco.mju_axisAngle2Quat(attitude, np.asarray(axis, dtype=float), angle)
    mujoco.mju_quat2Mat(rotation, attitude)
    matrix[:3, :3] = rotation.reshape(3, 3)
    return matrix
