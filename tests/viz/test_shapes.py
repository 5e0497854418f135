"""Solids: closed, of the right size, and facing outwards."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from vpptwin.viz.scene.geoms import read_paint
from vpptwin.viz.scene.meshes import SEGMENTS, make_capsule, make_cone, make_cylinder, make_geom, make_ribbon
from vpptwin.viz.scene.nodes import Geometry

# A polygon of n corners has n/(2 pi) sin(2 pi/n) of its circle's area.
POLYGON = SEGMENTS / (2 * np.pi) * np.sin(2 * np.pi / SEGMENTS)


def read_mesh(shape: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and faces (m, 3) of a mesh, from what the viewer is told."""
    data: Any = shape.content["data"]
    vertices = np.frombuffer(data["attributes"]["position"]["array"].data, dtype=np.float32)
    return vertices.reshape(-1, 3), np.frombuffer(data["index"]["array"].data, dtype=np.uint32).reshape(-1, 3)


def measure_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume enclosed by triangles that face outwards [m^3], by the divergence theorem."""
    a, b, c = (vertices[faces[:, i]].astype(float) for i in range(3))
    return float(np.sum(np.einsum("ij,ij->i", a, np.cross(b, c))) / 6.0)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (make_cylinder(0.1, -0.2, 0.3), np.pi * 0.1**2 * 0.5),
        (make_cone(0.1, 0.3), np.pi * 0.1**2 * 0.3 / 3),
        (make_capsule(0.1, 0.3), np.pi * 0.1**2 * 0.6 + 4 / 3 * np.pi * 0.1**3),
    ],
    ids=["cylinder", "cone", "capsule"],
)
def test_solid_encloses_its_volume(shape: Geometry, volume: float) -> None:
    """The triangles enclose the solid, less what the polygon cuts off; a wrong winding would make it negative."""
    measured = measure_volume(*read_mesh(shape))
    assert measured == pytest.approx(volume * POLYGON, rel=0.01)  # the capsule's ends are polygons along z too


def test_ribbon_has_six_indices_for_each_step() -> None:
    """The page shows the last seconds of the trail by counting six indices a frame."""
    points = np.stack([np.linspace(0, 1, 11), np.zeros(11), np.zeros(11)], -1)
    ribbon = make_ribbon(points, 0.02)
    vertices, faces = read_mesh(ribbon)
    assert faces.size == 6 * 10
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [1.0, 0.0, 0.02], atol=1e-6)


def test_every_mujoco_geom_is_drawn() -> None:
    """Box, sphere, capsule, cylinder, ellipsoid, plane and mesh have a shape; a colour comes from the material."""
    geoms = "".join(
        f'<geom type="{kind}" size="0.1 0.2 0.3"/>'
        for kind in ("box", "sphere", "capsule", "cylinder", "ellipsoid", "plane")
    )
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>'
        '<material name="red" rgba="1 0 0 0.5"/></asset>'
        f'<worldbody>{geoms}<geom type="mesh" mesh="m" material="red"/></worldbody></mujoco>'
    )
    assert all(make_geom(model, geom) is not None for geom in range(model.ngeom))
    paint = read_paint(model, model.ngeom - 1)
    assert (paint.colour, paint.opacity) == ("#FF0000", 0.5)


def test_geoms_without_a_colour_stand_out_from_the_floor() -> None:
    """MuJoCo's default grey would make floor and rig one: what moves is dark, what does not is pale."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body><joint type="slide"/><geom size="0.1"/></body>'
        '<body><joint type="slide"/><geom size="0.1" rgba="0 1 0 1"/></body></worldbody></mujoco>'
    )
    assert [read_paint(model, geom).colour for geom in range(3)] == ["#BFC4CC", "#26292E", "#00FF00"]
