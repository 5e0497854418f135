"""URDF as exporters write it: what MuJoCo cannot use is told by its tag or link, with what to do."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from vpptwin.system.errors import InputError
from vpptwin.system.resources import VARIABLE, name_packages
from vpptwin.twin.robot.model import compile_model

INERTIA = '<inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
JOINT = (
    '<joint name="{0}" type="{3}"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/>{4}'
    '<limit effort="{5}" velocity="1" lower="-1" upper="1"/></joint>'
)


def write(
    path: Path, upper: str = INERTIA.format(1), effort: str = "5", more: str = "", kind: str = "revolute"
) -> Path:
    """An arm of two links, `upper` and `fore`: what the first holds, how strong its motor is, what its joint says."""
    links = f'<link name="base"/><link name="upper">{upper}</link><link name="fore">{INERTIA.format(2)}</link>'
    joints = JOINT.format("shoulder", "base", "upper", kind, more, effort)
    joints += JOINT.format("elbow", "upper", "fore", "revolute", "", "3")
    path.write_text(f'<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">{links}{joints}</robot>')
    return path


def mesh(name: str, around: str = "collision") -> str:
    """A link's content with a mesh."""
    return f'{INERTIA.format(1)}<{around}><geometry><mesh filename="{name}"/></geometry></{around}>'


@pytest.mark.parametrize(
    ("upper", "kind", "parts"),
    [(mesh("package://arm_description/meshes/upper.stl"), "floating",
      ("<mesh> of link upper names package://arm_description/meshes/upper.stl, which is not found",
       "say --package arm_description=FOLDER")),
     (mesh("meshes/upper.stl"), "floating", ("<mesh> of link upper names meshes/upper.stl", "copy it there")),
     ("", "revolute", ("link upper moves and has no mass; expected <inertial>", "make its joint fixed")),
     ("<collision><geometry><sphere radius='1'/></geometry></collision>", "revolute", ("link upper moves",)),
     (INERTIA.format(0), "revolute", ("link upper moves and has no mass",)),
     ("<mesh", "revolute", ("expected a URDF, which is XML",)),
     ('<xacro:nothing/>', "revolute", ("xacro says", "xacro arm.urdf > arm_plain.urdf"))],
)  # fmt: skip
def test_what_is_missing_is_named(tmp_path: Path, upper: str, kind: str, parts: tuple[str, ...]) -> None:
    """The tag or the link, and what to do; a mesh only where the robot may touch what stands beside it."""
    for name in ("arm.urdf", "arm.xml"):
        with pytest.raises(InputError) as caught:
            compile_model(write(tmp_path / name, upper, kind=kind))
        for part in parts:
            assert part.replace("arm.urdf", name) in str(caught.value)


def test_meshes_are_found_by_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By what ROS says, by what the user says, or on the way up; they are looked at, and touch nothing."""
    folder = tmp_path / "ws" / "elsewhere"
    folder.mkdir(parents=True)
    write_mesh(folder / "upper.stl")
    path = write(tmp_path / "arm.urdf", mesh("package://arm_description/upper.stl"))
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", VARIABLE):
        monkeypatch.setenv(name, "")
    assert compile_model(path).ngeom == 0
    name_packages([f"arm_description={folder}"])
    model = compile_model(path)
    assert (model.ngeom, model.geom_contype.any(), model.geom_conaffinity.any()) == (1, False, False)
    monkeypatch.setenv(VARIABLE, "")
    for place in (tmp_path / "ros" / "arm_description", tmp_path / "ament" / "share" / "arm_description"):
        place.mkdir(parents=True)
        write_mesh(place / "upper.stl")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros"))
    assert compile_model(path).ngeom == 1
    monkeypatch.setenv("ROS_PACKAGE_PATH", "")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ament"))
    assert compile_model(path).ngeom == 1
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    home = tmp_path / "arm_description"
    (home / "urdf").mkdir(parents=True)
    write_mesh(home / "upper.stl")
    assert compile_model(write(home / "urdf" / "arm.urdf", mesh("package://arm_description/upper.stl"))).ngeom == 1
    for wrong in ("arm", "=x", f"arm={tmp_path / 'none'}"):
        with pytest.raises(InputError, match="NAME=DIR"):
            name_packages([wrong])


def write_mesh(path: Path) -> None:
    """A tetrahedron."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = b"".join(
        np.array([[0, 0, 0], *corners[list(face)]], "<f4").tobytes() + b"\0\0"
        for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    )
    path.write_bytes(bytes(80) + np.uint32(4).tobytes() + faces)


