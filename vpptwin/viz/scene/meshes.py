"""Solids as meshcat's triangle meshes in metres, and how their surfaces are painted."""

from __future__ import annotations

import mujoco
import numpy as np

from vpptwin.viz.plots.palette import to_int
from vpptwin.viz.scene.geoms import PLANE_THICKNESS, Paint, size_plane
from vpptwin.viz.scene.nodes import Geometry, Message, make_box, make_ellipsoid, make_mesh, paint_material

SEGMENTS = 32  # around a solid of revolution


def make_material(paint: Paint, smooth: bool = True) -> Message:
    """The meshcat material of a paint; translucent surfaces do not hide what lies behind them."""
    options: dict[str, object] = {"flatShading": not smooth}
    if paint.opacity < 1.0:
        options["depthWrite"] = False
    if paint.behind:
        options |= {"polygonOffset": True, "polygonOffsetFactor": 2.0, "polygonOffsetUnits": 2.0}
    return paint_material("MeshPhongMaterial", to_int(paint.colour), paint.opacity, **options)


def revolve(profile: np.ndarray) -> Geometry:
    """Turn a profile around z.

    Args:
        profile: (n, 2) radius and height [m], in order along the outline; a repeated point keeps that edge sharp.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    radius, height = profile[:, :1], profile[:, 1:]
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(height, (len(profile), SEGMENTS))])
    row, column = np.meshgrid(np.arange(len(profile) - 1), np.arange(SEGMENTS), indexing="ij")
    a = row * SEGMENTS + column
    b = row * SEGMENTS + (column + 1) % SEGMENTS
    c, d = a + SEGMENTS, b + SEGMENTS
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    return make_mesh(ring.reshape(3, -1).T, faces)


def make_cylinder(radius: float, bottom: float, top: float) -> Geometry:
    """A cylinder around z from height bottom to top [m]."""
    low, high = (radius, bottom), (radius, top)
    return revolve(np.array([(0, bottom), low, low, high, high, (0, top)], dtype=float))


def make_cone(radius: float, height: float) -> Geometry:
    """A cone standing on z = 0 with its tip at height [m]."""
    return revolve(np.array([(0, 0), (radius, 0), (radius, 0), (0, height)], dtype=float))


def make_capsule(radius: float, half_length: float) -> Geometry:
    """A capsule along z: a cylinder of the given half length [m] closed by half spheres."""
    bow = np.linspace(-np.pi / 2, 0.0, 7)
    lower = np.stack([radius * np.cos(bow), radius * np.sin(bow) - half_length], -1)
    return revolve(np.concatenate([lower, lower[::-1] * [1.0, -1.0]]))


def make_ribbon(points: np.ndarray, width: float) -> Geometry:
    """A ribbon in the x-z plane through points (n, 3) [m]; segment i owns indices 6 i to 6 i + 5."""
    step = np.gradient(points[:, [0, 2]], axis=0)
    length = np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
    side = np.stack([-step[:, 1], np.zeros(len(points)), step[:, 0]], -1) / length * (0.5 * width)
    vertices = np.stack([points - side, points + side], 1).reshape(-1, 3)
    corner = np.array([0, 1, 2, 1, 3, 2])
    faces = (2 * np.arange(len(points) - 1)[:, None] + corner).reshape(-1, 3)
    return make_mesh(vertices, faces)


def make_geom(model: mujoco.MjModel, geom: int) -> tuple[Geometry, bool] | None:
    """The mesh of a MuJoCo geom in its own frame and whether it is shaded smoothly; None for kinds not drawn."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return make_box((2.0 * size).tolist()), True
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return make_ellipsoid([float(size[0])] * 3), True
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return make_ellipsoid(size.tolist()), True
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return make_cylinder(size[0], -size[1], size[1]), True
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return make_capsule(size[0], size[1]), True
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        width, depth = (2.0 * s for s in size_plane(model, geom))
        return make_box([width, depth, PLANE_THICKNESS]), True
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(int(model.geom_dataid[geom]))
        vertex, face = int(mesh.vertadr[0]), int(mesh.faceadr[0])
        vertices = model.mesh_vert[vertex : vertex + int(mesh.vertnum[0])]
        return make_mesh(vertices, model.mesh_face[face : face + int(mesh.facenum[0])]), False
    return None