def test_xacro_is_expanded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With macros, properties and packages; what is wrong in it is one line, and inner code is refused."""
    pytest.importorskip("xacro")
    monkeypatch.setenv(VARIABLE, "")
    package = tmp_path / "parts"
    package.mkdir()
    head = '<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">'
    (package / "link.xacro").write_text(
        f'{head}<xacro:macro name="part" params="name mass"><link name="${{name}}">{INERTIA.format("${mass}")}</link>'
        "</xacro:macro></robot>"
    )
    joint = JOINT.format("hip", "base", "leg", "revolute", "", "${2 * effort}")
    body = f'<link name="base"/><xacro:part name="leg" mass="2"/>{joint}'
    path = tmp_path / "arm.urdf.xacro"
    whole = f'<xacro:include filename="$(find parts)/link.xacro"/><xacro:property name="effort" value="3"/>{body}'
    path.write_text(f"{head}{whole}</robot>")
    model = compile_model(path)
    np.testing.assert_allclose((model.body_mass[-1], model.jnt_actfrcrange[0, 1]), (2.0, 6.0))
    inner = "${[x.__class__ for x in [1]]}"
    for content, said in (
        ('<xacro:include filename="$(find nowhere)/x.xacro"/>', "say --package nowhere=FOLDER"),
        (f'<link name="{inner}"/>', "two underscores"),
        ("<xacro:part/>", "xacro says"),
    ):
        path.write_text(f"{head}{content}</robot>")
        with pytest.raises(InputError, match=said):
            compile_model(path)


def test_mimic_is_one_degree_of_freedom(tmp_path: Path) -> None:
    """What follows has no motor, stays where it belongs, and adds m² of its inertia to what leads."""
    path = write(tmp_path / "arm.urdf", more='<mimic joint="elbow" multiplier="-2" offset="0.1"/>')
    model = compile_model(path)
    assert [model.actuator(i).name for i in range(model.nu)] == ["elbow"]
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0.0
    data.qpos[:] = (0.1, 0.0)
    data.ctrl[:] = 3.0
    for _ in range(200):
        mujoco.mj_step(model, data)
    shoulder, elbow = data.qpos
    assert abs(shoulder - (0.1 - 2.0 * elbow)) < 1e-4
    # Both turn about one axis: 1 kg m² at the shoulder, and 1 kg m² that turns by both, so that
    # I = 1 · 2² + 1 · (1 - 2)² = 5 for the elbow's angle.
    np.testing.assert_allclose(data.qvel[1], 3.0 * data.time / 5.0, rtol=1e-3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"effort": "0"}, 'no motor drives shoulder, by <limit effort="0">; write what one can exert'),
     ({"effort": "0.0", "kind": "continuous"}, "no motor drives shoulder"),
     ({"more": '<mimic joint="elbow" multiplier="2"/>', "effort": "0"}, ""),
     ({"effort": "0", "kind": "prismatic"}, "no motor drives shoulder"),
     ({}, ""), ({"effort": "0.05"}, ""), ({"effort": "0", "kind": "fixed"}, ""),
     ({"upper": mesh("package://x/y.dae", "visual")}, "")],
)  # fmt: skip
def test_what_drives_nothing_is_told_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, str], said: str
) -> None:
    """In a line on standard error, and the model is there; of meshes for the eye alone nothing is asked."""
    path = write(tmp_path / "arm.urdf", **changes)
    models = [compile_model(path) for _ in range(2)]
    assert models[0].njnt == 2 - (changes.get("kind") == "fixed")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == bool(said)
    assert said in "".join(lines)
